"""Commands that are disturbed while they write, and the checks of what they leave; for ``faults`` and the tests."""

"""The living inventory: versions of buildings, changes, events and decisions, written and read."""

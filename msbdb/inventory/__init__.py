"""The inventory: buildings from parts."""

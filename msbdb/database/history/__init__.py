"""The living inventory: reading and writing versions of buildings, changes, events and decisions."""

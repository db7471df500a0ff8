"""Ground filters: from points to the terrain. `choice` is their one interface; each filter has a module."""

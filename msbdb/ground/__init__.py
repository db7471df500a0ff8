"""Ground filters: from points to the terrain; one module a filter behind one of two Protocols."""

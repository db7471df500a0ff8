"""Ground filters: from points to the terrain, one module a filter behind one Protocol."""

from msbdb.surface.ground.choose import GroundFilter, terrain

__all__ = ["GroundFilter", "terrain"]

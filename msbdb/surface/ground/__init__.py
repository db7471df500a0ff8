"""Ground filters: from points to the terrain, one module a filter behind one of two Protocols."""

from msbdb.surface.ground.adaptive import adaptive_ground
from msbdb.surface.ground.choose import GroundFilter, PointGroundFilter, terrain
from msbdb.surface.ground.quadratic import ground_heights, quadratic_ground

__all__ = ["GroundFilter", "PointGroundFilter", "adaptive_ground", "ground_heights", "quadratic_ground", "terrain"]

"""From points to surfaces: gridding, ground, heights above ground, and the texture of the surface."""

from msbdb.surface.build import Surface, build_surface, cover_from_surface, grid_surface, surface_from_rasters
from msbdb.surface.cover import Structure, drop_green_regions, structural_cover
from msbdb.surface.gridding import Samples, cell_size, density, sample_nearest
from msbdb.surface.ground import terrain
from msbdb.surface.heights import heights_above, normalise
from msbdb.surface.texture import Echoes, echoes, roughness

__all__ = [
    "Echoes",
    "Samples",
    "Structure",
    "Surface",
    "build_surface",
    "cell_size",
    "cover_from_surface",
    "density",
    "drop_green_regions",
    "echoes",
    "grid_surface",
    "heights_above",
    "normalise",
    "roughness",
    "sample_nearest",
    "structural_cover",
    "surface_from_rasters",
    "terrain",
]

"""Surfaces on the lattice: gridding, gaps, heights above ground, texture, and land cover by structure."""

from msbdb.surface.cover import cover_from_surface, crown_cells, crown_split, recorded_echoes, texture_of
from msbdb.surface.gridding import Samples, cell_size, density, sample_nearest
from msbdb.surface.heights import (
    Surface,
    density_of_cells,
    grid_surface,
    heights_above,
    heights_of_cells,
    normalise,
    points_of_cells,
    surface_from_rasters,
    without_narrow_gaps,
)
from msbdb.surface.structure import (
    Structure,
    cover_with_colours,
    drop_green_regions,
    structural_cover,
)
from msbdb.surface.texture import Echoes, Texture, echoes, roughness

__all__ = [
    "Echoes",
    "Samples",
    "Structure",
    "Surface",
    "Texture",
    "cell_size",
    "cover_from_surface",
    "cover_with_colours",
    "crown_cells",
    "crown_split",
    "density",
    "density_of_cells",
    "drop_green_regions",
    "echoes",
    "grid_surface",
    "heights_above",
    "heights_of_cells",
    "normalise",
    "points_of_cells",
    "recorded_echoes",
    "roughness",
    "sample_nearest",
    "structural_cover",
    "surface_from_rasters",
    "texture_of",
    "without_narrow_gaps",
]

"""Surfaces on the lattice: gridding, gaps, heights above ground, texture, and land cover by structure."""

from msbdb.surface.gridding import Samples, cell_size, density, sample_nearest
from msbdb.surface.heights import (
    Surface,
    grid_surface,
    heights_above,
    heights_of_cells,
    normalise,
    points_of_cells,
    surface_from_rasters,
)
from msbdb.surface.structure import (
    Structure,
    Texture,
    cover_from_surface,
    cover_with_colours,
    drop_green_regions,
    split_of_crowns,
    splits_in_crowns,
    structural_cover,
    texture_of,
)
from msbdb.surface.texture import Echoes, echoes, roughness

__all__ = [
    "Echoes",
    "Samples",
    "Structure",
    "Surface",
    "Texture",
    "cell_size",
    "cover_from_surface",
    "cover_with_colours",
    "density",
    "drop_green_regions",
    "echoes",
    "grid_surface",
    "heights_above",
    "heights_of_cells",
    "normalise",
    "points_of_cells",
    "roughness",
    "sample_nearest",
    "split_of_crowns",
    "splits_in_crowns",
    "structural_cover",
    "surface_from_rasters",
    "texture_of",
]

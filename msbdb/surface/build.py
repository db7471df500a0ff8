"""The stage as a whole: from points, or from rasters, to surfaces; and from surfaces to structural cover."""

import logging
from dataclasses import dataclass
from functools import partial

import numpy as np

from msbdb.grid import Grid, GridSpec, lattice
from msbdb.params import Params
from msbdb.pointcloud import PointCloud
from msbdb.surface.cover import Structure, structural_cover
from msbdb.surface.gridding import Samples, cell_size, density, fill_gaps, sample_nearest
from msbdb.surface.ground import terrain
from msbdb.surface.heights import normalise
from msbdb.surface.texture import echoes, grid_samples, roughness
from msbdb.threads import in_threads

logger = logging.getLogger(__name__)

LEAST_GAP_CELLS = 2.0
"""Gaps this wide are filled at any cell size: a jittered scan leaves them within its own spacing."""

GIVEN_GROUND = "given"
"""Stands for a ground filter where the terrain was given as a raster."""


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """The surfaces of one survey, all on one lattice.

    Parameters
    ----------
    dsm, dtm, ndsm : Grid of float32, metres
        Surface, terrain and height above ground.
    samples : Samples
        The heights as they were measured, for the texture.
    ground_filter : str
        Name of the filter that told the ground; ``given`` for a terrain raster.
    density : float
        First echoes, or cells of the source raster, a square metre.
    """

    dsm: Grid
    dtm: Grid
    ndsm: Grid
    samples: Samples
    ground_filter: str
    density: float


def build_surface(points: PointCloud, params: Params) -> Surface:
    """Grid the first echoes, tell the ground, and subtract it (V13 to V16).

    Parameters
    ----------
    points : PointCloud
        All echoes of the survey; outliers are gone.
    params : Params
        Sections ``surface`` and ``ground``.

    Raises
    ------
    NodataError
        When there is no first echo, or no ground.
    """
    points_m2 = density(points)
    cell_m = params.surface.cell_m or cell_size(points_m2, literal=params.surface.cell_rule == "literal")
    spec = lattice(points.bounds, cell_m, points.crs)
    dsm, samples = grid_surface(points, spec, params)
    dtm, name = terrain(points, spec, params.ground)
    logger.info("surface: %d x %d cells of %s m, %.2f points/m2, ground by %s", *spec.shape, cell_m, points_m2, name)
    return Surface(dsm, dtm, normalise(dsm, dtm), samples, name, points_m2)


def grid_surface(points: PointCloud, spec: GridSpec, params: Params) -> tuple[Grid, Samples]:
    """Grid the first echoes on a lattice (V14, V15), and fill the gaps between them.

    Returns
    -------
    dsm : Grid of float32, metres
        Valid where a first echo is near enough.
    samples : Samples
        The heights as they were measured.
    """
    samples = sample_nearest(points, spec)
    gap_cells = max(LEAST_GAP_CELLS, params.surface.max_gap_m / spec.cell_m)
    heights, valid = fill_gaps(samples, gap_cells)
    return Grid(heights.astype(np.float32), valid, spec), samples


def surface_from_rasters(dsm: Grid, dtm: Grid) -> Surface:
    """Take a surface and a terrain as they are given.

    Raises
    ------
    GridMismatchError
        When the lattices differ.
    """
    return Surface(dsm, dtm, normalise(dsm, dtm), grid_samples(dsm), GIVEN_GROUND, 1 / dsm.spec.cell_area_m2)


def cover_from_surface(surface: Surface, points: PointCloud | None, params: Params) -> Structure:
    """Tell roofs from vegetation by texture, and by echoes where there are any.

    Parameters
    ----------
    surface : Surface
        What ``build_surface`` or ``surface_from_rasters`` returned.
    points : PointCloud, optional
        The same points; None for a raster source.
    params : Params
        Sections ``surface`` and ``cover``.

    Returns
    -------
    Structure
        Building and vegetation above the mask, each cell's own probability of roof, and the roughness in the small
        window.
    """
    small_m, wide_m, mask_m = params.cover.window_m, params.cover.wide_window_m, params.surface.mask_m
    rough, wide = in_threads(partial(roughness, surface.samples), (small_m, wide_m))
    found = (
        None
        if points is None
        else echoes(points, surface.ndsm, surface.dtm, small_m=small_m, wide_m=wide_m, mask_m=mask_m)
    )
    return structural_cover(surface.ndsm, rough, wide, found, mask_m=mask_m, params=params.cover)

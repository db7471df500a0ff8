"""Surface, terrain and heights above ground: of the cells of a lattice, and of the points themselves."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from msbdb.errors import GridMismatchError
from msbdb.grid import Frame, Grid, GridSpec
from msbdb.kept import PER_METRE
from msbdb.morphology.windows import opening
from msbdb.params import Params
from msbdb.points.cloud import PointCloud
from msbdb.points.lots import lots
from msbdb.surface.gaps import fill_gaps
from msbdb.surface.gridding import Samples, sample_nearest
from msbdb.surface.texture import grid_samples
from msbdb.surveyplan import PointFacts
from msbdb.threads import in_threads, kernel

LEAST_GAP_CELLS = 2.0
"""Gaps this wide are filled at any cell size: a jittered scan leaves them within its own spacing."""

PART = 1_000_000
"""So many points at a time are worked on by a thread."""

WIDEST_M = 1.0
"""Ours: in windows of larger cells roofs are no planes, and the limits of roughness allow for it."""

ASIDE = 0.01
"""Ours: points that stand for cells lie up to half of this share of a cell beside its centre."""

SINGLE = 0.865
"""Ours, in sample: share of measured cells. With two echoes a cell on average, chance leaves e^-2 of them empty."""

GIVEN_GROUND = "given"
"""Name instead of a ground filter's, where the terrain was given as a raster."""


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
        Name of the ground filter; ``given`` for a terrain raster.
    density : float
        First echoes, or cells of the source raster, a square metre; see `density_of_cells`.
    terrain_known : bool
        Whether the terrain has its level; False where the source has heights above ground.
    roughness : mapping of (float, int) to (H, W) ndarray of float32
        Roughness of the samples, metres, where it was measured beside the terrain: by the side of the window, metres,
        and the least samples of a plane.
    """

    dsm: Grid
    dtm: Grid
    ndsm: Grid
    samples: Samples
    ground_filter: str
    density: float
    terrain_known: bool = True
    roughness: Mapping[tuple[float, int], NDArray[np.float32]] = field(default_factory=dict)


def normalise(dsm: Grid, dtm: Grid) -> Grid:
    """Subtract the terrain from the surface, nDSM = DSM - DTM (V13), in whole centimetres.

    Parameters
    ----------
    dsm, dtm : Grid
        On one lattice, metres.

    Returns
    -------
    Grid
        nDSM, metres; valid where both are, 0 elsewhere. Negative heights stay as they are.

    Raises
    ------
    GridMismatchError
        When the lattices differ.

    Examples
    --------
    >>> from pyproj import CRS
    >>> from msbdb.grid import lattice
    >>> spec, valid = lattice((0, 0.1, 1.9, 0.9), 1.0, CRS.from_epsg(2154)), np.ones((1, 2), dtype=bool)
    >>> normalise(Grid(np.array([[57.31, 51.0]]), valid, spec), Grid(np.array([[51.3, 51.2]]), valid, spec)).values
    array([[ 6.01, -0.2 ]], dtype=float32)
    """
    if not dsm.spec.same_lattice(dtm.spec):
        msg = (
            f"The DSM {dsm.spec.shape} at {dsm.spec.bounds} and the DTM {dtm.spec.shape} at {dtm.spec.bounds} must "
            "share one lattice; resample one of them."
        )
        raise GridMismatchError(msg)
    valid = dsm.valid & dtm.valid
    height = np.asarray(dsm.values, dtype=np.float64) - np.asarray(dtm.values, dtype=np.float64)
    height[~valid] = 0
    height *= PER_METRE
    np.rint(height, out=height)
    height /= PER_METRE
    return Grid(height.astype(np.float32), valid, dsm.spec)


def heights_above(points: PointCloud, dtm: Grid) -> NDArray[np.float64]:
    """Subtract the terrain from the points themselves; only the terrain is a raster (C13, S1).

    Parameters
    ----------
    points : PointCloud
        N points in the terrain's CRS.
    dtm : Grid
        Terrain without gaps, metres; taken bilinearly between cell centres, and held constant beyond the outermost.

    Returns
    -------
    (N,) ndarray of float64
        Heights above ground, metres; negative below it.
    """
    terrain, heights = np.asarray(dtm.values), np.empty(len(points))

    def subtract(part: slice) -> None:
        _subtract((points.x[part], points.y[part], points.z[part]), terrain, dtm.spec.frame, heights[part])

    in_threads(subtract, [slice(start, start + PART) for start in range(0, len(points), PART)])
    return heights


@kernel
def _subtract(
    xyz: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
    terrain: NDArray[np.floating],
    frame: Frame,
    heights: NDArray[np.float64],
) -> None:
    """Subtract the terrain at each point, bilinearly; the same as `scipy.ndimage.map_coordinates` to the last bit."""
    x, y, z = xyz
    last_row, last_col = terrain.shape[0] - 1, terrain.shape[1] - 1
    for i in range(x.size):
        # A whole number is taken off without rounding, so that no window changes the shares.
        down = (frame.north_m - y[i]) / frame.cell_m - frame.row - 0.5
        right = (x[i] - frame.east_m) / frame.cell_m - frame.col - 0.5
        row, col = math.floor(down), math.floor(right)
        north_share, west_share = 1 - (down - row), 1 - (right - col)
        south_share, east_share = 1 - north_share, 1 - west_share
        above, below = min(max(row, 0), last_row), min(max(row + 1, 0), last_row)
        left, beside = min(max(col, 0), last_col), min(max(col + 1, 0), last_col)
        level = terrain[above, left] * north_share * west_share + terrain[above, beside] * north_share * east_share
        level = level + terrain[below, left] * south_share * west_share
        heights[i] = z[i] - (level + terrain[below, beside] * south_share * east_share)


def points_of_cells(surface: Surface) -> PointCloud:
    """Return the cells of a surface as points, for detectors on points where the source is a raster of heights.

    Parameters
    ----------
    surface : Surface
        N of its cells stand for points.

    Returns
    -------
    PointCloud
        N points in row order, one in the middle of each such cell, at the height of the DSM: single echoes.

    Notes
    -----
    All cells with a height above ground stand for points. Where less than `SINGLE` of them were measured, only the
    measured ones do, as what fills the gaps is too even; the spacing is then that of their density.
    Distances on an exact lattice tie, and rounding would decide. So each point lies a little beside the centre of its
    cell, by a hash of its place: in any window of a survey alike.

    Examples
    --------
    >>> from pyproj import CRS
    >>> from msbdb.grid import lattice
    >>> spec, valid = lattice((0, 0.1, 1.9, 0.9), 1.0, CRS.from_epsg(2154)), np.ones((1, 2), dtype=bool)
    >>> dsm, dtm = (Grid(np.full((1, 2), level, dtype=np.float32), valid, spec) for level in (57, 51))
    >>> points = points_of_cells(surface_from_rasters(dsm, dtm))
    >>> points.x.round(1), points.z, points.facts.spacing_m
    (array([0.5, 1.5]), array([57., 57.]), 1.0)
    """
    chosen, spec, density = _standing(surface), surface.ndsm.spec, surface.density
    spacing_m = spec.cell_m / math.sqrt(round(density * spec.cell_area_m2, 9))  # to the bit the cell without gaps
    x, y = spec.xy(*np.nonzero(chosen))
    facts = PointFacts(
        points=len(x),
        density=density,
        all_density=density,
        spacing_m=spacing_m,
        typical_m=spacing_m,
        sparse_m=spacing_m,
        link_m=spacing_m,
        numbered=False,
        echoes=False,
        crown_split=None,
        under_m=0.0,
        ground_share=0.0,
        colours=(),
        intensity=False,
        levels_m=(),
    )
    cells = PointCloud(x, y, np.asarray(surface.dsm.values, dtype=np.float64)[chosen], spec.crs, facts=facts)
    bits = lots(cells)
    beside = ((bits >> np.uint64(shift) & np.uint64(2**16 - 1)) / 2**16 - 0.5 for shift in (48, 32))
    x, y = (place + ASIDE * spec.cell_m * each for place, each in zip((x, y), beside, strict=True))
    return replace(cells, x=x, y=y)


def heights_of_cells(surface: Surface) -> NDArray[np.float64]:
    """Return the heights of `points_of_cells` above ground, metres."""
    return np.asarray(surface.ndsm.values, dtype=np.float64)[_standing(surface)]


def density_of_cells(surfaces: Sequence[Surface]) -> float:
    """Return the cells of rasters on one lattice a square metre.

    Where less than `SINGLE` of the cells with a height were measured, only the measured ones count.
    """
    measured = sum(int(np.count_nonzero(each.ndsm.valid & each.samples.observed)) for each in surfaces)
    covered = sum(int(np.count_nonzero(each.ndsm.valid)) for each in surfaces)
    share = measured / covered if 0 < measured < SINGLE * covered else 1.0
    return share / surfaces[0].ndsm.spec.cell_area_m2


def _standing(surface: Surface) -> NDArray[np.bool_]:
    """Return the cells that stand for points."""
    valid, measured = surface.ndsm.valid, surface.samples.observed
    return valid & measured if surface.density * surface.ndsm.spec.cell_area_m2 < SINGLE else valid


def grid_surface(points: PointCloud, spec: GridSpec, params: Params) -> tuple[Grid, Samples]:
    """Grid the first echoes on a lattice (V14, V15), and fill the gaps between them.

    Returns
    -------
    dsm : Grid of float32, metres
        Valid where a first echo is near enough.
    samples : Samples
        The heights as they were measured.
    """
    samples = sample_nearest(points, spec, params.surface.below_top_m)
    gap_cells = max(LEAST_GAP_CELLS, params.surface.max_gap_m / spec.cell_m)
    heights, valid = fill_gaps(samples, gap_cells)
    return Grid(heights.astype(np.float32), valid, spec), samples


def without_narrow_gaps(dsm: Grid, max_gap_m: float) -> Grid:
    """Fill the narrow gaps of a raster of heights, as those between points (V14): many rasters were not interpolated.

    Parameters
    ----------
    dsm : Grid of float32, metres
        The measured cells are valid.
    max_gap_m : float
        Gaps up to twice as wide are narrow, metres, and those up to twice `LEAST_GAP_CELLS`.

    Returns
    -------
    Grid of float32, metres
        Cells of narrow gaps have the height of the nearest measured cell, of equally near ones the lower. Gaps that
        hold a wider square are water, or the end of the survey: there nothing is added.

    Examples
    --------
    >>> from pyproj import CRS
    >>> from msbdb.grid import lattice
    >>> spec = lattice((0, 0.1, 9.9, 0.9), 1.0, CRS.from_epsg(2154))
    >>> valid = np.array([[True, False, True, True, False, False, False, False, False, False]])
    >>> without_narrow_gaps(Grid(np.full((1, 10), 7, dtype=np.float32) * valid, valid, spec), 1.0).values
    array([[7., 7., 7., 7., 0., 0., 0., 0., 0., 0.]], dtype=float32)
    """
    if dsm.valid.all():
        return dsm
    reach = max(LEAST_GAP_CELLS, max_gap_m / dsm.spec.cell_m)
    missing = ~dsm.valid
    wide = opening(missing.astype(np.float32), 2 * int(reach) + 1, None) > 0
    if np.array_equal(wide, missing):
        return dsm
    heights, near = fill_gaps(grid_samples(dsm), 2 * reach)  # twice: where narrow gaps cross, they are wider
    valid = near & ~wide
    return Grid(np.where(valid, heights, 0).astype(np.float32), valid, dsm.spec)


def surface_from_rasters(
    dsm: Grid, dtm: Grid, *, measured: NDArray[np.bool_] | None = None, terrain_known: bool = True
) -> Surface:
    """Take a surface and a terrain as they are given.

    Of the surface the cells that were ``measured``, all unless given, count as samples.
    ``terrain_known`` is False where the surface holds heights above ground, and the terrain is 0 everywhere.

    Raises
    ------
    GridMismatchError
        When the lattices differ.
    """
    cell_m = dsm.spec.cell_m
    seen = dsm if measured is None else Grid(dsm.values, measured, dsm.spec)
    samples = grid_samples(seen, cell_m if cell_m <= WIDEST_M else 0.0)
    surface = Surface(dsm, dtm, normalise(dsm, dtm), samples, GIVEN_GROUND, 1 / dsm.spec.cell_area_m2, terrain_known)
    return replace(surface, density=density_of_cells([surface]))

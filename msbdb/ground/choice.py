"""The choice of the ground filter, and the terrain that it gives: all filters behind one interface."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, uniform_filter

from msbdb.errors import NodataError, give_notice
from msbdb.grid import Grid, GridSpec, lattice
from msbdb.ground.adaptivewindows import adaptive_ground
from msbdb.ground.interpolation import NearestGround, interpolate_ground, refine
from msbdb.ground.progressive import progressive_ground
from msbdb.ground.quadratic import quadratic_ground
from msbdb.ground.regions import WAY_PX, bridges
from msbdb.ground.walls import wall_step_m, walled_ground
from msbdb.ground.wavelet import wavelet_ground
from msbdb.labels import chosen_cells, join_cells, label_zones, sizes, sums
from msbdb.morphology.windows import dilation
from msbdb.params import GroundParams
from msbdb.points.cloud import GROUND_CLASS, PointCloud
from msbdb.surface.gridding import density, lowest
from msbdb.threads import kernel

MIN_GROUND_SHARE = 0.02
"""Below this share of class 2 the given classes are not taken for a classification of the ground."""

DECKS = "The given ground leaves out bridges. Decks that it leads to count as ground, so that they are no buildings."
"""Notice of decks."""

VOID_M = 10.0
"""Radius of the circles without points that make a void: water, or beyond the survey. Sparse scan lines lie nearer."""

SIDE = 5
"""Side of the square of cells whose median shows a pit."""

PIT_M2 = 10.0
"""As ``vector.court_m2``: smaller hollows are false echoes or light wells; lanes and courts are larger."""


class GroundFilter(Protocol):
    """Detects the ground cells of a grid of lowest points."""

    def __call__(self, surface: Grid, params: GroundParams, points_m2: float = ..., /) -> NDArray[np.bool_]:
        """Return the (H, W) mask of ground cells.

        Parameters
        ----------
        surface : Grid
            Lowest heights, gap-free, metres. Valid are the cells near points; the values of others are mere guesses.
        params : GroundParams
            The filter's parameters.
        points_m2 : float
            First echoes a square metre; by default so many that it does not matter.
        """


class PointGroundFilter(Protocol):
    """Detects the ground points of a cloud, without a grid."""

    def __call__(self, points: PointCloud, params: GroundParams, /) -> NDArray[np.bool_]:
        """Return the (N,) mask of ground points.

        Parameters
        ----------
        points : PointCloud
            N points, all echoes.
        params : GroundParams
            The filter's parameters.
        """


FILTERS: dict[str, GroundFilter] = {
    "progressive": lambda surface, params, _=0.0: progressive_ground(surface, params),
    "walls": walled_ground,
    "wavelet": lambda surface, params, _=0.0: wavelet_ground(surface, params),
}

POINT_FILTERS: dict[str, PointGroundFilter] = {"quadratic": quadratic_ground, "adaptive": adaptive_ground}


def terrain(points: PointCloud, spec: GridSpec, params: GroundParams) -> tuple[Grid, str]:
    """Return the DTM on a lattice, and the name of the ground filter.

    The filter detects the ground among points or cells. The terrain is interpolated under the other ones on cells of
    ``ground_cell_m``, or of half the lattice's where those are larger, and taken bilinearly at the lattice's cells.
    Walls are steps between cells: on cells as large as the spacing of sparse points, low houses would have none.

    Parameters
    ----------
    points : PointCloud
        All echoes.
    spec : GridSpec
        Lattice of the DTM.
    params : GroundParams
        ``ground_filter`` names the filter; ``auto`` trusts class 2 where at least 2 % of the points have it.

    Raises
    ------
    NodataError
        When class 2 is asked for and no point has it.
    """
    name = _resolve(points, params.ground_filter)
    coarse = lattice(spec.bounds, max(params.ground_cell_m, spec.cell_m / 2), spec.crs)
    if name == "class2":
        given = _through(points, points.in_class(GROUND_CLASS), coarse)
        return refine(with_decks(given, points, params), spec), name
    if name in POINT_FILTERS:
        return refine(_through(points, POINT_FILTERS[name](points, params), coarse), spec), name
    surface = lowest_surface(points, coarse, params)
    ground = FILTERS[name](surface, params, density(points))
    return refine(interpolate_ground(surface.values, ground, coarse), spec), name


def _through(points: PointCloud, ground: NDArray[np.bool_], spec: GridSpec) -> Grid:
    """Lay the terrain through the lowest ground point of each cell."""
    found = lowest(points, spec, ground)
    return interpolate_ground(found.values, found.valid, spec)


def with_decks(given: Grid, points: PointCloud, params: GroundParams) -> Grid:
    """Raise a given terrain to the decks of bridges, which class 2 and most terrain models leave out.

    On average a deck lies higher than a step to another region; what is lower is no building, and stays as it is given.
    The filter by walls takes bridges for ground, too.

    Parameters
    ----------
    given : Grid of float32, metres
    points : PointCloud
        All echoes.
    params : GroundParams
        ``height_m`` and the parameters of `bridges`.

    Returns
    -------
    Grid of float32, metres
        On the same lattice, with the same gaps; without any deck the same object. Border: as that of `bridges`.
    """
    spec = lattice(given.spec.bounds, max(params.ground_cell_m, given.spec.cell_m), given.spec.crs)
    known = given if given.valid.all() else interpolate_ground(given.values, given.valid, given.spec)
    surface, own = lowest_surface(points, spec, params), np.asarray(refine(known, spec).values)
    above = np.asarray(surface.values) - own
    ground, step_m = surface.valid & (above < params.height_m), wall_step_m(spec.cell_m, params)
    zones, count = label_zones(bridges(surface, own, ground, step_m, params))
    high = sums(zones, above, count) > step_m * sizes(zones, count)
    if not high.any():
        return given
    decks = chosen_cells(zones, high)
    give_notice(DECKS)
    raised = np.where(decks, above, 0).astype(np.float32)
    # Cells at its edge, and those in which echoes came from below, are a deck above what was seen there.
    raised = np.where(ground, dilation(raised, WAY_PX, None), raised)
    raised = np.asarray(refine(Grid(raised, surface.valid, spec), given.spec).values)
    return given.with_values(np.asarray(given.values) + raised)


def lowest_surface(points: PointCloud, spec: GridSpec, params: GroundParams) -> Grid:
    """Grid the lowest points without gaps, with isolated low outliers raised to their neighbourhood.

    All cells have values. Not valid are voids: what a circle of `VOID_M` covers that holds no cell with points. So the
    survey ends with its outermost points where its border crosses the lattice at an angle. Centres beyond the lattice
    do not count, so that a frame of empty cells, as lattices have it, is no void.
    """
    found = lowest(points, spec)
    supported = _supported(found.valid)
    sources = NearestGround.of(supported)
    filled = interpolate_ground(found.values, supported, spec, nearest=True, sources=sources).values
    raised = without_pits(np.asarray(filled, dtype=np.float32), params.low_outlier_m, spec.cell_area_m2)
    return Grid(raised, _surveyed(sources, max(VOID_M / spec.cell_m, 2.0)), spec)


def _surveyed(sources: NearestGround, radius: float) -> NDArray[np.bool_]:
    """Return the cells that no circle of ``radius`` cells reaches whose centre is as far from all cells with points."""
    empty = sources.distance > radius
    if not empty.any():
        return np.ones_like(empty)
    surveyed: NDArray[np.bool_] = distance_transform_edt(~empty) > radius
    return surveyed


def without_pits(heights: NDArray[np.float32], depth_m: float, cell_m2: float = 1.0) -> NDArray[np.float32]:
    """Raise the cells of pits to ``depth_m`` below the median of the 5 by 5 cells around them.

    A pit is a region of at most `PIT_M2`, connected by steps of less than ``depth_m``. A lane between roofs, or the
    corner of a court, lies as far below most cells around it, but belongs to a larger region.

    Parameters
    ----------
    heights : (H, W) ndarray of float32, metres
        Without gaps.
    depth_m : float
        How far a cell of a pit may lie below the median, metres.
    cell_m2 : float
        The area of a cell.

    Returns
    -------
    (H, W) ndarray of float32, metres

    Notes
    -----
    The median is sought only where it decides: where most of the 25 cells lie higher by more than the depth.
    Border: the outermost cell is repeated. Linear in the cells.

    Examples
    --------
    >>> without_pits(np.float32([[5, 5, 5], [5, 1, 4], [5, 5, 5]]), 0.5)
    array([[5. , 5. , 5. ],
           [5. , 4.5, 4.5],
           [5. , 5. , 5. ]], dtype=float32)
    """
    framed = np.pad(heights, SIDE // 2, mode="edge")
    raised = _raised(framed, np.float32(depth_m))
    regions, count = join_cells(heights, np.ones(heights.shape, dtype=np.bool_), depth_m)
    small = np.bincount(regions.ravel(), minlength=count) * cell_m2 <= PIT_M2
    return np.where(small[regions], raised, heights)


@kernel
def _raised(framed: NDArray[np.float32], depth: np.float32) -> NDArray[np.float32]:
    """Return the cells of `without_pits`, of heights with a frame as wide as half of the square."""
    half = SIDE // 2
    rows, cols = framed.shape[0] - 2 * half, framed.shape[1] - 2 * half
    raised = framed[half : half + rows, half : half + cols].copy()
    # Rounding keeps the order, so that the median of the floors is the floor of the median.
    higher, floors = np.empty(cols, dtype=np.int8), np.empty(SIDE * SIDE, dtype=np.float32)
    for row in range(rows):
        own = raised[row]
        higher[:] = 0
        for i in range(SIDE):
            for j in range(SIDE):
                line = framed[row + i, j : j + cols]
                for col in range(cols):
                    higher[col] += line[col] - depth > own[col]
        for col in range(cols):
            if 2 * higher[col] > floors.size:
                for i in range(SIDE):
                    for j in range(SIDE):
                        floors[SIDE * i + j] = framed[row + i, col + j] - depth
                own[col] = np.sort(floors)[floors.size // 2]
    return raised


def _supported(observed: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Leave out cells alone in a void, where a single false echo would decide the terrain of all of it.

    Such a cell has fewer than two observed others among the 24 around it; where that is most cells, all of them stay.
    """
    around = uniform_filter(observed.astype(np.float32), 5, mode="constant") * 25
    supported = observed & (around > 2.5)
    return supported if 2 * np.count_nonzero(supported) > np.count_nonzero(observed) else observed


def _resolve(points: PointCloud, name: str) -> str:
    """Turn ``auto`` into the filter that fits the points, and check that class 2 is there when asked for."""
    known = points.facts
    own = float(np.count_nonzero(points.in_class(GROUND_CLASS))) / max(len(points), 1)
    share = own if known is None else known.ground_share
    if name == "auto":
        return "class2" if share >= MIN_GROUND_SHARE else "walls"
    if name == "class2" and share == 0.0:
        msg = "The ground filter 'class2' needs points of class 2, and no point has it; take 'walls' or 'progressive'."
        raise NodataError(msg)
    return name

"""Terrain from ground cells: gaps filled smoothly, the step to a finer lattice, and the edges of what is above ground.

The filters on cells check regions by their edges: walls rise above the ground beside them in a step, hills do not.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from msbdb.errors import NodataError
from msbdb.grid import Grid, GridSpec
from msbdb.ground.trend import bilinear, known_trend
from msbdb.labels import sizes
from msbdb.morphology.windows import erosion
from msbdb.params import GroundParams
from msbdb.threads import kernel

Heights = NDArray[np.float32]
Counts = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class NearestGround:
    """The nearest cell of ground, or of any other mask, of each cell.

    Parameters
    ----------
    distance : (H, W) ndarray of float64
        To its centre, cells; 0 on ground.
    place : (2, H, W) ndarray of int32
        Its row and column.
    """

    distance: NDArray[np.float64]
    place: NDArray[np.int32]

    @classmethod
    def of(cls, ground: NDArray[np.bool_]) -> "NearestGround":
        """Find it for an (H, W) mask; without any cell in the mask the result has no meaning."""
        return cls(*distance_transform_edt(~ground, return_indices=True))


def interpolate_ground(
    values: NDArray[np.generic],
    ground: NDArray[np.bool_],
    spec: GridSpec,
    *,
    nearest: bool = False,
    sources: NearestGround | None = None,
) -> Grid:
    """Fill the cells that are not ground from those that are.

    Parameters
    ----------
    values : (H, W) ndarray of float32, metres
        Heights; those outside of the ground are ignored.
    ground : (H, W) ndarray of bool
        Ground cells.
    spec : GridSpec
        Their lattice.
    nearest : bool
        Take the nearest ground cell as it is, instead of a smooth surface through all around.
    sources : NearestGround, optional
        The nearest ground of each cell, where it is known already.

    Raises
    ------
    NodataError
        When no cell is ground.

    Notes
    -----
    The trend of the ground is subtracted (`msbdb.ground.trend.known_trend`), so that a slope goes on under a block that
    the border cuts. Of the rest, a gap takes the nearest ground, which means over windows of 65, 33, 17, 9, 5 and 3
    cells then smooth. Ground cells keep their heights, and no other cell is above the highest or below the lowest.

    Examples
    --------
    A roof on a slope of 1 in 1 is replaced by the slope:

    >>> from pyproj import CRS
    >>> from msbdb.grid import lattice
    >>> spec = lattice((0, 0.1, 6.9, 0.9), 1.0, CRS.from_epsg(2154))
    >>> heights, ground = np.array([[0.0, 1, 2, 9, 4, 5, 6]]), np.array([[1, 1, 1, 0, 1, 1, 1]], dtype=bool)
    >>> interpolate_ground(heights, ground, spec).values.round(1)
    array([[0., 1., 2., 3., 4., 5., 6.]], dtype=float32)
    """
    if not ground.any():
        msg = "No ground was found, so that heights above ground are unknown; check the ground filter's parameters."
        raise NodataError(msg)
    known = np.asarray(values, dtype=np.float32)
    if not ground.all():
        sources = sources or NearestGround.of(ground)
        rows, cols = sources.place
        if nearest:
            known = known[rows, cols]
        else:
            trend = known_trend(known, ground, spec.origin)
            smooth = trend + _relax((known - trend)[rows, cols], sources.distance)
            known = np.where(ground, known, np.clip(smooth, known[ground].min(), known[ground].max()))
    return Grid(known, np.ones(spec.shape, dtype=np.bool_), spec)


def _relax(filled: NDArray[np.float32], distance: NDArray[np.float64]) -> NDArray[np.float32]:
    """Smooth the filled cells by means over shrinking windows; ground cells are fixed.

    A window changes only the cells at least half its radius from the ground. Nearer cells get better values from
    smaller windows; at the border, where windows are cut, large ones would pull them off a slope.
    """
    surface = np.ascontiguousarray(filled)
    for radius in (32, 16, 8, 4, 2, 1):
        free = distance >= max(radius / 2, 1)
        if not free.any():
            continue
        for _ in range(4):
            surface = means_over_windows(surface, free, radius)
    return surface


@kernel
def means_over_windows(values: Heights, chosen: NDArray[np.bool_], radius: int) -> Heights:
    """Return heights in which each chosen cell has the mean of the square around it, 2·radius + 1 cells wide.

    The outermost cell is repeated beyond the border. The means are those of `scipy.ndimage.uniform_filter` to the bit:
    sums run down the columns, then along the rows. That function takes three times as long, and knows no mask.
    """
    (rows, cols), width = values.shape, 2 * radius + 1
    result = values.copy()
    column, framed = np.zeros(cols), np.empty(cols + 2 * radius)
    for row in range(-radius, radius + 1):
        line = values[min(max(row, 0), rows - 1)]
        for col in range(cols):
            column[col] += line[col]
    for row in range(rows):
        if row > 0:
            after, before = values[min(row + radius, rows - 1)], values[max(row - radius - 1, 0)]
            for col in range(cols):
                column[col] += np.float64(after[col]) - np.float64(before[col])
        if not chosen[row].any():
            continue
        for col in range(cols):
            framed[radius + col] = np.float32(column[col] / width)
        framed[:radius], framed[radius + cols :] = framed[radius], framed[radius + cols - 1]
        total = framed[:width].sum()
        for col in range(cols):
            if col > 0:
                total += framed[col + width - 1] - framed[col - 1]
            if chosen[row, col]:
                result[row, col] = total / width
    return result


def refine(coarse: Grid, spec: GridSpec) -> Grid:
    """Bring a gap-free grid onto another lattice bilinearly; beyond the outermost centres it is held constant."""
    if coarse.spec.same_lattice(spec):
        return coarse
    rows, cols = np.arange(spec.shape[0]), np.arange(spec.shape[1])
    east, north = spec.xy(np.zeros_like(cols), cols)[0], spec.xy(rows, np.zeros_like(rows))[1]
    own = coarse.spec.frame
    # A whole number is taken off without rounding, so that no window changes the shares of the cells.
    row = (own.north_m - north) / own.cell_m - own.row - 0.5
    col = (east - own.east_m) / own.cell_m - own.col - 0.5
    source = np.asarray(coarse.values, dtype=np.float32)
    values = bilinear(source, np.clip(row, 0, source.shape[0] - 1), np.clip(col, 0, source.shape[1] - 1))
    return Grid(values, np.ones(spec.shape, dtype=np.bool_), spec)


def edge_step(params: GroundParams, cell_m: float) -> float:
    """Return the step of an edge, metres: it grows with cells above 1 m, over which terrain itself rises more."""
    return params.edge_step_m * max(cell_m, 1.0)


def count_edges(
    labels: NDArray[np.int32], count: int, heights: Heights, beside: Heights, step_m: float
) -> tuple[Counts, Counts]:
    """Count the cells on the boundary of each cluster, and those of them that are an edge.

    Parameters
    ----------
    labels : (H, W) ndarray of int32
        Clusters 1 to ``count``; 0 elsewhere.
    count : int
        Number of clusters.
    heights : (H, W) ndarray of float32, metres
        Lowest heights.
    beside : (H, W) ndarray of float32, metres
        Heights of the cells to compare with; infinity in all other cells.
    step_m : float
        A cell more than this above the lowest of its eight neighbours in ``beside`` is an edge.

    Returns
    -------
    boundary, edges : (count,) ndarray of int
        Cells of each cluster with a neighbour in ``beside``, and the edges among them.
    """
    lowest = erosion(beside, 3, None)
    boundary = (labels > 0) & np.isfinite(lowest)
    edges = boundary & (heights - np.where(boundary, lowest, 0) > step_m)
    return sizes(labels[boundary], count), sizes(labels[edges], count)

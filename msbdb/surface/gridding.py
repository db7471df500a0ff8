"""Gridding of points: the mean spacing, and the nearest, the highest and the lowest values of cells.

Nothing here depends on the order of the points: ties go to the lower point, and sums are of whole numbers.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msbdb.errors import NodataError
from msbdb.grid import Frame, Grid, GridSpec, lattice
from msbdb.points.cellindex import index_cells, number_along
from msbdb.points.cloud import PointCloud
from msbdb.threads import kernel

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Squares = tuple[Frame, tuple[int, int], int]
"""A lattice, its rows and columns of cells, and into how many squares each cell is divided along an axis."""

CELL_LADDER_M = (0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0)
"""Round cell sizes, so that surveys of like density, and tiles of one survey, share a lattice.

No cell is smaller than 0.3 m: dense surveys come out worse on cells of 0.25 m, where a window of 0.9 m has five cells.
"""

PLACE_M = 0.3
"""Echoes about this near to each other in plan are of one place: the width of the spot that a pulse lights."""

LEVEL_M, LEAST_BEHIND = 0.5, 3
"""Ours, in sample: neighbouring heights of a roof differ by less, metres, and so many cells lie behind its edge."""

OCCUPANCY_CELL_M = 2.0
"""Cell on which the covered area is counted for the density."""

LEAST_A_CELL, OCCUPANCY_GROWTH, LARGEST_OCCUPANCY_M = 4, 1.5, 100.0
"""Scattered points: the mean number in a cell that is needed, the growth of the cells, and their largest size."""


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """The first echo nearest to each cell centre.

    Parameters
    ----------
    z : (H, W) ndarray of float64, metres
        Its height; NaN where the cell holds no first echo.
    east, north : (H, W) ndarray of float32, metres
        Its offset from the cell centre.
    spec : GridSpec
        The lattice.
    within_m : float
        Side of the square around that place in which it may lie, metres; 0 where it is known.
    """

    z: NDArray[np.float64]
    east: NDArray[np.float32]
    north: NDArray[np.float32]
    spec: GridSpec
    within_m: float = 0.0

    @property
    def observed(self) -> NDArray[np.bool_]:
        """Where a cell holds a first echo."""
        return np.isfinite(self.z)


def density(points: PointCloud, link_m: float = 0.0) -> float:
    """First echoes a square metre of covered ground; of the whole survey, where that is known.

    Covered are the 2 m cells that hold a first echo. Sparse points would cover less than their share, and islands far
    apart would need many empty cells. Cells grow where the bounding box has less than one echo a cell, or the covered
    cells less than four. They then hold four on average, or are `LARGEST_OCCUPANCY_M` wide. They also grow up to the
    least link between points (`msbdb.points.spacing.least_link`), as no cell between two scan lines is open ground.

    Raises
    ------
    NodataError
        When there is no first echo.
    """
    if points.facts is not None:
        return points.facts.density
    first = points.first_echo
    count = int(np.count_nonzero(first))
    if count == 0:
        msg = "No point is a first echo (V15), so that no surface can be made; check the return numbers of the source."
        raise NodataError(msg)
    x, y = points.x, points.y
    spec = lattice(_bounds(x, y, first), OCCUPANCY_CELL_M, points.crs)
    if link_m <= OCCUPANCY_CELL_M and count >= spec.shape[0] * spec.shape[1]:
        covered = np.count_nonzero(_occupied(x, y, first, spec.frame, spec.shape))
        if count >= LEAST_A_CELL * covered:
            return float(count / (covered * spec.cell_area_m2))
    return _scattered_density(x[first], y[first], link_m)


def _scattered_density(x: Floats, y: Floats, link_m: float) -> float:
    """Return the points a square metre of the cells that hold any, on cells that hold four on average."""
    cell_m = OCCUPANCY_CELL_M
    while True:
        cells = index_cells(x, y, cell_m)
        enough = cells.order.size >= LEAST_A_CELL * cells.keys.size and cell_m >= link_m
        if enough or cell_m >= LARGEST_OCCUPANCY_M:
            return cells.order.size / (cells.keys.size * cell_m**2)
        cell_m *= OCCUPANCY_GROWTH


def cell_size(points_m2: float, *, literal: bool = False) -> float:
    """Return the round cell size nearest to the mean point spacing, 1/sqrt(density) (V14), metres.

    With ``literal`` it is R_g = 1/density as Mongus et al. print it (M7, A10), in whole centimetres.

    Examples
    --------
    Twelve points a square metre lie 0.28 m apart:

    >>> cell_size(12.35), cell_size(12.35, literal=True)
    (0.3, 0.08)
    """
    if literal:
        return max(round(1 / points_m2, 2), 0.01)
    spacing = 1.0 / np.sqrt(points_m2)
    ladder = np.asarray(CELL_LADDER_M)
    return float(ladder[np.argmin(np.abs(np.log(ladder / spacing)))])


def sample_nearest(points: PointCloud, spec: GridSpec, below_top_m: float = 0.0) -> Samples:
    """Take for each cell the first echo nearest to its centre (V14, V15); ties go to the lower point.

    Parameters
    ----------
    points : PointCloud
        The points, in any order.
    spec : GridSpec
        The lattice.
    below_top_m : float
        How far the nearest echo of a cell may lie below a roof, metres; 0 takes the nearest of all. See the notes.

    Returns
    -------
    Samples
        A cell that holds a first echo has a sample.

    Notes
    -----
    At an edge the nearest echo may lie on the wall, or on the ground beside its foot. So each cell is divided into
    squares of about `PLACE_M`. Upper echoes are those within `LEVEL_M` of the highest one of their square. The nearest
    upper echo is taken if both hold:

    - it lies more than ``below_top_m`` above the nearest echo of all;
    - `LEAST_BEHIND` of the eight cells around have their nearest echo within `LEVEL_M` of its height, as a roof goes on
      behind its edge. Within a crown heights differ.
    """
    arrays, chosen = (points.x, points.y, points.z), points.first_echo
    z, east, north = _nearest(arrays, chosen, spec.frame, spec.shape)
    if below_top_m > 0:
        parts = max(1, round(spec.cell_m / PLACE_M))
        high = _upper_echoes(arrays, chosen, (spec.frame, spec.shape, parts))
        upper = _nearest(arrays, high, spec.frame, spec.shape)
        edge = _at_edges(z, upper[0], below_top_m)
        z[edge], east[edge], north[edge] = (values[edge] for values in upper)
    return Samples(z, east, north, spec)


def count_first(points: PointCloud, spec: GridSpec) -> NDArray[np.uint16]:
    """Count the first echoes in each cell; more than 65,535 count as that."""
    return _count(points.x, points.y, points.first_echo, spec.frame, spec.shape)


def lowest(points: PointCloud, spec: GridSpec, chosen: NDArray[np.bool_] | None = None) -> Grid:
    """Grid the lowest of the chosen points (all unless given) of each cell; cells without one are not valid."""
    values, valid = lowest_heights(points, spec, chosen)
    return Grid(values.astype(np.float32), valid, spec)


def lowest_heights(points: PointCloud, spec: GridSpec, chosen: NDArray[np.bool_] | None = None) -> tuple[Floats, Mask]:
    """Return what `lowest` does in 64 bits: the heights (H, W), 0 where there is none, and the cells that have one."""
    wanted = np.ones(len(points), dtype=np.bool_) if chosen is None else chosen
    values = _lowest((points.x, points.y, points.z), wanted, spec.frame, spec.shape)
    valid = np.isfinite(values)
    values[~valid] = 0.0
    return values, valid


@kernel
def cell_of(x: float, y: float, frame: Frame, shape: tuple[int, int]) -> tuple[int, int]:
    """Row and column of the cell that holds a point; row -1 outside of the lattice."""
    col = int(number_along(x - frame.east_m, frame.cell_m)) - frame.col
    row = int(number_along(frame.north_m - y, frame.cell_m)) - frame.row
    if row < 0 or col < 0 or row >= shape[0] or col >= shape[1]:
        return -1, -1
    return row, col


@kernel
def _bounds(x: Floats, y: Floats, chosen: Mask) -> tuple[float, float, float, float]:
    """Return west, south, east and north of the chosen points."""
    west, south, east, north = np.inf, np.inf, -np.inf, -np.inf
    for i in range(x.size):
        if chosen[i]:
            west, east = min(west, x[i]), max(east, x[i])
            south, north = min(south, y[i]), max(north, y[i])
    return west, south, east, north


@kernel
def _occupied(x: Floats, y: Floats, chosen: Mask, frame: Frame, shape: tuple[int, int]) -> Mask:
    """Mark the cells that hold a chosen point."""
    found = np.zeros(shape, dtype=np.bool_)
    for i in range(x.size):
        if chosen[i]:
            row, col = cell_of(x[i], y[i], frame, shape)
            if row >= 0:
                found[row, col] = True
    return found


@kernel
def _count(x: Floats, y: Floats, chosen: Mask, frame: Frame, shape: tuple[int, int]) -> NDArray[np.uint16]:
    """Count the chosen points of each cell, up to what 16 bits hold."""
    counts = np.zeros(shape, dtype=np.uint16)
    for i in range(x.size):
        if chosen[i]:
            row, col = cell_of(x[i], y[i], frame, shape)
            if row >= 0 and counts[row, col] < 65_535:
                counts[row, col] += np.uint16(1)
    return counts


@kernel
def _nearest(
    xyz: tuple[Floats, Floats, Floats], chosen: Mask, frame: Frame, shape: tuple[int, int]
) -> tuple[Floats, NDArray[np.float32], NDArray[np.float32]]:
    """Nearest chosen point of each cell, by distance to the centre and then by height."""
    x, y, z = xyz
    best_z = np.full(shape, np.nan)
    # Invariant: best_z, east and up are those of the point that is first by (distance, height, offset) so far; this
    # order is total, so that the order of the points does not matter.
    best_d = np.full(shape, np.inf, dtype=np.float32)
    east = np.zeros(shape, dtype=np.float32)
    up = np.zeros(shape, dtype=np.float32)
    for i in range(x.size):
        if not chosen[i]:
            continue
        row, col = cell_of(x[i], y[i], frame, shape)
        if row < 0:
            continue
        de = np.float32(x[i] - (frame.east_m + (frame.col + col + 0.5) * frame.cell_m))
        dn = np.float32(y[i] - (frame.north_m - (frame.row + row + 0.5) * frame.cell_m))
        d = de * de + dn * dn
        if d > best_d[row, col]:
            continue
        old = best_z[row, col]
        tie = d == best_d[row, col]
        if tie and (z[i] > old or (z[i] == old and (de, dn) >= (east[row, col], up[row, col]))):
            continue
        best_d[row, col] = d
        best_z[row, col] = z[i]
        east[row, col] = de
        up[row, col] = dn
    return best_z, east, up


@kernel
def _square_of(x: float, y: float, squares: Squares) -> tuple[int, int]:
    """Row and column of the square that holds a point; row -1 outside of the lattice."""
    frame, shape, parts = squares
    row, col = cell_of(x, y, frame, shape)
    if row < 0:
        return -1, -1
    east = (x - (frame.east_m + (frame.col + col) * frame.cell_m)) / frame.cell_m
    south = (frame.north_m - (frame.row + row) * frame.cell_m - y) / frame.cell_m
    # By rounding, a point on the edge of a cell may lie a little outside of it; int() takes what is below 0 for 0.
    down, right = min(int(south * parts), parts - 1), min(int(east * parts), parts - 1)
    return row * parts + down, col * parts + right


@kernel
def _upper_echoes(xyz: tuple[Floats, Floats, Floats], chosen: Mask, squares: Squares) -> Mask:
    """Keep the chosen points that lie within `LEVEL_M` of the highest one of their square."""
    x, y, z = xyz
    _, shape, parts = squares
    tops = np.full((shape[0] * parts, shape[1] * parts), -np.inf, dtype=np.float32)
    for i in range(x.size):
        if chosen[i]:
            row, col = _square_of(x[i], y[i], squares)
            if row >= 0:
                tops[row, col] = max(tops[row, col], np.float32(z[i]))
    kept = np.zeros(x.size, dtype=np.bool_)
    for i in range(x.size):
        if chosen[i]:
            row, col = _square_of(x[i], y[i], squares)
            kept[i] = row >= 0 and np.float32(z[i]) >= tops[row, col] - LEVEL_M
    return kept


@kernel
def _at_edges(nearest: Floats, upper: Floats, below_m: float) -> Mask:
    """Mark the cells whose upper echo lies so far above the nearest one, with enough neighbours at its height."""
    height, width = nearest.shape
    found = np.zeros(nearest.shape, dtype=np.bool_)
    for row in range(height):
        for col in range(width):
            z = upper[row, col]
            if not z - nearest[row, col] > below_m:
                continue
            behind = 0
            for r in range(max(row - 1, 0), min(row + 2, height)):
                for c in range(max(col - 1, 0), min(col + 2, width)):
                    behind += (r != row or c != col) and abs(nearest[r, c] - z) <= LEVEL_M
            found[row, col] = behind >= LEAST_BEHIND
    return found


@kernel
def _lowest(xyz: tuple[Floats, Floats, Floats], chosen: Mask, frame: Frame, shape: tuple[int, int]) -> Floats:
    """Lowest chosen point of each cell, infinity in empty cells."""
    x, y, z = xyz
    values = np.full(shape, np.inf)
    for i in range(x.size):
        if chosen[i]:
            row, col = cell_of(x[i], y[i], frame, shape)
            if row >= 0:
                values[row, col] = min(values[row, col], z[i])
    return values

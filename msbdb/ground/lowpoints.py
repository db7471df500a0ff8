"""The lowest points of small cells, which alone can be ground, in a local frame of the cloud.

The frame has a near origin, and empty stretches are shortened. False echoes from below are left out.
"""

from dataclasses import dataclass
from functools import partial, reduce
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from msbdb.errors import InputError, NodataError
from msbdb.grid import cell_along
from msbdb.order import ranks
from msbdb.params import GroundParams
from msbdb.points.cellindex import number_along
from msbdb.points.cloud import PointCloud
from msbdb.surface.gridding import cell_size
from msbdb.threads import in_threads, kernel

Floats = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

CELL_SPACINGS = 1.5
"""Least side of a cell in point spacings: nine of ten cells hold a point then."""

MOST_CELLS = 64
"""Most cells a point; a thin line of points across a wide box has more, which would fill the memory."""

SPARE_CELLS = 1_000_000
"""Cells that any cloud may have."""

NEEDED = 2
"""Points that must lie near a low point for it to be believed."""

PARTS = 2
"""Parts that threads work on; their number changes nothing."""

ROUNDS = 4
"""Times that the next point of a cell is tried; false echoes hardly come more than three a cell."""


@dataclass(frozen=True, slots=True, eq=False)
class PointFrame:
    """Points in local metres, from the corner of the cloud's south-western cell and its lowest point.

    Parameters
    ----------
    u, v : (N,) ndarray of float64, metres
        Eastings and northings; long empty stretches along an axis are shortened.
    z : (N,) ndarray of float64, metres
        Heights.
    cell_m : float
        Side of the cells, metres; cell (i, j) holds the points with i and j by `msbdb.grid.cell_along` of v and u.
    shape : tuple of int
        Cells from south to north and from west to east.
    """

    u: Floats
    v: Floats
    z: Floats
    cell_m: float
    shape: tuple[int, int]


@dataclass(frozen=True, slots=True, eq=False)
class LowPoints:
    """The lowest believed point of each cell that has one, in row-major order of the cells.

    Parameters
    ----------
    index : (M,) ndarray of int64
        The points' places in the cloud.
    u, v, z : (M,) ndarray of float64, metres
        Their coordinates in the frame.
    at : (rows, cols) ndarray of int64
        Which low point a cell has; -1 for none.
    """

    index: Index
    u: Floats
    v: Floats
    z: Floats
    at: Index


def cell_side(first_m2: float, params: GroundParams) -> float:
    """Return the side of the cells for the lowest points, from the density of first echoes.

    It is ``ground_cell_m``, or for few points a larger round value, so that tiles of one survey have the same.
    """
    return max(params.ground_cell_m, cell_size(first_m2 / CELL_SPACINGS**2))


def frame(points: PointCloud, cell_m: float, gap_m: float) -> PointFrame:
    """Put the points into a local frame.

    Windows of at most ``gap_m`` hold the same points in it as in the world. Islands far apart cost no memory, and huge
    offsets no digits.

    Raises
    ------
    InputError
        When the points are so scattered that their cells would fill the memory.
    """
    arrays = (points.x, points.y, points.z)
    u, v = (shorten(a, cell_m, gap_m) for a in arrays[:2])
    rows, cols = (int(cell_along(float(a.max()), cell_m)) + 1 for a in (v, u))
    most = MOST_CELLS * len(points) + SPARE_CELLS
    if rows * cols > most:
        msg = (
            f"{len(points)} points would need {rows} x {cols} cells of {cell_m:g} m and at most {most} are kept; "
            "take larger cells (ground.ground_cell_m), or parts of the survey one by one."
        )
        raise InputError(msg)
    return PointFrame(u, v, points.z - float(points.z.min()), cell_m, (rows, cols))


def require_points(points: PointCloud) -> None:
    """Refuse clouds in which no ground can be found.

    Raises
    ------
    NodataError
        When there are no points.
    InputError
        When a coordinate is not finite.
    """
    if len(points) == 0:
        msg = "The ground filter got no points; check what was left out before it."
        raise NodataError(msg)
    wrong = sum(int(np.count_nonzero(~np.isfinite(a))) for a in (points.x, points.y, points.z))
    if wrong:
        msg = f"The ground filter needs finite coordinates and {wrong} are NaN or infinite; drop these points."
        raise InputError(msg)


def shorten(values: Floats, cell_m: float, gap_m: float) -> Floats:
    """Shift coordinates by whole cells to start near 0, and shorten long empty stretches by whole cells.

    Cells of the result are cells of the world's lattice, so neighbouring tiles of a survey are cut alike.

    Parameters
    ----------
    values : (N,) ndarray of float64, metres
        Coordinates along one axis, in any order.
    cell_m : float
        Side of a cell.
    gap_m : float
        Least length that stays of a stretch of more than twice this length.

    Examples
    --------
    >>> shorten(np.array([5_000_107.5, 100.0, 101.0]), 2.0, 10.0)
    array([11.5,  0. ,  1. ])
    """
    local = values - cell_along(float(values.min()), cell_m) * cell_m
    blocks = cell_along(local, gap_m).astype(np.int64)
    used, inverse = ranks(blocks)
    if used.size == used[-1] + 1:
        return np.asarray(local)
    first, last = np.full(used.size, np.inf), np.full(used.size, -np.inf)
    np.minimum.at(first, inverse, local)
    np.maximum.at(last, inverse, local)
    empty = np.diff(used) > 1
    excess = np.where(empty, np.floor(np.maximum(first[1:] - last[:-1] - gap_m, 0.0) / cell_m) * cell_m, 0.0)
    return np.asarray(local - np.concatenate([[0.0], np.cumsum(excess)])[inverse])


def low_points(frame: PointFrame, outlier_m: float) -> tuple[LowPoints, Mask]:
    """Take the lowest believed point of each cell.

    A point is believed when at least two others lie within ``outlier_m`` of its height. The others are the points of
    its cell and the lowest points of the 24 cells around. Where this fails for most cells, all points are believed:
    then the cells are too small for a decision.

    Parameters
    ----------
    frame : PointFrame
        The points.
    outlier_m : float
        Farthest height of a neighbour, metres.

    Returns
    -------
    LowPoints
        Ties go to the western, then the southern point.
    (N,) ndarray of bool
        Which points are false echoes from below.
    """
    arrays = (frame.u, frame.v, frame.z)
    false = np.zeros(frame.z.size, dtype=np.bool_)
    lowest = _lowest(arrays, false, frame.cell_m, frame.shape)
    for _ in range(ROUNDS):
        counts = in_threads(partial(_company, arrays, lowest, false, (frame.cell_m, outlier_m)), cuts(false.size))
        own = reduce(np.add, counts)
        doubts = in_threads(partial(_doubted, frame.z, lowest, own, outlier_m), cuts(frame.shape[0]))
        doubted = np.concatenate(doubts)
        if doubted.size == 0 or 2 * doubted.size > np.count_nonzero(lowest >= 0):
            break
        false[doubted] = True
        lowest = _lowest(arrays, false, frame.cell_m, frame.shape)
    index = lowest[lowest >= 0]
    at = np.full(frame.shape, -1, dtype=np.int64)
    at[lowest >= 0] = np.arange(index.size)
    return LowPoints(index, frame.u[index], frame.v[index], frame.z[index], at), false


def cuts(count: int) -> list[tuple[int, int]]:
    """Cut a number of points or rows in parts for threads."""
    return list(pairwise(count * part // PARTS for part in range(PARTS + 1)))


@kernel
def _lowest(arrays: tuple[Floats, Floats, Floats], false: Mask, cell: float, shape: tuple[int, int]) -> Index:
    """Lowest point of each cell that is not false; -1 where no point lies."""
    u, v, z = arrays
    found = np.full(shape, -1, dtype=np.int64)
    for i in range(z.size):
        if false[i]:
            continue
        row, col = int(number_along(v[i], cell)), int(number_along(u[i], cell))
        # A total order, so that the order of the points does not matter.
        old = found[row, col]
        if old < 0 or (z[i], u[i], v[i]) < (z[old], u[old], v[old]):
            found[row, col] = i
    return found


@kernel
def _company(
    arrays: tuple[Floats, Floats, Floats],
    lowest: Index,
    false: Mask,
    sizes: tuple[float, float],
    part: tuple[int, int],
) -> NDArray[np.int32]:
    """Count the other points, of a range of them, that lie near the height of their cell's lowest one."""
    u, v, z = arrays
    cell, outlier = sizes
    count = np.zeros(lowest.shape, dtype=np.int32)
    for i in range(part[0], part[1]):
        row, col = int(number_along(v[i], cell)), int(number_along(u[i], cell))
        low = lowest[row, col]
        if low >= 0 and low != i and not false[i] and z[i] - z[low] <= outlier:
            count[row, col] += 1
    return count


@kernel
def _doubted(z: Floats, lowest: Index, own: NDArray[np.int32], outlier: float, part: tuple[int, int]) -> Index:
    """Return the lowest points, of a range of rows, that fewer than two others support."""
    height, width = lowest.shape
    found = []
    for row in range(part[0], part[1]):
        for col in range(width):
            low = lowest[row, col]
            if low < 0 or own[row, col] >= NEEDED:
                continue
            support = own[row, col] - 1  # less the point itself, which the cells around include
            for r in range(max(row - 2, 0), min(row + 3, height)):
                for c in range(max(col - 2, 0), min(col + 3, width)):
                    if lowest[r, c] >= 0 and abs(z[lowest[r, c]] - z[low]) <= outlier:
                        support += 1
            if support < NEEDED:
                found.append(low)
    return np.array(found, dtype=np.int64)

"""The lowest points of small cells, which alone can be ground; false echoes from below are left out."""

from dataclasses import dataclass
from functools import partial, reduce
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from msbdb.surface.ground.frames import Frame
from msbdb.threads import in_threads, kernel

Floats = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

NEEDED = 2
"""Points that must lie near a low point for it to be believed."""
PARTS = 2
"""Parts that threads work on; their number changes nothing."""
ROUNDS = 4
"""Times that the next point of a cell is tried; false echoes hardly come more than three a cell."""


@dataclass(frozen=True, slots=True, eq=False)
class LowPoints:
    """One point for each cell that holds any believed one, in row-major order of the cells.

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


def low_points(frame: Frame, outlier_m: float) -> tuple[LowPoints, Mask]:
    """Take the lowest believed point of each cell.

    A point is believed when at least two others lie within ``outlier_m`` of its height, in its own cell or among the
    lowest points of the 24 cells around. Where most cells hold but single points without such neighbours, all are
    believed: then the cells are too small for the points to tell.

    Parameters
    ----------
    frame : Frame
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
    """Lowest point of each cell that is not false; -1 where there is none."""
    u, v, z = arrays
    found = np.full(shape, -1, dtype=np.int64)
    for i in range(z.size):
        if false[i]:
            continue
        row, col = int(v[i] / cell), int(u[i] / cell)
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
        row, col = int(v[i] / cell), int(u[i] / cell)
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
            support = own[row, col] - 1
            for r in range(max(row - 2, 0), min(row + 3, height)):
                for c in range(max(col - 2, 0), min(col + 3, width)):
                    if lowest[r, c] >= 0 and abs(z[lowest[r, c]] - z[low]) <= outlier:
                        support += 1
            if support < NEEDED:
                found.append(low)
    return np.array(found, dtype=np.int64)

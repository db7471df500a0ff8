"""Erosion, dilation and opening on points, each with a window of its own (S3)."""

from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from msbdb.ground.lowpoints import LowPoints, cuts
from msbdb.threads import in_threads, kernel

Floats = NDArray[np.float64]
Index = NDArray[np.int64]


class PointWindows(NamedTuple):
    """Points by cells, and the half-widths of their windows, for kernels."""

    at: Index
    u: Floats
    v: Floats
    half: Floats
    cell: float


def opening(low: LowPoints, heights: Floats, half_m: Floats, cell_m: float) -> Floats:
    """Open heights of points by windows of their own.

    The window W(p) of a point p is the square of half-width h(p) around it. With ε(p) = min z(q) over q in W(p), the
    opening is γ(p) = max ε(q) over all q whose W(q) holds p. The dilation takes the transposed windows, so γ is an
    opening: never above the heights, and idempotent for the same windows. With windows of one size it is S3's maximum
    of minima.

    Parameters
    ----------
    low : LowPoints
        The points, at most one a cell.
    heights : (M,) ndarray of float64, metres
        The function that is opened.
    half_m : (M,) ndarray of float64, metres
        Half-widths of the windows.
    cell_m : float
        Side of the cells.

    Returns
    -------
    (M,) ndarray of float64, metres
        Opened heights.

    Examples
    --------
    A window of three points removes a peak of one, and leaves a roof of three:

    >>> u = np.arange(8) + 0.5
    >>> z = np.array([0.0, 7, 0, 0, 5, 5, 5, 0])
    >>> low = LowPoints(np.arange(8), u, np.full(8, 0.5), z, np.arange(8)[None])
    >>> opening(low, z, np.ones(8), 1.0)
    array([0., 0., 0., 0., 5., 5., 5., 0.])
    """
    return dilation(low, erosion(low, heights, half_m, cell_m), half_m, cell_m)


def erosion(low: LowPoints, heights: Floats, half_m: Floats, cell_m: float) -> Floats:
    """Take for each point the lowest height in its own window; arguments as of `opening`.

    Cells wholly inside of a window are covered by overlapping blocks, whose side is a power of two; each level of
    blocks is made from the level before. The points of the cells on its rim are compared one by one. Cost: linear in
    the half-width.
    """
    windows = PointWindows(low.at, low.u, low.v, half_m, cell_m)
    level = _levels(windows)
    parts = cuts(level.size)
    found = heights.copy()
    table = np.where(low.at >= 0, heights[low.at], np.inf)
    for k in range(-1, int(level.max()) + 1):
        if k > 0:
            table = _coarser(table, 2 ** (k - 1))
        values, now = (heights, table), (level, k)
        in_threads(partial(_query, windows, now, values, found), parts)
    return found


def dilation(low: LowPoints, eroded: Floats, half_m: Floats, cell_m: float) -> Floats:
    """Take for each point the highest of the values whose windows hold it; arguments as of `opening`."""
    windows = PointWindows(low.at, low.u, low.v, half_m, cell_m)
    level = _levels(windows)
    work = partial(_dilated, windows, level, eroded)
    found: Floats = np.maximum.reduce(in_threads(work, cuts(level.size)))
    return found


def _dilated(windows: PointWindows, level: Index, eroded: Floats, part: tuple[int, int]) -> Floats:
    """Dilate the values of a part of the points."""
    found = np.full(eroded.size, -np.inf)
    found[part[0] : part[1]] = eroded[part[0] : part[1]]
    shape = windows.at.shape
    # From the largest blocks down: a block hands its maximum to the four blocks of half its side that cover it.
    top = int(level.max())
    table = np.full(_shrunk(shape, 2 ** max(top, 0)), -np.inf)
    for k in range(top, -2, -1):
        _spread(windows, (level, k), (eroded, table), found, part)
        if k > 0:
            table = _finer(table, _shrunk(shape, 2 ** (k - 1)), 2 ** (k - 1))
    there = windows.at >= 0
    found[windows.at[there]] = np.maximum(found[windows.at[there]], table[there])
    return found


def _shrunk(shape: tuple[int, int], block: int) -> tuple[int, int]:
    """Return how many places a block has on the cells."""
    return max(shape[0] - block + 1, 0), max(shape[1] - block + 1, 0)


def _coarser(table: Floats, half: int) -> Floats:
    """Minima over blocks of twice the side, from those of blocks of side ``half``."""
    tall = np.minimum(table[:-half], table[half:])
    return np.minimum(tall[:, :-half], tall[:, half:])


def _finer(table: Floats, shape: tuple[int, int], half: int) -> Floats:
    """Maxima that blocks of half the side inherit."""
    finer = np.full(shape, -np.inf)
    rows, cols = table.shape
    for row in (0, half):
        for col in (0, half):
            part = finer[row : row + rows, col : col + cols]
            np.maximum(part, table, out=part)
    return finer


@kernel
def _span(centre: float, half: float, cell: float, count: int) -> tuple[int, int]:
    """First and last cell that a window touches along one axis, cut at the cells there are."""
    return max(int(np.floor((centre - half) / cell)), 0), min(int(np.floor((centre + half) / cell)), count - 1)


@kernel
def _inner(centre: float, half: float, cell: float, count: int) -> tuple[int, int]:
    """First and one past the last cell wholly inside of a window; beyond the cells' ends there are no points."""
    first, last = int(np.floor((centre - half) / cell)) + 1, int(np.floor((centre + half) / cell))
    return max(first, 0), min(last, count)


@kernel
def _inside(windows: PointWindows, p: int) -> tuple[int, int, int, int]:
    """First and one past the last row, and column, of the cells wholly inside of a window."""
    rows, cols = windows.at.shape
    south, north = _inner(windows.v[p], windows.half[p], windows.cell, rows)
    west, east = _inner(windows.u[p], windows.half[p], windows.cell, cols)
    return south, north, west, east


@kernel
def _levels(windows: PointWindows) -> Index:
    """Power of two of the blocks that cover the inside of each window; -1 where no cell is inside."""
    found = np.empty(windows.u.size, dtype=np.int64)
    for p in range(found.size):
        south, north, west, east = _inside(windows, p)
        side = min(east - west, north - south)
        k = -1
        while 2 ** (k + 1) <= side:
            k += 1
        found[p] = k
    return found


@kernel
def _rim(windows: PointWindows, p: int, blocks: bool, rim: Index) -> int:
    """Write the points of a window that its blocks, if it has any, do not cover; return how many they are."""
    at, u, v, half, cell = windows
    south, north, west, east = _inside(windows, p)
    first_row, last_row = _span(v[p], half[p], cell, at.shape[0])
    first_col, last_col = _span(u[p], half[p], cell, at.shape[1])
    count = 0
    for row in range(first_row, last_row + 1):
        covered = blocks and south <= row < north  # here the blocks hold all cells from west to east
        col = first_col
        while col <= last_col:
            if covered and west <= col < east:
                col = east
                continue
            q = at[row, col]
            # A cell on the rim lies partly outside of the window, so its point is compared itself.
            if q >= 0 and abs(u[q] - u[p]) <= half[p] and abs(v[q] - v[p]) <= half[p]:
                rim[count] = q
                count += 1
            col += 1
    return count


@kernel
def _most_rim(windows: PointWindows) -> int:
    """Bound how many points a rim has."""
    widest = int(2 * windows.half.max() / windows.cell) + 3
    rows, cols = windows.at.shape
    most: int = max(4 * (min(widest, rows) + min(widest, cols)), 9)
    return most


@kernel
def _query(
    windows: PointWindows,
    levels: tuple[Index, int],
    values: tuple[Floats, Floats],
    found: Floats,
    part: tuple[int, int],
) -> None:
    """Lower ``found`` to the minimum over the window, for the points whose blocks are of one level."""
    level, k = levels
    heights, table = values
    rim = np.empty(_most_rim(windows), dtype=np.int64)
    for p in range(part[0], part[1]):
        if level[p] != k:
            continue
        best = heights[p]
        for n in range(_rim(windows, p, k >= 0, rim)):
            best = min(best, heights[rim[n]])
        if k >= 0:
            # The last block of a row or column is moved back to end with the window: minima may count cells twice.
            side = 2**k
            south, north, west, east = _inside(windows, p)
            for row in range(south, north, side):
                for col in range(west, east, side):
                    best = min(best, table[min(row, north - side), min(col, east - side)])
        found[p] = best


@kernel
def _spread(
    windows: PointWindows,
    levels: tuple[Index, int],
    values: tuple[Floats, Floats],
    found: Floats,
    part: tuple[int, int],
) -> None:
    """Raise the blocks in ``table`` and the rim in ``found`` to each value, for the windows of one level."""
    level, k = levels
    eroded, table = values
    rim = np.empty(_most_rim(windows), dtype=np.int64)
    for p in range(part[0], part[1]):
        if level[p] != k:
            continue
        value = eroded[p]
        for n in range(_rim(windows, p, k >= 0, rim)):
            found[rim[n]] = max(found[rim[n]], value)
        if k >= 0:
            side = 2**k
            south, north, west, east = _inside(windows, p)
            for row in range(south, north, side):
                for col in range(west, east, side):
                    r, c = min(row, north - side), min(col, east - side)
                    table[r, c] = max(table[r, c], value)

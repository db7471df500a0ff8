"""The nearest points of each point in space, by cells in plan."""

import math
from collections.abc import Iterator
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from msbdb.errors import ParameterError
from msbdb.labels import by_three, look_up
from msbdb.points.cellindex import CellIndex, cell_place, index_cells, parts_of, require_coordinates, strip
from msbdb.threads import cores, in_threads, kernel

Floats = NDArray[np.float64]

A_CELL = 3.0
"""Mean number of points in the cells that hold any: then few rings of cells are searched."""

FIRST_CELL_M = 1.0
"""Cells by which the density is measured."""

RINGS = 3
"""Rings of cells around a point's own that are searched, before its cells are taken larger."""

LARGER = 4.0
"""Factor by which the cells grow: points that lie far from the others find theirs in few steps."""

MOST_PIECES = 2 * (2 * RINGS + 1)
"""Largest number of stretches of rows in a ring."""

ASKING = 1 << 18
"""Points that ask a tree at once: the distances of all would take more memory than the points."""

SLACK = 3e-6
"""Share of a cell by which a ring counts as nearer: rounding may put a point into the next cell."""


class _NearestSearch(NamedTuple):
    """Points in the order of their cells; for kernels."""

    cells: CellIndex
    x: Floats
    y: Floats
    z: Floats


def nearest(x: Floats, y: Floats, z: Floats, count: int) -> NDArray[np.int32]:
    """Return the nearest points of each point, itself included, the nearest first.

    Parameters
    ----------
    x, y, z : (N,) ndarray of float64, metres
        Finite coordinates.
    count : int
        K, at least 1. Of fewer points, all.

    Returns
    -------
    (N, K) ndarray of int32
        Of equally near points the first ones in the points' order.

    Raises
    ------
    InputError
        When the arrays are not three of one length, or a coordinate is NaN or infinite.
    ParameterError
        When K is not at least 1.

    Notes
    -----
    Rings of cells around a point are searched until no cell beyond can hold a nearer point. Where points are about as
    dense everywhere, O(N K); a search tree takes twice as long.

    Examples
    --------
    >>> nearest(np.array([0.0, 1.0, 3.0]), np.zeros(3), np.zeros(3), 2)
    array([[0, 1],
           [1, 0],
           [2, 1]], dtype=int32)
    """
    require_coordinates(x=x, y=y, z=z)
    if count < 1:
        msg = f"The number of nearest points must be 1 or more; got {count}."
        raise ParameterError(msg)
    found = np.empty((len(x), min(count, len(x))), dtype=np.int32)
    left = np.ones(len(x), dtype=np.bool_)
    cell_m = _cell_size(x, y)
    while left.any():
        index = index_cells(x, y, cell_m)
        search = _NearestSearch(index, *(look_up(axis, index.order) for axis in (x, y, z)))
        in_threads(partial(_find, search, left, found), parts_of(index))
        cell_m *= LARGER
    return found


def nearest_in_plan(
    tree: cKDTree, plan: tuple[Floats, Floats], asking: NDArray[np.integer], count: int, within_m: float
) -> Iterator[tuple[NDArray[np.integer], Floats, NDArray[np.intp]]]:
    """Yield for batches of the asking points which they are, and distances and numbers of their nearest in a tree.

    Points are left out where cells show that they have none within the distance.

    Parameters
    ----------
    tree : cKDTree
        Of other points in plan, one at least.
    plan : two (N,) ndarrays of float64, metres
        x and y of all points.
    asking : (M,) ndarray of int
        Which of them ask.
    count : int
        K, at least 1.
    within_m : float
        Only points nearer than this are found, metres; in place of others the distance is infinite, and the number
        that of the tree's points.

    Examples
    --------
    >>> plan = np.array([0.0, 1.0, 5.0, 90.0]), np.zeros(4)
    >>> for some, distance, number in nearest_in_plan(cKDTree([[0, 0], [4, 0]]), plan, np.array([1, 2, 3]), 1, 2.0):
    ...     print(some, distance.ravel(), number.ravel())
    [1 2] [1. 1.] [0 1]
    """
    asking = asking[_may_be_near(tree, plan, asking, within_m)]
    for start in range(0, len(asking), ASKING):
        some = asking[start : start + ASKING]
        place = np.column_stack([axis[some] for axis in plan])
        distance, number = tree.query(place, k=np.arange(1, count + 1), distance_upper_bound=within_m, workers=cores())
        yield some, distance, number


def _may_be_near(
    tree: cKDTree, plan: tuple[Floats, Floats], asking: NDArray[np.integer], within_m: float
) -> NDArray[np.bool_]:
    """Return which asking points lie in a cell that holds points of the tree, or beside such a cell.

    Cells are at least as wide as the distance, so that all others have no point of the tree within it.
    """
    extent = tree.maxes - tree.mins
    # About two cells for each asking point at most, so that few points in a wide survey need little memory.
    enough_m = float(np.sqrt((extent + within_m).prod() / (2 * len(asking) + 1)))
    cell_m = max(within_m * (1 + SLACK), enough_m)
    held = np.zeros([int(side / cell_m) + 3 for side in extent], dtype=np.bool_)
    held[tuple((np.asarray((tree.data - tree.mins) / cell_m, dtype=np.int64) + 1).T)] = True
    near = by_three(np.logical_or, held, beyond=np.False_)
    return _in_cells(plan, asking, near, (float(tree.mins[0]), float(tree.mins[1])), cell_m)


@kernel
def _in_cells(
    plan: tuple[Floats, Floats],
    asking: NDArray[np.integer],
    cells: NDArray[np.bool_],
    corner: tuple[float, float],
    cell_m: float,
) -> NDArray[np.bool_]:
    """Return (M,) which asking points lie in cells that are true; the corner is that of the cell (1, 1)."""
    x, y = plan
    found = np.zeros(asking.size, dtype=np.bool_)
    for number in range(asking.size):
        point = asking[number]
        col, row = math.floor((x[point] - corner[0]) / cell_m) + 1, math.floor((y[point] - corner[1]) / cell_m) + 1
        found[number] = 0 <= col < cells.shape[0] and 0 <= row < cells.shape[1] and cells[col, row]
    return found


def nearest_of(known: tuple[Floats, Floats, Floats], asking: tuple[Floats, Floats, Floats]) -> NDArray[np.int64]:
    """Return which of some points is the nearest one of each asking point.

    Parameters
    ----------
    known : three (N,) ndarrays of float64, metres
        x, y and z of at least one point.
    asking : three (M,) ndarrays of float64, metres
        Places.

    Returns
    -------
    (M,) ndarray of int64
        Of equally near points any one.

    Examples
    --------
    >>> none = np.zeros(2)
    >>> nearest_of((np.array([0.0, 5.0]), none, none), (np.array([4.0, 1.0]), none, none))
    array([1, 0])
    """
    tree = cKDTree(np.column_stack(known))
    found = np.empty(len(asking[0]), dtype=np.int64)
    for start in range(0, len(found), ASKING):
        some = slice(start, start + ASKING)
        found[some] = tree.query(np.column_stack([axis[some] for axis in asking]), workers=cores())[1]
    return found


def _cell_size(x: Floats, y: Floats) -> float:
    """Return the side of cells that hold about `A_CELL` points."""
    if not len(x):
        return FIRST_CELL_M
    first = index_cells(x, y, FIRST_CELL_M)
    return FIRST_CELL_M * float(np.sqrt(A_CELL * first.keys.size / first.order.size))


@kernel
def _find(search: _NearestSearch, left: NDArray[np.bool_], found: NDArray[np.int32], part: tuple[int, int]) -> None:
    """Find the nearest points of the points that are left, in a range of cells, where the rings suffice."""
    index, x, y, _ = search
    count = found.shape[1]
    squares, points = np.empty(count), np.empty(count, dtype=np.int32)
    pieces = np.empty((RINGS + 1, MOST_PIECES, 2), dtype=np.int64)
    sizes = np.empty(RINGS + 1, dtype=np.int64)
    rows, cols = index.shape
    for cell in range(part[0], part[1]):
        row, col = cell_place(index, cell)
        ready = 0  # rings whose pieces are known; they are the same for all points of the cell
        for own in range(index.starts[cell], index.starts[cell + 1]):
            if not left[index.order[own]]:
                continue
            west, south = x[own] - (index.west + col * index.cell_m), y[own] - (index.south + row * index.cell_m)
            # Way from the point to the border of its own cell; a ring farther out begins so much farther.
            inside = min(west, index.cell_m - west, south, index.cell_m - south) - SLACK * index.cell_m
            held = 0
            for ring in range(1, RINGS + 1):
                if ring > ready:
                    sizes[ring] = _ring(index, row, col, ring, pieces[ring])
                    ready = ring
                for piece in range(sizes[ring]):
                    held = _take(search, own, pieces[ring, piece], (squares, points), held)
                # All points nearer than this lie in the rings searched so far.
                reach = max(ring * index.cell_m + inside, 0.0)
                everything = row <= ring and col <= ring and row + ring >= rows - 1 and col + ring >= cols - 1
                if everything or (held == count and squares[count - 1] < reach * reach):
                    left[index.order[own]] = False
                    found[index.order[own]] = points
                    break


@kernel
def _ring(index: CellIndex, row: int, col: int, ring: int, pieces: NDArray[np.int64]) -> int:
    """Write where the points of a ring of cells begin and end, the first ring with its inside; return the pieces."""
    size = 0
    for other in range(row - ring, row + ring + 1):
        whole = ring == 1 or abs(other - row) == ring
        for side in range(1 if whole else 2):
            first_col = col - ring if whole or side == 0 else col + ring
            last_col = col + ring if whole else first_col
            first, stop = strip(index, other, first_col, last_col)
            if stop > first:
                pieces[size, 0] = first
                pieces[size, 1] = stop
                size += 1
    return size


@kernel
def _take(
    search: _NearestSearch,
    own: int,
    piece: NDArray[np.int64],
    held: tuple[Floats, NDArray[np.int32]],
    size: int,
) -> int:
    """Sort the points of a piece into the held ones, if they are among the nearest; return how many are held.

    Invariant: the held ones ascend by distance, and by number where distances are equal.
    """
    index, x, y, z = search
    squares, points = held
    for other in range(piece[0], piece[1]):
        dx, dy, dz = x[other] - x[own], y[other] - y[own], z[other] - z[own]
        square = dx * dx + dy * dy + dz * dz
        point = index.order[other]
        place = size
        if size == squares.size:
            place -= 1
            if square > squares[place] or (square == squares[place] and point > points[place]):
                continue
        else:
            size += 1
        while place > 0 and (
            squares[place - 1] > square or (squares[place - 1] == square and points[place - 1] > point)
        ):
            squares[place], points[place] = squares[place - 1], points[place - 1]
            place -= 1
        squares[place], points[place] = square, point
    return size

"""Thinning: only the points that matter to alpha shapes, those near the rim of a region and some around them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msbdb.labels import Labels
from msbdb.order import order_of, ranks
from msbdb.threads import kernel

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]

REACH = 2
"""The centre of a disc that touches a point lies at most so many cells (of half a radius) from the point's."""

COARSE = 2 * REACH
"""So many cells are twice the radius, the diameter of a disc."""

GAP_CELLS = COARSE
"""Wider empty bands are narrowed to it; a point covers the next cell at most, so one between stays uncovered."""

WINDOW = 2 * REACH + 1
"""Cells across the square in which the centre of a disc can lie."""

SLACK = 1e-6
"""A disc's radius, squared, in cells, is taken smaller by it, for coordinates are rounded."""

NONE = np.iinfo(np.int32).max
"""No point covers a cell."""


@dataclass(frozen=True, slots=True, eq=False)
class Axis:
    """The cells of coordinates along one axis.

    Parameters
    ----------
    cell : (N,) ndarray of int64
        Packed number of each coordinate's cell, from 0.
    occupied, number : (M,) ndarray of int64
        The cells that hold a coordinate on the absolute lattice, ascending; and their packed numbers.
    """

    cell: Ints
    occupied: Ints
    number: Ints


def pack(values: Floats, side_m: float, gap: int) -> Axis:
    """Return the cells along one axis, numbered so that at most ``gap`` - 1 empty ones follow each other.

    Parameters
    ----------
    values : (N,) ndarray of float64, metres
        Coordinates; one at least.
    side_m : float
        Side of a cell, metres; corners lie at whole multiples of it.
    gap : int
        Largest step between two occupied cells that is left.
    """
    occupied, place = ranks(np.floor(values / side_m).astype(np.int64))
    number = np.cumsum(np.minimum(np.diff(occupied, prepend=occupied[:1]), gap))
    return Axis(number[place], occupied, number)


def thinned(x: Floats, y: Floats, labels: Labels, radius_m: float) -> tuple[NDArray[np.intp], Mask]:
    """Return the points that can matter to alpha shapes, and which of all points are deep inside of a region.

    Parameters
    ----------
    x, y : (N,) ndarray of float64, metres
        Points, in canonical order.
    labels : (N,) ndarray of int32
        Region of each point.
    radius_m : float
        1/alpha, metres.

    Returns
    -------
    kept : (K,) ndarray of int
        Indices, ascending: the points that are not deep, and of the deep ones around them enough.
    deep : (N,) ndarray of bool
        Points that no empty disc of the radius touches, and from which no other region is within its reach.

    Notes
    -----
    A cell of half the radius is covered when some point is nearer than the radius to all of it: a disc whose centre
    lies in it is not empty. A point is deep when all cells around it that can hold the centre of a disc on it are
    covered. A disc with its centre in a cell that is not covered holds no deep point. So for each covered cell around
    the points that are not deep, it is enough to keep one point that covers it.

    The kernels walk the cells in row-major order, with a place in each row around that moves along with them. After
    two sorts by cells, the time is linear in the points.
    """
    if not np.isfinite(radius_m) or len(x) == 0:
        return np.arange(len(x)), np.zeros(len(x), dtype=np.bool_)
    side = radius_m / REACH
    east, north = pack(x, side, GAP_CELLS), pack(y, side, GAP_CELLS)
    width = int(east.number[-1]) + 1 + 4 * REACH
    key = (north.cell + 2 * REACH) * width + east.cell + 2 * REACH
    order = order_of(key, descending=False)
    key = key[order]
    starts = np.append(np.flatnonzero(np.diff(key, prepend=-1)), key.size)
    cells = key[starts[:-1]]
    around = _around(cells, width)
    places = np.mod(x / side, 1), np.mod(y / side, 1)
    coverer = _coverers(places, (order, starts, cells), around, width)
    deep_cell = _deep(cells, around, coverer, width) & _pure(labels[order], starts, np.divmod(cells, width))
    kept_order = np.repeat(~deep_cell, np.diff(starts))
    kept, deep = np.empty(len(x), dtype=np.bool_), np.empty(len(x), dtype=np.bool_)
    kept[order], deep[order] = kept_order, ~kept_order
    kept[coverer[_near(cells[~deep_cell], around, width) & (coverer != NONE)]] = True
    return np.flatnonzero(kept), deep


def _pure(labels: Labels, starts: Ints, place: tuple[Ints, Ints]) -> Mask:
    """Return which cells have points of one region alone within a disc's diameter.

    The labels come in the order of the cells, whose rows and columns are given. They are compared over cells as wide as
    the diameter.
    """
    lowest, highest = np.minimum.reduceat(labels, starts[:-1]), np.maximum.reduceat(labels, starts[:-1])
    row, col = (number // COARSE for number in place)
    width = int(col.max()) + 3
    key = (row + 1) * width + col + 1
    order = order_of(key, descending=False)
    first = np.flatnonzero(np.diff(key[order], prepend=-1))
    cells = key[order][first]
    low, high = np.minimum.reduceat(lowest[order], first), np.maximum.reduceat(highest[order], first)
    pure = low == high
    for step in (down * width + right for down in (-1, 0, 1) for right in (-1, 0, 1)):
        there = np.minimum(np.searchsorted(cells, cells + step), len(cells) - 1)
        pure &= (cells[there] != cells + step) | ((low[there] == low) & (high[there] == low))
    found = np.empty(len(key), dtype=np.bool_)
    found[order] = np.repeat(pure, np.diff(np.append(first, len(key))))
    return found


@kernel
def _around(cells: Ints, width: int) -> Ints:
    """Return the cells and all that touch them, ascending."""
    # A merge of three sorted lists: the cells themselves, and those shifted one row up and down. `at` is the place in
    # each of the lists, and `last` the latest cell written; all three places only move forward.
    found = np.empty(9 * cells.size, dtype=np.int64)
    count = 0
    last = -1
    at = np.zeros(3, dtype=np.int64)
    while True:
        # The smallest cell above `last` that touches the next cell of one of the lists.
        following = -1
        for row in range(3):
            shift = (row - 1) * width
            while at[row] < cells.size and cells[at[row]] + shift + 1 <= last:
                at[row] += 1
            if at[row] < cells.size:
                first = max(cells[at[row]] + shift - 1, last + 1)
                if following < 0 or first < following:
                    following = first
        if following < 0:
            return found[:count].copy()
        found[count] = last = following
        count += 1


@kernel
def _coverers(
    places: tuple[Floats, Floats], points: tuple[NDArray[np.int32], Ints, Ints], around: Ints, width: int
) -> NDArray[np.int32]:
    """Return for each cell around the first point nearer than two sides to all of the cell; `NONE` without one.

    ``places`` are those of all points in their cells, 0 to 1; ``points`` has the points of each cell.
    """
    right, up = places
    order, starts, cells = points
    limit = REACH * REACH - SLACK
    found = np.full(around.size, NONE, dtype=np.int32)
    at = np.zeros(3, dtype=np.int64)
    across, along = np.empty(3), np.empty(3)
    for cell in range(cells.size):
        # The cell and its eight neighbours are all in `around`, so this search needs no bound.
        for row in range(3):
            while around[at[row]] < cells[cell] + (row - 1) * width - 1:
                at[row] += 1
        for point in order[starts[cell] : starts[cell + 1]]:
            east, north = right[point], up[point]
            # Squared distance along each axis from the point to the far side of the three columns and rows around.
            across[0], across[1], across[2] = (east + 1) ** 2, max(east, 1 - east) ** 2, (2 - east) ** 2
            along[0], along[1], along[2] = (north + 1) ** 2, max(north, 1 - north) ** 2, (2 - north) ** 2
            for row in range(3):
                for col in range(3):
                    if across[col] + along[row] < limit:
                        # The lowest index wins, so the order of the points in a cell has no effect.
                        place = at[row] + col
                        found[place] = min(found[place], point)
    return found


@kernel
def _advanced(around: Ints, place: int, cell: int) -> int:
    """Return the first place from the given one on that holds a cell or a later one; the cells rise."""
    while place < around.size and around[place] < cell:
        place += 1
    return place


@kernel
def _deep(cells: Ints, around: Ints, coverer: NDArray[np.int32], width: int) -> Mask:
    """Return the cells around which all cells that can hold the centre of a disc are covered."""
    # run[place]: how many covered cells follow each other in the row from this place on.
    run = np.zeros(around.size + 1, dtype=np.int64)
    for place in range(around.size - 1, -1, -1):
        if coverer[place] != NONE:
            follows = place + 1 < around.size and around[place + 1] == around[place] + 1
            run[place] = 1 + (run[place + 1] if follows else 0)
    deep = np.ones(cells.size, dtype=np.bool_)
    at = np.zeros(WINDOW, dtype=np.int64)
    for cell in range(cells.size):
        for row in range(WINDOW):
            first = cells[cell] + (row - REACH) * width - REACH
            at[row] = _advanced(around, at[row], first)
            place = at[row]
            # Covered across the whole window: the row's first cell is there, and a run of its width begins at it.
            deep[cell] &= place < around.size and around[place] == first and run[place] >= WINDOW
    return deep


@kernel
def _near(rim: Ints, around: Ints, width: int) -> Mask:
    """Return which cells around lie near one of some cells, so that a disc on a point there may have its centre."""
    # As in `_deep`, but from the cells that are not deep; windows of two cells may overlap, and set the same marks.
    near = np.zeros(around.size, dtype=np.bool_)
    at = np.zeros(WINDOW, dtype=np.int64)
    for cell in range(rim.size):
        for row in range(WINDOW):
            first = rim[cell] + (row - REACH) * width - REACH
            at[row] = _advanced(around, at[row], first)
            place = at[row]
            while place < around.size and around[place] < first + WINDOW:
                near[place] = True
                place += 1
    return near

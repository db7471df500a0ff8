"""Points sorted into square cells in plan, so that a kernel finds what lies near a point without looking further.

Only cells that hold points are kept, so islands far apart cost nothing for the emptiness between them. The cells are
in row-major order: neighbours along a row follow each other, and the points of any stretch of a row are one slice.
"""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from msbdb.errors import InputError, ParameterError
from msbdb.grid import cell_along
from msbdb.order import order_of
from msbdb.threads import kernel

Plan = tuple[NDArray[np.float64], NDArray[np.float64]]
Sorting = tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int64]]
"""Order, starts and keys of a `CellIndex`."""

MAX_POINTS = 2**31 - 2**16
"""Points are counted in 32 bits, which halves the memory."""

MAX_LATTICE = 2**62
"""Rows times columns, empty ones included: a cell's number must fit into 64 bits."""

MAX_NUMBER = 2**53
"""Absolute rows and columns up to this are exact as numbers of 64 bits with a fraction."""

MARGIN = 1e-6
"""Cells larger than a distance by this share never have points nearer than it two cells apart, by rounding."""

MOST_CELLS = 2
"""Lattices of up to so many cells a point are dense: points are sorted by counting, and rows are found at once."""

PARTS, LEAST_POINTS = 16, 20_000
"""Work is cut into at most so many parts, of no fewer points each."""


class CellIndex(NamedTuple):
    """Points sorted by square cells in plan; a plain tuple of arrays, which kernels take as an argument.

    Parameters
    ----------
    order : (N,) ndarray of int32
        The points by cells in row-major order, ascending within a cell.
    starts : (M + 1,) ndarray of int32
        Where in ``order`` the points of each cell begin, and N at the end. M cells hold points.
    keys : (M,) ndarray of int64
        Row times the number of columns plus column of each cell, strictly ascending.
    rows : (R + 1,) ndarray of int32
        Where in ``keys`` the cells of each row begin, and M at the end; empty where the lattice is not dense.
    shape : (int, int)
        Rows and columns of the lattice over all points, empty cells included. Row 0 is the southernmost, column 0
        the westernmost.
    west, south : float
        Corner of row 0 and column 0, metres: whole multiples of the cell size, so that the same point has the same
        neighbours in its cell whatever part of a survey is indexed.
    cell_m : float
        Side of a cell, metres.
    """

    order: NDArray[np.int32]
    starts: NDArray[np.int32]
    keys: NDArray[np.int64]
    rows: NDArray[np.int32]
    shape: tuple[int, int]
    west: float
    south: float
    cell_m: float


number_along = kernel(cell_along)
"""`msbdb.grid.cell_along` for kernels."""


def index_cells(x: NDArray[np.float64], y: NDArray[np.float64], cell_m: float) -> CellIndex:
    """Sort points into square cells.

    Parameters
    ----------
    x, y : (N,) ndarray of float64, metres
        Finite coordinates, also none. Not modified.
    cell_m : float
        Side of a cell, metres, above 0.

    Returns
    -------
    CellIndex

    Raises
    ------
    InputError
        When the arrays are not two of one length, or a coordinate is NaN or infinite.
    ParameterError
        When the cell size is no positive number, or so small that the lattice has more than 2^62 cells.

    Notes
    -----
    A kernel goes through the cells rather than the points, and looks up a cell's surroundings once for all points in
    it. Two points nearer than the cell size lie in the same or in touching cells, up to rounding. To be exact, take
    cells that are larger by a millionth, as `msbdb.points.graph.connect` does.

    Complexity: O(N) where the lattice has no more than two cells a point, else O(N log N). Each `strip` is O(log M) or
    faster: where nearly all cells of a row hold points, the place of a column is nearly known.
    Memory: 4 bytes a point and 12 a cell; sorting takes 20 a point in passing. No border: what is not there has no
    cell.

    Examples
    --------
    How many points lie within a radius of each, by windows of 3 by 3 cells:

    >>> import numba
    >>> @numba.njit  # in a module: @kernel, which caches what it compiled
    ... def count_near(index, x, y, radius_m):
    ...     near = np.zeros(x.size, dtype=np.int64)
    ...     for cell in range(index.keys.size):
    ...         row, col = cell_place(index, cell)
    ...         for other_row in range(row - 1, row + 2):
    ...             first, stop = strip(index, other_row, col - 1, col + 1)
    ...             for point in index.order[index.starts[cell] : index.starts[cell + 1]]:
    ...                 for other in index.order[first:stop]:
    ...                     near[point] += math.hypot(x[other] - x[point], y[other] - y[point]) <= radius_m
    ...     return near
    >>> x, y = np.array([0.0, 0.8, 9e6, 1.6]), np.zeros(4)
    >>> count_near(index_cells(x, y, 1.0), x, y, 1.0)
    array([2, 3, 1, 2])
    """
    (west, cols), (south, rows) = _lattice(x, y, cell_m)
    x, y = np.ascontiguousarray(x, dtype=np.float64), np.ascontiguousarray(y, dtype=np.float64)
    dense = rows * cols <= MOST_CELLS * x.size
    sort = _counted if dense else _sorted
    order, starts, keys = sort((x, y), (west, south), float(cell_m), (rows, cols))
    begins = np.arange(rows + 1) * cols if dense else np.zeros(0, dtype=np.int64)
    at_rows = np.searchsorted(keys, begins).astype(np.int32)
    return CellIndex(order, starts, keys, at_rows, (rows, cols), west * cell_m, south * cell_m, float(cell_m))


def most_in_a_cell(x: NDArray[np.float64], y: NDArray[np.float64], cell_m: float) -> int:
    """Return how many points the fullest cell holds, without sorting them where the lattice is dense.

    Parameters and errors are those of `index_cells`; without any points 0.
    """
    (west, cols), (south, rows) = _lattice(x, y, cell_m)
    if rows * cols > MOST_CELLS * len(x):
        return int(np.diff(index_cells(x, y, cell_m).starts).max(initial=0))
    x, y = np.ascontiguousarray(x, dtype=np.float64), np.ascontiguousarray(y, dtype=np.float64)
    return int(_counts((x, y), (west, south), float(cell_m), (rows, cols)).max(initial=0))


def _lattice(x: NDArray[np.float64], y: NDArray[np.float64], cell_m: float) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return the absolute number of the first column and row, and the count of columns and rows."""
    _require_plan(x, y, cell_m)
    (west, cols), (south, rows) = (_numbers(each, float(cell_m)) for each in (x, y))
    if rows * cols > MAX_LATTICE or max(map(abs, (west, west + cols, south, south + rows))) > MAX_NUMBER:
        msg = (
            f"Cells of {cell_m:g} m over an extent of {rows} rows and {cols} columns cannot be numbered in 64 bits. "
            "Take larger cells, or drop the points that lie far from the others."
        )
        raise ParameterError(msg)
    return (west, cols), (south, rows)


def parts_of(index: CellIndex) -> list[tuple[int, int]]:
    """Cut the cells into ranges of about as many points each, for threads; one at least, though it be empty."""
    points = index.order.size
    count = min(max(points // LEAST_POINTS, 1), PARTS)
    bounds = np.searchsorted(index.starts, np.linspace(0, points, count + 1).astype(np.int64))
    return list(pairwise(bounds.tolist()))


@kernel
def places_around(index: CellIndex, part: tuple[int, int]) -> tuple[int, int]:
    """Return where in ``index.order`` the points begin and end that lie in a range of cells or in cells that touch it.

    Others may lie between them. So a part of the work needs the coordinates of a slice alone.
    """
    if part[0] >= part[1]:
        return 0, 0
    (row, col), cols = cell_place(index, part[0]), index.shape[1]
    first, stop = strip(index, row - 1, col - 1, cols)
    begin = first if stop > first else strip(index, row, 0, col)[0]
    row, col = cell_place(index, part[1] - 1)
    first, stop = strip(index, row + 1, 0, col + 1)
    return begin, stop if stop > first else strip(index, row, col, cols)[1]


@kernel
def cell_of_each(index: CellIndex) -> NDArray[np.int32]:
    """Return (N,) the place in ``index.keys`` of each point's cell, in the points' order."""
    cells = np.empty(index.order.size, dtype=np.int32)
    for cell in range(index.keys.size):
        for place in range(index.starts[cell], index.starts[cell + 1]):
            cells[index.order[place]] = cell
    return cells


@kernel
def cell_place(index: CellIndex, cell: int) -> tuple[int, int]:
    """Return the row and the column of a cell, given its place in ``index.keys``; for kernels."""
    key = index.keys[cell]
    return key // index.shape[1], key % index.shape[1]


@kernel
def strip(index: CellIndex, row: int, first_col: int, last_col: int) -> tuple[int, int]:
    """Return where in ``index.order`` the points of a stretch of a row begin and end; for kernels.

    Parameters
    ----------
    row : int
        May lie outside of the lattice: then the stretch is empty.
    first_col, last_col : int
        First and last column of the stretch, both included; they may lie outside of the lattice.
    """
    rows, cols = index.shape
    if row < 0 or row >= rows or last_col < 0 or first_col >= cols:
        return 0, 0
    low, high, first_col = 0, index.keys.size, max(first_col, 0)
    if index.rows.size:
        # Of the row's cells no more than there are columns lie before this one, nor after it.
        begin, end = index.rows[row], index.rows[row + 1]
        low, high = max(begin, end - (cols - first_col)), min(begin + first_col, end)
    first = _place_of(index.keys, row * cols + first_col, low, high)
    last_key = row * cols + min(last_col, cols - 1)
    # A stretch is a few cells long: the next keys are nearer than another bisection.
    stop = first
    while stop < index.keys.size and index.keys[stop] <= last_key:
        stop += 1
    return index.starts[first], index.starts[stop]


@kernel
def _place_of(keys: NDArray[np.int64], key: int, low: int, high: int) -> int:
    """Return the first place whose key is no lower; keys before ``low`` are lower, keys from ``high`` on are not."""
    while low < high:
        middle = (low + high) // 2
        if keys[middle] < key:
            low = middle + 1
        else:
            high = middle
    return low


@kernel
def _key(x: float, y: float, corner: tuple[int, int], cell_m: float, cols: int) -> int:
    """Return the number of a point's cell; the corner is the absolute column and row of the first cell."""
    return (int(number_along(y, cell_m)) - corner[1]) * cols + int(number_along(x, cell_m)) - corner[0]


@kernel
def _keys(plan: Plan, corner: tuple[int, int], cell_m: float, cols: int) -> NDArray[np.int64]:
    """Return the number of each point's cell."""
    x, y = plan
    keys = np.empty(x.size, dtype=np.int64)
    for point in range(x.size):
        keys[point] = _key(x[point], y[point], corner, cell_m, cols)
    return keys


@kernel
def _counts(plan: Plan, corner: tuple[int, int], cell_m: float, shape: tuple[int, int]) -> NDArray[np.int32]:
    """Count the points of each cell of a dense lattice."""
    x, y = plan
    count = np.zeros(shape[0] * shape[1], dtype=np.int32)
    for point in range(x.size):
        count[_key(x[point], y[point], corner, cell_m, shape[1])] += 1
    return count


@kernel
def _counted(plan: Plan, corner: tuple[int, int], cell_m: float, shape: tuple[int, int]) -> Sorting:
    """Sort by counting the points of each cell of a dense lattice."""
    (x, y), limit = plan, shape[0] * shape[1]
    place = _counts(plan, corner, cell_m, shape)
    cells = 0
    for key in range(limit):
        cells += place[key] > 0
    starts, occupied = np.empty(cells + 1, dtype=np.int32), np.empty(cells, dtype=np.int64)
    cell = total = 0
    for key in range(limit):
        points = place[key]
        place[key] = total  # from here on, where the next point of the cell goes
        if points > 0:
            starts[cell], occupied[cell] = total, key
            cell += 1
            total += points
    starts[cells] = total
    order = np.empty(x.size, dtype=np.int32)
    for point in range(x.size):
        key = _key(x[point], y[point], corner, cell_m, shape[1])
        order[place[key]] = point
        place[key] += 1
    return order, starts, occupied


def _sorted(plan: Plan, corner: tuple[int, int], cell_m: float, shape: tuple[int, int]) -> Sorting:
    """Sort by the numbers of the cells, on any lattice."""
    keys = _keys(plan, corner, cell_m, shape[1])
    wide = shape[0] * shape[1] > 2**32
    order = np.argsort(keys, kind="stable").astype(np.int32) if wide else order_of(keys, descending=False)
    keys = keys[order]
    first = np.ones(keys.size, dtype=np.bool_)
    np.not_equal(keys[1:], keys[:-1], out=first[1:])
    starts = np.append(np.flatnonzero(first), keys.size).astype(np.int32)
    return order, starts, keys[first]


def _numbers(values: NDArray[np.float64], cell_m: float) -> tuple[int, int]:
    """Return the absolute number of the first cell along an axis, and the count of cells up to the last value."""
    if values.size == 0:
        return 0, 0
    low, high = (int(cell_along(float(each), cell_m)) for each in (values.min(), values.max()))
    return low, high - low + 1


def _require_plan(x: NDArray[np.float64], y: NDArray[np.float64], cell_m: float) -> None:
    """Refuse coordinates that are no points, and sizes that are none."""
    require_coordinates(x=x, y=y)
    require_distance("cell size", cell_m)


def require_coordinates(**columns: NDArray[np.float64]) -> None:
    """Refuse arrays that are not one-dimensional, of one length and finite, or too long."""
    shapes = {name: values.shape for name, values in columns.items()}
    shape = next(iter(shapes.values()))
    if len(shape) != 1 or set(shapes.values()) != {shape} or shape[0] > MAX_POINTS:
        msg = f"Coordinates must be arrays of one length, of at most {MAX_POINTS} points; got the shapes {shapes}."
        raise InputError(msg)
    for name, values in columns.items():
        strange = values.size - np.count_nonzero(np.isfinite(values))
        if strange:
            msg = f"The coordinate {name} is NaN or infinite at {strange} of {values.size} points. Drop these points."
            raise InputError(msg)


def require_distance(what: str, value_m: float) -> None:
    """Refuse what is no finite number of metres above 0."""
    if not (math.isfinite(value_m) and value_m > 0):
        msg = f"The {what} must be a finite number of metres above 0; got {value_m!r}."
        raise ParameterError(msg)

"""Points connected in space: the graph of all pairs nearer than T_c, and the components that it makes.

The graph (Cao & Wu, Definition 1) depends on the points alone, not on a height. So it is built once, and every on-set
S_h and off-set is a choice of its points.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from msbdb.errors import InputError, ParameterError
from msbdb.labels import look_up
from msbdb.labels.cellkernels import find_root
from msbdb.points.aside import let_go, set_aside
from msbdb.points.cellindex import (
    MARGIN,
    CellIndex,
    cell_place,
    index_cells,
    parts_of,
    places_around,
    require_coordinates,
    require_distance,
)
from msbdb.threads import in_threads, kernel

MOST_CANDIDATES = 2**34
"""Most pairs of points in touching cells, each seen from both ends: more would take minutes."""

MOST_NEIGHBOURS = 2**32
"""Most neighbours of all points together: more would take over 16 GiB."""

A_POINT = 8
"""Neighbours of a point for which there is space at first."""

FEW = 64
"""Up to so many neighbours are sorted by insertion."""

NOBODY = np.zeros(0, dtype=np.int32)
"""No neighbours, in place of those that are in the graph by now."""

ROOT = -1
"""Marks a point that is the first of its component or cluster so far."""


@dataclass(frozen=True, slots=True, eq=False)
class PointGraph:
    """The connected points of each point, as compressed sparse rows.

    Parameters
    ----------
    indptr : (N + 1,) ndarray of int64
        Where in ``indices`` the neighbours of each point begin, and E at the end.
    indices : (E,) ndarray of int32
        The neighbours. Each pair is held from both ends, and they ascend for each point; or it is held from one end
        alone, and they come in any order. No point is its own neighbour.
    """

    indptr: NDArray[np.int64]
    indices: NDArray[np.int32]

    def __post_init__(self) -> None:
        """Refuse rows that do not fit, which would lead the kernels astray."""
        indptr, indices = self.indptr, self.indices
        fits = indptr.size > 0 and indptr[0] == 0 and indptr[-1] == indices.size and (indptr[1:] >= indptr[:-1]).all()
        if not fits or (indices.size and indices.view(np.uint32).max() >= len(self)):
            msg = f"The rows of a graph of {indptr.size - 1} points do not fit its {indices.size} neighbours."
            raise InputError(msg)

    def __len__(self) -> int:
        """Return the number of points."""
        return self.indptr.size - 1

    def aside(self) -> "PointGraph":
        """Return the graph as files hold it where memory is bounded (`msbdb.points.aside.set_aside`)."""
        return PointGraph(set_aside(self.indptr), set_aside(self.indices))

    def with_neighbours(self, chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return the points of a set, (N,) booleans, and all that are connected to one of them."""
        return _with_neighbours(chosen, self.indptr, self.indices)


def connect(
    x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], distance_m: float, *, once: bool = False
) -> PointGraph:
    """Connect all points whose distance in space is smaller than T_c.

    Parameters
    ----------
    x, y, z : (N,) ndarray of float64, metres
        Finite coordinates, also none. Not modified.
    distance_m : float
        T_c, metres, above 0. The paper gives none; 1.5 to 2 times the spacing of the points joins a surface.
    once : bool
        Hold each pair from one end alone, in half of the memory and time: enough for `components`.

    Returns
    -------
    PointGraph
        In the order of the points given.

    Raises
    ------
    InputError
        When the arrays are not three of one length, or a coordinate is NaN or infinite.
    ParameterError
        When T_c is no positive number, or so large that the pairs would not fit into memory.

    Notes
    -----
    Points p and q are connected when |p - q| < T_c, strictly (C2). Points at one place have the distance 0, and are
    connected. Border: what lies outside of the cloud does not exist.

    The points are sorted into cells of T_c in plan; their neighbours are found by the cores side by side for parts of
    the points, then put in the order of the points. Distances are those of the coordinates given, in 64 bits: large
    offsets do not matter.

    Complexity: O(N d) for d points in 3 by 3 cells. Memory: 8 bytes a point and 4 a neighbour, and in passing
    some 30 a point.

    Examples
    --------
    >>> graph = connect(np.array([0.0, 1.0, 3.0]), np.zeros(3), np.array([0.0, 1.0, 1.0]), 2.0)
    >>> graph.indptr, graph.indices
    (array([0, 1, 2, 2]), array([1, 0], dtype=int32))
    """
    require_coordinates(x=x, y=y, z=z)
    require_distance("distance T_c below which points are connected", distance_m)
    index = index_cells(x, y, distance_m * (1 + MARGIN))
    degree = np.zeros(x.size, dtype=np.int32)
    found = _neighbours(index, (x, y, z), distance_m, degree, once)
    indptr = np.zeros(x.size + 1, dtype=np.int64)
    np.cumsum(degree, out=indptr[1:])
    _require_affordable(int(indptr[-1]), MOST_NEIGHBOURS, x.size, distance_m)
    indices = np.empty(indptr[-1], dtype=np.int32)

    def place(part: int) -> None:
        _place(index, parts[part], found[part], indptr, indices)
        found[part] = NOBODY

    parts = parts_of(index)
    in_threads(place, range(len(parts)))
    return PointGraph(indptr, indices)


def _neighbours(
    index: CellIndex,
    places: tuple[NDArray[np.float64], ...],
    distance_m: float,
    degree: NDArray[np.int32],
    once: bool,
) -> list[NDArray[np.int32]]:
    """Return what `_find` does for each part of the cells, which alone has copies of its coordinates."""
    strips = _strips(index)
    around = (strips[:, :, 1] - strips[:, :, 0]).sum(axis=1, dtype=np.int64)
    _require_affordable(int(around @ np.diff(index.starts)), MOST_CANDIDATES, degree.size, distance_m)

    def find(part: tuple[int, int]) -> NDArray[np.int32]:
        begin, end = places_around(index, part)
        x, y, z = (_sorted(each, index.order[begin:end]) for each in places)
        let_go()
        search = _GraphSearch(index.order, index.starts, strips, begin, x, y, z, distance_m**2)
        return _find(search, degree, once, part)

    return in_threads(find, parts_of(index))


class _GraphSearch(NamedTuple):
    """What the kernel looks for: points sorted by cells, the three strips around each cell, and T_c squared.

    The coordinates are those from the place ``begin`` of this order on.
    """

    order: NDArray[np.int32]
    starts: NDArray[np.int32]
    strips: NDArray[np.int32]
    begin: int
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    z: NDArray[np.float64]
    limit_m2: float


@kernel
def _strips(index: CellIndex) -> NDArray[np.int32]:
    """Return where the points of the three strips around each cell begin and end, from south to north."""
    keys, starts, (rows, cols) = index.keys, index.starts, index.shape
    strips = np.zeros((keys.size, 3, 2), dtype=np.int32)
    for side in range(3):  # three cells of a row follow each other, so nine cells are three strips
        first = 0  # cells come in row-major order, so the first one of a strip never moves back
        for cell in range(keys.size):
            row, col = cell_place(index, cell)
            row += side - 1
            if row < 0 or row >= rows:
                continue
            while first < keys.size and keys[first] < row * cols + max(col - 1, 0):
                first += 1
            stop = first
            while stop < keys.size and keys[stop] <= row * cols + min(col + 1, cols - 1):
                stop += 1
            strips[cell, side, 0] = starts[first]
            strips[cell, side, 1] = starts[stop]
    return strips


@kernel
def _find(search: _GraphSearch, degree: NDArray[np.int32], once: bool, part: tuple[int, int]) -> NDArray[np.int32]:
    """Return the neighbours of the points in a range of cells, ascending for each point, or each pair once.

    They come in the order of the cells; ``degree`` gets how many each point has. A pair that is stored once is stored
    with the point that comes later in the order of the cells: the other one is in its own row or in that to the south.
    """
    order, starts, strips, begin, x, y, z, limit_m2 = search
    found = np.empty(max(A_POINT * (starts[part[1]] - starts[part[0]]), FEW), dtype=np.int32)
    end = 0
    for cell in range(part[0], part[1]):
        around = 0
        for side in range(3):
            around += strips[cell, side, 1] - strips[cell, side, 0]
        for own in range(starts[cell], starts[cell + 1]):
            while end + around > found.size:
                found = np.concatenate((found, np.empty_like(found)))
            point, first = order[own], end
            east, north, up = x[own - begin], y[own - begin], z[own - begin]
            for side in range(2 if once else 3):
                stop = own if once and side == 1 else strips[cell, side, 1]
                for other in range(strips[cell, side, 0], stop):
                    dx, dy, dz = x[other - begin] - east, y[other - begin] - north, z[other - begin] - up
                    # There is space for all around. About half of it is used: a branch would be foreseen badly.
                    found[end] = order[other]
                    end += dx * dx + dy * dy + dz * dz < limit_m2 and other != own
            if not once:
                _sort(found[first:end])
            degree[point] = end - first
    return found[:end].copy()  # without the space that was not needed


@kernel
def _place(
    index: CellIndex,
    part: tuple[int, int],
    found: NDArray[np.int32],
    indptr: NDArray[np.int64],
    indices: NDArray[np.int32],
) -> None:
    """Write the neighbours of the points in a range of cells into the points' rows."""
    place = 0
    for own in range(index.starts[part[0]], index.starts[part[1]]):
        point = index.order[own]  # rows do not overlap, so threads never write to the same place
        for row in range(indptr[point], indptr[point + 1]):
            indices[row] = found[place]
            place += 1


@kernel
def _sort(values: NDArray[np.int32]) -> None:
    """Sort in place: by insertion, which is quickest for the few neighbours that a point commonly has."""
    if values.size > FEW:
        values.sort()
        return
    for end in range(1, values.size):
        value = values[end]
        place = end
        while place > 0 and values[place - 1] > value:
            values[place] = values[place - 1]
            place -= 1
        values[place] = value


def _sorted(column: NDArray[np.float64], order: NDArray[np.int32]) -> NDArray[np.float64]:
    """Return a coordinate in the order of the cells, in 64 bits."""
    return look_up(column, order).astype(np.float64, copy=False)


def _require_affordable(pairs: int, most: int, points: int, distance_m: float) -> None:
    """Refuse a T_c that pairs too many points for time or memory."""
    if pairs > most:
        msg = (
            f"T_c = {distance_m:g} m pairs each of {points} points with up to {pairs // points} others on average, "
            f"more than the {most} pairs that can be afforded. Take T_c as 1.5 to 2 times the spacing of the points, "
            "drop duplicates, or cut the cloud into tiles."
        )
        raise ParameterError(msg)


def components(mask: NDArray[np.bool_], graph: PointGraph) -> tuple[NDArray[np.int32], int]:
    """Label the connected components of a set of points (Definition 2).

    Parameters
    ----------
    mask : (N,) ndarray of bool
        The set, such as an on-set.
    graph : PointGraph
        The connected points, from `connect`.

    Returns
    -------
    labels : (N,) ndarray of int32
        0 outside of the set, otherwise 1 to ``count`` in the order of the components' first points.
    count : int
        Number of components.

    Raises
    ------
    InputError
        When the set has not one boolean a point.

    Notes
    -----
    Two points are in one component when a path of connected points of the set leads from one to the other. One pass
    of union-find over the neighbours of the set's points: nearly O(N + E); 8 bytes a point.

    Examples
    --------
    >>> graph = connect(np.arange(5.0), np.zeros(5), np.zeros(5), 1.5)
    >>> components(np.array([True, True, False, True, True]), graph)
    (array([1, 1, 0, 2, 2], dtype=int32), 2)
    """
    if mask.dtype != np.bool_ or mask.shape != (len(graph),):
        msg = f"The set must be of {len(graph)} booleans, one a point; got {mask.dtype} of the shape {mask.shape}."
        raise InputError(msg)
    labels, count = _number_components(mask, graph.indptr, graph.indices)
    let_go()
    return labels, int(count)


@kernel
def _number_components(
    mask: NDArray[np.bool_], indptr: NDArray[np.int64], indices: NDArray[np.int32]
) -> tuple[NDArray[np.int32], int]:
    """Join each point of the set to those that it is connected to, under the earliest; then number them."""
    node = np.full(mask.size, ROOT, dtype=np.int32)
    for point in range(mask.size):
        if not mask[point]:
            continue
        root = find_root(node, point)
        for place in range(indptr[point], indptr[point + 1]):
            other = indices[place]
            if mask[other]:
                its = find_root(node, other)
                if its != root:
                    node[max(root, its)] = min(root, its)
                    root = min(root, its)
    labels = np.zeros(mask.size, dtype=np.int32)
    found = 0
    for point in range(mask.size):
        if mask[point]:
            # Roots are the earliest points of their components, and a parent is earlier than its child.
            if node[point] < 0:
                found += 1
                labels[point] = found
            else:
                labels[point] = labels[node[point]]
    return labels, found


@kernel
def _with_neighbours(
    chosen: NDArray[np.bool_], indptr: NDArray[np.int64], indices: NDArray[np.int32]
) -> NDArray[np.bool_]:
    """Return the chosen points and all that one of them is connected to, whichever point holds the pair."""
    found = chosen.copy()
    for point in range(chosen.size):
        for other in indices[indptr[point] : indptr[point + 1]]:
            if chosen[point]:
                found[other] = True
            elif chosen[other]:
                found[point] = True
    return found

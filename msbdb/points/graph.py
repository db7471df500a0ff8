"""Points connected in space: the graph of all pairs nearer than T_c, and the components and clusters that it makes.

The graph (Cao & Wu, Definition 1) depends on the points alone, not on a height. So it is built once, and every on-set
S_h and off-set is a choice of its points. `linked` gives the clusters alone, the tree of single linkage cut at a
distance, without a graph.
"""

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from msbdb.errors import InputError, ParameterError
from msbdb.morphology.area import find_root
from msbdb.points.cellindex import (
    MARGIN,
    CellIndex,
    cell_place,
    index_cells,
    parts_of,
    require_coordinates,
    require_distance,
    strip,
)
from msbdb.threads import in_threads, kernel

Floats = NDArray[np.float64]

MOST_CANDIDATES = 2**34
"""Most pairs of points in touching cells, each seen from both ends: more would take minutes."""

MOST_NEIGHBOURS = 2**32
"""Most neighbours of all points together: more would take over 16 GiB."""

FEW = 64
"""Up to so many neighbours are sorted by insertion."""

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
        The neighbours, ascending for each point. Each pair is held from both ends; no point is its own neighbour.
    """

    indptr: NDArray[np.int64]
    indices: NDArray[np.int32]

    def __post_init__(self) -> None:
        """Refuse rows that do not fit, which would lead the kernels astray."""
        indptr, indices = self.indptr, self.indices
        fits = indptr.size > 0 and indptr[0] == 0 and indptr[-1] == indices.size and (np.diff(indptr) >= 0).all()
        if not fits or (indices.size and not 0 <= indices.min() <= indices.max() < len(self)):
            msg = f"The rows of a graph of {indptr.size - 1} points do not fit its {indices.size} neighbours."
            raise InputError(msg)

    def __len__(self) -> int:
        """Return the number of points."""
        return self.indptr.size - 1


def connect(x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], distance_m: float) -> PointGraph:
    """Connect all points whose distance in space is smaller than T_c.

    Parameters
    ----------
    x, y, z : (N,) ndarray of float64, metres
        Finite coordinates, also none. Not modified.
    distance_m : float
        T_c, metres, above 0. The paper gives none; 1.5 to 2 times the spacing of the points joins a surface.

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

    The points are sorted into cells of T_c in plan; their neighbours are counted, then written, each by the cores
    side by side for parts of the points. Distances are those of the coordinates given, in 64 bits: large offsets do
    not matter.

    Complexity: O(N d) for d points in 3 by 3 cells. Memory: 8 bytes a point and 4 a neighbour, and some 50 a point
    in passing.

    Examples
    --------
    >>> graph = connect(np.array([0.0, 1.0, 3.0]), np.zeros(3), np.array([0.0, 1.0, 1.0]), 2.0)
    >>> graph.indptr, graph.indices
    (array([0, 1, 2, 2]), array([1, 0], dtype=int32))
    """
    require_coordinates(x=x, y=y, z=z)
    require_distance("distance T_c below which points are connected", distance_m)
    index = index_cells(x, y, distance_m * (1 + MARGIN))
    order, starts, strips = index.order, index.starts, _strips(index)
    around = (strips[:, :, 1] - strips[:, :, 0]).sum(axis=1, dtype=np.int64)
    _require_affordable(int(around @ np.diff(starts)), MOST_CANDIDATES, x.size, distance_m)
    search = _GraphSearch(order, starts, strips, _sorted(x, order), _sorted(y, order), _sorted(z, order), distance_m**2)
    parts = parts_of(index)
    indptr = np.zeros(x.size + 1, dtype=np.int64)
    in_threads(partial(_count, search, indptr[1:]), parts)
    np.cumsum(indptr, out=indptr)
    _require_affordable(int(indptr[-1]), MOST_NEIGHBOURS, x.size, distance_m)
    indices = np.empty(indptr[-1], dtype=np.int32)
    in_threads(partial(_fill, search, indptr, indices), parts)
    return PointGraph(indptr, indices)


class _GraphSearch(NamedTuple):
    """What the kernels look for: points sorted by cells, the three strips around each cell, and T_c squared."""

    order: NDArray[np.int32]
    starts: NDArray[np.int32]
    strips: NDArray[np.int32]
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    z: NDArray[np.float64]
    limit_m2: float


@kernel
def _strips(index: CellIndex) -> NDArray[np.int32]:
    """Return where the points of the three strips around each cell begin and end, from south to north."""
    strips = np.empty((index.keys.size, 3, 2), dtype=np.int32)
    for cell in range(index.keys.size):
        row, col = cell_place(index, cell)
        for side in range(3):  # three cells of a row follow each other, so nine cells are three strips
            first, stop = strip(index, row - 1 + side, col - 1, col + 1)
            strips[cell, side, 0] = first
            strips[cell, side, 1] = stop
    return strips


@kernel
def _count(search: _GraphSearch, degree: NDArray[np.int64], part: tuple[int, int]) -> None:
    """Count the neighbours of the points in a range of cells."""
    order, starts, strips, x, y, z, limit_m2 = search
    for cell in range(part[0], part[1]):
        for own in range(starts[cell], starts[cell + 1]):
            count = -1  # the point itself, which is found too
            for side in range(3):
                for other in range(strips[cell, side, 0], strips[cell, side, 1]):
                    dx, dy, dz = x[other] - x[own], y[other] - y[own], z[other] - z[own]
                    count += dx * dx + dy * dy + dz * dz < limit_m2
            degree[order[own]] = count


@kernel
def _fill(search: _GraphSearch, indptr: NDArray[np.int64], indices: NDArray[np.int32], part: tuple[int, int]) -> None:
    """Write the neighbours of the points in a range of cells, ascending."""
    order, starts, strips, x, y, z, limit_m2 = search
    for cell in range(part[0], part[1]):
        for own in range(starts[cell], starts[cell + 1]):
            begin = end = indptr[order[own]]  # rows do not overlap, so threads never write to the same place
            for side in range(3):
                for other in range(strips[cell, side, 0], strips[cell, side, 1]):
                    dx, dy, dz = x[other] - x[own], y[other] - y[own], z[other] - z[own]
                    if dx * dx + dy * dy + dz * dz < limit_m2 and other != own:
                        indices[end] = order[other]
                        end += 1
            _sort(indices[begin:end])


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
    return column[order].astype(np.float64, copy=False)


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
    return labels, int(count)


@kernel
def _number_components(
    mask: NDArray[np.bool_], indptr: NDArray[np.int64], indices: NDArray[np.int32]
) -> tuple[NDArray[np.int32], int]:
    """Join each point of the set to the earlier ones that it is connected to, under the earliest; then number them."""
    node = np.full(mask.size, ROOT, dtype=np.int32)
    for point in range(mask.size):
        if not mask[point]:
            continue
        root = point  # no later point has joined it yet
        for place in range(indptr[point], indptr[point + 1]):
            other = indices[place]
            if other > point:
                break  # neighbours ascend; the later ones join this point when they come
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


class _LinkSearch(NamedTuple):
    """Points in the order of their cells, and the square of the distance; for kernels."""

    cells: CellIndex
    x: Floats
    y: Floats
    z: Floats
    limit_m2: float


def linked(x: Floats, y: Floats, z: Floats, distance_m: float) -> tuple[NDArray[np.int32], int]:
    """Label the clusters of points: the connected components of all points nearer than a distance.

    Parameters
    ----------
    x, y, z : (N,) ndarray of float64, metres
        Finite coordinates.
    distance_m : float
        Points whose distance in space is smaller belong together, metres, above 0.

    Returns
    -------
    labels : (N,) ndarray of int32
        1 to ``count`` in the order of the clusters' first points.
    count : int
        Number of clusters.

    Raises
    ------
    InputError
        When the arrays are not three of one length, or a coordinate is NaN or infinite.
    ParameterError
        When the distance is no positive number.

    Notes
    -----
    As `components` of all points in the graph of `connect`, in a fraction of time and memory: pairs are joined as they
    are found, and those that are joined already are not measured. O(N d) for d points in 3 by 3 cells.

    Examples
    --------
    >>> linked(np.array([0.0, 9.0, 1.0]), np.zeros(3), np.zeros(3), 2.0)
    (array([1, 2, 1], dtype=int32), 2)
    """
    require_coordinates(x=x, y=y, z=z)
    require_distance("distance below which points belong together", distance_m)
    index = index_cells(x, y, distance_m * (1 + MARGIN))
    search = _LinkSearch(index, x[index.order], y[index.order], z[index.order], distance_m**2)
    labels, count = _number_clusters(_joined(search), index.order)
    return labels, int(count)


@kernel
def _joined(search: _LinkSearch) -> NDArray[np.int32]:
    """Join each point, in the order of the cells, to the earlier ones near it; return each point's parent.

    Invariant: a parent comes earlier in the order than its child, so that the root is the first point of a cluster.
    """
    index, x, y, z, limit_m2 = search
    node = np.full(x.size, ROOT, dtype=np.int32)
    for cell in range(index.keys.size):
        row, col = cell_place(index, cell)
        # Earlier points lie in the row below, or in the own row up to the own cell; later pairs find the others.
        below = strip(index, row - 1, col - 1, col + 1)
        own = strip(index, row, col - 1, col)
        for point in range(index.starts[cell], index.starts[cell + 1]):
            root = point
            for first, stop in (own, below):
                for other in range(first, min(stop, point)):
                    dx, dy, dz = x[other] - x[point], y[other] - y[point], z[other] - z[point]
                    if dx * dx + dy * dy + dz * dz >= limit_m2:
                        continue
                    its = find_root(node, other)
                    if its != root:
                        node[max(root, its)] = min(root, its)
                        root = min(root, its)
    return node


@kernel
def _number_clusters(node: NDArray[np.int32], order: NDArray[np.int32]) -> tuple[NDArray[np.int32], int]:
    """Return cluster numbers by first points, from the points' parents in the order of the cells."""
    labels = np.zeros(node.size, dtype=np.int32)
    place = np.empty(node.size, dtype=np.int32)
    for number in range(node.size):
        place[order[number]] = number
    label = np.zeros(node.size, dtype=np.int32)
    count = 0
    for point in range(node.size):
        root = find_root(node, place[point])
        if label[root] == 0:
            count += 1
            label[root] = count
        labels[point] = label[root]
    return labels, count

"""Clusters of points by single linkage: the tree of nearest pairs cut at a distance, without a graph."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from msbdb.labels.cellkernels import find_root
from msbdb.points.aside import let_go
from msbdb.points.cellindex import (
    MARGIN,
    CellIndex,
    cell_place,
    index_cells,
    parts_of,
    places_around,
    require_coordinates,
    require_distance,
    strip,
)
from msbdb.points.graph import ROOT
from msbdb.threads import in_threads, kernel

Floats = NDArray[np.float64]


class _LinkSearch(NamedTuple):
    """Points by cells, coordinates in this order from the place ``begin`` on, and the square of the distance."""

    cells: CellIndex
    begin: int
    x: Floats
    y: Floats
    z: Floats
    limit_m2: float


def linked(
    x: Floats, y: Floats, z: Floats, distance_m: float, among: NDArray[np.bool_] | None = None
) -> tuple[NDArray[np.int32], int]:
    """Label the clusters of points: the connected components of all points nearer than a distance.

    Parameters
    ----------
    x, y, z : (N,) ndarray of float64, metres
        Finite coordinates.
    distance_m : float
        Points whose distance in space is smaller belong together, metres, above 0.
    among : (N,) ndarray of bool, optional
        The points that belong to clusters at all; without it all of them.

    Returns
    -------
    labels : (N,) ndarray of int32
        1 to ``count`` in the order of the clusters' first points; 0 for points that are not among them.
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
    As `msbdb.points.graph.components` of all points in the graph of `msbdb.points.graph.connect`, in a fraction of time
    and memory: pairs are joined as they are found, and those that are joined already are not measured. O(N d) for d
    points in 3 by 3 cells.

    Examples
    --------
    >>> linked(np.array([0.0, 9.0, 1.0]), np.zeros(3), np.zeros(3), 2.0)
    (array([1, 2, 1], dtype=int32), 2)
    """
    require_coordinates(x=x, y=y, z=z)
    require_distance("distance below which points belong together", distance_m)
    inside = None if among is None else np.flatnonzero(among).astype(np.int32)
    plan = (x, y) if inside is None else (x[inside], y[inside])
    index = index_cells(*plan, distance_m * (1 + MARGIN))
    del plan
    let_go()
    node = np.full(index.order.size, ROOT, dtype=np.int32)
    # Each part joins its points to earlier ones, so the parts follow each other; a part alone has coordinates by cells.
    for part in parts_of(index):
        begin, end = places_around(index, part)
        own = index.order[begin:end] if inside is None else inside[index.order[begin:end]]
        _join(_LinkSearch(index, begin, x[own], y[own], z[own], distance_m**2), part, node)
        let_go()
    labels, count = _number_clusters(node, index.order)
    if inside is None:
        return labels, int(count)
    every = np.zeros(x.size, dtype=np.int32)
    every[inside] = labels
    return every, int(count)


def near_others(x: Floats, y: Floats, z: Floats, distance_m: float, chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which of the chosen points are nearer than a distance to one that is not chosen, (N,) booleans.

    Examples
    --------
    >>> near_others(np.array([0.0, 1.0, 2.5, 9.0]), np.zeros(4), np.zeros(4), 2.0, np.array([True, False, True, True]))
    array([ True, False,  True, False])
    """
    index = index_cells(x, y, distance_m * (1 + MARGIN))
    found = np.zeros(x.size, dtype=np.bool_)

    def look(part: tuple[int, int]) -> None:
        begin, end = places_around(index, part)
        own = index.order[begin:end]
        search = _LinkSearch(index, begin, x[own], y[own], z[own], distance_m**2)
        let_go()
        _look_beside(search, part, chosen[own], found)

    in_threads(look, parts_of(index))
    return found


@kernel
def _look_beside(
    search: _LinkSearch, part: tuple[int, int], chosen: NDArray[np.bool_], found: NDArray[np.bool_]
) -> None:
    """Mark the chosen points of a range of cells that have others near; ``chosen`` comes as the coordinates do."""
    index, begin, x, y, z, limit_m2 = search
    for cell in range(part[0], part[1]):
        own, after = index.starts[cell] - begin, index.starts[cell + 1] - begin
        if not chosen[own:after].any():
            continue
        row, col = cell_place(index, cell)
        strips = [strip(index, other, col - 1, col + 1) for other in range(row - 1, row + 2)]
        lowest, highest = math.inf, -math.inf  # of the others
        for first, stop in strips:
            for other in range(first - begin, stop - begin):
                if not chosen[other]:
                    lowest, highest = min(lowest, z[other]), max(highest, z[other])
        for point in range(own, after):
            up = max(z[point] - highest, lowest - z[point], 0.0)
            if not chosen[point] or up * up >= limit_m2:  # above or below them all
                continue
            near = False
            for first, stop in strips:
                for other in range(first - begin, stop - begin):
                    if near:
                        break
                    if chosen[other]:
                        continue
                    dx, dy, dz = x[other] - x[point], y[other] - y[point], z[other] - z[point]
                    near = dx * dx + dy * dy + dz * dz < limit_m2
            found[index.order[begin + point]] = near


@kernel
def _join(search: _LinkSearch, part: tuple[int, int], node: NDArray[np.int32]) -> None:
    """Join each point of a range of cells to the earlier ones near it, in the order of the cells.

    Invariant: a parent in ``node`` comes earlier in the order than its child, so that the root is the first point of a
    cluster.
    """
    index, begin, x, y, z, limit_m2 = search
    for cell in range(part[0], part[1]):
        row, col = cell_place(index, cell)
        # Earlier points lie in the row below, or in the own row up to the own cell; later pairs find the others.
        below = strip(index, row - 1, col - 1, col + 1)
        own = strip(index, row, col - 1, col)
        for point in range(index.starts[cell], index.starts[cell + 1]):
            root = point
            east, north, up = x[point - begin], y[point - begin], z[point - begin]
            for first, stop in (own, below):
                for other in range(first, min(stop, point)):
                    if node[other] == root:  # joined already
                        continue
                    dx, dy, dz = x[other - begin] - east, y[other - begin] - north, z[other - begin] - up
                    if dx * dx + dy * dy + dz * dz >= limit_m2:
                        continue
                    its = find_root(node, other)
                    if its != root:
                        node[max(root, its)] = min(root, its)
                        root = min(root, its)


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

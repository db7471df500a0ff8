"""Alpha shapes of many regions at once, by one triangulation of all of their points (S7)."""

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import shortest_path
from scipy.spatial import Delaunay, QhullError

from msbdb.vector.packing import pack
from msbdb.vector.polygons import Geometries

Floats = NDArray[np.float64]
Labels = NDArray[np.int32]
Mask = NDArray[np.bool_]

GAP_CELLS = 2
"""Wider empty bands are narrowed to one empty cell, so that islands far apart are triangulated without loss."""

COVERED_GAP_CELLS = 4
"""The same for cells that a point of the next cell can cover: one between stays uncovered."""

REACH = 2
"""The centre of a disc that touches a point lies at most so many cells (of half a radius) from the point's."""


def alpha_shapes(x: Floats, y: Floats, labels: Labels, count: int, radius_m: float) -> Geometries:
    """Return the alpha shape of each region: its triangles of a circumradius below 1/alpha, united.

    Parameters
    ----------
    x, y : (N,) ndarray of float64, metres
        Points; duplicates count once.
    labels : (N,) ndarray of int32
        1 to ``count``: the region of each point.
    count : int
        Number of regions.
    radius_m : float
        1/alpha, metres; infinite gives the convex hull of a region that is alone.

    Returns
    -------
    (count,) ndarray of Polygon or MultiPolygon
        With their holes; None for a region of which no triangle is left. Regions share no inner point, because their
        triangles are of one Delaunay triangulation.

    Notes
    -----
    The outline is made of the edges that an empty disc of the radius touches at both ends. `thinned` leaves out what
    no such disc touches; that opens holes inside, whose edges run between deep points and are left out as well.
    O(n log n) in the points that are left.
    """
    kept, deep = thinned(x, y, labels, radius_m)
    x, y, labels, deep = x[kept], y[kept], labels[kept], deep[kept]
    simplices, neighbours = _triangles(np.column_stack((narrowed(x, radius_m), narrowed(y, radius_m))))
    one, two, three = (labels[simplices[:, k]] for k in range(3))
    taken = (one == two) & (two == three) & (_circumradius(x, y, simplices) < radius_m)
    # A triangle's k-th neighbour lies beyond the edge that is opposite to its k-th vertex; -1 is none.
    triangle, k = np.nonzero(taken[:, None] & ~np.append(taken, values=False)[neighbours])
    start, end = simplices[triangle, (k + 1) % 3], simplices[triangle, (k + 2) % 3]
    real = ~(deep[start] | deep[end])
    start, end = start[real], end[real]
    points = np.column_stack((x, y))
    return enclosed(points[start], points[end], labels[start], count)


def enclosed(start: Floats, end: Floats, labels: NDArray[np.integer], count: int) -> Geometries:
    """Return the area that the border edges of each region enclose.

    Parameters
    ----------
    start, end : (E, 2) ndarray of float64, metres
        Ends of the edges, in any order and direction; edges of a region meet only at their ends.
    labels : (E,) ndarray of int
        1 to ``count``: the region of each edge.
    count : int
        Number of regions.

    Returns
    -------
    (count,) ndarray of Polygon or MultiPolygon
        With holes; None for a region without edges.

    Notes
    -----
    The edges cut the plane into faces. Every edge has the region on one side alone, so that a face belongs to it when
    an odd number of edges lies between it and the outside. That holds where holes touch each other or the outline
    with a corner, too, of which GEOS' own build_area makes solid ground.
    """
    found = np.full(count, None, dtype=np.object_)
    order = np.argsort(labels, kind="stable")
    present, region = np.unique(labels[order], return_inverse=True)
    if not present.size:
        return found
    lines = np.asarray(shapely.linestrings(np.stack((start[order], end[order]), axis=1)), dtype=np.object_)
    meshes = np.split(lines, np.flatnonzero(np.diff(region)) + 1)
    faces, owner = shapely.get_parts(np.array([shapely.polygonize(mesh) for mesh in meshes]), return_index=True)
    inside = _steps_from_outside(faces, owner) % 2 == 1
    # Of a region's faces no two share an edge.
    solid, place = np.unique(owner[inside], return_inverse=True)
    found[present[solid] - 1] = shapely.multipolygons(faces[inside], indices=place)
    return found


def _steps_from_outside(faces: Geometries, owner: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the least number of edges between each face and the outside of its region."""
    rings, face = shapely.get_rings(faces, return_index=True)
    xy, ring = shapely.get_coordinates(rings, return_index=True)
    same = ring[1:] == ring[:-1]
    a, b, of = xy[:-1][same], xy[1:][same], face[ring[:-1][same]]
    # Two faces give one edge in opposite directions.
    turned = (a[:, 0] > b[:, 0]) | ((a[:, 0] == b[:, 0]) & (a[:, 1] > b[:, 1]))
    a, b = np.where(turned[:, None], b, a), np.where(turned[:, None], a, b)
    key = np.column_stack((owner[of], a, b))
    _, edge = np.unique(key, axis=0, return_inverse=True)
    edge = edge.ravel()
    outside = len(faces)
    sides = np.full((int(edge.max(initial=-1)) + 1, 2), outside)
    by_edge = np.argsort(edge, kind="stable")
    first = np.diff(edge[by_edge], prepend=-1) > 0
    sides[edge[by_edge][first], 0] = of[by_edge][first]
    sides[edge[by_edge][~first], 1] = of[by_edge][~first]
    graph = coo_array((np.ones(len(sides)), (sides[:, 0], sides[:, 1])), shape=(outside + 1, outside + 1)).tocsr()
    steps = shortest_path(graph, directed=False, unweighted=True, indices=outside)
    return np.asarray(steps[:-1], dtype=np.int64)


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
    covered. A disc with its centre in a cell that is not covered holds no deep point; so it is enough to keep a point
    that covers for each covered cell around the points that are not deep.
    """
    if not np.isfinite(radius_m) or len(x) == 0:
        return np.arange(len(x)), np.zeros(len(x), dtype=np.bool_)
    side = radius_m / REACH
    east, north = pack(x, side, COVERED_GAP_CELLS), pack(y, side, COVERED_GAP_CELLS)
    width = int(east.number[-1]) + 1 + 4 * REACH
    key = (north.cell + 2 * REACH) * width + east.cell + 2 * REACH
    covered, coverer = _covered(key, np.mod(x / side, 1), np.mod(y / side, 1), width)
    deep = _pure(x, y, labels, 2 * radius_m)
    cells, cell = np.unique(key, return_inverse=True)
    inner = np.ones(len(cells), dtype=np.bool_)
    for down in range(-REACH, REACH + 1):
        last = np.searchsorted(covered, cells + down * width - REACH) + 2 * REACH
        inner &= last < len(covered)
        inner &= covered[np.minimum(last, len(covered) - 1)] == cells + down * width + REACH
    deep &= inner[cell]
    rim = np.unique(key[~deep])
    near = np.zeros(len(covered), dtype=np.bool_)
    for down in range(-REACH, REACH + 1):
        place = np.searchsorted(rim, covered + down * width - REACH)
        near |= np.append(rim, covered[-1] * 2 + 9 * width)[place] <= covered + down * width + REACH
    kept = ~deep
    kept[coverer[near]] = True
    return np.flatnonzero(kept), deep


def _covered(
    key: NDArray[np.int64], right: Floats, up: Floats, width: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the cells all of which is nearer than two sides to some point, ascending, and the first such point.

    ``right`` and ``up`` are the place of each point in its cell, 0 to 1.
    """
    reach_x = {-1: right + 1, 0: np.maximum(right, 1 - right), 1: 2 - right}
    reach_y = {-1: up + 1, 0: np.maximum(up, 1 - up), 1: 2 - up}
    keys, points = [], []
    for row in (-1, 0, 1):
        for col in (-1, 0, 1):
            # A little less than the radius, for coordinates are rounded.
            found = np.flatnonzero(reach_x[col] ** 2 + reach_y[row] ** 2 < REACH**2 - 1e-6)
            keys.append(key[found] + row * width + col)
            points.append(found)
    every = np.concatenate(keys)
    order = np.lexsort((np.concatenate(points), every))
    first = order[np.flatnonzero(np.diff(every[order], prepend=-1))]
    return every[first], np.concatenate(points)[first]


def _pure(x: Floats, y: Floats, labels: Labels, reach_m: float) -> Mask:
    """Return the points within whose reach all points are of their own region."""
    east, north = pack(x, reach_m, GAP_CELLS), pack(y, reach_m, GAP_CELLS)
    width = int(east.number[-1]) + 3
    cells, cell = np.unique((north.cell + 1) * width + east.cell + 1, return_inverse=True)
    low, high = np.full(len(cells), labels.max()), np.zeros(len(cells), dtype=labels.dtype)
    np.minimum.at(low, cell, labels)
    np.maximum.at(high, cell, labels)
    pure = low == high
    for step in (down * width + right for down in (-1, 0, 1) for right in (-1, 0, 1)):
        place = np.minimum(np.searchsorted(cells, cells + step), len(cells) - 1)
        there = cells[place] == cells + step
        pure &= ~there | ((low[place] == low) & (high[place] == low))
    return np.asarray(pure[cell])


def narrowed(values: Floats, radius_m: float) -> Floats:
    """Return the coordinates along one axis from 0, with empty bands wider than any triangle's edge narrowed.

    A triangle of a circumradius below ``radius_m`` has no edge of twice as much; bands stay at least four times as
    wide, so no such triangle is made or lost.
    """
    if not np.isfinite(radius_m) or not len(values):
        return values
    side = 4 * radius_m
    axis = pack(values, side, GAP_CELLS)
    return np.asarray(values - (axis.occupied - axis.number)[np.searchsorted(axis.number, axis.cell)] * side)


def _triangles(points: Floats) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return the Delaunay triangles and their neighbours; none where the points span no area."""
    try:
        made = Delaunay(points - points.min(axis=0))
    except (QhullError, ValueError):  # fewer than three points, or all on one line
        return np.zeros((0, 3), dtype=np.int32), np.zeros((0, 3), dtype=np.int32)
    return made.simplices, made.neighbors


def _circumradius(x: Floats, y: Floats, simplices: NDArray[np.int32]) -> Floats:
    """Return abc / 4A of each triangle, metres; infinite where it has no area."""
    x1, x2, x3 = (x[simplices[:, k]] for k in range(3))
    y1, y2, y3 = (y[simplices[:, k]] for k in range(3))
    sides = np.hypot(x2 - x1, y2 - y1) * np.hypot(x3 - x2, y3 - y2) * np.hypot(x1 - x3, y1 - y3)
    double_area = np.abs((x2 - x1) * (y3 - y1) - (x3 - x1) * (y2 - y1))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(double_area > 0, sides / (2 * double_area), np.inf)

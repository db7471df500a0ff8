"""Alpha shapes of many regions at once, by one triangulation of all of their points (S7)."""

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components, shortest_path
from scipy.spatial import Delaunay, QhullError

from msbdb.labels import Labels
from msbdb.outline.polygons import Geometries
from msbdb.outline.thinning import pack, thinned
from msbdb.threads import in_threads

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

GAP_CELLS = 2
"""Wider empty bands are narrowed to one empty cell, so that islands far apart are triangulated without loss."""

BATCH = 1 << 13
"""Points that are triangulated together, if their clusters are not larger: their triangles stay in the cache."""


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
        With their holes; None for a region without a triangle. Regions share no inner point, because their
        triangles are of one Delaunay triangulation.

    Notes
    -----
    The outline consists of the edges that an empty disc of the radius touches at both ends. `thinned` removes points
    that no such disc touches. That opens holes inside, whose edges run between deep points and are removed as well.
    The other points are triangulated in `batches`, by threads. So the shape of a region depends only on points within
    the double radius of it. Of points at one place in plan the one of the lowest label counts. Where four points or
    more lie on one circle, and some are of another region, any of the possible triangles between them may occur.
    Rings begin at their westernmost vertex. O(n log n) in the points of a batch.

    Examples
    --------
    The points of an L-shaped roof, 1 m apart: 5 m² of squares, and half a square in the inner corner:

    >>> x = np.array([0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 0, 1], dtype=float)
    >>> y = np.array([0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 3, 3], dtype=float)
    >>> float(alpha_shapes(x, y, np.ones(12, dtype=np.int32), 1, radius_m=0.9)[0].area)
    5.5
    """
    kept, deep = thinned(x, y, labels, radius_m)
    x, y, labels, deep = x[kept], y[kept], labels[kept], deep[kept]
    points = np.column_stack((x, y))
    edges = np.concatenate(
        in_threads(lambda batch: _border_edges(points, labels, batch, radius_m), batches(x, y, radius_m))
    )
    edges.sort(axis=1)
    start, end = edges[np.lexsort((edges[:, 1], edges[:, 0]))].T
    real = ~(deep[start] | deep[end])
    start, end = start[real], end[real]
    return enclosed(points[start], points[end], labels[start], count)


def batches(x: Floats, y: Floats, radius_m: float) -> list[NDArray[np.intp]]:
    """Cut points into batches of whole clusters, between which no triangle of a small circumradius can lie.

    Parameters
    ----------
    x, y : (N,) ndarray of float64, metres
        Points.
    radius_m : float
        1/alpha, metres; infinite gives one batch.

    Returns
    -------
    list of ndarray of int
        Indices of the points of each batch, ascending; each point in one of them.

    Notes
    -----
    A cluster is a connected set of cells, corners included, whose side is the double radius. The disc about a triangle
    of a smaller circumradius holds no other point, and whatever point could lie in it is in the triangle's cluster.
    So the small triangles of all points are those of the clusters, each triangulated by itself.
    """
    if not np.isfinite(radius_m) or not len(x):
        return [np.arange(len(x))]
    east, north = pack(x, 2 * radius_m, GAP_CELLS), pack(y, 2 * radius_m, GAP_CELLS)
    width = int(east.number[-1]) + 3
    cells, cell = np.unique((north.cell + 1) * width + east.cell + 1, return_inverse=True)
    pairs = []
    for step in (1, width - 1, width, width + 1):
        place = np.minimum(np.searchsorted(cells, cells + step), len(cells) - 1)
        there = np.flatnonzero(cells[place] == cells + step)
        pairs.append((there, place[there]))
    one, other = (np.concatenate(ends) for ends in zip(*pairs, strict=True))
    graph = coo_array((np.ones(one.size, dtype=np.bool_), (one, other)), shape=(cells.size, cells.size))
    cluster = connected_components(graph, directed=False)[1][cell]
    size = np.bincount(cluster)
    batch = ((np.cumsum(size) - size) // BATCH)[cluster]
    order = np.argsort(batch, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(batch[order])) + 1)


def _without_duplicates(points: Floats, batch: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the batch without points at the place of an earlier one, because a triangulation may take either."""
    order = batch[np.lexsort((points[batch, 1], points[batch, 0]))]
    first = np.append(True, (np.diff(points[order], axis=0) != 0).any(axis=1))
    return np.sort(order[first])


def _border_edges(points: Floats, labels: Labels, batch: NDArray[np.intp], radius_m: float) -> NDArray[np.intp]:
    """Return (E, 2) the ends of the edges between triangles of a batch that are taken and others."""
    batch = _without_duplicates(points, batch)
    x, y, labels = points[batch, 0], points[batch, 1], labels[batch]
    simplices, neighbours = _triangles(np.column_stack((narrowed(x, radius_m), narrowed(y, radius_m))))
    one, two, three = (labels[simplices[:, k]] for k in range(3))
    taken = (one == two) & (two == three) & (_circumradius(x, y, simplices) < radius_m)
    # A triangle's k-th neighbour lies beyond the edge that is opposite to its k-th vertex; -1 is none.
    triangle, k = np.nonzero(taken[:, None] & ~np.append(taken, values=False)[neighbours])
    ends = np.column_stack((simplices[triangle, (k + 1) % 3], simplices[triangle, (k + 2) % 3]))
    edges: NDArray[np.intp] = batch[ends]
    return edges


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
    The edges cut the plane into faces. Every edge has the region on one side alone, so a face belongs to the region
    when an odd number of edges lies between it and the outside. This also holds where holes touch each other or the
    outline with a corner; there GEOS' build_area loses the hole.
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

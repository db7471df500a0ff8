"""Simplification: outlines of cells without their stairs, by Douglas-Peucker, with shared edges kept shared."""

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from msbdb.errors import InputError, ParameterError
from msbdb.outline.polygons import Geometries

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]

LEVELS = 3
"""How often an arc at fault is redrawn: by half of the tolerance, by a quarter, and not at all."""

LENGTH_TOLERANCE = 1e-6
"""Relative excess at which an edge still counts as no longer than the tolerance, for coordinates are rounded."""


def simplify_coverage(geometries: Geometries, tolerance_m: float) -> Geometries:
    """Remove the zig-zag of outlines by Douglas-Peucker, from shared edges once for both neighbours (V47, V48).

    Parameters
    ----------
    geometries : (N,) ndarray of MultiPolygon
        They do not overlap, and neighbours share whole edges, vertex by vertex, as `polygonise` returns them. Empty
        ones stay empty.
    tolerance_m : float
        Largest distance of a removed vertex from the new outline, metres; 0 changes nothing. One cell is the least
        that removes the stairs of oblique walls.

    Returns
    -------
    (N,) ndarray of MultiPolygon
        Valid, without overlaps, with every ring of the input still there.

    Raises
    ------
    ParameterError
        For a negative tolerance.
    InputError
        When outlines are invalid or overlap, or share an edge with different vertices.

    Notes
    -----
    The outlines are cut into arcs at the vertices where three edges or more meet, and each arc is simplified on its
    own with its ends kept; a ring without such a vertex starts at its westernmost one. First, each stair becomes its
    midpoint: an edge no longer than the tolerance between opposite turns. Without this step Douglas-Peucker runs along
    the tips of the stairs on one side and shifts the wall. Then Douglas-Peucker takes half of the tolerance.

    A polygon is broken when it collapses, or crosses itself or a neighbour. Its arcs at fault are simplified by half of
    the tolerance, then by a quarter, then not at all. Neighbours get the same arc.

    On 200 rectangles and L-shapes of 8 to 60 cells at all angles, a third with frayed edges, with a tolerance of
    one cell: 15 vertices an outline (raster: 97), IoU with the truth 0.947 (raster: 0.944), mean change of the
    area 0.9 % in size and 0.1 % in sum, largest distance to the raster outline 1 cell. Douglas-Peucker alone gives
    16 vertices and IoU 0.937; the coverage simplification of GEOS (by areas of triangles) 29 vertices and IoU 0.942,
    or 13 and 0.938 at a tolerance of two cells, with distances of up to 2.8 cells.

    Examples
    --------
    A wall with stairs of 1 m, from (0, 0) to (8, 3), becomes straight:

    >>> stairs = [(0, 0), (2, 0), (2, 1), (4, 1), (4, 2), (6, 2), (6, 3), (8, 3), (8, 10), (0, 10)]
    >>> outline = np.array([shapely.MultiPolygon([shapely.Polygon(stairs)])])
    >>> print(simplify_coverage(outline, 1.0)[0])
    MULTIPOLYGON (((0 0, 8 3, 8 10, 0 10, 0 0)))
    """
    if not tolerance_m >= 0:
        msg = f"The tolerance must be 0 or more metres; got {tolerance_m}."
        raise ParameterError(msg)
    if tolerance_m == 0 or shapely.is_empty(geometries).all():
        return geometries.copy()
    arcs = _cut(geometries)
    level = np.zeros(len(arcs.sizes), dtype=np.int64)
    drawn = _redrawn(arcs, arcs.as_given(), np.arange(len(level)), level, tolerance_m)
    while True:
        result = _assembled(arcs, drawn)
        if result is None:
            fault = (drawn.ring_sizes(arcs) < 3)[arcs.ring]
        else:
            broken = _broken(result)
            if not broken.any():
                return result
            fault = _at_fault(arcs, drawn, level, np.flatnonzero(broken[arcs.geometry]))
        changed = np.flatnonzero(np.isin(arcs.key, arcs.key[fault & (level < LEVELS)]))
        if not len(changed):
            msg = (
                "Outlines can be simplified only when they are valid, do not overlap and share whole edges; "
                f"{len(np.unique(arcs.geometry[fault]))} of {len(geometries)} do not. Polygonise the labels anew."
            )
            raise InputError(msg)
        level[changed] += 1
        drawn = _redrawn(arcs, drawn, changed, level, tolerance_m)


@dataclass(frozen=True, slots=True, eq=False)
class _Arcs:
    """Arcs in the order of their rings; the vertices of an arc do not include its end, the next arc's first.

    Attributes
    ----------
    coords : (V, 2) ndarray
        Vertices of all arcs.
    sizes, end, ring, geometry, key, forward : (A,) ndarray
        Of each arc: number of vertices; index of the vertex at which it ends; its ring and geometry; a key that
        the same arc has in all polygons; and whether it runs in its canonical direction here.
    offsets : tuple of ndarray
        Rings a polygon and polygons a geometry, cumulated.
    rings : int
        Number of rings.
    """

    coords: Floats
    sizes: Ints
    end: Ints
    ring: Ints
    geometry: Ints
    key: Ints
    forward: NDArray[np.bool_]
    offsets: tuple[Ints, Ints]
    rings: int

    def as_given(self) -> "_Drawn":
        """Return all arcs with all of their vertices."""
        return _Drawn(self.coords, np.cumsum(self.sizes) - self.sizes, self.sizes)


@dataclass(frozen=True, slots=True, eq=False)
class _Drawn:
    """How each arc is drawn: its vertices are ``sizes`` rows of ``pool`` from ``start`` on, without its end."""

    pool: Floats
    start: Ints
    sizes: Ints

    def coords(self, which: Ints) -> Floats:
        """Return the vertices of the arcs, one after the other."""
        sizes = self.sizes[which]
        offset = np.repeat(self.start[which] - (np.cumsum(sizes) - sizes), sizes)
        return self.pool[offset + np.arange(len(offset))]

    def ring_sizes(self, arcs: _Arcs) -> Ints:
        """Return the number of vertices of each ring."""
        return np.bincount(arcs.ring, weights=self.sizes, minlength=arcs.rings).astype(np.int64)

    def lines(self, arcs: _Arcs, which: Ints) -> Geometries:
        """Return the arcs as lines, with their ends."""
        sizes = self.sizes[which]
        coords = np.insert(self.coords(which), np.cumsum(sizes), arcs.coords[arcs.end[which]], axis=0)
        lines = shapely.linestrings(coords, indices=np.repeat(np.arange(len(which)), sizes + 1))
        return np.asarray(lines, dtype=np.object_)


def _cut(geometries: Geometries) -> _Arcs:
    """Cut the rings into arcs at the vertices where three edges or more meet."""
    _, closed, (ring_offsets, polygon_offsets, offsets) = shapely.to_ragged_array(_as_multi(geometries))
    sizes = np.diff(ring_offsets).astype(np.int64) - 1
    ring = np.repeat(np.arange(len(sizes)), sizes)
    first = np.cumsum(sizes) - sizes
    coords = closed[np.arange(len(ring)) + ring]  # without the vertex that closes each ring
    vertex = np.unique(coords[:, 0] + 1j * coords[:, 1], return_inverse=True)[1].astype(np.int64)
    cut = _degree(vertex, _following(first, sizes, ring)) > 2
    westernmost = np.lexsort((vertex, ring))[first]
    anchor = np.zeros(len(sizes), dtype=np.bool_)
    np.logical_or.at(anchor, ring[cut], True)
    cut[westernmost[~anchor]] = True
    # Turn each ring so that it starts at a cut.
    cuts = np.flatnonzero(cut)
    start = cuts[np.searchsorted(ring[cuts], np.arange(len(sizes)))]
    turned = first[ring] + (np.arange(len(ring)) - first[ring] + (start - first)[ring]) % sizes[ring]
    coords, vertex, cut = coords[turned], vertex[turned], cut[turned]
    begin = np.flatnonzero(cut)
    following = _following(first, sizes, ring)
    last = np.append(begin[1:], len(ring)) - 1
    key, forward = _identity(vertex, begin, last, following)
    rings_before = polygon_offsets[offsets]
    geometry = np.searchsorted(rings_before, ring[begin], side="right") - 1
    return _Arcs(
        coords,
        last - begin + 1,
        following[last],
        ring[begin],
        geometry,
        key,
        forward,
        (polygon_offsets.astype(np.int64), offsets.astype(np.int64)),
        len(sizes),
    )


def _following(first: Ints, sizes: Ints, ring: Ints) -> Ints:
    """Return the index of each vertex's successor in its ring."""
    index = np.arange(len(ring)) + 1
    wraps = index == (first + sizes)[ring]
    return np.where(wraps, first[ring], index)


def _degree(vertex: Ints, following: Ints) -> Ints:
    """Return at each vertex the number of distinct edges that meet there, whichever polygons they belong to."""
    ends = np.sort(np.column_stack((vertex, vertex[following])), axis=1)
    count = int(vertex.max()) + 1
    edges = np.unique(ends[:, 0] * count + ends[:, 1])
    degree = np.bincount(edges // count, minlength=count) + np.bincount(edges % count, minlength=count)
    return degree[vertex].astype(np.int64)


def _identity(vertex: Ints, begin: Ints, last: Ints, following: Ints) -> tuple[Ints, NDArray[np.bool_]]:
    """Return the arcs' keys and whether they run in canonical direction.

    The lesser of the first and the last directed edge, the last one taken backwards, gives both.
    """
    count = int(vertex.max()) + 1
    head = vertex[begin] * count + vertex[following[begin]]
    tail = vertex[following[last]] * count + vertex[last]
    return np.minimum(head, tail), head <= tail


def _redrawn(arcs: _Arcs, drawn: _Drawn, which: Ints, level: Ints, tolerance_m: float) -> _Drawn:
    """Draw the arcs anew for their level."""
    start, sizes = drawn.start.copy(), drawn.sizes.copy()
    given = arcs.as_given()
    start[which], sizes[which] = given.start[which], given.sizes[which]
    pools, used = [drawn.pool], len(drawn.pool)
    for step in range(LEVELS):
        here = which[level[which] == step]
        if len(here):
            coords, found = _simplified(arcs, here, tolerance_m / 2**step)
            start[here], sizes[here] = used + np.cumsum(found) - found, found
            pools.append(coords)
            used += len(coords)
    return _Drawn(np.concatenate(pools), start, sizes)


def _simplified(arcs: _Arcs, which: Ints, tolerance_m: float) -> tuple[Floats, Ints]:
    """Simplify arcs in their canonical direction; the vertices returned are in the ring's, without the ends."""
    backwards = ~arcs.forward[which]
    lines = arcs.as_given().lines(arcs, which)
    lines[backwards] = shapely.reverse(lines[backwards])
    coords, arc = shapely.get_coordinates(lines, return_index=True)
    coords, arc = _without_stairs(coords, arc, tolerance_m)
    lines[:] = shapely.simplify(shapely.linestrings(coords, indices=arc), tolerance_m / 2, preserve_topology=False)
    lines[backwards] = shapely.reverse(lines[backwards])
    coords, arc = shapely.get_coordinates(lines, return_index=True)
    ends = np.flatnonzero(np.diff(arc, append=len(which)))
    return np.delete(coords, ends, axis=0), np.bincount(arc, minlength=len(which)) - 1


def _without_stairs(coords: Floats, arc: Ints, tolerance_m: float) -> tuple[Floats, Ints]:
    """Replace every stair by its midpoint: an edge no longer than the tolerance, between opposite turns.

    An end of the stair stays as well where a longer wall begins: the edge beyond it exceeds the one before the stair
    by more than the tolerance, and has no stair at its other end. Else the wall would tilt by half of the stair.
    """
    step = np.zeros_like(coords)
    inner = arc[1:] == arc[:-1]
    step[:-1][inner] = (coords[1:] - coords[:-1])[inner]
    turn = np.zeros(len(coords))
    turn[1:] = np.sign(step[:-1, 0] * step[1:, 1] - step[:-1, 1] * step[1:, 0])
    length = np.hypot(step[:, 0], step[:, 1])
    limit = tolerance_m * (1 + LENGTH_TOLERANCE)
    stair = np.flatnonzero((length[:-1] <= limit) & (turn[:-1] * turn[1:] < 0))
    on_stair = np.zeros(len(coords), dtype=np.bool_)
    on_stair[stair] = on_stair[stair + 1] = True
    # An opposite turn at both ends means that the arc continues beyond both.
    before, after = length[stair - 1], length[stair + 1]
    kept = ~on_stair
    kept[stair[(before > after + limit) & ~on_stair[stair - 1]]] = True
    kept[stair[(after > before + limit) & ~on_stair[stair + 2]] + 1] = True
    order = np.argsort(np.concatenate((np.flatnonzero(kept), stair + 0.5)), kind="stable")
    middles = (coords[stair] + coords[stair + 1]) / 2
    return np.concatenate((coords[kept], middles))[order], np.concatenate((arc[kept], arc[stair]))[order]


def _assembled(arcs: _Arcs, drawn: _Drawn) -> Geometries | None:
    """Build the multipolygons of the drawn arcs; None when a ring has collapsed."""
    ring_sizes = drawn.ring_sizes(arcs)
    if (ring_sizes < 3).any():
        return None
    ring_offsets = np.concatenate(([0], np.cumsum(ring_sizes + 1)))
    closed = np.empty((ring_offsets[-1], 2))
    ring = np.repeat(np.arange(len(ring_sizes)), ring_sizes)
    closed[np.arange(len(ring)) + ring] = drawn.coords(np.arange(len(arcs.sizes)))
    closed[ring_offsets[1:] - 1] = closed[ring_offsets[:-1]]
    built = shapely.from_ragged_array(shapely.GeometryType.MULTIPOLYGON, closed, (ring_offsets, *arcs.offsets))
    return np.asarray(built, dtype=np.object_)


def _at_fault(arcs: _Arcs, drawn: _Drawn, level: Ints, suspects: Ints) -> NDArray[np.bool_]:
    """Return the arcs of broken polygons that cross themselves or one another; all of the suspects if none does.

    Of two that cross, the one with fewer vertices is at fault, as long as it can be redrawn.
    """
    _, first = np.unique(arcs.key[suspects], return_index=True)
    which = suspects[first]
    lines = drawn.lines(arcs, which)
    fault = ~shapely.is_simple(lines)
    one, other = shapely.STRtree(lines).query(lines)
    one, other = one[one < other], other[one < other]
    crossing = ~shapely.relate_pattern(lines[one], lines[other], "FF*F*****")
    one, other = one[crossing], other[crossing]
    fewer = drawn.sizes[which[one]] <= drawn.sizes[which[other]]
    take_one = (level[which[other]] >= LEVELS) | (fewer & (level[which[one]] < LEVELS))
    fault[np.where(take_one, one, other)] = True
    fault &= level[which] < LEVELS
    result = np.zeros(len(level), dtype=np.bool_)
    result[which[fault] if fault.any() else suspects] = True
    return result


def _broken(geometries: Geometries) -> NDArray[np.bool_]:
    """Return which geometries are invalid or overlap others."""
    invalid = ~shapely.is_valid(geometries)
    if invalid.any():
        return np.asarray(invalid)
    return np.asarray(~shapely.is_empty(shapely.coverage_invalid_edges(geometries)))


def _as_multi(geometries: Geometries) -> Geometries:
    """Return polygons as multipolygons, in two dimensions.

    Raises
    ------
    InputError
        When something else than a polygon or multipolygon is there.
    """
    kinds = shapely.get_type_id(geometries)
    wrong = ~np.isin(kinds, (shapely.GeometryType.POLYGON, shapely.GeometryType.MULTIPOLYGON))
    if wrong.any():
        found = sorted({shapely.GeometryType(kind).name.lower() for kind in kinds[wrong]})
        msg = f"Only polygons have outlines to simplify; got {', '.join(found)}."
        raise InputError(msg)
    single = kinds == shapely.GeometryType.POLYGON
    result = shapely.force_2d(geometries)
    result[single] = [shapely.MultiPolygon([polygon]) for polygon in result[single]]
    return np.asarray(result, dtype=np.object_)

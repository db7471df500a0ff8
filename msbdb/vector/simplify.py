"""Removal of the zig-zag of raster outlines, with shared edges kept shared."""

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from msbdb.errors import InputError, ParameterError
from msbdb.vector.polygons import Geometries

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]

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
        No vertex that is left out lies farther than this from the new outline, metres; 0 changes nothing. One cell
        is the least that removes the stairs of oblique walls.

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
    own with its ends kept; a ring without such a vertex starts at its westernmost one. First, a stair (an edge no
    longer than the tolerance between opposite turns) becomes its midpoint, since Douglas-Peucker alone runs along
    the tips of the stairs on one side and shifts the wall; then Douglas-Peucker takes half of the tolerance.
    Where this breaks a polygon (it collapses, crosses itself or a neighbour), its arcs get their own vertices back,
    and the neighbours see the same; this repeats until nothing is broken.

    On 200 rectangles and L-shapes of 8 to 60 cells at all angles, a third with frayed edges, with a tolerance of
    one cell: 15 vertices an outline (raster: 97), IoU with the truth 0.947 (raster: 0.944), mean change of the
    area 0.9 % in size and 0.1 % in sum, largest distance to the raster outline 1 cell. Douglas-Peucker alone gives
    16 vertices and IoU 0.937; the coverage simplification of GEOS (by areas of triangles) 29 vertices and IoU 0.942,
    or 13 and 0.938 at a tolerance of two cells, with distances of up to 2.8 cells.
    """
    if not tolerance_m >= 0:
        msg = f"The tolerance must be 0 or more metres; got {tolerance_m}."
        raise ParameterError(msg)
    if tolerance_m == 0 or shapely.is_empty(geometries).all():
        return geometries.copy()
    arcs = _cut(geometries)
    simple, simple_sizes = _simplified(arcs, tolerance_m)
    raw = np.zeros(len(arcs.sizes), dtype=np.bool_)
    while True:
        coords, sizes = _choose(arcs, simple, simple_sizes, raw)
        ring_sizes = np.bincount(arcs.ring, weights=sizes, minlength=arcs.rings).astype(np.int64)
        broken = (ring_sizes < 3)[arcs.ring]
        if not broken.any():
            result = _assembled(arcs, coords, ring_sizes)
            broken = _broken(result)[arcs.geometry]
            if not broken.any():
                return result
        restored = raw | np.isin(arcs.key, arcs.key[broken])
        if (restored == raw).all():
            msg = (
                "Outlines can be simplified only when they are valid, do not overlap and share whole edges; "
                f"{len(np.unique(arcs.geometry[broken]))} of {len(geometries)} do not. Polygonise the labels anew."
            )
            raise InputError(msg)
        raw = restored


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


def _simplified(arcs: _Arcs, tolerance_m: float) -> tuple[Floats, Ints]:
    """Simplify every arc in its canonical direction; the result is in the ring's, without the arcs' ends."""
    closed = arcs.sizes + 1
    arc = np.repeat(np.arange(len(closed)), closed)
    start = np.cumsum(arcs.sizes) - arcs.sizes
    along = np.arange(len(arc)) - np.repeat(np.cumsum(closed) - closed, closed)
    index = np.where(along == arcs.sizes[arc], arcs.end[arc], start[arc] + along)
    index = _reversed(index, closed, ~arcs.forward)
    coords, arc = _without_stairs(arcs.coords[index], arc, tolerance_m)
    lines = shapely.simplify(shapely.linestrings(coords, indices=arc), tolerance_m / 2, preserve_topology=False)
    coords, arc = shapely.get_coordinates(lines, return_index=True)
    sizes = np.bincount(arc, minlength=len(closed))
    coords = coords[_reversed(np.arange(len(arc)), sizes, ~arcs.forward)]
    keep = np.ones(len(coords), dtype=np.bool_)
    keep[np.cumsum(sizes) - 1] = False
    return coords[keep], sizes - 1


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
    # An opposite turn at both ends means that the arc goes on beyond both.
    before, after = length[stair - 1], length[stair + 1]
    kept = ~on_stair
    kept[stair[(before > after + limit) & ~on_stair[stair - 1]]] = True
    kept[stair[(after > before + limit) & ~on_stair[stair + 2]] + 1] = True
    order = np.argsort(np.concatenate((np.flatnonzero(kept), stair + 0.5)), kind="stable")
    middles = (coords[stair] + coords[stair + 1]) / 2
    return np.concatenate((coords[kept], middles))[order], np.concatenate((arc[kept], arc[stair]))[order]


def _reversed(values: Ints, sizes: Ints, backwards: NDArray[np.bool_]) -> Ints:
    """Reverse the order within the groups that are marked."""
    group = np.repeat(np.arange(len(sizes)), sizes)
    first = np.cumsum(sizes) - sizes
    here = np.arange(len(values))
    there = (2 * first + sizes - 1)[group] - here
    return values[np.where(backwards[group], there, here)]


def _choose(arcs: _Arcs, simple: Floats, simple_sizes: Ints, raw: NDArray[np.bool_]) -> tuple[Floats, Ints]:
    """Return the vertices and sizes of the arcs, raw or simplified, in their order."""
    sizes = np.where(raw, arcs.sizes, simple_sizes)
    arc = np.repeat(np.arange(len(sizes)), sizes)
    along = np.arange(len(arc)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    from_raw = (np.cumsum(arcs.sizes) - arcs.sizes)[arc] + along
    from_simple = (np.cumsum(simple_sizes) - simple_sizes)[arc] + along
    chosen = raw[arc]
    coords = np.empty((len(arc), 2))
    coords[chosen] = arcs.coords[from_raw[chosen]]
    coords[~chosen] = simple[from_simple[~chosen]]
    return coords, sizes


def _assembled(arcs: _Arcs, coords: Floats, ring_sizes: Ints) -> Geometries:
    """Build the multipolygons of the arcs' vertices."""
    ring_offsets = np.concatenate(([0], np.cumsum(ring_sizes + 1)))
    closed = np.empty((ring_offsets[-1], 2))
    ring = np.repeat(np.arange(len(ring_sizes)), ring_sizes)
    closed[np.arange(len(ring)) + ring] = coords
    closed[ring_offsets[1:] - 1] = closed[ring_offsets[:-1]]
    built = shapely.from_ragged_array(shapely.GeometryType.MULTIPOLYGON, closed, (ring_offsets, *arcs.offsets))
    return np.asarray(built, dtype=np.object_)


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

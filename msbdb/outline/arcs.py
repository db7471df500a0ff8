"""Arcs: the rings of a coverage, cut where three edges or more meet, so that neighbours are drawn by the same lines."""

from dataclasses import dataclass, replace

import numpy as np
import shapely
from numpy.typing import NDArray

from msbdb.errors import InputError
from msbdb.grid import GridSpec
from msbdb.outline.polygons import Geometries
from msbdb.outline.runs import WallRuns

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Arcs:
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

    def as_given(self) -> "Drawn":
        """Return all arcs with all of their vertices."""
        return Drawn(self.coords, np.cumsum(self.sizes) - self.sizes, self.sizes, self.coords[self.end])


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """How each arc is drawn: its vertices are ``sizes`` rows of ``pool`` from ``start`` on; its end is in ``ends``."""

    pool: Floats
    start: Ints
    sizes: Ints
    ends: Floats

    def coords(self, which: Ints) -> Floats:
        """Return the vertices of the arcs, one after the other."""
        sizes = self.sizes[which]
        offset = np.repeat(self.start[which] - (np.cumsum(sizes) - sizes), sizes)
        return self.pool[offset + np.arange(len(offset))]

    def ring_sizes(self, arcs: Arcs) -> Ints:
        """Return the number of vertices of each ring."""
        return np.bincount(arcs.ring, weights=self.sizes, minlength=arcs.rings).astype(np.int64)

    def lines(self, which: Ints) -> Geometries:
        """Return the arcs as lines, with their ends."""
        sizes = self.sizes[which]
        coords = np.insert(self.coords(which), np.cumsum(sizes), self.ends[which], axis=0)
        lines = shapely.linestrings(coords, indices=np.repeat(np.arange(len(which)), sizes + 1))
        return np.asarray(lines, dtype=np.object_)


def cut(geometries: Geometries, spec: GridSpec | None = None) -> Arcs:
    """Cut the rings into arcs where three edges or more meet, and where they reach or leave the border of a lattice."""
    _, closed, (ring_offsets, polygon_offsets, offsets) = shapely.to_ragged_array(_as_multi(geometries))
    sizes = np.diff(ring_offsets).astype(np.int64) - 1
    ring = np.repeat(np.arange(len(sizes)), sizes)
    first = np.cumsum(sizes) - sizes
    coords = closed[np.arange(len(ring)) + ring]  # without the vertex that closes each ring
    vertex = np.unique(coords[:, 0] + 1j * coords[:, 1], return_inverse=True)[1].astype(np.int64)
    following = _following(first, sizes, ring)
    cut = _degree(vertex, following) > 2
    if spec is not None:
        along = border_sides(cells_of(coords, spec), following, spec)
        cut[following] |= (along != along[:, following]).any(axis=0)
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
    return Arcs(
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


def cells_of(coords: Floats, spec: GridSpec) -> Ints:
    """Return places in the CRS as columns and rows of the lattice's corners."""
    return np.rint((coords - (spec.transform.c, spec.transform.f)) / (spec.cell_m, -spec.cell_m)).astype(np.int64)


def border_sides(places: Ints, following: Ints, spec: GridSpec) -> NDArray[np.bool_]:
    """Return whether the edge from each corner to the following one runs along the border: west, north, east, south.

    Parameters
    ----------
    places : (V, 2) ndarray of int64
        Columns and rows of corners.
    following : (E,) ndarray of int64
        Index of the corner at which the edge from each of the first ones ends.
    spec : GridSpec
        The lattice.

    Returns
    -------
    (4, E) ndarray of bool
    """
    rows, cols = spec.shape
    column, row = places.T
    at = np.stack((column == 0, row == 0, column == cols, row == rows))
    return np.asarray(at[:, : len(following)] & at[:, following])


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


def assembled(arcs: Arcs, drawn: Drawn) -> Geometries | None:
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


def at_fault(arcs: Arcs, drawn: Drawn, redrawable: NDArray[np.bool_], suspects: Ints) -> NDArray[np.bool_]:
    """Return the arcs of broken polygons that cross themselves or one another; all of the suspects if none does.

    Of two that cross, the one with fewer vertices is at fault, as long as it can be redrawn.
    """
    _, first = np.unique(arcs.key[suspects], return_index=True)
    which = suspects[first]
    lines = drawn.lines(which)
    fault = ~shapely.is_simple(lines)
    one, other = shapely.STRtree(lines).query(lines)
    one, other = one[one < other], other[one < other]
    crossing = ~shapely.relate_pattern(lines[one], lines[other], "FF*F*****")
    one, other = one[crossing], other[crossing]
    fewer = drawn.sizes[which[one]] <= drawn.sizes[which[other]]
    take_one = ~redrawable[which[other]] | (fewer & redrawable[which[one]])
    fault[np.where(take_one, one, other)] = True
    fault &= redrawable[which]
    result = np.zeros(len(redrawable), dtype=np.bool_)
    result[which[fault] if fault.any() else suspects] = True
    return result


class Soundness:
    """Which geometries are sound; those that have not changed since the last look are not looked at again."""

    def __init__(self, count: int) -> None:
        self.checked, self.valid = np.full(count, None, dtype=np.object_), np.zeros(count, dtype=np.bool_)
        self.compared, self.overlaps = self.checked, np.zeros(count, dtype=np.bool_)

    def broken(self, geometries: Geometries) -> NDArray[np.bool_]:
        """Return which geometries are invalid; which overlap others, where all are valid."""
        new = ~shapely.equals_exact(geometries, self.checked)
        self.valid[new] = shapely.is_valid(geometries[new])
        self.checked = geometries
        if not self.valid.all():
            return ~self.valid
        new = ~shapely.equals_exact(geometries, self.compared)
        # A geometry overlaps what its box meets: what changed concerns those around its old and its new place.
        tree = shapely.STRtree(geometries)
        near = np.unique(tree.query(np.concatenate((geometries[new], self.compared[new])))[1])
        around = np.unique(tree.query(geometries[near])[1])
        if len(around):
            wrong = ~shapely.is_empty(shapely.coverage_invalid_edges(geometries[around]))
            self.overlaps[near] = wrong[np.isin(around, near)]
        self.compared = geometries
        return self.overlaps


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


@dataclass(frozen=True, slots=True, eq=False)
class Chains:
    """The distinct arcs in canonical direction, with a vertex at each cell.

    Attributes
    ----------
    own : (O,) ndarray of int64
        The arc of each occurrence in a ring.
    places : columns, rows, offsets
        The vertices of the arcs, cells, ends included.
    nodes : (A,) tail, (A,) head, (N, 2) places
        The nodes at the ends, -1 for rings without one.
    regions : (A, 2) ndarray of int64
        The geometries on both sides, -1 for none.
    border : (A,) ndarray of bool
        The arc runs along the border of the lattice: it is a cut, and no wall.
    """

    own: Ints
    places: tuple[Floats, Floats, Ints]
    nodes: tuple[Ints, Ints, Floats]
    regions: Ints
    border: NDArray[np.bool_]

    @property
    def count(self) -> int:
        """Number of arcs."""
        return len(self.regions)


def traced_chains(arcs: Arcs, spec: GridSpec) -> Chains:
    """Return the distinct arcs, a vertex a cell."""
    _, first, own = np.unique(arcs.key, return_index=True, return_inverse=True)
    given = arcs.as_given()
    lines = given.lines(first)
    backwards = ~arcs.forward[first]
    lines[backwards] = shapely.reverse(lines[backwards])
    coords, arc = shapely.get_coordinates(lines, return_index=True)
    corners = cells_of(coords, spec)
    step = np.zeros_like(corners)
    inner = arc[1:] == arc[:-1]
    step[:-1][inner] = np.diff(corners, axis=0)[inner]
    length = np.maximum(np.abs(step).sum(axis=1), 1)
    index = np.repeat(np.arange(len(corners)), length)
    along = np.arange(len(index)) - np.repeat(np.cumsum(length) - length, length)
    dense = corners[index] + np.sign(step)[index] * along[:, None]
    starts = np.concatenate(([0], np.cumsum(np.bincount(arc[index], minlength=len(first)))))
    regions = np.full((len(first), 2), -1)
    regions[:, 0] = arcs.geometry[first]
    second = np.setdiff1d(np.arange(len(own)), first)
    regions[own[second], 1] = arcs.geometry[second]
    nodes = _nodes(dense[starts[:-1]], dense[starts[1:] - 1])
    border = np.asarray(border_sides(dense, np.arange(1, len(dense)), spec).any(axis=0))[starts[:-1]]
    return Chains(own.astype(np.int64), (*dense.T.astype(np.float64), starts), nodes, regions, border)


def _nodes(tail: Ints, head: Ints) -> tuple[Ints, Ints, Floats]:
    """Return the nodes at the ends of the arcs; the place where a ring begins that meets no other arc is none."""
    places, node = np.unique(np.concatenate((tail, head)), axis=0, return_inverse=True)
    node = node.reshape(2, -1)
    alone = (node[0] == node[1]) & (np.bincount(node.ravel())[node[0]] == 2)
    node[:, alone] = -1
    return node[0], node[1], places.astype(np.float64)


def from_corners(chains: Chains, runs: WallRuns) -> Chains:
    """Return chains whose rings begin between two walls: where the shorter of both is longest."""
    x, y, starts = chains.places
    x, y = x.copy(), y.copy()
    ring = chains.nodes[0][runs.arc] < 0
    inner = np.flatnonzero(ring[1:] & (runs.arc[1:] == runs.arc[:-1])) + 1
    size = runs.end - runs.begin
    shorter = np.minimum(size[inner], size[inner - 1])
    best = inner[np.lexsort((-inner, shorter, runs.arc[inner]))]
    best = best[np.flatnonzero(np.diff(runs.arc[best], append=-1))]
    for run in best:
        arc, begin = runs.arc[run], runs.begin[run]
        low, high = starts[arc], starts[arc + 1]
        for values in (x, y):
            values[low : high - 1] = np.roll(values[low : high - 1], -begin)
            values[high - 1] = values[low]
    return replace(chains, places=(x, y, starts))

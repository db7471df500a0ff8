"""Fitted outlines: straight walls along the main directions of a building, on arcs that neighbours share."""

from dataclasses import dataclass, fields, replace

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from msbdb.grid import GridSpec
from msbdb.labels import Labels
from msbdb.outline.arcs import Arcs, Drawn, assembled, at_fault, broken, cut
from msbdb.outline.corners import drawn_arcs, joined_walls, placed_nodes
from msbdb.outline.directions import apart, main_frames
from msbdb.outline.polygons import Geometries, polygonise
from msbdb.outline.runs import Runs, WallCosts, divide
from msbdb.outline.simplification import LEVELS, redrawn, simplify_coverage
from msbdb.outline.tidying import tidied
from msbdb.params import VectorParams

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Frames = tuple[Floats, Ints, Ints]

SHARES = (1.0, 0.6, 0.35)
"""Shares of the costs and the reach: an arc at fault is divided anew, more finely, before it is traced."""

TRACED = len(SHARES)
"""From this level on an arc is traced, and simplified ever less; below it is drawn along its walls."""

LAST = TRACED + LEVELS
"""The level of arcs with all of their vertices."""

FINE = 1024
"""Corners lie on so many places a cell, so that rounding decides nothing."""

SAME = np.radians(2.0)
"""A region whose direction differs from its group's by less takes the group's."""

WEAK_CELLS = 30.0
"""Regions with less length along their own direction take the group's."""

GATE = 0.5
"""Corners are rounded by the cells: beside them an edge may lie so much farther than the reach, cells."""


def outline_labels(labels: Labels, count: int, spec: GridSpec, params: VectorParams) -> tuple[Geometries, Mask]:
    """Return the outlines of labelled regions, and which of them are fitted throughout.

    Parameters
    ----------
    labels : (H, W) ndarray of int32
        1 to ``count``; 0 where there is no region.
    count : int
        Number of labels.
    spec : GridSpec
        The lattice of the labels.
    params : VectorParams
        ``walls`` (fitted or traced), ``court_m2`` and ``simplify_px``.

    Returns
    -------
    outlines : (count,) ndarray of MultiPolygon
        A coverage: neighbours share their edges.
    fitted : (count,) ndarray of bool
        False where an arc of the outline is traced, or all are.

    Notes
    -----
    The labels are tidied first (`msbdb.outline.tidying`), in both ways alike: no holes or loose pieces below
    ``court_m2``.
    """
    if not count:
        return np.empty(0, dtype=object), np.zeros(0, dtype=np.bool_)
    traced = polygonise(tidied(labels, params.court_m2 / spec.cell_area_m2), spec, count)
    if params.walls == "traced":
        return simplify_coverage(traced, params.simplify_px * spec.cell_m), np.zeros(count, dtype=np.bool_)
    return fit_coverage(traced, spec, tolerance_px=params.simplify_px, least_m2=params.court_m2)


def fit_coverage(
    geometries: Geometries,
    spec: GridSpec,
    *,
    tolerance_px: float = 1.0,
    least_m2: float = 0.0,
    costs: WallCosts | None = None,
) -> tuple[Geometries, Mask]:
    """Return outlines of straight walls on shared arcs, and which of them are fitted throughout.

    Parameters
    ----------
    geometries : (N,) ndarray of MultiPolygon
        As `msbdb.outline.polygons.polygonise` returns them for labels on the lattice.
    spec : GridSpec
        The lattice.
    tolerance_px : float
        Tolerance with which arcs are simplified that stay traced, cells.
    least_m2 : float
        A ring of this area or more does not shrink below it.
    costs : WallCosts, optional
        Of the division into walls.

    Returns
    -------
    outlines : (N,) ndarray of MultiPolygon
        Valid, without overlaps, with every ring of the input still there.
    fitted : (N,) ndarray of bool
        False where an arc of the outline stays traced.

    Notes
    -----
    The rings are cut into arcs where three regions meet, as for `simplify_coverage`. Then:

    1. Each arc is divided into free straight runs. Their lengths and directions give the main directions of each
       region and touching group (`msbdb.outline.directions`).
    2. Each arc is divided anew, along the main directions of the regions on both sides where that is cheaper than a
       free wall. A wall is the mean place of its run (`msbdb.outline.runs`).
    3. Walls that go on beyond a node become one, and nodes move to where their walls meet
       (`msbdb.outline.corners`). An arc is drawn from node to node by the corners of its walls.
    4. An arc is at fault when an edge of its cells is off by more than the reach and `GATE`, when it crosses itself or
       another one, or when its ring shrinks below the least area. It is divided anew at lower costs and a shorter
       reach, and at last stays traced: simplified by Douglas-Peucker, with its nodes where they are.

    What lies elsewhere has no effect on a touching group, nor has its place on the lattice: corners lie on a lattice of
    1/1024 cell.

    Examples
    --------
    A house at an angle gets its four walls back:

    >>> from affine import Affine
    >>> from pyproj import CRS
    >>> from msbdb.outline.polygons import rasterise
    >>> spec = GridSpec((40, 40), Affine(1, 0, 0, 0, -1, 40), CRS.from_epsg(25832))
    >>> house = shapely.Polygon([(5, 5), (29, 11), (26, 23), (2, 17)])
    >>> (outline,), _ = fit_coverage(polygonise(rasterise([house], spec), spec, 1), spec)
    >>> print(outline.geoms[0].normalize().simplify(0).exterior.length.__round__(1), len(outline.geoms[0].exterior.coords))
    74.2 5
    """
    costs = costs or WallCosts()
    if shapely.is_empty(geometries).all():
        return geometries.copy(), np.ones(len(geometries), dtype=np.bool_)
    arcs = cut(geometries)
    chains = _chains(arcs, spec)
    runs = divide(chains.places, _no_frames(chains.count), costs)
    frames = _frames(chains, runs, len(geometries), spec)
    chains = _from_corners(chains, runs)
    chains = _from_corners(chains, divide(chains.places, frames, costs))
    level = np.zeros(chains.count, dtype=np.int64)
    runs = divide(chains.places, frames, costs)
    smallest = np.minimum(least_m2, _ring_areas(arcs, arcs.as_given()))
    while True:
        walls = joined_walls(runs, chains.places, chains.nodes)
        places = _settled(chains, placed_nodes(walls, chains.nodes), level)
        vertices, offsets, off = drawn_arcs(walls, chains.places, (chains.nodes[0], chains.nodes[1], places))
        fault = (off > costs.reach + GATE) & (level < TRACED)
        if not fault.any():
            drawn = _drawn(arcs, chains, (_world(_fine(vertices), spec), offsets), level, tolerance_px * spec.cell_m)
            result = assembled(arcs, drawn)
            occurrence = _faults(arcs, drawn, result, (level < LAST)[chains.own], smallest)
            fault[chains.own[occurrence]] = True
            fault &= level < LAST
            if not fault.any():
                break
        level[fault] += 1
        again = fault & (level < TRACED)
        for step, share in enumerate(SHARES):
            chosen = np.flatnonzero(again & (level == step))
            if len(chosen):
                runs = _with_runs(runs, chains, frames, chosen, costs.scaled(share))
    fitted = np.ones(len(geometries), dtype=np.bool_)
    fitted[arcs.geometry[level[chains.own] >= TRACED]] = False
    return result, fitted


def _faults(arcs: Arcs, drawn: Drawn, result: Geometries | None, redrawable: Mask, smallest: Floats) -> Mask:
    """Return the occurrences of arcs that must be drawn anew."""
    if result is None:
        return (drawn.ring_sizes(arcs) < 3)[arcs.ring]
    fault = (_ring_areas(arcs, drawn) < smallest - 1e-6)[arcs.ring] & redrawable
    faulty = broken(result)
    if faulty.any():
        fault |= at_fault(arcs, drawn, redrawable, np.flatnonzero(faulty[arcs.geometry]))
    return fault


def _with_runs(runs: Runs, chains: "_Chains", frames: Frames, chosen: Ints, costs: WallCosts) -> Runs:
    """Return runs in which some arcs are divided anew, at other costs."""
    x, y, starts = chains.places
    size = np.diff(starts)[chosen]
    index = np.repeat(starts[chosen] - (np.cumsum(size) - size), size)
    index += np.arange(len(index))
    angles, ranks, bounds = frames
    number = np.diff(bounds)[chosen]
    place = np.repeat(bounds[chosen] - (np.cumsum(number) - number), number)
    place += np.arange(len(place))
    few = (x[index], y[index], np.concatenate(([0], np.cumsum(size))))
    new = divide(few, (angles[place], ranks[place], np.concatenate(([0], np.cumsum(number)))), costs)
    kept = ~np.isin(runs.arc, chosen)
    arc = np.concatenate((runs.arc[kept], chosen[new.arc]))
    order = np.argsort(arc, kind="stable")
    return Runs(
        *(
            np.concatenate((getattr(runs, f.name)[kept], getattr(new, f.name)))[order]
            if f.name != "arc"
            else arc[order]
            for f in fields(Runs)
        )
    )


def _settled(chains: "_Chains", goals: Floats, level: Ints) -> Floats:
    """Return the places of the nodes: those of traced arcs stay."""
    tail, head, traced = chains.nodes
    places = _fine(goals)
    for side in (tail[level >= TRACED], head[level >= TRACED]):
        places[side[side >= 0]] = traced[side[side >= 0]]
    return places


@dataclass(frozen=True, slots=True, eq=False)
class _Chains:
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
    """

    own: Ints
    places: tuple[Floats, Floats, Ints]
    nodes: tuple[Ints, Ints, Floats]
    regions: Ints

    @property
    def count(self) -> int:
        """Number of arcs."""
        return len(self.regions)


def _chains(arcs: Arcs, spec: GridSpec) -> _Chains:
    """Return the distinct arcs, a vertex a cell."""
    _, first, own = np.unique(arcs.key, return_index=True, return_inverse=True)
    given = arcs.as_given()
    lines = given.lines(first)
    backwards = ~arcs.forward[first]
    lines[backwards] = shapely.reverse(lines[backwards])
    coords, arc = shapely.get_coordinates(lines, return_index=True)
    corners = np.rint((coords - (spec.transform.c, spec.transform.f)) / (spec.cell_m, -spec.cell_m)).astype(np.int64)
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
    return _Chains(own.astype(np.int64), (*dense.T.astype(np.float64), starts), nodes, regions)


def _nodes(tail: Ints, head: Ints) -> tuple[Ints, Ints, Floats]:
    """Return the nodes at the ends of the arcs; the place where a ring begins that meets no other arc is none."""
    places, node = np.unique(np.concatenate((tail, head)), axis=0, return_inverse=True)
    node = node.reshape(2, -1)
    alone = (node[0] == node[1]) & (np.bincount(node.ravel())[node[0]] == 2)
    node[:, alone] = -1
    return node[0], node[1], places.astype(np.float64)


def _frames(chains: _Chains, runs: Runs, count: int, spec: GridSpec) -> tuple[Floats, Ints, Ints]:
    """Return the main directions of each arc: those of the regions on its sides."""
    x, y, starts = chains.places
    low, high = starts[runs.arc] + runs.begin, starts[runs.arc] + runs.end
    length = np.hypot(x[high] - x[low], y[high] - y[low])
    # The border of the lattice is no wall.
    rows, cols = spec.shape
    middle_x, middle_y = (x[low] + x[high]) / 2, (y[low] + y[high]) / 2
    length[(middle_x == 0) | (middle_x == cols) | (middle_y == 0) | (middle_y == rows)] = 0.0
    group = _groups(chains.regions, count)
    sides = chains.regions[runs.arc]
    own = np.concatenate((sides[:, 0], sides[:, 1][sides[:, 1] >= 0]))
    run = np.concatenate((np.arange(len(length)), np.flatnonzero(sides[:, 1] >= 0)))
    frames, support = main_frames(runs.angle[run], length[run], own, count)
    common, _ = main_frames(runs.angle, length, group[sides[:, 0]], int(group.max()) + 1)
    common = common[group]
    weak = ~(support[:, 0] >= WEAK_CELLS)
    frames[weak] = common[weak]
    for place in range(common.shape[1]):
        near = np.abs(apart(frames, common[:, place, None])) < SAME
        frames = np.where(near, common[:, place, None], frames)
    both = np.column_stack((frames[chains.regions[:, 0]], frames[chains.regions[:, 1]]))
    both[:, frames.shape[1] :][chains.regions[:, 1] < 0] = np.nan
    # Once each: a frame near an earlier one of the other side is that one.
    kept = ~np.isnan(both)
    for later in range(1, both.shape[1]):
        for earlier in range(later):
            kept[:, later] &= ~(kept[:, earlier] & (np.abs(apart(both[:, later], both[:, earlier])) < SAME))
    rank = np.broadcast_to(np.tile(np.arange(frames.shape[1]), 2), both.shape)
    return both[kept], rank[kept], np.concatenate(([0], np.cumsum(kept.sum(axis=1))))


def _no_frames(count: int) -> tuple[Floats, Ints, Ints]:
    """Return no main directions for each of the arcs."""
    return np.empty(0), np.empty(0, dtype=np.int64), np.zeros(count + 1, dtype=np.int64)


def _groups(regions: Ints, count: int) -> Ints:
    """Return the touching group of each region."""
    shared = regions[regions[:, 1] >= 0]
    graph = coo_matrix((np.ones(len(shared)), (shared[:, 0], shared[:, 1])), shape=(count, count))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def _from_corners(chains: _Chains, runs: Runs) -> _Chains:
    """Return chains whose rings begin between two walls: where the shorter of both is longest."""
    x, y, starts = (values.copy() for values in chains.places)
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


def _world(places: Floats, spec: GridSpec) -> Floats:
    """Return places on the lattice in the CRS."""
    return np.asarray(places * (spec.cell_m, -spec.cell_m) + (spec.transform.c, spec.transform.f))


def _fine(places: Floats) -> Floats:
    """Return places on the fine lattice, cells."""
    return np.asarray(np.rint(places * FINE) / FINE)


def _drawn(arcs: Arcs, chains: _Chains, fits: tuple[Floats, Ints], level: Ints, tolerance_m: float) -> Drawn:
    """Draw all arcs for their levels."""
    world, offsets = fits
    occurrence_level = level[chains.own] - TRACED
    traced = np.flatnonzero(occurrence_level >= 0)
    drawn = redrawn(arcs, arcs.as_given(), traced, np.maximum(occurrence_level, 0), tolerance_m)
    fitted = np.flatnonzero(occurrence_level < 0)
    own = chains.own[fitted]
    size = np.diff(offsets)[own] - 1
    start, sizes, ends = drawn.start.copy(), drawn.sizes.copy(), drawn.ends.copy()
    index = np.repeat(np.arange(len(own)), size)
    along = np.arange(len(index)) - np.repeat(np.cumsum(size) - size, size)
    forward = arcs.forward[fitted]
    place = np.where(forward[index], offsets[own[index]] + along, offsets[own[index] + 1] - 1 - along)
    start[fitted] = len(drawn.pool) + np.cumsum(size) - size
    sizes[fitted] = size
    ends[fitted] = world[np.where(forward, offsets[own + 1] - 1, offsets[own])]
    return Drawn(np.concatenate((drawn.pool, world[place])), start, sizes, ends)


def _ring_areas(arcs: Arcs, drawn: Drawn) -> Floats:
    """Return the areas of the rings, square metres."""
    coords = drawn.coords(np.arange(len(arcs.sizes)))
    ring = np.repeat(arcs.ring, drawn.sizes)
    following = np.append(coords[1:], coords[:1], axis=0)
    size = drawn.ring_sizes(arcs)
    first = np.cumsum(size) - size
    following[(first + size - 1)[size > 0]] = coords[first[size > 0]]
    origin = coords[first[ring]]
    one, other = coords - origin, following - origin
    cross = one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]
    return np.abs(np.bincount(ring, cross, arcs.rings)) / 2

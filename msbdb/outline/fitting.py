"""Fitted outlines: straight walls along the main directions of a building, on arcs that neighbours share."""

import numpy as np
import shapely
from numpy.typing import NDArray

from msbdb.errors import InputError
from msbdb.grid import GridSpec
from msbdb.labels import Labels, islands_of
from msbdb.outline.arcs import Arcs, Chains, Drawn, Soundness, assembled, at_fault, cut, from_corners, traced_chains
from msbdb.outline.corners import drawn_arcs, joined_walls, placed_nodes
from msbdb.outline.directions import arc_frames, no_frames
from msbdb.outline.polygons import Geometries, polygonise, tidied, with_joined_corners
from msbdb.outline.runs import WallCosts, divide, redivided
from msbdb.outline.simplification import LEVELS, redrawn, simplify_coverage
from msbdb.params import VectorParams

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

SHARES = (1.0, 1.0, 0.6, 0.35)
"""Shares of the costs and the reach by level: an arc at fault is first drawn without the steps at its nodes, then
divided anew, more finely, before it is traced."""

CHORDS = 2
"""The level of curves from the beginning."""

TRACED = len(SHARES)
"""From this level on an arc is traced, and simplified ever less; below it is drawn along its walls."""

LAST = TRACED + LEVELS
"""The level of arcs with all of their vertices."""

FINE = 1024
"""Corners lie on so many places a cell, so that rounding decides nothing."""

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
    The labels are tidied first (`msbdb.outline.polygons`), in both ways alike: no holes or loose pieces below
    ``court_m2``.
    """
    if not count:
        return np.empty(0, dtype=object), np.zeros(0, dtype=np.bool_)
    # Joined corners may let two islands touch.
    joined = with_joined_corners(labels)
    islands = islands_of(joined > 0)
    sheet = tidied(islands.gather(joined), params.court_m2 / spec.cell_area_m2)
    traced = polygonise(sheet, spec, count, islands=islands)
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
        Valid, without overlaps, within the lattice, with every ring of the input still there.
    fitted : (N,) ndarray of bool
        False where an arc of the outline stays traced.

    Notes
    -----
    The rings are cut into arcs where three regions meet, as for `simplify_coverage`, and where they reach the border of
    the lattice. What runs along the border is a cut through a building and no wall: it stays at the border. Then:

    1. Each arc is divided into free straight runs. Their lengths and directions give the main directions of each
       region and touching group (`msbdb.outline.directions`).
    2. Each arc is divided anew, along the main directions of the regions on both sides where that is cheaper than a
       free wall. A wall is the mean place of its run (`msbdb.outline.runs`).
    3. Walls that go on beyond a node become one, and nodes move to where their walls meet
       (`msbdb.outline.corners`). An arc is drawn from node to node by the corners of its walls.
    4. An arc is at fault when an edge of its cells is off by more than the reach and `GATE`. It is also at fault when
       it crosses itself or another one, or when its ring shrinks below the least area. First it goes without the steps
       at its nodes, then it is divided anew at lower costs and a shorter reach. At last it stays traced: simplified by
       Douglas-Peucker, with its nodes where they are.

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
    >>> int(shapely.get_num_coordinates(outline)), round(outline.length, 1), round(house.length, 1)
    (5, 74.2, 74.2)
    """
    costs = costs or WallCosts()
    if shapely.is_empty(geometries).all():
        return geometries.copy(), np.ones(len(geometries), dtype=np.bool_)
    arcs = cut(geometries, spec)
    chains = traced_chains(arcs, spec)
    runs = divide(chains.places, no_frames(chains.count), costs)
    frames = arc_frames(chains, runs, len(geometries))
    chains = from_corners(chains, runs)
    runs = divide(chains.places, frames, costs)
    chains = from_corners(chains, runs)
    # Rings have another beginning now; the walls of the other arcs are found.
    runs = redivided(runs, chains.places, frames, np.flatnonzero(chains.nodes[0] < 0), costs)
    level = np.zeros(chains.count, dtype=np.int64)
    # Where there are no main directions, walls are the chords of a curve.
    curved = np.flatnonzero(np.diff(frames[2]) == 0)
    level[curved] = CHORDS
    runs = redivided(runs, chains.places, frames, curved, costs.scaled(SHARES[CHORDS]))
    smallest = np.minimum(least_m2, _ring_areas(arcs, arcs.as_given()))
    soundness = Soundness(len(geometries))
    while True:
        walls = joined_walls(runs, chains.places, chains.nodes, chains.border)
        places = _settled(chains, placed_nodes(walls, chains.nodes), level, spec)
        vertices, offsets, off = drawn_arcs(
            walls, chains.places, (chains.nodes[0], chains.nodes[1], places), level == 1
        )
        fault = (off > costs.reach + GATE) & (level < TRACED)
        if not fault.any():
            # A wall along the border of the survey must not lean over it.
            inside = np.clip(_fine(vertices), 0, spec.shape[::-1])
            drawn = _drawn(arcs, chains, (_world(inside, spec), offsets), level, tolerance_px * spec.cell_m)
            result = assembled(arcs, drawn)
            occurrence = _faults(
                arcs, drawn, result, (level < LAST)[chains.own], smallest=smallest, soundness=soundness
            )
            fault[chains.own[occurrence]] = True
            if result is not None and not fault.any():
                break
            if not fault.any():
                msg = "Outlines can be fitted only when they are traced along cells. Polygonise the labels anew."
                raise InputError(msg)
        level[fault] += 1
        again = fault & (level < TRACED)
        for step, share in enumerate(SHARES):
            chosen = np.flatnonzero(again & (level == step))
            if share < 1 and len(chosen):
                runs = redivided(runs, chains.places, frames, chosen, costs.scaled(share))
    fitted = np.ones(len(geometries), dtype=np.bool_)
    fitted[arcs.geometry[level[chains.own] >= TRACED]] = False
    return result, fitted


def _faults(
    arcs: Arcs, drawn: Drawn, result: Geometries | None, redrawable: Mask, *, smallest: Floats, soundness: Soundness
) -> Mask:
    """Return the occurrences of arcs that must be drawn anew."""
    if result is None:
        return np.asarray((drawn.ring_sizes(arcs) < 3)[arcs.ring] & redrawable)
    fault = (_ring_areas(arcs, drawn) < smallest - 1e-6)[arcs.ring] & redrawable
    faulty = soundness.broken(result)
    if faulty.any():
        fault |= at_fault(arcs, drawn, redrawable, np.flatnonzero(faulty[arcs.geometry])) & redrawable
    return np.asarray(fault)


def _settled(chains: Chains, goals: Floats, level: Ints, spec: GridSpec) -> Floats:
    """Return the places of the nodes: those of traced arcs stay, and those at the border stay at it."""
    tail, head, traced = chains.nodes
    at_border = (traced == 0) | (traced == spec.shape[::-1])
    places = np.where(at_border, traced, np.clip(_fine(goals), 0, spec.shape[::-1]))
    for side in (tail[level >= TRACED], head[level >= TRACED]):
        places[side[side >= 0]] = traced[side[side >= 0]]
    return places


def _world(places: Floats, spec: GridSpec) -> Floats:
    """Return places on the lattice in the CRS."""
    return np.column_stack(spec.corners(places[:, 1], places[:, 0]))


def _fine(places: Floats) -> Floats:
    """Return places on the fine lattice, cells."""
    return np.asarray(np.rint(places * FINE) / FINE)


def _drawn(arcs: Arcs, chains: Chains, fits: tuple[Floats, Ints], level: Ints, tolerance_m: float) -> Drawn:
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

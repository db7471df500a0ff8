"""Corners: walls that go on beyond a node are made one, nodes go to where walls meet, and arcs are drawn anew."""

import numpy as np
from numpy.typing import NDArray

from msbdb.outline.runs import FREE, WallRuns
from msbdb.threads import kernel

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]

ONE_WALL = 0.75
"""Walls that go on beyond a node are one up to this distance, cells."""

NODE_REACH = 2.0
"""A node goes so far at most, cells."""

CORNER_REACH = 2.5
"""A corner lies so far from the place where its walls were divided at most, cells; else a step joins the walls."""

TILT = 0.35
"""An end of an arc beside its wall by so much, cells, tilts the wall; by more, a step is drawn."""

STRAIGHT = np.radians(4.0)
"""Free walls of about the same direction are one."""

MEETING = np.sin(np.radians(10.0))
"""Sine of the least angle at which walls are cut with each other."""

SHORT_ARC = 7
"""An arc of one wall with so many vertices at most goes straight from node to node."""

AROUND = 3
"""So many walls beside that of the last edge are looked at first."""

NODE_WEIGHT = 30.0
"""A wall of more edges pulls a node no more."""


def joined_walls(
    runs: WallRuns, chains: tuple[Floats, Floats, Ints], nodes: tuple[Ints, Ints, Floats], border: Mask
) -> WallRuns:
    """Return runs in which walls that go on beyond a node lie on one line.

    Parameters
    ----------
    runs : WallRuns
    chains : columns, rows, offsets
        The traced arcs (`msbdb.outline.runs.divide`).
    nodes : (A,) tail, (A,) head, (N, 2) places
        The nodes at the ends of each arc, -1 for rings; and where the nodes are, cells.
    border : (A,) ndarray of bool
        Arcs along the border of the lattice, which are joined with none.
    """
    tail, head, places = nodes
    first, last = _ends(runs, len(tail))
    node = np.where(np.tile(border, 2), -1, np.concatenate((tail, head)))
    run = np.concatenate((first, last))
    away = np.concatenate((runs.angle[first], runs.angle[last] + np.pi))
    real = np.flatnonzero(node >= 0)
    order = real[np.argsort(node[real], kind="stable")]
    offsets = np.searchsorted(node[order], np.arange(len(places) + 1))
    lines = (runs.angle, runs.east, runs.south, runs.frame)
    off, one, other = _pairs((run[order], away[order], offsets), lines, places)
    root = _united(one[np.argsort(off, kind="stable")], other[np.argsort(off, kind="stable")], len(runs.arc))
    return _on_one_line(runs, chains, root)


def _ends(runs: WallRuns, arcs: int) -> tuple[Ints, Ints]:
    """Return the first and the last run of each arc."""
    bounds = np.searchsorted(runs.arc, np.arange(arcs + 1))
    return bounds[:-1], bounds[1:] - 1


@kernel
def _pairs(
    ends: tuple[Ints, Floats, Ints], lines: tuple[Floats, Floats, Floats, Ints], places: Floats
) -> tuple[Floats, Ints, Ints]:
    """Return how far apart the walls are that go on beyond a node, and which they are."""
    run, away, offsets = ends
    angle, east, south, frame = lines
    off, one, other = np.empty(run.size), np.empty(run.size, dtype=np.int64), np.empty(run.size, dtype=np.int64)
    count = 0
    for v in range(offsets.size - 1):
        for a in range(offsets[v], offsets[v + 1]):
            for b in range(a + 1, offsets[v + 1]):
                p, q = run[a], run[b]
                if p == q or (frame[p] == FREE) != (frame[q] == FREE) or np.cos(away[a] - away[b]) > 0:
                    continue
                bent = abs(np.sin(angle[p] - angle[q]))
                if bent > (STRAIGHT if frame[p] == FREE else 1e-6):
                    continue
                # Distances of the node from both lines, along the normal of the first.
                sense = 1.0 if np.cos(angle[p] - angle[q]) > 0 else -1.0
                from_p = -np.sin(angle[p]) * (places[v, 0] - east[p]) + np.cos(angle[p]) * (places[v, 1] - south[p])
                from_q = -np.sin(angle[q]) * (places[v, 0] - east[q]) + np.cos(angle[q]) * (places[v, 1] - south[q])
                between = abs(from_p - sense * from_q)
                if between <= ONE_WALL and count < off.size:
                    off[count], one[count], other[count] = between, p, q
                    count += 1
    return off[:count].copy(), one[:count].copy(), other[:count].copy()


@kernel
def _united(one: Ints, other: Ints, count: int) -> Ints:
    """Return the representative of each run's set, the pairs united in their order."""
    root = np.arange(count)
    for k in range(one.size):
        a, b = one[k], other[k]
        while root[a] != a:
            a = root[a]
        while root[b] != b:
            b = root[b]
        root[max(a, b)] = min(a, b)
    for k in range(count):
        root[k] = root[root[k]]
    return root


def _on_one_line(runs: WallRuns, chains: tuple[Floats, Floats, Ints], root: Ints) -> WallRuns:
    """Move the runs of a set onto its mean line; one that is far from it keeps its own."""
    count = len(runs.arc)
    east, south, starts = chains
    size = (runs.end - runs.begin).astype(np.float64)
    begin = starts[runs.arc] + runs.begin
    # Places relative to the first run of the set, so that sums of squares keep their digits.
    edge = np.repeat(begin - (np.cumsum(size) - size).astype(np.int64), size.astype(np.int64))
    edge += np.arange(len(edge))
    own = np.repeat(root, size.astype(np.int64))
    dx = (east[edge] + east[edge + 1]) / 2 - runs.east[own]
    dy = (south[edge] + south[edge + 1]) / 2 - runs.south[own]
    n = np.maximum(np.bincount(own, minlength=count), 1)
    mean_x, mean_y = np.bincount(own, dx, count) / n, np.bincount(own, dy, count) / n
    xx = np.bincount(own, dx * dx, count) - n * mean_x**2
    yy = np.bincount(own, dy * dy, count) - n * mean_y**2
    xy = np.bincount(own, dx * dy, count) - n * mean_x * mean_y
    single = np.bincount(root, minlength=count) == 1
    angle = np.where((runs.frame == FREE) & ~single, 0.5 * np.arctan2(2 * xy, xx - yy), runs.angle)[root]
    angle = np.where(np.cos(angle - runs.angle) < 0, angle + np.pi, angle)
    line_x, line_y = (runs.east + mean_x)[root], (runs.south + mean_y)[root]
    off = -np.sin(angle) * (runs.east - line_x) + np.cos(angle) * (runs.south - line_y)
    alone = single[root] | (np.abs(off) > ONE_WALL)
    return WallRuns(
        runs.arc,
        runs.begin,
        runs.end,
        runs.frame,
        np.where(alone, runs.angle, angle),
        np.where(alone, runs.east, line_x),
        np.where(alone, runs.south, line_y),
    )


def placed_nodes(runs: WallRuns, nodes: tuple[Ints, Ints, Floats]) -> Floats:
    """Return where the walls meet that end at each node: the point nearest to their lines, cells, (N, 2).

    A wall weighs as its edges, up to `NODE_WEIGHT`. A node that would go farther than `NODE_REACH` stays.
    """
    tail, head, places = nodes
    first, last = _ends(runs, len(tail))
    node, run = np.concatenate((tail, head)), np.concatenate((first, last))
    node, run = node[node >= 0], run[node >= 0]
    weight = np.minimum(runs.end[run] - runs.begin[run], NODE_WEIGHT).astype(np.float64)
    normal_x, normal_y = -np.sin(runs.angle[run]), np.cos(runs.angle[run])
    off = normal_x * (runs.east[run] - places[node, 0]) + normal_y * (runs.south[run] - places[node, 1])
    count = len(places)
    # A weak pull to the traced place decides along parallel walls.
    pull = 1e-3
    xx = np.bincount(node, weight * normal_x**2, count) + pull
    yy = np.bincount(node, weight * normal_y**2, count) + pull
    xy = np.bincount(node, weight * normal_x * normal_y, count)
    x, y = np.bincount(node, weight * normal_x * off, count), np.bincount(node, weight * normal_y * off, count)
    determinant = xx * yy - xy * xy
    shift = np.column_stack(((yy * x - xy * y) / determinant, (xx * y - xy * x) / determinant))
    shift[np.hypot(shift[:, 0], shift[:, 1]) > NODE_REACH] = 0.0
    return np.asarray(places + shift)


def drawn_arcs(
    runs: WallRuns, chains: tuple[Floats, Floats, Ints], nodes: tuple[Ints, Ints, Floats], tilted: Mask
) -> tuple[Floats, Ints, Floats]:
    """Draw each arc along its walls, from node to node; the tilted ones without steps at their nodes.

    Returns
    -------
    vertices : (V, 2) ndarray of float64, cells
        Of all arcs, both ends included; rings are closed.
    offsets : (A + 1,) ndarray of int64
    off : (A,) ndarray of float64, cells
        The largest distance of a midpoint of the traced arc's edges from the drawn arc.
    """
    tail, head, places = nodes
    east, south, starts = chains
    bounds = np.searchsorted(runs.arc, np.arange(len(tail) + 1))
    lines = np.column_stack((runs.angle, runs.east, runs.south))
    vertices, offsets, off = _drawn(lines, (runs.begin, bounds), (east, south, starts), (tail, head, places), tilted)
    return vertices, offsets, off


@kernel
def _drawn(
    lines: Floats,
    divisions: tuple[Ints, Ints],
    chains: tuple[Floats, Floats, Ints],
    nodes: tuple[Ints, Ints, Floats],
    tilted: Mask,
) -> tuple[Floats, Ints, Floats]:
    """Draw the arcs (`drawn_arcs`)."""
    begin, bounds = divisions
    east, south, starts = chains
    tail, head, places = nodes
    pool = np.empty((2 * lines.shape[0] + 5 * tail.size, 2))
    offsets = np.zeros(tail.size + 1, dtype=np.int64)
    off = np.zeros(tail.size)
    count = 0
    for a in range(tail.size):
        low, high = bounds[a], bounds[a + 1]
        short = tilted[a] or (high - low == 1 and starts[a + 1] - starts[a] <= SHORT_ARC)
        if tail[a] >= 0:
            pool[count] = places[tail[a]]
            count += 1
            if not short:
                count = _stepped(pool, count, lines[low], places[tail[a]])
        for r in range(low + 1, high):
            v = starts[a] + begin[r]
            count = _cornered(pool, count, lines[r - 1], lines[r], (east[v], south[v]))
        if head[a] >= 0:
            if not short:
                count = _stepped(pool, count, lines[high - 1], places[head[a]])
            pool[count] = places[head[a]]
            count += 1
        else:
            v = starts[a]
            if high - low > 1:
                count = _cornered(pool, count, lines[high - 1], lines[low], (east[v], south[v]))
            else:
                pool[count] = np.array((east[v], south[v]))
                count += 1
            pool[count] = pool[offsets[a]]
            count += 1
        offsets[a + 1] = count
        off[a] = _distance(pool[offsets[a] : count], east[starts[a] : starts[a + 1]], south[starts[a] : starts[a + 1]])
    return pool[:count].copy(), offsets, off


@kernel
def _foot(line: Floats, x: float, y: float) -> tuple[float, float]:
    """Return the point of a line nearest to a place."""
    along_x, along_y = np.cos(line[0]), np.sin(line[0])
    along = along_x * (x - line[1]) + along_y * (y - line[2])
    return line[1] + along * along_x, line[2] + along * along_y


@kernel
def _stepped(pool: Floats, count: int, line: Floats, end: Floats) -> int:
    """Add the step between the end of an arc and its wall, where there is one; return the number of vertices."""
    x, y = _foot(line, end[0], end[1])
    if np.hypot(x - end[0], y - end[1]) > TILT:
        pool[count, 0], pool[count, 1] = x, y
        count += 1
    return count


@kernel
def _cornered(pool: Floats, count: int, one: Floats, other: Floats, place: tuple[float, float]) -> int:
    """Add the corner of two walls, or the step between them; return the number of vertices."""
    x, y = place
    sine = np.sin(other[0] - one[0])
    if abs(sine) > MEETING:
        # one + t along one lies on the other line.
        t = (np.sin(other[0]) * (other[1] - one[1]) - np.cos(other[0]) * (other[2] - one[2])) / sine
        corner_x, corner_y = one[1] + t * np.cos(one[0]), one[2] + t * np.sin(one[0])
        if np.hypot(corner_x - x, corner_y - y) <= CORNER_REACH:
            pool[count, 0], pool[count, 1] = corner_x, corner_y
            return count + 1
    one_x, one_y = _foot(one, x, y)
    other_x, other_y = _foot(other, x, y)
    if np.hypot(other_x - one_x, other_y - one_y) <= TILT:
        pool[count, 0], pool[count, 1] = (one_x + other_x) / 2, (one_y + other_y) / 2
        return count + 1
    pool[count, 0], pool[count, 1] = one_x, one_y
    pool[count + 1, 0], pool[count + 1, 1] = other_x, other_y
    return count + 2


@kernel
def _distance(line: Floats, east: Floats, south: Floats) -> float:
    """Return the largest distance of a midpoint of the traced edges from a line.

    Edges and walls follow each other: a wall near that of the last edge is near enough, up to a cell.
    """
    worst, walls, at = 0.0, line.shape[0] - 1, 0
    for k in range(east.size - 1):
        x, y = (east[k] + east[k + 1]) / 2, (south[k] + south[k + 1]) / 2
        squared, at = _nearest(line, max(at - AROUND, 0), min(at + AROUND + 1, walls), x, y)
        if squared > 1.0:
            squared, at = _nearest(line, 0, walls, x, y)
        worst = max(worst, squared)
    return float(np.sqrt(worst))


@kernel
def _nearest(line: Floats, low: int, high: int, x: float, y: float) -> tuple[float, int]:
    """Return the squared distance of the nearest wall of a line to a place, and its index, among some."""
    best, found = np.inf, low
    for s in range(low, high):
        ax, ay = line[s, 0], line[s, 1]
        dx, dy = line[s + 1, 0] - ax, line[s + 1, 1] - ay
        squared = dx * dx + dy * dy
        t = 0.0 if squared == 0 else min(max(((x - ax) * dx + (y - ay) * dy) / squared, 0.0), 1.0)
        off = (ax + t * dx - x) ** 2 + (ay + t * dy - y) ** 2
        if off < best:
            best, found = off, s
    return best, found

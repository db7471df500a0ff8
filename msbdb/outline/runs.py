"""Straight runs: a traced arc is divided into walls by dynamic programming, along main directions where it can be."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msbdb.threads import kernel

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

FREE = -1
"""The direction of a run that follows none of the main ones."""

STEEP = 1e-9
"""Costs must differ by more than this, so that rounding decides nothing."""

ROUNDED = 1.0
"""Sums of squares are exact to far less than this."""

FREE_RMS = 0.6
"""A free run whose edges lie farther from its line, in tolerances (RMS), is not lengthened."""


@dataclass(frozen=True, slots=True)
class WallCosts:
    """What a division of an arc costs besides the squared distances of its edges, in squared cells.

    Parameters
    ----------
    wall : float
        A run.
    second : float
        A run along another than the first main direction of a region, more.
    free : float
        A run that follows no main direction, more.
    turn : float
        From one frame of directions to another.
    jog : float
        From a wall to a parallel one: two corners more.
    reach : float
        Largest distance of an edge's midpoint from its run, cells.
    """

    wall: float = 3.0
    second: float = 3.0
    free: float = 15.0
    turn: float = 2.0
    jog: float = 3.0
    reach: float = 1.5

    def scaled(self, share: float) -> "WallCosts":
        """Return a share of all costs, and of the reach."""
        return WallCosts(*(share * float(value) for value in self.packed()))

    def packed(self) -> Floats:
        """Return the values in order."""
        return np.array([self.wall, self.second, self.free, self.turn, self.jog, self.reach])


@dataclass(frozen=True, slots=True, eq=False)
class WallRuns:
    """The runs of all arcs, in their order.

    Parameters
    ----------
    arc, begin, end : (R,) ndarray of int64
        The arc, and the vertices between which the run stands, counted from the arc's first one.
    frame : (R,) ndarray of int64
        Index of the direction among those of the arc, or `FREE`.
    angle : (R,) ndarray of float64
        Direction of the line, radians, in the sense of the arc.
    east, south : (R,) ndarray of float64
        A point of the line: the mean of the edges' midpoints, cells.
    """

    arc: Ints
    begin: Ints
    end: Ints
    frame: Ints
    angle: Floats
    east: Floats
    south: Floats


def divide(chains: tuple[Floats, Floats, Ints], frames: tuple[Floats, Ints, Ints], costs: WallCosts) -> WallRuns:
    """Divide traced arcs into straight runs.

    Parameters
    ----------
    chains : (V,) columns, (V,) rows, (A + 1,) offsets
        The vertices of the arcs a cell apart, ends included.
    frames : (F,) angles, (F,) ranks, (A + 1,) offsets
        The main directions of each arc, radians: an angle means itself and its right angle. The rank is 0 for the
        first direction of a region.
    costs : WallCosts

    Returns
    -------
    WallRuns

    Notes
    -----
    The division with the least sum of squared distances and costs is found exactly. Dynamic programming goes over the
    vertices and the direction of the run that ends there. A run of a main direction lies at the mean of its edges'
    midpoints; a free run is their total least-squares line. Each arc is worked on from its own first vertex, so that
    its place changes nothing. The time is the length of an arc times that of its longest possible run.
    """
    x, y, starts = chains
    return WallRuns(*_divided(x, y, starts, frames, costs.packed()))


def redivided(
    runs: WallRuns,
    chains: tuple[Floats, Floats, Ints],
    frames: tuple[Floats, Ints, Ints],
    chosen: Ints,
    costs: WallCosts,
) -> WallRuns:
    """Return runs in which the chosen arcs are divided anew, at other costs."""
    x, y, starts = chains
    angles, ranks, bounds = frames
    index, begins = _gathered(starts, chosen)
    place, few = _gathered(bounds, chosen)
    new = divide((x[index], y[index], begins), (angles[place], ranks[place], few), costs)
    kept = ~np.isin(runs.arc, chosen)
    order = np.argsort(np.concatenate((runs.arc[kept], chosen[new.arc])), kind="stable")
    return WallRuns(
        np.concatenate((runs.arc[kept], chosen[new.arc]))[order],
        np.concatenate((runs.begin[kept], new.begin))[order],
        np.concatenate((runs.end[kept], new.end))[order],
        np.concatenate((runs.frame[kept], new.frame))[order],
        np.concatenate((runs.angle[kept], new.angle))[order],
        np.concatenate((runs.east[kept], new.east))[order],
        np.concatenate((runs.south[kept], new.south))[order],
    )


def _gathered(offsets: Ints, chosen: Ints) -> tuple[Ints, Ints]:
    """Return the indices of the members of some groups, and the groups' offsets among these."""
    size = np.diff(offsets)[chosen]
    begins = np.concatenate(([0], np.cumsum(size)))
    return np.repeat(offsets[chosen] - begins[:-1], size) + np.arange(begins[-1]), begins


@kernel
def _divided(
    x: Floats, y: Floats, starts: Ints, frames: tuple[Floats, Ints, Ints], costs: Floats
) -> tuple[Ints, Ints, Ints, Ints, Floats, Floats, Floats]:
    """Divide each arc; the results are those of `WallRuns`."""
    angles, ranks, bounds = frames
    found, lines = np.empty((x.size, 4), dtype=np.int64), np.empty((x.size, 3))
    count = 0
    for a in range(starts.size - 1):
        first, last = starts[a], starts[a + 1]
        px, py = x[first:last] - x[first], y[first:last] - y[first]
        middle = np.empty((2, last - first - 1))
        middle[0], middle[1] = (px[1:] + px[:-1]) / 2, (py[1:] + py[:-1]) / 2
        mains = angles[bounds[a] : bounds[a + 1]]
        extra = np.where(ranks[bounds[a] : bounds[a + 1]] == 0, 0.0, costs[1])
        breaks, states, runs = _cheapest(middle, mains, extra, costs)
        for r in range(runs):
            low, high = breaks[r], breaks[r + 1]
            found[count] = a, low, high, FREE if states[r] == 2 * mains.size else states[r] // 2
            if states[r] < 2 * mains.size:
                angle = mains[states[r] // 2] + (states[r] % 2) * np.pi / 2
            elif high - low > 1:
                angle = _free_angle(middle[0, low:high], middle[1, low:high])
            else:
                angle = np.arctan2(py[high] - py[low], px[high] - px[low])
            # The line runs as the arc does.
            if np.cos(angle) * (px[high] - px[low]) + np.sin(angle) * (py[high] - py[low]) < 0:
                angle += np.pi
            lines[count, 0] = angle
            lines[count, 1] = middle[0, low:high].mean() + x[first]
            lines[count, 2] = middle[1, low:high].mean() + y[first]
            count += 1
    ints, floats = found[:count].T.copy(), lines[:count].T.copy()
    return ints[0], ints[1], ints[2], ints[3], floats[0], floats[1], floats[2]


@kernel
def _free_angle(x: Floats, y: Floats) -> float:
    """Return the direction of the total least-squares line of points."""
    dx, dy = x - x.mean(), y - y.mean()
    return float(0.5 * np.arctan2(2 * (dx * dy).sum(), (dx * dx).sum() - (dy * dy).sum()))


@kernel
def _cheapest(middle: Floats, mains: Floats, extra: Floats, costs: Floats) -> tuple[Ints, Ints, int]:
    """Return the vertices at which the runs of the cheapest division begin and end, their directions and number.

    ``middle`` has the midpoints of the edges, and ``extra`` what a run of each frame costs more. Direction 2 f is that
    of frame f, 2 f + 1 its right angle, and the last one is free.
    """
    size, free_state = middle.shape[1], 2 * mains.size
    # Sums of x, y, xx, xy and yy before each edge.
    sums = np.zeros((5, size + 1))
    sums[0, 1:], sums[1, 1:] = np.cumsum(middle[0]), np.cumsum(middle[1])
    sums[2, 1:], sums[3, 1:] = np.cumsum(middle[0] ** 2), np.cumsum(middle[0] * middle[1])
    sums[4, 1:] = np.cumsum(middle[1] ** 2)
    # Of each direction: its normal, what a run costs, and the reach.
    ways = np.empty((3, free_state + 1))
    for s in range(free_state):
        angle = mains[s // 2] + (s % 2) * np.pi / 2
        ways[0, s], ways[1, s], ways[2, s] = -np.sin(angle), np.cos(angle), costs[0] + extra[s // 2]
    # Without main directions all runs are free, and nothing is to be preferred.
    ways[2, free_state] = costs[0] + (costs[2] if free_state else 0.0)
    # best[j, s]: cost up to vertex j with a last run of direction s; opened[i, s]: cost before a run of s from i on.
    best, opened = np.full((size + 1, free_state + 1), np.inf), np.full((size + 1, free_state + 1), np.inf)
    origin = np.zeros((size + 1, free_state + 1), dtype=np.int64)
    before = np.zeros((size + 1, free_state + 1), dtype=np.int64)
    opened[0, :] = 0.0
    for j in range(1, size + 1):
        _end_runs(j, (middle, sums, ways), costs[5], (best, opened, origin))
        _turn(j, (best, opened, before), costs)
    breaks, states = np.empty(size + 1, dtype=np.int64), np.empty(size, dtype=np.int64)
    runs, j, s = 0, size, 0
    for t in range(1, free_state + 1):
        if best[size, t] < best[size, s] - STEEP:
            s = t
    while j > 0:
        breaks[runs], states[runs] = j, s
        runs += 1
        i = origin[j, s]
        s = before[i, s]
        j = i
    breaks[runs] = 0
    return breaks[: runs + 1][::-1].copy(), states[:runs][::-1].copy(), runs


@kernel
def _end_runs(j: int, given: tuple[Floats, Floats, Floats], reach: float, costs: tuple[Floats, Floats, Ints]) -> None:
    """Find the cheapest run of each direction that ends at a vertex."""
    middle, sums, ways = given
    best, opened, origin = costs
    free_state = ways.shape[1] - 1
    low, high = np.full(free_state, np.inf), np.full(free_state, -np.inf)
    free_alive = True
    for i in range(j - 1, -1, -1):
        alive = free_alive
        n = j - i
        mean_x, mean_y = (sums[0, j] - sums[0, i]) / n, (sums[1, j] - sums[1, i]) / n
        xx = max(sums[2, j] - sums[2, i] - n * mean_x * mean_x, 0.0)
        yy = max(sums[4, j] - sums[4, i] - n * mean_y * mean_y, 0.0)
        xy = sums[3, j] - sums[3, i] - n * mean_x * mean_y
        for s in range(free_state):
            # Once the edges spread over more than twice the reach, a longer run does so too.
            if high[s] - low[s] > 2 * reach:
                continue
            place = ways[0, s] * middle[0, i] + ways[1, s] * middle[1, i]
            low[s], high[s] = min(low[s], place), max(high[s], place)
            alive = True
            mean = ways[0, s] * mean_x + ways[1, s] * mean_y
            if high[s] - mean > reach or mean - low[s] > reach:
                continue
            # The squares make nothing cheaper, but for rounding.
            if opened[i, s] + ways[2, s] >= best[j, s] + ROUNDED:
                continue
            squares = ways[0, s] ** 2 * xx + 2 * ways[0, s] * ways[1, s] * xy + ways[1, s] ** 2 * yy
            cost = opened[i, s] + squares + ways[2, s]
            if cost < best[j, s] - STEEP:
                best[j, s], origin[j, s] = cost, i
        if free_alive:
            squares = max((xx + yy) / 2 - np.sqrt((xx - yy) ** 2 / 4 + xy * xy), 0.0)
            free_alive = n < 4 or squares < n * (FREE_RMS * reach) ** 2
            cost = opened[i, free_state] + squares + ways[2, free_state]
            if cost < best[j, free_state] - STEEP:
                angle = 0.5 * np.arctan2(2 * xy, xx - yy)
                if _within(middle[0, i:j], middle[1, i:j], angle, reach):
                    best[j, free_state], origin[j, free_state] = cost, i
        if not alive:
            break


@kernel
def _turn(j: int, found: tuple[Floats, Floats, Ints], costs: Floats) -> None:
    """Find the cheapest way to begin a run of each direction at a vertex."""
    best, opened, before = found
    free_state = best.shape[1] - 1
    for s in range(free_state + 1):
        for t in range(free_state + 1):
            cost = best[j, t]
            if s < free_state and s == t:
                cost += costs[4]
            elif s < free_state and t < free_state and s // 2 != t // 2:
                cost += costs[3]
            if cost < opened[j, s] - STEEP:
                opened[j, s], before[j, s] = cost, t


@kernel
def _within(x: Floats, y: Floats, angle: float, reach: float) -> bool:
    """Return whether all points lie within the reach of their line of a direction, at their mean."""
    mean_x, mean_y, cosine, sine = x.mean(), y.mean(), np.cos(angle), np.sin(angle)
    farthest = 0.0
    for k in range(x.size):
        farthest = max(farthest, abs(cosine * (y[k] - mean_y) - sine * (x[k] - mean_x)))
    return bool(farthest <= reach)

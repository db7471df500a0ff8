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
    free: float = 12.0
    turn: float = 2.0
    jog: float = 1.0
    reach: float = 1.5

    def scaled(self, share: float) -> "WallCosts":
        """Return a share of all costs, and of the reach."""
        return WallCosts(*(share * float(value) for value in self.packed()))

    def packed(self) -> Floats:
        """Return the values in order."""
        return np.array([self.wall, self.second, self.free, self.turn, self.jog, self.reach])


@dataclass(frozen=True, slots=True, eq=False)
class Runs:
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


def divide(chains: tuple[Floats, Floats, Ints], frames: tuple[Floats, Ints, Ints], costs: WallCosts) -> Runs:
    """Divide traced arcs into straight runs.

    Parameters
    ----------
    chains : (V,) columns, (V,) rows, (A + 1,) offsets
        The vertices of the arcs a cell apart, ends included.
    frames : (F,) angles, (F,) ranks, (A + 1,) offsets
        The main directions of each arc, radians: an angle stands for itself and its right angle. The rank is 0 for the
        first direction of a region.
    costs : WallCosts

    Returns
    -------
    Runs

    Notes
    -----
    The division with the least sum of squared distances and costs is found exactly, by dynamic programming over the
    vertices and the direction of the run that ends there. A run of a main direction lies at the mean of its edges'
    midpoints; a free run is their total least-squares line. Each arc is worked on from its own first vertex, so that
    its place changes nothing. The time is the length of an arc times that of its longest possible run.
    """
    x, y, starts = chains
    found = _divided(x, y, starts, frames, costs.packed())
    return Runs(*found)


@kernel
def _divided(
    x: Floats, y: Floats, starts: Ints, frames: tuple[Floats, Ints, Ints], costs: Floats
) -> tuple[Ints, Ints, Ints, Ints, Floats, Floats, Floats]:
    """Divide each arc; the results are those of `Runs`."""
    angles, ranks, frame_starts = frames
    most = x.size
    arc, begin = np.empty(most, dtype=np.int64), np.empty(most, dtype=np.int64)
    end, frame = np.empty(most, dtype=np.int64), np.empty(most, dtype=np.int64)
    angle, east, south = np.empty(most), np.empty(most), np.empty(most)
    count = 0
    for a in range(starts.size - 1):
        first, last = starts[a], starts[a + 1]
        size = last - first - 1
        px, py = x[first:last] - x[first], y[first:last] - y[first]
        middle_x, middle_y = (px[1:] + px[:-1]) / 2, (py[1:] + py[:-1]) / 2
        mains = angles[frame_starts[a] : frame_starts[a + 1]]
        walls = np.where(ranks[frame_starts[a] : frame_starts[a + 1]] == 0, costs[0], costs[0] + costs[1])
        breaks, states, runs = _cheapest(middle_x, middle_y, mains, walls, costs)
        for r in range(runs):
            low, high = breaks[r], breaks[r + 1]
            mean_x, mean_y = middle_x[low:high].mean(), middle_y[low:high].mean()
            if states[r] == 2 * mains.size:
                turned = _free_angle(middle_x, middle_y, low, high, px, py)
                frame[count] = FREE
            else:
                turned = mains[states[r] // 2] + (states[r] % 2) * np.pi / 2
                frame[count] = states[r] // 2
            # The line runs as the arc does.
            if np.cos(turned) * (px[high] - px[low]) + np.sin(turned) * (py[high] - py[low]) < 0:
                turned += np.pi
            arc[count], begin[count], end[count], angle[count] = a, low, high, turned
            east[count], south[count] = mean_x + x[first], mean_y + y[first]
            count += 1
    return (
        arc[:count].copy(),
        begin[:count].copy(),
        end[:count].copy(),
        frame[:count].copy(),
        angle[:count].copy(),
        east[:count].copy(),
        south[:count].copy(),
    )


@kernel
def _free_angle(middle_x: Floats, middle_y: Floats, low: int, high: int, px: Floats, py: Floats) -> float:
    """Return the direction of the total least-squares line of midpoints; of an edge, its own."""
    if high - low == 1:
        return float(np.arctan2(py[high] - py[low], px[high] - px[low]))
    dx, dy = middle_x[low:high] - middle_x[low:high].mean(), middle_y[low:high] - middle_y[low:high].mean()
    return float(0.5 * np.arctan2(2 * (dx * dy).sum(), (dx * dx).sum() - (dy * dy).sum()))


@kernel
def _cheapest(
    middle_x: Floats, middle_y: Floats, mains: Floats, walls: Floats, costs: Floats
) -> tuple[Ints, Ints, int]:
    """Return the vertices at which the runs of the cheapest division begin and end, their directions and number.

    Direction 2 f is that of frame f, 2 f + 1 its right angle, and the last one is free.
    """
    wall, _, free, turn, jog, reach = costs
    if mains.size == 0:
        free = 0.0
    size, free_state = middle_x.size, 2 * mains.size
    sum_x, sum_y = np.zeros(size + 1), np.zeros(size + 1)
    sum_xx, sum_xy, sum_yy = np.zeros(size + 1), np.zeros(size + 1), np.zeros(size + 1)
    sum_x[1:], sum_y[1:] = np.cumsum(middle_x), np.cumsum(middle_y)
    sum_xx[1:], sum_xy[1:] = np.cumsum(middle_x * middle_x), np.cumsum(middle_x * middle_y)
    sum_yy[1:] = np.cumsum(middle_y * middle_y)
    normal_x, normal_y = np.empty(free_state), np.empty(free_state)
    for s in range(free_state):
        turned = mains[s // 2] + (s % 2) * np.pi / 2
        normal_x[s], normal_y[s] = -np.sin(turned), np.cos(turned)
    # best[j, s]: cost up to vertex j with a last run of direction s; open[i, s]: cost before a run of s from i on.
    best = np.full((size + 1, free_state + 1), np.inf)
    opened = np.full((size + 1, free_state + 1), np.inf)
    origin = np.zeros((size + 1, free_state + 1), dtype=np.int64)
    before = np.zeros((size + 1, free_state + 1), dtype=np.int64)
    opened[0, :] = 0.0
    low, high = np.empty(free_state), np.empty(free_state)
    for j in range(1, size + 1):
        low[:], high[:] = np.inf, -np.inf
        free_alive = True
        for i in range(j - 1, -1, -1):
            alive = free_alive
            n = j - i
            mean_x, mean_y = (sum_x[j] - sum_x[i]) / n, (sum_y[j] - sum_y[i]) / n
            xx = max(sum_xx[j] - sum_xx[i] - n * mean_x * mean_x, 0.0)
            yy = max(sum_yy[j] - sum_yy[i] - n * mean_y * mean_y, 0.0)
            xy = sum_xy[j] - sum_xy[i] - n * mean_x * mean_y
            for s in range(free_state):
                if high[s] - low[s] > 2 * reach:
                    continue
                place = normal_x[s] * middle_x[i] + normal_y[s] * middle_y[i]
                low[s], high[s] = min(low[s], place), max(high[s], place)
                if high[s] - low[s] > 2 * reach:
                    continue
                alive = True
                mean = normal_x[s] * mean_x + normal_y[s] * mean_y
                if high[s] - mean > reach or mean - low[s] > reach:
                    continue
                squares = normal_x[s] ** 2 * xx + 2 * normal_x[s] * normal_y[s] * xy + normal_y[s] ** 2 * yy
                cost = opened[i, s] + squares + walls[s // 2]
                if cost < best[j, s] - STEEP:
                    best[j, s], origin[j, s] = cost, i
            if free_alive:
                squares = max((xx + yy) / 2 - np.sqrt((xx - yy) ** 2 / 4 + xy * xy), 0.0)
                free_alive = n < 4 or squares < n * (FREE_RMS * reach) ** 2
                cost = opened[i, free_state] + squares + wall + free
                if cost < best[j, free_state] - STEEP and _within(
                    middle_x[i:j], middle_y[i:j], 0.5 * np.arctan2(2 * xy, xx - yy), reach
                ):
                    best[j, free_state], origin[j, free_state] = cost, i
            if not alive:
                break
        for s in range(free_state + 1):
            for t in range(free_state + 1):
                cost = best[j, t]
                if s == t and s != free_state:
                    cost += jog
                elif s // 2 != t // 2 and s != free_state and t != free_state:
                    cost += turn
                if cost < opened[j, s] - STEEP:
                    opened[j, s], before[j, s] = cost, t
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
def _within(x: Floats, y: Floats, angle: float, reach: float) -> bool:
    """Return whether all points lie within the reach of their line of a direction, at their mean."""
    normal_x, normal_y = -np.sin(angle), np.cos(angle)
    mean = normal_x * x.mean() + normal_y * y.mean()
    for k in range(x.size):
        if abs(normal_x * x[k] + normal_y * y[k] - mean) > reach:
            return False
    return True

"""The adaptive indicator: profiles along both axes and both senses measure the feature under a point (S4, S5)."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from msbdb.ground.lowpoints import LowPoints
from msbdb.threads import in_threads, kernel

Floats = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

NOTHING, END, SINK, FALL = 0, 1, 2, 3
"""Results of a profile: nothing within its reach, the end of the data, a fall onto points that sank before, and a fall
onto points that did not."""

NARROW = 2
"""Widest gap in cells across which terrain may rise; beyond a wider gap higher points may have ground of their own."""

STRETCH = 8
"""Cells to either side over which the slope of a level is measured."""

FEWEST = 3
"""Cells that a level must have for its slope to be known; half of the steepest is taken otherwise."""

SLOPE_FACTOR, SLOPE_MORE = 1.5, 0.1
"""How much steeper than measured beside a feature terrain may be beneath it: slopes change, and heights are noisy."""

CUT = 4
"""The reach over this is the longest visible part of a building that the end of the data cuts."""

BAND = 64
"""Rows or columns of cells that a thread takes at a time."""


@dataclass(frozen=True, slots=True)
class Profile:
    """Thresholds of rise and fall along a profile.

    Parameters
    ----------
    reach_m : float
        Length of a profile, metres: twice the half-width of the largest window.
    step_m : float
        Least change from one point of a profile to the next that is an edge, metres.
    fall_m : float
        Least height of a feature at its edge, metres.
    slope : float
        Steepest terrain from one side of a feature to the other, m/m.
    """

    reach_m: float
    step_m: float
    fall_m: float
    slope: float


def feature_sizes(low: LowPoints, heights: Floats, firm: Mask, cell_m: float, profile: Profile) -> Floats:
    """Return the distance of each point from the foot of the feature under it.

    Parameters
    ----------
    low : LowPoints
        The points.
    heights : (M,) ndarray of float64, metres
        Their heights, opened so far.
    firm : (M,) ndarray of bool
        Which points have not sunk so far.
    cell_m : float
        Side of the cells, metres.
    profile : Profile
        Reach and thresholds.

    Returns
    -------
    (M,) ndarray of float64, metres
        The distance to the nearest foot along an axis that shows the feature; 0 where none does.

    Notes
    -----
    From the point a profile runs along its row or column of cells in both senses (S5):

    - It follows the level of the point through gentle changes.
    - A fall from this level by ``fall_m``, in one or more steps, ends the feature at its foot.
    - After a rise it follows the higher level until it comes down again. Back on the first level, it goes on. If it
      comes down farther, by more than the terrain's slope allows over that way, this is the fall.
    - Points that sank before count for falls only: their opened heights are no terrain.

    There is a feature under the point where an axis has falls in both senses. Where the data end within the reach, a
    building may be cut. Then one fall is enough if the visible part is no longer than a quarter of the reach.

    Examples
    --------
    A roof of three cells, 5 m high, in a row of cells of 1 m; the ends of the row are ground:

    >>> u = np.arange(9) + 0.5
    >>> z = np.array([0.0, 0, 0, 5, 5, 5, 0, 0, 0])
    >>> low = LowPoints(np.arange(9), u, np.full(9, 0.5), z, np.arange(9)[None])
    >>> feature_sizes(low, z, np.ones(9, dtype=bool), 1.0, Profile(8.0, 0.9, 1.5, 0.5))
    array([0., 0., 0., 1., 2., 1., 0., 0., 0.])
    """
    reach = max(int(profile.reach_m / cell_m), 1)
    rules = Rules(cell_m, reach, profile.step_m, profile.fall_m, profile.slope)
    points = (low.u, low.v, heights, firm)
    nearest = np.minimum(_along(low.at, points, rules), _along(low.at.T, points, rules))
    return np.where(np.isfinite(nearest), nearest, 0.0)


def _along(at: Index, points: tuple[Floats, Floats, Floats, Mask], rules: "Rules") -> Floats:
    """Return how far each point is from its foot along the rows of ``at``; infinity without a feature."""
    lines = np.ascontiguousarray(at)
    sizes = np.full(points[2].size, np.inf)
    bands = [lines[first : first + BAND] for first in range(0, lines.shape[0], BAND)]
    in_threads(lambda band: _measure(band, points, rules, sizes), bands)
    return sizes


class Rules(NamedTuple):
    """The values of `Profile`, for kernels; the reach in cells."""

    cell: float
    reach: int
    step: float
    fall: float
    steepest: float


class Line(NamedTuple):
    """The points of a row or column of cells in the order of a profile, for kernels."""

    place: Index
    u: Floats
    v: Floats
    z: Floats
    firm: Mask
    slope: Floats


@kernel
def _measure(lines: Index, points: tuple[Floats, Floats, Floats, Mask], rules: Rules, sizes: Floats) -> None:
    """Write how far each point of some lines of cells is from its foot along its line; infinity without a feature."""
    u, v, z, firm = points
    longest_cut = rules.reach * rules.cell / CUT
    for number in range(lines.shape[0]):
        place = np.flatnonzero(lines[number] >= 0)
        if place.size == 0:
            continue
        ids = lines[number][place]
        line = Line(place, u[ids], v[ids], z[ids], firm[ids], np.empty(place.size))
        # One kernel follows the line in one sense; the other sense is the line turned round.
        _write_slopes(line, rules)
        one, near = _runs(line, rules)
        back = Line(
            place[-1] - place[::-1],
            line.u[::-1].copy(),
            line.v[::-1].copy(),
            line.z[::-1].copy(),
            line.firm[::-1].copy(),
            line.slope[::-1].copy(),
        )
        other, far = _runs(back, rules)
        other, far = other[::-1], far[::-1]
        for k in range(ids.size):
            if one[k] > END and other[k] > END:
                sizes[ids[k]] = min(near[k], far[k])
            elif max(one[k], other[k]) > END and min(one[k], other[k]) == END and near[k] + far[k] <= longest_cut:
                sizes[ids[k]] = near[k] if one[k] > END else far[k]


@kernel
def _write_slopes(line: Line, rules: Rules) -> None:
    """Write the steepest slope that the terrain beside each point may have along a line."""
    place, z, slope = line.place, line.z, line.slope
    for k in range(z.size):
        first, last = (
            _level_end(place, z, line.firm, (k, -1), rules.step),
            _level_end(place, z, line.firm, (k, 1), rules.step),
        )
        length = place[last] - place[first]
        slope[k] = rules.steepest / 2
        if length >= FEWEST:
            slope[k] = min(SLOPE_FACTOR * abs(z[last] - z[first]) / (length * rules.cell) + SLOPE_MORE, rules.steepest)


@kernel
def _level_end(place: Index, z: Floats, firm: Mask, start: tuple[int, int], step: float) -> int:
    """Follow the level of a point through gentle changes in one sense; return where on the line it ends."""
    k, sense = start
    end = k
    while True:
        i = end + sense
        if i < 0 or i >= z.size or abs(place[i] - place[k]) > STRETCH:
            return end
        if firm[i] != firm[k] or abs(z[i] - z[end]) > step:
            return end
        end = i


@kernel
def _runs(line: Line, rules: Rules) -> tuple[Index, Floats]:
    """Follow the profiles of all points of a line; return what `_run` does."""
    place, z, firm = line.place, line.z, line.firm
    count = z.size
    # From a point to the event after it there are only gentle changes between neighbours.
    event = np.empty(count, dtype=np.int64)
    event[count - 1] = count
    for k in range(count - 2, -1, -1):
        gentle = firm[k] and firm[k + 1] and abs(z[k + 1] - z[k]) <= rules.step
        event[k] = event[k + 1] if gentle else k + 1
    codes = np.empty(count, dtype=np.int64)
    feet = np.empty(count)
    stop = 0
    for k in range(count):
        while stop + 1 < count and place[stop + 1] - place[k] <= rules.reach:
            stop += 1
        codes[k], feet[k] = _run(line, rules, event, k, stop)
    return codes, feet


@kernel
def _run(line: Line, rules: Rules, event: Index, p: int, stop: int) -> tuple[int, float]:
    """Follow one profile as far as point ``stop``; return its result, and how far its foot or the data's end is.

    The state while it runs: ``last`` is the height of the level reached, ``brink`` that of the edge where the present
    rise or fall began. ``steep`` is set within a fall of several steps, ``above`` on something higher than the level,
    ``fallen`` once the fall is deep enough; then the profile only looks for the lowest point of the foot.
    """
    place, u, v, z, firm, slopes = line
    cell, reach, step, fall, _ = rules
    last, last_i, slope = z[p], place[p], slopes[p]
    brink, brink_i = z[p], place[p]
    steep, above, fallen = False, False, False
    onto, foot = NOTHING, 0.0
    q = p
    while True:
        # Gentle changes need no decision: skip to the last point before the next event.
        if event[q] > q + 1 and not above and not fallen:
            q = min(event[q] - 1, stop)
            last, last_i, slope, steep = z[q], place[q], slopes[q], False
        q += 1
        if q > stop and not fallen:
            seen = place[stop] - place[p]
            return (END if CUT * seen <= reach and not above else NOTHING), seen * cell
        if q > stop:
            return onto, foot
        here, gap = z[q], place[q] - last_i - 1
        if above:
            fallen = here < brink - fall - slope * cell * (place[q] - brink_i)
            above, steep = not (fallen or (firm[q] and here <= brink + step)), fallen
        elif here - last < -step - slope * cell * gap:
            brink, brink_i = (brink, brink_i) if steep else (last, last_i)
            steep = True
            # The foot must also lie below the point itself: terrain may rise between them.
            fallen = min(brink, z[p] + fall - step) - here >= fall + slope * cell * gap
        elif fallen:
            return onto, foot
        elif not firm[q]:
            continue
        else:
            steep, above = False, here - last > step + slope * cell * min(gap, NARROW)
            brink, brink_i = (last, last_i) if above else (brink, brink_i)
        if fallen:
            onto, foot = (FALL if firm[q] else SINK), max(abs(u[q] - u[p]), abs(v[q] - v[p]))
        if firm[q] or fallen:
            last, last_i = here, place[q]
            slope = slope if above else slopes[q]

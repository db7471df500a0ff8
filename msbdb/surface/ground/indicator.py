"""The adaptive indicator: profiles along both axes and both senses tell what a point stands on (S4, S5)."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from msbdb.morphology.kernels import kernel
from msbdb.surface.ground.lowpoints import LowPoints
from msbdb.threads import in_threads

Floats = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

NOTHING, END, SINK, FALL = 0, 1, 2, 3
"""What a profile comes to: nothing within its reach, the end of the data, a fall onto points that sank before, and a
fall onto points that did not."""
NARROW = 2
"""Widest gap in cells across which terrain may rise; what is higher beyond a wider one may stand on its own ground."""
STRETCH = 8
"""Cells to either side over which the slope of a level is measured."""
FEWEST = 3
"""Cells that a level must have for its slope to be known; half of the steepest is taken otherwise."""
SLOPE_FACTOR, SLOPE_MORE = 1.5, 0.1
"""How much steeper than measured beside a feature terrain may be beneath it: slopes change, and heights are noisy."""
CUT = 4
"""What part of the reach a building that the end of the data cuts may take of it."""
ROWS = 64
"""Rows of cells that a thread takes at a time."""


@dataclass(frozen=True, slots=True)
class Profile:
    """What counts as rise and fall along a profile.

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
    """Return how far each point is from the foot of the feature that it stands on.

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
    From the point a profile runs along its row or column of cells in both senses (S5). It follows the level that the
    point stands on through gentle changes. A fall from this level by ``fall_m`` in one or more steps ends the
    feature, at its foot. A rise onto something higher is followed until the profile comes down again: to the level
    before (then it goes on), or below it by more than the terrain's slope makes of the way (then that is the fall).
    Points that sank before are looked at for falls only: what is left of their heights is no terrain.

    The point stands on a feature where an axis has falls in both senses. Where the data end (for the rest of the
    reach), so that a building may be cut, one fall is enough if the part seen is no longer than a quarter of it.
    """
    field = Field(
        low.at,
        (low.u, low.v, heights),
        firm,
        np.empty((2, heights.size)),
        cell_m,
        max(int(profile.reach_m / cell_m), 1),
        profile.step_m,
        profile.fall_m,
        profile.slope,
    )
    sizes = np.zeros(heights.size)
    bands = range(0, low.at.shape[0], ROWS)
    in_threads(lambda first: _write_slopes(field, first), bands)
    in_threads(lambda first: _write_sizes(field, first, sizes), bands)
    return sizes


class Field(NamedTuple):
    """What the profiles run over, and their rules, for kernels; lengths in metres, the reach in cells."""

    at: Index
    points: tuple[Floats, Floats, Floats]
    firm: Mask
    slopes: Floats
    cell: float
    reach: int
    step: float
    fall: float
    steepest: float


@kernel
def _next(at: Index, start: tuple[int, int], sense: tuple[int, int], i: int, reach: int) -> tuple[int, int]:
    """Return the next point after ``i`` cells of a profile, -1 where there is none within reach, and its cell."""
    rows, cols = at.shape
    for j in range(i + 1, reach + 1):
        row, col = start[0] + j * sense[0], start[1] + j * sense[1]
        if row < 0 or col < 0 or row >= rows or col >= cols:
            break
        if at[row, col] >= 0:
            return at[row, col], j
    return -1, reach


@kernel
def _write_slopes(field: Field, first: int) -> None:
    """Write the steepest slope that the terrain beside each point of a band may have, along columns and rows."""
    for row in range(first, min(first + ROWS, field.at.shape[0])):
        for col in range(field.at.shape[1]):
            p = field.at[row, col]
            if p < 0:
                continue
            for axis in range(2):
                down, across = 1 - axis, axis
                one, ahead = _level_end(field, (row, col), (down, across))
                other, behind = _level_end(field, (row, col), (-down, -across))
                field.slopes[axis, p] = field.steepest / 2
                if ahead + behind >= FEWEST:
                    measured = abs(one - other) / ((ahead + behind) * field.cell)
                    field.slopes[axis, p] = min(SLOPE_FACTOR * measured + SLOPE_MORE, field.steepest)


@kernel
def _level_end(field: Field, start: tuple[int, int], sense: tuple[int, int]) -> tuple[float, int]:
    """Follow the level of a point through gentle changes; return the height at its end, and the cells to there."""
    at, z = field.at, field.points[2]
    p = at[start]
    last, length = z[p], 0
    while True:
        q, i = _next(at, start, sense, length, STRETCH)
        if q < 0 or field.firm[q] != field.firm[p] or abs(z[q] - last) > field.step:
            return last, length
        last, length = z[q], i


@kernel
def _write_sizes(field: Field, first: int, sizes: Floats) -> None:
    """Write the sizes of the points of a band."""
    longest_cut = field.reach * field.cell / CUT
    for row in range(first, min(first + ROWS, field.at.shape[0])):
        for col in range(field.at.shape[1]):
            if field.at[row, col] < 0:
                continue
            nearest = np.inf
            for axis in range(2):
                down, across = 1 - axis, axis
                one, near = _run(field, (row, col), (down, across), axis)
                if one == NOTHING:
                    continue
                other, far = _run(field, (row, col), (-down, -across), axis)
                if one > END and other > END:
                    nearest = min(nearest, near, far)
                elif max(one, other) > END and min(one, other) == END and near + far <= longest_cut:
                    nearest = min(nearest, near if one > END else far)
            sizes[field.at[row, col]] = nearest if np.isfinite(nearest) else 0.0


@kernel
def _run(field: Field, start: tuple[int, int], sense: tuple[int, int], axis: int) -> tuple[int, float]:
    """Follow one profile; return what it comes to, and how far the foot of its fall, or the end of the data, is."""
    at, (u, v, z), firms, slopes = field.at, field.points, field.firm, field.slopes[axis]
    cell, reach, step, fall = field.cell, field.reach, field.step, field.fall
    p = at[start]
    last, last_i, slope = z[p], 0, slopes[p]
    brink, brink_i = z[p], 0
    steep, above, fallen = False, False, False
    onto, foot = NOTHING, 0.0
    i = 0
    while True:
        seen = i
        q, i = _next(at, start, sense, i, reach)
        if q < 0 and not fallen:
            return (END if CUT * seen <= reach and not above else NOTHING), seen * cell
        if q < 0:
            return onto, foot
        here, gap, firm = z[q], i - last_i - 1, firms[q]
        if above:
            fallen = here < brink - fall - slope * cell * (i - brink_i)
            above, steep = not (fallen or (firm and here <= brink + step)), fallen
        elif here - last < -step - slope * cell * gap:
            brink, brink_i = (brink, brink_i) if steep else (last, last_i)
            steep = True
            # The foot must also lie below the point itself: terrain may rise between them.
            fallen = min(brink, z[p] + fall - step) - here >= fall + slope * cell * gap
        elif fallen:
            return onto, foot
        elif not firm:
            continue
        else:
            steep, above = False, here - last > step + slope * cell * min(gap, NARROW)
            brink, brink_i = (last, last_i) if above else (brink, brink_i)
        if fallen:
            onto, foot = (FALL if firm else SINK), max(abs(u[q] - u[p]), abs(v[q] - v[p]))
        if firm or fallen:
            last, last_i = here, i
            slope = slope if above else slopes[q]

"""Lines along the edge points of regions, and the main directions of these lines (Cao & Wu; C11)."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from msbdb.threads import cores, in_threads

BINS = 36
"""Bars of the histogram of directions, 5 degrees each."""

BATCH = 1 << 13
"""Windows that are fitted by a line at once."""

APART = 3
"""The second main direction lies at least so many bars off the first."""


def measure_lines(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    member: NDArray[np.int32],
    *,
    most: int,
    least: int,
    tolerance_m: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return linearity L(u) and direction D(u) of the edge points (C11).

    Parameters
    ----------
    x, y : (E,) ndarray of float64, metres
        Edge points.
    member : (E,) ndarray of int32
        Their regions.
    most, least : int
        n_b and n_s, the most and fewest points of a line.
    tolerance_m : float
        σ_l.

    Returns
    -------
    linearity : (E,) ndarray of float64
        exp(-ε) of the longest line with an error ε below σ_l, ε in metres; 0 without one.
    direction : (E,) ndarray of float64
        Its angle, degrees from east, 0 to 180; NaN without one.

    Notes
    -----
    The paper says neither which points adjoin nor when to stop. Here a window has the n points of a region nearest to
    one of its edge points, which is one of them. For n from n_b down to n_s, all windows that hold u are compared. So a
    corner finds the lines of both walls beside it. After n_s, L(u) = 0. The line is that of total least squares, which
    may be vertical, and ε is the root of the mean squared distance to it. Of equal errors the window of the first edge
    point counts.
    """
    count = len(x)
    linearity, direction = np.zeros(count), np.full(count, np.nan)
    if count < least:
        return linearity, direction
    around, size = _nearest(x, y, member, min(most, count))
    for n in range(min(most, count), least - 1, -1):
        window = np.flatnonzero(size >= n)
        error, angle = _fit_in_batches(x, y, around[window, :n])
        fits = error < tolerance_m
        window, error, angle = window[fits], error[fits], angle[fits]
        order = np.argsort(error, kind="stable")[::-1]
        best = np.full(count, -1)
        # Of equal indices the last is what remains, so the window with the smallest error comes last.
        best[around[window[order], :n].ravel()] = np.repeat(order, n)
        won = np.flatnonzero((best >= 0) & (linearity == 0))
        linearity[won], direction[won] = np.exp(-error[best[won]]), angle[best[won]]
    return linearity, direction


def _nearest(
    x: NDArray[np.float64], y: NDArray[np.float64], member: NDArray[np.int32], k: int
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the k nearest points of the same region, the point itself first, and how many of them there are."""
    extent = float(np.hypot(np.ptp(x), np.ptp(y))) + 1
    stacked = np.column_stack([x, y, member * extent])  # in height, regions lie farther apart than any two points
    distance, around = cKDTree(stacked).query(stacked, k=np.arange(1, k + 1), workers=cores())
    return around, np.count_nonzero(distance < extent, axis=1)


def _fit_in_batches(
    x: NDArray[np.float64], y: NDArray[np.float64], windows: NDArray[np.intp]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return what `_fit_lines` does, by threads; a batch of windows stays in the processor's cache."""
    batches = [windows[first : first + BATCH] for first in range(0, max(len(windows), 1), BATCH)]
    fitted = in_threads(lambda batch: _fit_lines(x, y, batch), batches)
    return np.concatenate([error for error, _ in fitted]), np.concatenate([angle for _, angle in fitted])


def _fit_lines(
    x: NDArray[np.float64], y: NDArray[np.float64], windows: NDArray[np.intp]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return error and angle of the total least squares lines of (W, n) windows of points."""
    east, north = x[windows], y[windows]
    east -= east.mean(axis=1, keepdims=True)
    north -= north.mean(axis=1, keepdims=True)
    xx, yy, xy = ((a * b).mean(axis=1) for a, b in ((east, east), (north, north), (east, north)))
    smallest = (xx + yy) / 2 - np.hypot((xx - yy) / 2, xy)
    return np.sqrt(np.maximum(smallest, 0)), np.degrees(np.arctan2(2 * xy, xx - yy) / 2) % 180


def main_directions(direction: NDArray[np.float64], member: NDArray[np.int32], count: int) -> NDArray[np.float64]:
    """Return (count, 2) the two strongest peaks of the directions of each region's edge points (C11).

    Parameters
    ----------
    direction : (E,) ndarray of float64
        Degrees, 0 to 180; NaN for none.
    member : (E,) ndarray of int32
        Regions from 0.

    Notes
    -----
    The histogram has bars of 5 degrees on the half circle. Half of the neighbours' counts are added to each bar, so
    that a direction on a border counts. The second peak lies 15 degrees or more off the first. A peak's direction is
    the mean of the angles in its three bars. NaN where no edge point is left.

    Examples
    --------
    The edges of a house run at 30 and 120 degrees; 178 and 4 degrees are near each other on the half circle:

    >>> angles = np.array([29.0, 30.0, 31.0, 119.0, 121.0, 178.0, 4.0])
    >>> main_directions(angles, np.array([0, 0, 0, 0, 0, 1, 1], dtype=np.int32), 2).round(0)
    array([[ 30., 120.],
           [  1.,  nan]])
    """
    known = np.flatnonzero(np.isfinite(direction))
    angle, of = direction[known], member[known]
    bar = (angle / (180 / BINS)).astype(np.int64) % BINS
    counts = np.bincount(of * np.int64(BINS) + bar, minlength=count * BINS).reshape(count, BINS).astype(np.float64)
    weight = counts + (np.roll(counts, 1, axis=1) + np.roll(counts, -1, axis=1)) / 2
    found = np.full((count, 2), np.nan)
    row = np.arange(count)
    for place in range(2):
        peak = weight.argmax(axis=1)
        some = weight[row, peak] > 0
        found[some, place] = _mean_angles(angle, bar, of, peak)[some]
        for step in range(-APART + 1, APART):
            weight[row, (peak + step) % BINS] = 0
    return found


def _mean_angles(
    angle: NDArray[np.float64], bar: NDArray[np.int64], of: NDArray[np.int32], peak: NDArray[np.intp]
) -> NDArray[np.float64]:
    """Return the mean of the angles within a bar of each region's peak, on the half circle."""
    width = 180 / BINS
    near = np.abs((bar - peak[of] + BINS // 2) % BINS - BINS // 2) <= 1
    middle = (peak + 0.5) * width
    off = (angle[near] - middle[of[near]] + 90) % 180 - 90
    total = np.bincount(of[near], off, len(peak)) / np.maximum(np.bincount(of[near], minlength=len(peak)), 1)
    return (middle + total) % 180

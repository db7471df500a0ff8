"""Main directions: the frames of right angles along which the walls of a region or a touching group run."""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from msbdb.labels import sums
from msbdb.outline.arcs import Chains
from msbdb.outline.runs import WallRuns

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Frames = tuple[Floats, Ints, Ints]
"""Main directions of arcs: angles, their ranks in their region, and where each arc's begin."""

RIGHT = np.pi / 2
BINS = 180
"""Half degrees of a right angle."""

SPREAD = np.radians(4.0)
"""Directions nearer than this support each other."""

APART = np.radians(8.0)
"""Two frames of a region differ by more."""

MOST_FRAMES = 3

LEAST_SHARE = 0.2
"""A frame has at least this share of the length of the walls; round buildings have none."""

LEAST_CELLS = 20.0
"""A further frame has at least this length, cells."""

SHORT_CELLS = 6.0
"""Shorter walls have no direction worth the name."""


SAME = np.radians(2.0)
"""A region whose direction differs from its group's by less takes the group's."""

WEAK_CELLS = 30.0
"""Regions with less length along their own direction take the group's."""


def main_frames(angle: Floats, length: Floats, region: Ints, count: int) -> tuple[Floats, Floats]:
    """Return the main directions of each region, from the lengths and directions of its walls.

    Parameters
    ----------
    angle, length : (W,) ndarray of float64, radians and cells
        The walls.
    region : (W,) ndarray of int64
        0 to ``count`` - 1.
    count : int
        Number of regions.

    Returns
    -------
    frames : (count, MOST_FRAMES) ndarray of float64, radians
        From 0 to a right angle, the strongest first; NaN for none.
    support : (count, MOST_FRAMES) ndarray of float64, cells
        Length of the walls along each of them.

    Notes
    -----
    A direction is the peak of the histogram of directions modulo a right angle, weighed by length and smoothed by a
    triangle of `SPREAD`. It is then refined: the mean of the walls near it, weighed by the cube of their length,
    because the error of a direction falls with the power 3/2 of the length. The walls near it are then put aside, and
    the next peak is sought.

    Examples
    --------
    A rectangle whose long sides run at 10°:

    >>> angle = np.radians([10.0, 100.0, 190.0, 280.0])
    >>> frames, _ = main_frames(angle, np.array([40.0, 20.0, 40.0, 20.0]), np.zeros(4, dtype=np.int64), 1)
    >>> np.degrees(frames).round(3).tolist()
    [[10.0, nan, nan]]
    """
    frames = np.full((count, MOST_FRAMES), np.nan)
    support = np.zeros((count, MOST_FRAMES))
    kept = length >= SHORT_CELLS
    angle, length, region = np.mod(angle[kept], RIGHT), length[kept], region[kept]
    total = sums(region + 1, length, count)
    smoothing = _smoothing()
    for place in range(MOST_FRAMES):
        number = np.minimum((angle / RIGHT * BINS).astype(np.int64), BINS - 1)
        found = np.bincount(region * BINS + number, weights=length, minlength=count * BINS).reshape(count, BINS)
        peak = (np.argmax(np.round(found @ smoothing, 6), axis=1) + 0.5) * RIGHT / BINS
        off = apart(angle, peak[region])
        near = np.abs(off) <= SPREAD
        weight = np.where(near, length**3, 0.0)
        shift = sums(region + 1, weight * off, count) / np.maximum(sums(region + 1, weight, count), 1e-12)
        held = sums(region + 1, np.where(near, length, 0.0), count)
        least = np.maximum(LEAST_SHARE * total, 0.0 if place == 0 else LEAST_CELLS)
        good = (held > 0) & (held >= least)
        frames[good, place] = np.mod(peak + shift, RIGHT)[good]
        support[:, place] = np.where(good, held, 0.0)
        far = np.abs(apart(angle, np.mod(peak + shift, RIGHT)[region])) > APART
        angle, length, region = angle[far], length[far], region[far]
    return frames, support


def apart(angle: Floats, other: Floats) -> Floats:
    """Return the first direction less the second one, modulo a right angle, from minus to plus half of one."""
    return np.asarray(np.mod(angle - other + RIGHT / 2, RIGHT) - RIGHT / 2)


def _smoothing() -> Floats:
    """Return the triangle of `SPREAD` around each bin, as a matrix."""
    centre = np.arange(BINS) * RIGHT / BINS
    return np.asarray(np.maximum(1 - np.abs(apart(centre[:, None], centre[None, :])) / SPREAD, 0.0))


def arc_frames(chains: Chains, runs: WallRuns, count: int) -> tuple[Floats, Ints, Ints]:
    """Return the main directions of each arc: those of the regions on its sides; none along the border."""
    x, y, starts = chains.places
    low, high = starts[runs.arc] + runs.begin, starts[runs.arc] + runs.end
    length = np.hypot(x[high] - x[low], y[high] - y[low])
    length[chains.border[runs.arc]] = 0.0
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
    both[chains.border] = np.nan
    # Once each: a frame near an earlier one of the other side is that one.
    kept = ~np.isnan(both)
    for later in range(1, both.shape[1]):
        for earlier in range(later):
            kept[:, later] &= ~(kept[:, earlier] & (np.abs(apart(both[:, later], both[:, earlier])) < SAME))
    rank = np.broadcast_to(np.tile(np.arange(frames.shape[1]), 2), both.shape)
    return both[kept], rank[kept], np.concatenate(([0], np.cumsum(kept.sum(axis=1))))


def no_frames(count: int) -> tuple[Floats, Ints, Ints]:
    """Return no main directions for each of the arcs."""
    return np.empty(0), np.empty(0, dtype=np.int64), np.zeros(count + 1, dtype=np.int64)


def _groups(regions: Ints, count: int) -> Ints:
    """Return the touching group of each region."""
    shared = regions[regions[:, 1] >= 0]
    graph = coo_matrix((np.ones(len(shared)), (shared[:, 0], shared[:, 1])), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)

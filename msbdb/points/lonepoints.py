"""Points far from all others, in height or in position: birds, planes, faults of a file."""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from msbdb.surveyplan import PointFacts

LONE_GAP_Z_M, LONE_GAP_XY_M = 500.0, 50_000.0
"""A gap of this width without any point separates lone points from the main body, in height or in position."""

LONE_SHARE = 0.01
"""Points are lone if they are at most this share of all; one point always may be."""


def lone_points(
    x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], facts: PointFacts | None = None
) -> NDArray[np.bool_]:
    """Return (N,) bool, which points are lone by their height or by their position: birds, planes, faults of a file.

    Where facts are known, the heights of the whole survey decide.
    """
    lone = lone_values(z, LONE_GAP_Z_M) if facts is None else _beyond(z, facts)
    lone |= lone_values(x, LONE_GAP_XY_M) | lone_values(y, LONE_GAP_XY_M)
    return lone


def levels_of(z: NDArray[np.float64]) -> tuple[tuple[float, float], ...]:
    """Return the lowest and highest value of each group of elevations, between which are wide gaps, metres."""
    if not len(z):
        return ()
    low, high = float(z.min()), float(z.max())
    if high - low <= LONE_GAP_Z_M:
        return ((low, high),)
    ordered = np.sort(z)
    starts = np.flatnonzero(np.diff(ordered) > LONE_GAP_Z_M) + 1
    edges = [0, *starts.tolist(), len(z)]
    return tuple((float(ordered[start]), float(ordered[end - 1])) for start, end in pairwise(edges))


def _beyond(z: NDArray[np.float64], facts: PointFacts) -> NDArray[np.bool_]:
    """Return which elevations lie a wide gap away from all groups of the survey."""
    near = np.zeros(len(z), dtype=np.bool_)
    for low, high in facts.levels_m:
        near |= (z >= low - LONE_GAP_Z_M) & (z <= high + LONE_GAP_Z_M)
    return ~near


def lone_values(values: NDArray[np.float64], gap: float) -> NDArray[np.bool_]:
    """Return which values are lone: few, and separated from the main body by a wide gap.

    Parameters
    ----------
    values : (N,) ndarray of float64
        Finite.
    gap : float
        Width without any value that separates two groups, in the values' unit.

    Returns
    -------
    (N,) ndarray of bool
        True in every group of at most ``LONE_SHARE`` of the values (or of one value) besides the largest group.
        It depends on the values alone, not on their order.

    Examples
    --------
    >>> lone_values(np.array([12.0, 14.0, 2900.0, 13.0]), 500.0)
    array([False, False,  True, False])
    """
    lone = np.zeros(len(values), dtype=np.bool_)
    if len(values) < 3 or values.max() - values.min() <= gap:
        return lone
    ordered = np.sort(values)
    starts = np.flatnonzero(np.diff(ordered) > gap) + 1
    edges = [0, *starts.tolist(), len(values)]
    largest = max(end - start for start, end in pairwise(edges))
    few = max(1, int(LONE_SHARE * len(values)))
    for start, end in pairwise(edges):
        if end - start <= few and end - start < largest:
            lone |= (values >= ordered[start]) & (values <= ordered[end - 1])
    return lone

"""Height scales h_j: local minima of the histogram of the heights above ground (Cao & Wu, sections 2.2 and 3.2)."""

import numpy as np
from numpy.typing import NDArray

from msbdb.params import Area3dParams

BINS = 100
"""Bars of the histogram (C14)."""

BESIDE = 3
"""Bars to the left and to the right that a local minimum is compared with (C14)."""


def height_scales(heights: NDArray[np.float64], params: Area3dParams, *, mask_m: float) -> tuple[float, ...]:
    """Choose the heights at which regions are sought (C14).

    Parameters
    ----------
    heights : (N,) ndarray of float64, metres
        Heights above ground of all points, finite.
    params : Area3dParams
        ``heights_m`` decides where it is set; otherwise ``most_heights``, ``mask_first`` and the histogram's tail.
    mask_m : float
        What is lower is no building: no scale of the histogram lies below.

    Returns
    -------
    tuple of float
        Ascending, at least one, metres. The single-scale mode is the first of them alone.

    Notes
    -----
    A bar of the histogram is a local minimum when none of the three bars on either side is lower; bars without three
    others on both sides are none. Adjoining local minima are equal bars, a plateau, and count once, by their middle,
    unless no bar beside them is higher either. Of more than are wanted the lowest stay, as in the paper, whose first
    is SS's. Where there is no local minimum above the mask, the mask is the only scale.
    """
    if params.heights_m:
        return tuple(sorted(set(params.heights_m)))[: params.most_heights]
    first = [mask_m] if params.mask_first else []
    found = [h for h in histogram_minima(heights, params.histogram_tail_percent) if h > mask_m]
    return tuple([*first, *found][: params.most_heights]) or (mask_m,)


def histogram_minima(heights: NDArray[np.float64], tail_percent: float = 0.0) -> list[float]:
    """Return the centres of the histogram's local minima, ascending, metres.

    Parameters
    ----------
    heights : (N,) ndarray of float64, metres
        Not modified.
    tail_percent : float
        Share of the heights left out at either end, per cent.
    """
    low, high = np.percentile(heights, (tail_percent, 100 - tail_percent), method="closest_observation")
    if not high > low:
        return []
    counts, bounds = np.histogram(heights, BINS, (low, high))
    windows = np.lib.stride_tricks.sliding_window_view(counts, 2 * BESIDE + 1)
    middle = windows[:, BESIDE]
    lowest = np.pad(middle == windows.min(axis=1), BESIDE + 1)
    below = np.pad(middle < windows.max(axis=1), BESIDE + 1)
    begins = np.flatnonzero(lowest[1:] & ~lowest[:-1])
    ends = np.flatnonzero(lowest[:-1] & ~lowest[1:])
    return [
        float((bounds[begin] + bounds[end]) / 2)
        for begin, end in zip(begins, ends, strict=True)
        if below[begin + 1 : end + 1].any()
    ]

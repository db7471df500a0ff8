"""The progressive morphological filter, our default ground filter (Zhang et al. 2003)."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter

from msbdb.grid import Grid
from msbdb.params import GroundParams


def progressive_ground(surface: Grid, params: GroundParams) -> NDArray[np.bool_]:
    """Tell ground cells by openings with growing windows.

    A cell is off-ground when one of the openings lowers it by more than dh_k = dh_0 + s·(r_k − r_{k−1}), where r_k
    is the half-width of the k-th square window and s the slope of the terrain; each opening acts on the one before.
    The increment, not the whole window, bounds the height of what may stay: so low roofs among higher ones, which a
    threshold that grows with the window keeps as ground, are told.

    Parameters
    ----------
    surface : Grid
        Lowest heights, gap-free, metres.
    params : GroundParams
        Window, slope and threshold.

    Returns
    -------
    ndarray of bool, (H, W)
        Ground cells.

    Notes
    -----
    Border: the outermost cell is repeated. Cost: a number of passes that grows with the logarithm of the window.

    References
    ----------
    Zhang, K., et al. (2003). A progressive morphological filter for removing nonground measurements from airborne
    LIDAR data. IEEE TGRS 41(4), 872-882. doi:10.1109/TGRS.2003.810682
    """
    cell = surface.spec.cell_m
    opened = np.asarray(surface.values, dtype=np.float32)
    ground = np.ones(opened.shape, dtype=np.bool_)
    before = 0
    for radius in window_radii(params.window_m / cell, params.window_growth):
        size = 2 * radius + 1
        lower = maximum_filter(minimum_filter(opened, size, mode="nearest"), size, mode="nearest")
        threshold = params.height_m + params.slope * (radius - before) * cell
        ground &= opened - lower <= threshold
        opened, before = lower, radius
    return ground


def window_radii(largest: float, growth: float) -> list[int]:
    """Half-widths of the windows in cells: 1, then each larger by the factor and by at least one cell.

    Examples
    --------
    >>> window_radii(20, 1.4)
    [1, 2, 3, 4, 6, 8, 11, 15]
    """
    radii = []
    radius = 1
    while radius <= max(largest, 1):
        radii.append(radius)
        radius = max(radius + 1, round(radius * growth))
    return radii

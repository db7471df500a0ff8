"""Differential morphological profiles: at which window a surface changes most (Mongus et al. 2013, §2, §3.2)."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msbdb.errors import ParameterError
from msbdb.morphology.profiles import MAX_ZONES, Theta
from msbdb.morphology.windows import Mask, opening, require_surface


def window_profile(
    values: NDArray[Any], windows_px: Sequence[int], valid: Mask = None, *, valleys: bool = False
) -> Theta:
    """Return θ(g), or θ(-g), of the differential morphological profile by square windows (Eq. 1, 4, 5; M2, M5, M9).

    Parameters
    ----------
    values : (H, W) ndarray
        Integers or floats; finite in valid cells. Not modified.
    windows_px : sequence of int
        Sides of the windows w_{S_1} to w_{S_I}, cells; odd and increasing. w_{S_0} is a single cell, the surface
        itself, and is not listed.
    valid : (H, W) ndarray of bool, optional
        The cells that count; all by default.
    valleys : bool
        Profile -g instead of g: how deep each cell lies within closings.

    Raises
    ------
    InputError
        When the array is no image, the mask is not of its shape, or a valid cell is infinite or NaN.
    ParameterError
        When the windows are not odd, start below 3 or do not increase.

    Notes
    -----
    Border and nodata: windows count by their cells that are within the array and valid. Squares are made of smaller
    squares, so no response is negative. Halo: the largest window less one cell. Complexity: linear in the cells for
    each window, whatever its size.

    Examples
    --------
    >>> response, zone = window_profile(np.array([[0, 9, 0, 4, 4, 0, 0]]), [3, 5])
    >>> response, zone
    (array([[0., 9., 0., 4., 4., 0., 0.]]), array([[0, 1, 0, 1, 1, 0, 0]], dtype=int16))
    """
    _require_windows(windows_px)
    surface, valid = require_surface(values, valid)
    if valleys:
        surface = -surface
    response = np.zeros(surface.shape)
    zone = np.zeros(surface.shape, dtype=np.int16)
    before = surface
    for i, window in enumerate(windows_px, start=1):
        opened = opening(surface, window, valid)
        difference = _difference(before, opened, valid)
        better = (difference >= response) & (difference > 0)
        response[better] = difference[better]
        zone[better] = i
        before = opened
    return Theta(response, zone)


def _difference(upper: NDArray[Any], lower: NDArray[Any], valid: Mask) -> NDArray[np.float64]:
    """Return the difference in 64 bits in valid cells, 0 in others."""
    difference = np.zeros(upper.shape, dtype=np.float64)
    np.subtract(upper, lower, out=difference, where=True if valid is None else valid, dtype=np.float64)
    return difference


def _require_windows(windows_px: Sequence[int]) -> None:
    """Refuse windows that are no granulometry."""
    sizes = list(windows_px)
    if not sizes or len(sizes) > MAX_ZONES or sizes[0] < 3 or any(np.diff(sizes) <= 0):
        msg = f"The windows of a profile must increase from 3 cells; got {windows_px!r}."
        raise ParameterError(msg)

"""Erosion, dilation and opening by square windows, of the valid cells of a surface.

Each window counts by those of its cells that are within the array and valid; nothing is assumed about the others.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from msbdb.errors import InputError, ParameterError
from msbdb.morphology.runs import require_valid

Mask = NDArray[np.bool_] | None


def require_surface(values: NDArray[Any], valid: Mask) -> tuple[NDArray[np.floating], Mask]:
    """Return an image as floats, without rounding up to 32 bits, and its mask, none where all cells are valid.

    Raises
    ------
    InputError
        When the array is no image, the mask is not of its shape, or a valid cell is infinite.
    """
    valid = require_valid(values, valid)
    surface = values.astype(np.result_type(values.dtype, np.float32), copy=False)
    infinite = np.isinf(surface) if valid is None else np.isinf(surface) & valid
    if infinite.any():
        msg = f"The surface is infinite in {infinite.sum()} valid cells, which have no differences; mask them."
        raise InputError(msg)
    return surface, valid


def erosion(surface: NDArray[np.floating], window_px: int, valid: Mask) -> NDArray[np.floating]:
    """Return the lowest valid value within a square window around each cell; infinity where it has none."""
    _require_window(window_px)
    lowest: NDArray[np.floating] = ndimage.minimum_filter(
        _masked(surface, valid, np.inf), size=window_px, mode="constant", cval=np.inf
    )
    return lowest


def dilation(surface: NDArray[np.floating], window_px: int, valid: Mask) -> NDArray[np.floating]:
    """Return the highest valid value within a square window around each cell; minus infinity where it has none."""
    _require_window(window_px)
    highest: NDArray[np.floating] = ndimage.maximum_filter(
        _masked(surface, valid, -np.inf), size=window_px, mode="constant", cval=-np.inf
    )
    return highest


def opening(surface: NDArray[np.floating], window_px: int, valid: Mask) -> NDArray[np.floating]:
    """Return for each valid cell the highest of the minima of all windows around it; others have no meaning.

    Windows may stand on any cell of the array, valid or not, so that each is made of the smaller ones within it. So
    a larger opening absorbs the smaller, beside gaps and edges too. Time does not depend on the window's size.
    """
    return dilation(erosion(surface, window_px, valid), window_px, None)


def _masked(surface: NDArray[np.floating], valid: Mask, never: float) -> NDArray[np.floating]:
    """Return the surface with a value in invalid cells that never is the extreme one."""
    return surface if valid is None else np.where(valid, surface, surface.dtype.type(never))


def _require_window(window_px: int) -> None:
    """Refuse a window without a cell in its middle."""
    whole = isinstance(window_px, int | np.integer) and not isinstance(window_px, bool)
    if not whole or window_px < 1 or window_px % 2 == 0:
        msg = f"A window must be an odd number of cells from 1; got {window_px!r}."
        raise ParameterError(msg)

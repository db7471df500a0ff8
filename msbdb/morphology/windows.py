"""Filters of a surface by square windows: openings, and the gradients and profiles made of them (Mongus et al. 2013).

A window takes those of its cells that are within the array and valid; nothing is assumed about the others. Gradients
(M13) and the responses of a profile (M2) are never negative. So the sum of gradients over a component never falls as
the component grows (M4).
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msbdb.errors import InputError, ParameterError
from msbdb.morphology.area import require_valid
from msbdb.morphology.attributeprofiles import MAX_ZONES

Mask = NDArray[np.bool_] | None

WINDOW_PX = 3
"""Side of the window of a gradient, cells. The paper does not state one; this is the smallest."""

BLOCK = 64
"""Rows that are filtered at a time."""


class Theta(NamedTuple):
    """What characterises each cell in a profile, θ(g) (Eq. 4 and 5; M5).

    Parameters
    ----------
    response : (H, W) ndarray of float64
        r, the highest response of any zone, in the unit of the surface; 0 in invalid cells.
    zone : (H, W) ndarray of int16
        q, the largest zone i, from 1, with that response; 0 where no zone responds. As printed, Eq. 5 gives the last
        zone there, as if that zone responded.
    """

    response: NDArray[np.float64]
    zone: NDArray[np.int16]


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
    """Return ε(g), the lowest valid value within a square window around each cell; infinity where it has none.

    Examples
    --------
    >>> erosion(np.array([[5.0, 5, 5, 1, 5]]), 3, None)
    array([[5., 5., 1., 1., 1.]])
    """
    _require_window(window_px)
    return _extremes(np.minimum, _masked(surface, valid, np.inf), window_px, np.inf)


def dilation(surface: NDArray[np.floating], window_px: int, valid: Mask) -> NDArray[np.floating]:
    """Return δ(g), the highest valid value within a square window around each cell; minus infinity where it has none.

    Examples
    --------
    >>> dilation(np.array([[0.0, 0, 0, 4, 0]]), 3, None)
    array([[0., 0., 4., 4., 4.]])
    """
    _require_window(window_px)
    return _extremes(np.maximum, _masked(surface, valid, -np.inf), window_px, -np.inf)


def opening(surface: NDArray[np.floating], window_px: int, valid: Mask) -> NDArray[np.floating]:
    """Return γ(g) = δ(ε(g)): for each valid cell the highest of the minima of all windows that hold it.

    Invalid cells get values without meaning. A window may be centred on any cell of the array, valid or not, so each
    window is a union of smaller ones. Therefore a larger opening absorbs a smaller one, next to gaps and edges too.
    Time grows with the logarithm of the window's size.

    Examples
    --------
    >>> opening(np.array([[0.0, 9, 0, 4, 4, 4, 0]]), 3, None)
    array([[0., 0., 0., 4., 4., 4., 0.]])
    """
    return dilation(erosion(surface, window_px, valid), window_px, None)


def _extremes(extreme: np.ufunc, surface: NDArray[np.floating], window_px: int, never: float) -> NDArray[np.floating]:
    """Return the extremes of square windows, in which what lies beyond the array has a value that is never extreme.

    Some rows at a time, which the processor's cache holds (decision 0008).
    """
    half = window_px // 2
    rows, cols = surface.shape
    found = np.empty_like(surface)
    for row in range(0, rows, BLOCK):
        count = min(BLOCK, rows - row)
        first, stop = max(row - half, 0), min(row + count + half, rows)
        framed = np.full((count + 2 * half, cols + 2 * half), never, dtype=surface.dtype)
        framed[first - row + half : stop - row + half, half : half + cols] = surface[first:stop]
        across = _along_columns(extreme, framed.T, window_px).T
        found[row : row + count] = _along_columns(extreme, across, window_px)
    return found


def _along_columns(extreme: np.ufunc, framed: NDArray[np.floating], window_px: int) -> NDArray[np.floating]:
    """Return the extremes of windows along the columns: those of 2, 4, 8 ... cells are made of two of half the length.

    The two longest that fit cover the window.
    """
    length = 1
    while 2 * length <= window_px:
        framed, length = extreme(framed[:-length], framed[length:]), 2 * length
    rest = window_px - length
    covered: NDArray[np.floating] = extreme(framed[: len(framed) - rest], framed[rest:])
    return covered


def _masked(surface: NDArray[np.floating], valid: Mask, never: float) -> NDArray[np.floating]:
    """Return the surface with a value in invalid cells that is never the extreme of a window."""
    return surface if valid is None else np.where(valid, surface, surface.dtype.type(never))


def _require_window(window_px: int) -> None:
    """Refuse a window without a cell in its middle."""
    whole = isinstance(window_px, int | np.integer) and not isinstance(window_px, bool)
    if not whole or window_px < 1 or window_px % 2 == 0:
        msg = f"A window must be an odd number of cells from 1; got {window_px!r}."
        raise ParameterError(msg)


def external_gradient(values: NDArray[Any], valid: Mask = None, *, window_px: int = WINDOW_PX) -> NDArray[np.floating]:
    """Return by how much the highest cell around exceeds each cell: the lower sides of edges.

    Parameters
    ----------
    values : (H, W) ndarray
        Integers or floats; finite in valid cells. Not modified.
    valid : (H, W) ndarray of bool, optional
        The cells that count; all by default.
    window_px : int
        Side of the square window, cells; odd.

    Returns
    -------
    (H, W) ndarray
        In the unit of the values, 0 or more; 0 in invalid cells. Of float32 for floats and integers that it holds
        without rounding, else of float64.

    Raises
    ------
    InputError
        When the array is no image, the mask is not of its shape, or a valid cell is infinite or NaN.
    ParameterError
        When the window is not odd.

    Notes
    -----
    ϱ_ex(g) = δ(g) - g. Border and nodata: the window counts by its cells that are within the array and valid; so
    neither an edge nor a gap is a step. Halo: half of the window. Complexity: linear in the cells for any window.

    Examples
    --------
    >>> external_gradient(np.array([[0, 0, 4, 4]]))
    array([[0., 4., 0., 0.]])
    """
    surface, valid = require_surface(values, valid)
    return _difference(dilation(surface, window_px, valid), surface, valid)


def internal_gradient(values: NDArray[Any], valid: Mask = None, *, window_px: int = WINDOW_PX) -> NDArray[np.floating]:
    """Return by how much each cell exceeds the lowest cell around: the upper sides of edges.

    Parameters, result, errors and rules are those of `external_gradient`: ϱ_in(g) = g - ε(g).

    Examples
    --------
    >>> internal_gradient(np.array([[0, 0, 4, 4]]))
    array([[0., 0., 4., 0.]])
    """
    surface, valid = require_surface(values, valid)
    return _difference(surface, erosion(surface, window_px, valid), valid)


def second_order_gradient(
    values: NDArray[Any], valid: Mask = None, *, window_px: int = WINDOW_PX
) -> NDArray[np.floating]:
    """Return the internal gradient of the external gradient: how much the slope changes, on the lower sides of edges.

    Parameters, result, errors and rules are those of `external_gradient`: ϱ_in(ϱ_ex(g)) (Eq. 11; M13). The attribute
    Λ of a component is the sum of this field. An even slope has none but at its ends: its external gradient is the
    same everywhere.

    Examples
    --------
    >>> second_order_gradient(np.array([[0, 0, 4, 4]]))
    array([[0., 4., 0., 0.]])
    """
    return internal_gradient(external_gradient(values, valid, window_px=window_px), valid, window_px=window_px)


def _difference(upper: NDArray[np.floating], lower: NDArray[np.floating], valid: Mask) -> NDArray[np.floating]:
    """Return the difference in valid cells, 0 in others."""
    difference = np.zeros_like(upper)
    np.subtract(upper, lower, out=difference, where=True if valid is None else valid)
    return difference


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
        difference = _opening_difference(before, opened, valid)
        better = (difference >= response) & (difference > 0)
        response[better] = difference[better]
        zone[better] = i
        before = opened
    return Theta(response, zone)


def _opening_difference(upper: NDArray[Any], lower: NDArray[Any], valid: Mask) -> NDArray[np.float64]:
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

"""Morphological gradients of a surface: how much it changes next to each cell (Mongus et al. 2013; M13).

All are the difference of two of the surface, its highest and its lowest within the window, so none is negative. That
is why the sum of one over a component never falls as the component grows (M4).
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msbdb.morphology.windows import Mask, dilation, erosion, require_surface

WINDOW_PX = 3
"""Side of the window, cells. The paper does not state one; this is the smallest."""


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

    Parameters, result, errors and rules are those of `external_gradient`: ϱ_in(ϱ_ex(g)) (Eq. 11; M13), the field of
    which Λ is the sum. An even slope has none, as its external gradient is the same all over, but at its ends.

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

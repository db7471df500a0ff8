"""Binarisation: flat regions by the attribute profile of second-order gradients (Mongus et al. 2013, section 3.3)."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msbdb.detect.flatregions.initialisation import window_px
from msbdb.errors import NodataError
from msbdb.grid import Grid
from msbdb.morphology import areas, build_profile, build_tree, second_order_gradient, sums, zone_thresholds
from msbdb.params import FlatRegionParams

LEAST_WINDOW_PX = 3
"""Smallest window that has neighbours."""

RATIO_WINDOW_M = 1.05
"""Windows of the gradients up to which R holds as it is: three cells of 0.35 m."""


@dataclass(frozen=True, slots=True, eq=False)
class Binarised:
    """The set G of building candidates.

    Parameters
    ----------
    flat : (H, W) ndarray of bool
        G, the union of all zones' flat components (Eq. 14).
    zones : (H, W) ndarray of int32
        i of the largest flat component that holds a cell; 0 outside of G.
    risen : (H, W) ndarray of bool
        The cells that were to be judged: all that are above the lowest level of their connected area.
    gradient : (H, W) ndarray
        Second-order gradient as it is summed, metres.
    thresholds : (I + 1,) ndarray of float64
        λ_0 = 0 to λ_I, m2.
    """

    flat: NDArray[np.bool_]
    zones: NDArray[np.int32]
    risen: NDArray[np.bool_]
    gradient: NDArray[np.floating]
    thresholds: NDArray[np.float64]


def binarise(g: Grid, initial: Grid, params: FlatRegionParams) -> Binarised:
    """Find the flat regions of a surface (Eq. 11 to 14; M13 to M18).

    Parameters
    ----------
    g : Grid
        The surface without outliers, metres.
    initial : Grid
        The surface before denoising, for the gradients where ``params.gradients`` is 'initial'.
    params : FlatRegionParams
        λ, R and the window of the gradients.

    Raises
    ------
    ParameterError
        When λ_max is below λ_min, or λ_Δ is 0.
    NodataError
        When no cell is valid.

    Notes
    -----
    Λ(C) is the sum of second-order gradients over C times the cell's area (A13), or over its cells with ``lambda_unit``
    'px'. A component C of the support {δ_i > 0} of zone i stays when its area is at least R λ_i (A12). Then its mean
    gradient is below about 1/R, by the zone's upper threshold. All zones are read from one component tree of
    8-connected cells; its nodes that leave their zone are these components. Ours: components larger than
    ``largest_m2`` are terrain.

    Heights count in steps of a centimetre, finer than any scanner, so that equal roofs are plateaus. On heights above
    ground, what is invalid or beyond the border counts as ground, so that a roof beside it rises from something; on
    the raw surface the lowest level of a connected area of valid cells is never a region.

    Examples
    --------
    A flat roof of 8 by 8 cells stays. A crown of as many cells, 3 m high with peaks of 6 m, does not:

    >>> from affine import Affine
    >>> from pyproj import CRS
    >>> from msbdb.grid import GridSpec
    >>> from msbdb.params import FlatRegionParams
    >>> heights = np.zeros((12, 24), dtype=np.float32)
    >>> heights[2:10, 2:10] = 5
    >>> heights[2:10, 14:22] = 3 + 3 * (np.indices((8, 8)) % 2).prod(axis=0)
    >>> spec = GridSpec((12, 24), Affine(1, 0, 0, 0, -1, 12), CRS.from_epsg(25832))
    >>> surface = Grid(heights, np.ones((12, 24), dtype=bool), spec)
    >>> binarise(surface, surface, FlatRegionParams()).flat[5].astype(int)
    array([0, 0, 1, 1, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0,
           0, 0])
    """
    thresholds = zone_thresholds(params.lambda_min_m2, params.lambda_max_m2, params.lambda_step_m2)
    if params.lambda_unit == "px":
        # A λ of cells is as many cell areas of m2: Λ and A in cells, or both in m2, compare alike.
        thresholds = thresholds * g.spec.cell_area_m2
    if not g.valid.any():
        msg = "The surface has no valid cell in which flat regions could lie. Check its extent and nodata value."
        raise NodataError(msg)
    gradient = gradient_of(initial if params.gradients == "initial" else g, params)
    margin = 1 if params.on == "ndsm" else 0
    tree = build_tree(*_framed(g, margin))
    cell_area = g.spec.cell_area_m2
    profile = build_profile(tree, sums(tree, np.pad(gradient, margin)) * cell_area, thresholds)
    area = areas(tree) * cell_area
    inner = np.s_[margin : margin + g.spec.shape[0], margin : margin + g.spec.shape[1]]

    # Areas are whole cells: a region of just R λ_i must not miss it by rounding.
    kept = profile.filter_supports(area * (1 + 1e-12), ratio_at(g.spec.cell_m, params) * thresholds)
    if params.largest_m2 > 0:
        kept &= area <= params.largest_m2
    node = profile.union(kept)[inner]
    zones = np.where(node >= 0, profile.zone[node], 0).astype(np.int32)
    return Binarised(node >= 0, zones, tree.paint(~tree.is_root)[inner], gradient, thresholds)


def _framed(g: Grid, margin: int) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return heights in whole centimetres, and which cells count; in a frame of ground where the ground is 0."""
    heights = np.round(np.asarray(g.values, dtype=np.float64), 2).astype(np.float32)
    valid = np.asarray(g.valid)
    if not margin:
        return heights, valid
    heights = np.pad(np.where(valid, heights, 0), margin)
    return heights, np.ones(heights.shape, dtype=np.bool_)


def ratio_at(cell_m: float, params: FlatRegionParams) -> float:
    """Return R at a cell size: less where the window of the gradients is wider than ``gradient_window_m`` (ours).

    With few points the least window, of three cells, is several times ``gradient_window_m``. The gradients of every
    edge and ridge then cover a wider band, and the given R would leave no roof. So R falls with the square root of
    the width; in proportion to it, crowns would become roofs, too. With ``gradient_window_m`` at 0, as in the paper, R
    is the same everywhere.

    Examples
    --------
    At cells of 2 m the window is 6 m wide, and R = 1.75 falls to 1.75 √(1.05 / 6):

    >>> from msbdb.params import FlatRegionParams
    >>> ratio_at(0.3, FlatRegionParams()), round(ratio_at(2.0, FlatRegionParams()), 2)
    (1.75, 0.73)
    """
    if not params.gradient_window_m:
        return params.ratio
    window_m = _gradient_window(cell_m, params) * cell_m
    return params.ratio * min(1.0, math.sqrt(max(RATIO_WINDOW_M, params.gradient_window_m) / window_m))


def _gradient_window(cell_m: float, params: FlatRegionParams) -> int:
    """Return the side of the window of the gradients, cells."""
    return max(LEAST_WINDOW_PX, window_px(params.gradient_window_m, cell_m))


def gradient_of(surface: Grid, params: FlatRegionParams) -> NDArray[np.floating]:
    """Return the second-order gradient ϱ_in(ϱ_ex(g)) of a surface, metres; 0 in invalid cells (M13).

    Ours: it is at most ``gradient_cap_m``. So the foot of a high wall on a roof counts as much as many cells of a
    crown, but not as much as the whole roof. Λ stays increasing, as no gradient becomes negative.
    """
    window = _gradient_window(surface.spec.cell_m, params)
    gradient = second_order_gradient(np.asarray(surface.values), np.asarray(surface.valid), window_px=window)
    if params.gradient_cap_m > 0:
        np.minimum(gradient, params.gradient_cap_m, out=gradient)
    return gradient

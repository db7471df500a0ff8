"""Recognition of buildings: the flat regions' outlines decide (Mongus et al. 2013, §3.4)."""

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from skimage.measure import regionprops

from msbdb.extract.flatregions.windowsize import window_px
from msbdb.grid import Grid
from msbdb.labels import Labels
from msbdb.morphology.windows import opening

SIDES = ((-1, 0), (0, -1), (0, 1), (1, 0))
CORNERS = ((-1, -1), (-1, 1), (1, -1), (1, 1))


def clean(flat: NDArray[np.bool_], size_m: float, cell_m: float) -> NDArray[np.bool_]:
    """Remove thin extensions and fill small holes: Φ_w(Γ_w(G)) with a square w (M19).

    Parameters
    ----------
    flat : (H, W) ndarray of bool
        G. Not modified.
    size_m : float
        Side of the window; 3 m in the paper (A14).
    cell_m : float
        Side of a cell.

    Notes
    -----
    Border: what lies outside of the array does not count, so that a roof cut by the border is no thinner for it.
    """
    window = window_px(size_m, cell_m)
    opened = opening(flat.astype(np.float32), window, None)
    return np.asarray(opening(1 - opened, window, None) < 0.5)


def grow(labels: Labels, heights: Grid, *, steps: int, step_m: float, least_m: float) -> Labels:
    """Give regions back the cells of their edges, ours.

    Parameters
    ----------
    labels : (H, W) ndarray of int32
        Regions; 0 for none. Not modified.
    heights : Grid
        Heights above ground of the first echoes, metres.
    steps : int
        How often a ring of cells may be added.
    step_m : float
        Largest difference in height to the cell of the region beside it.
    least_m : float
        Lower cells belong to no region.

    Notes
    -----
    The lowest point of a cell on a roof's edge often lies on the wall or the ground; so the surface that regions are
    sought on has smaller roofs than the first echoes show. Regions grow in rings, never into each other. Of several
    regions beside a cell it goes to one that shares a side, in row-major order of the neighbours.
    """
    high = np.asarray(heights.values)
    free = np.asarray(heights.valid) & (high >= least_m)
    grown = labels.copy()
    for _ in range(steps):
        before = np.pad(grown, 1)
        beside = np.pad(high, 1)
        for down, right in (*SIDES, *CORNERS):
            window = np.s_[1 + down : before.shape[0] - 1 + down, 1 + right : before.shape[1] - 1 + right]
            joins = free & (grown == 0) & (before[window] > 0) & (np.abs(high - beside[window]) <= step_m)
            grown[joins] = before[window][joins]
    return grown


def measure_shapes(labels: Labels, cell_m: float) -> pd.DataFrame:
    """Return area, perimeter and compactness of labelled regions (Eq. 15; M20).

    Parameters
    ----------
    labels : (H, W) ndarray of int32
        From 1 without a gap; 0 for none.
    cell_m : float
        Side of a cell.

    Returns
    -------
    DataFrame
        ``area_m2``, ``perimeter_m`` and ``compactness``, one row a region in the labels' order.

    Notes
    -----
    Ψ' = P²/(4πA) (A9): 1 for a disc, 1.3 for a square, (a + b)²/(πab) for a rectangle of a by b. P is the Crofton
    estimate over four directions, of outer outlines and holes: counting cells' edges is up to 41 % too long for
    oblique walls, which doubles Ψ'; this is within 5 % at any angle.
    """
    found = regionprops(labels)  # type: ignore[no-untyped-call]  # scikit-image has no types here
    area = np.array([region.area for region in found], dtype=np.float64) * cell_m**2
    perimeter = np.array([region.perimeter_crofton for region in found], dtype=np.float64) * cell_m
    table = pd.DataFrame({"area_m2": area, "perimeter_m": perimeter})
    table["compactness"] = perimeter**2 / (4 * np.pi * area)
    return table

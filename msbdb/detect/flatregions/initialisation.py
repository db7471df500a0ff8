"""The surface without gaps and outliers, in which flat regions are detected (Mongus et al. 2013, sections 3.1 and 3.2).

Initialisation takes the lowest point of each cell and fills the other cells by inverse distance weighting. Levelling
removes sharp peaks and steep valleys, found by differential morphological profiles.
"""

import logging
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from msbdb.errors import NodataError
from msbdb.grid import Grid, GridSpec
from msbdb.morphology import window_profile
from msbdb.params import FlatRegionParams
from msbdb.points.cloud import PointCloud
from msbdb.surface.gaps import nearest_cells
from msbdb.surface.gridding import lowest_heights
from msbdb.threads import kernel

logger = logging.getLogger(__name__)

NEAREST = 3
"""No fewer than the three nearest points (M8)."""

POWER = 2
"""r, the power of the distance (M8)."""

MOST = 24
"""Cells looked at for those as near as the third; a circle of cells' centres up to 12 cells wide holds fewer."""

REACH = 30
"""Distance in cells within which the nearest known cells are searched for cell by cell."""

BATCH = 1 << 17
"""Cells filled at once, which bounds the memory."""


@dataclass(frozen=True, slots=True, eq=False)
class Denoised:
    """A surface without outliers.

    Parameters
    ----------
    grid : Grid
        The surface with outliers interpolated, float32 metres.
    peaks, valleys : (H, W) ndarray of bool
        The outliers T_o: sharp peaks and steep valleys.
    """

    grid: Grid
    peaks: NDArray[np.bool_]
    valleys: NDArray[np.bool_]


def window_px(size_m: float, cell_m: float) -> int:
    """Return the side of the window w_S: S in whole cells, and one more where that is even; at least one cell (M11).

    Examples
    --------
    >>> window_px(3.0, 0.3), window_px(3.0, 0.5), window_px(0.2, 0.5)
    (11, 7, 1)
    """
    cells = int(size_m / cell_m + 0.5)
    return max(1, cells + (cells + 1) % 2)


def initialise(points: PointCloud, spec: GridSpec, *, max_gap_m: float = 0.0) -> Grid:
    """Take the lowest point of each cell, and fill the other cells from those around (M7, M8).

    Parameters
    ----------
    points : PointCloud
        All echoes; outliers beyond reason are gone.
    spec : GridSpec
        The survey's lattice. Its cell is the mean spacing 1/sqrt(density) on a ladder of round values, our reading of
        R_g (A10); so all detectors share one lattice.
    max_gap_m : float
        Cells farther than this from one with a point, and than two cells, stay invalid. 0 fills all, as the paper
        does. Then water is filled, too, as a flat slope from quay to quay.

    Returns
    -------
    Grid
        float32 metres.

    Raises
    ------
    NodataError
        When no point lies on the lattice.
    """
    lowest, known = lowest_heights(points, spec)
    if not known.any():
        msg = f"None of the {len(points)} points lies on the lattice {spec.bounds}; check the CRS and the extent."
        raise NodataError(msg)
    wanted = ~known
    if max_gap_m > 0 and wanted.any():
        cells = np.flatnonzero(wanted)
        wanted.ravel()[cells] = nearest_cells(known, cells, max(max_gap_m / spec.cell_m, 2.0)) >= 0
    values = fill_by_idw(lowest, known, wanted)
    return Grid(values.astype(np.float32), known | wanted, spec)


def denoise(g: Grid, params: FlatRegionParams) -> Denoised:
    """Find peaks and valleys that are too small for buildings, and interpolate them (Eq. 7 to 10; M9 to M12).

    Parameters
    ----------
    g : Grid
        The surface, metres.
    params : FlatRegionParams
        ``s_max_m``, ``valley_factor`` and ``peak_factor``; with a factor of 0 that kind stays.

    Notes
    -----
    Windows: squares of 3, 5, ... cells up to S_I. Border and nodata: windows count by their valid cells in the array.
    Outliers are refilled by Eq. 6 from all other valid cells. Where all are outliers, none is removed.
    """
    peaks, valleys = find_outliers(g, params)
    outliers = peaks | valleys
    known = g.valid & ~outliers
    if not outliers.any() or not known.any():
        none = np.zeros(g.spec.shape, dtype=np.bool_)
        return Denoised(g, none, none.copy())
    values = fill_by_idw(np.asarray(g.values, dtype=np.float64), known, outliers)
    logger.info(
        "The denoising removed peaks of %d cells and valleys of %d cells",
        np.count_nonzero(peaks),
        np.count_nonzero(valleys),
    )
    return Denoised(g.with_values(values.astype(np.float32)), peaks, valleys)


def find_outliers(g: Grid, params: FlatRegionParams) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return the cells of sharp peaks and of steep valleys (M9 to M12).

    Notes
    -----
    A cell is a peak where r(g) > r(-g), a valley where r(g) < r(-g), neither where they are equal (Eq. 7). Its response
    r̄ is the larger of the two (Eq. 8, read as a maximum: A11), and it is an outlier when r̄ ≥ t, with t = 2 R_g in
    valleys and 4 R_g on peaks (Eq. 9, 10). The branch that was taken decides which threshold counts, not a comparison
    of scales (M10). The largest window has three cells at least (ours), as smaller ones find nothing; with ``s_max_m``
    of 0 there is none.
    """
    cell_m = g.spec.cell_m
    if params.s_max_m <= 0:
        none = np.zeros(g.spec.shape, dtype=np.bool_)
        return none, none.copy()
    windows = range(3, max(3, window_px(params.s_max_m, cell_m)) + 1, 2)
    surface = np.asarray(g.values)
    valid = np.asarray(g.valid)
    up = window_profile(surface, windows, valid).response
    down = window_profile(surface, windows, valid, valleys=True).response
    return (
        _exceeding(up, down, params.peak_factor * cell_m),
        _exceeding(down, up, params.valley_factor * cell_m),
    )


def _exceeding(own: NDArray[np.float64], other: NDArray[np.float64], threshold: float) -> NDArray[np.bool_]:
    """Return where a response exceeds the other one and reaches the threshold; nowhere for a threshold of 0."""
    if threshold <= 0:
        return np.zeros(own.shape, dtype=np.bool_)
    # Heights are float32 beside R_g in float64: a response of just t must not miss it by rounding.
    return (own > other) & (own >= threshold - 1e-6)


def fill_by_idw(
    values: NDArray[np.float64], known: NDArray[np.bool_], wanted: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Interpolate cells from the nearest known ones by inverse distance weighting (Eq. 6; M8).

    Parameters
    ----------
    values : (H, W) ndarray of float64
        Heights where known. Not modified.
    known : (H, W) ndarray of bool
        The cells p_n of the neighbourhoods.
    wanted : (H, W) ndarray of bool
        The cells p* to interpolate; none of them known.

    Returns
    -------
    (H, W) ndarray of float64
        Interpolated where wanted, the values elsewhere.

    Raises
    ------
    NodataError
        When cells are wanted but none is known.

    Notes
    -----
    g[p*] = Σ g[p] d^-2 / Σ d^-2 over the three nearest known cells and all that are as near as the third; so no
    direction is preferred, and the order in which cells are found does not count. With fewer known cells, over all of
    them. Distances are between centres. Cells with three known ones within ``REACH`` are filled by a search from near
    to far; the others, O(n log n), by a KD-tree.

    Examples
    --------
    With d = 1, 1 and 2 the empty cell takes (2 + 4 + 4/4) / (1 + 1 + 1/4) = 3.11:

    >>> lowest = np.array([[2.0, 0.0, 4.0, 4.0]])
    >>> empty = np.array([[False, True, False, False]])
    >>> fill_by_idw(lowest, ~empty, empty).round(2)
    array([[2.  , 3.11, 4.  , 4.  ]])
    """
    if not wanted.any():
        return values.copy()
    if not known.any():
        msg = "No cell has a value from which others could be interpolated."
        raise NodataError(msg)
    filled, far = fill_near(values, known, wanted, _offsets(REACH))
    return _fill_far(filled, known, far) if far.any() else filled


def _offsets(reach: int) -> NDArray[np.int64]:
    """Return (N, 3) row offset, column offset and squared distance, from near to far and then in row order."""
    row, col = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1)
    squared = row**2 + col**2
    order = np.argsort(squared, kind="stable")
    order = order[(squared[order] > 0) & (squared[order] <= reach**2)]
    return np.stack([row[order], col[order], squared[order]], axis=1)


@kernel
def fill_near(
    values: NDArray[np.float64],
    known: NDArray[np.bool_],
    wanted: NDArray[np.bool_],
    offsets: NDArray[np.int64],
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Fill the wanted cells that have three known ones among the offsets; return the values, and the other cells."""
    # Only known cells are read and only wanted ones written, so the order of the cells has no effect.
    height, width = values.shape
    filled, far = values.copy(), np.zeros(values.shape, dtype=np.bool_)
    for row in range(height):
        for col in range(width):
            if not wanted[row, col]:
                continue
            found, limit, total, weights = 0, 0, 0.0, 0.0
            for i in range(len(offsets)):
                squared = offsets[i, 2]
                # Offsets rise in distance: beyond that of the third known cell none is nearer or as near.
                if found >= NEAREST and squared > limit:
                    break
                r, c = row + offsets[i, 0], col + offsets[i, 1]
                if r < 0 or c < 0 or r >= height or c >= width or not known[r, c]:
                    continue
                # `limit` is the distance of the last known cell, so ties with the third one still count.
                found, limit = found + 1, squared
                total += values[r, c] / squared
                weights += 1.0 / squared
            if found < NEAREST:
                far[row, col] = True
            else:
                filled[row, col] = total / weights
    return filled, far


def _fill_far(values: NDArray[np.float64], known: NDArray[np.bool_], wanted: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Interpolate cells that are far from the known ones, by a KD-tree."""
    targets = np.argwhere(wanted)
    sources = np.argwhere(known)
    tree = cKDTree(sources, balanced_tree=False, compact_nodes=False)
    heights = values[known]
    filled = values.copy()
    found = np.empty(len(targets))
    for start in range(0, len(targets), BATCH):
        batch = targets[start : start + BATCH]
        found[start : start + BATCH] = _weighted(tree, heights, sources, batch)
    filled[wanted] = found
    return filled


def _weighted(
    tree: cKDTree, heights: NDArray[np.float64], sources: NDArray[np.int64], targets: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Return the weighted mean of the nearest known cells of each target."""
    most = min(MOST, len(sources))
    _, near = tree.query(targets, k=np.arange(1, most + 1), workers=-1)
    near.sort(axis=1)  # sums in row-major order of the cells, whatever the order of equally near ones
    squared = ((sources[near] - targets[:, None, :]) ** 2).sum(axis=2)
    limit = np.partition(squared, min(NEAREST, most) - 1, axis=1)[:, min(NEAREST, most) - 1]
    weight = np.where(squared <= limit[:, None], squared.astype(np.float64) ** (-POWER / 2), 0.0)
    mean: NDArray[np.float64] = (weight * heights[near]).sum(axis=1) / weight.sum(axis=1)
    return mean

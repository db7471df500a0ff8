"""Removal of outliers: levelling by differential morphological profiles (Mongus et al. 2013, §3.2)."""

import logging
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msbdb.extract.flatregions.initialise import fill_by_idw
from msbdb.extract.flatregions.windowsize import window_px
from msbdb.grid import Grid
from msbdb.morphology import window_profile
from msbdb.params import FlatRegionParams

logger = logging.getLogger(__name__)


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


def denoise(g: Grid, params: FlatRegionParams) -> Denoised:
    """Find peaks and valleys that are too small for buildings, and interpolate them (Eq. 7 to 10; M9 to M12).

    Parameters
    ----------
    g : Grid
        The surface, metres.
    params : FlatRegionParams
        ``s_max_m``, ``valley_factor`` and ``peak_factor``; a factor of 0 leaves that kind as it is.

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
    logger.info("Denoising: %d cells of peaks, %d of valleys", np.count_nonzero(peaks), np.count_nonzero(valleys))
    return Denoised(g.with_values(values.astype(np.float32)), peaks, valleys)


def find_outliers(g: Grid, params: FlatRegionParams) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return the cells of sharp peaks and of steep valleys (M9 to M12).

    Notes
    -----
    A cell is a peak where r(g) > r(-g), a valley where r(g) < r(-g), neither where they are equal (Eq. 7). Its response
    r̄ is the larger of the two (Eq. 8, read as a maximum: A11), and it is an outlier when r̄ ≥ t, with t = 2 R_g in
    valleys and 4 R_g on peaks (Eq. 9, 10). Which threshold counts is told by the branch that was taken, not by
    comparing scales (M10).
    """
    cell_m = g.spec.cell_m
    none = np.zeros(g.spec.shape, dtype=np.bool_)
    windows = range(3, window_px(params.s_max_m, cell_m) + 1, 2)
    if not windows:
        return none, none.copy()
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

"""Vegetation among off-ground points: by NDVI where there are colours, and by surface and echoes (S6)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from skimage.filters import threshold_otsu

from msbdb.extract.adaptive.neighbours import means_around, plane_residuals
from msbdb.extract.adaptive.points import OffGround
from msbdb.params import AdaptiveParams

GREEN = 1
SCATTERED = 2


@dataclass(frozen=True, slots=True, eq=False)
class Structure:
    """How the surface about each point looks; (N,) ndarrays of float32 from 0 to 1.

    Parameters
    ----------
    level : ndarray
        Mean degree to which the points around lie on planes.
    split : ndarray
        Share of the points around that are of pulses with several echoes; 0 where the source knows none.
    """

    level: NDArray[np.float32]
    split: NDArray[np.float32]


def structure(points: OffGround, params: AdaptiveParams) -> Structure:
    """Measure planes in a small sphere about each point, and take their mean and that of the echoes in a wider disc."""
    small_m = max(params.surface_factor * points.spacing_m, params.surface_least_m)
    wide_m = max(params.around_factor * points.spacing_m, params.around_least_m)
    values = np.zeros((len(points), 2), dtype=np.float32)
    values[:, 0] = _degree(plane_residuals(points.x, points.y, points.z, small_m), params.level_m)
    if points.split is not None:
        values[:, 1] = points.split
    around = means_around(points.x, points.y, values, wide_m)
    return Structure(around[:, 0], around[:, 1])


def tell_vegetation(points: OffGround, found: Structure, params: AdaptiveParams) -> NDArray[np.int8]:
    """Return for each point `GREEN`, `SCATTERED`, or 0 for what may be a roof.

    Green points are vegetation, unless their surroundings are as level as only a planted roof is. Of the others those
    are, whose surroundings scatter: by log-odds of the level share and the share of split echoes (ours: the slides
    have colours; their sensor gave up to four echoes, S8).
    """
    if points.split is None:
        odds = params.blind_bias + params.blind_level_weight * found.level
    else:
        odds = params.bias + params.level_weight * found.level - params.split_weight * found.split
    kind = np.where(odds < params.least_odds, SCATTERED, 0).astype(np.int8)
    if points.ndvi is not None and np.isfinite(points.ndvi).any():
        green = points.ndvi > ndvi_threshold(points.ndvi, params)
        kind[green & (found.level < params.ndvi_smooth)] = GREEN
    return kind


def ndvi_threshold(ndvi: NDArray[np.float32], params: AdaptiveParams) -> float:
    """Return Otsu's threshold of the points that have colours, within the bounds."""
    known = ndvi[np.isfinite(ndvi)]
    low, high = min(params.ndvi_bounds), max(params.ndvi_bounds)
    if known.min() == known.max():
        return high
    return float(np.clip(threshold_otsu(known), low, high))  # type: ignore[no-untyped-call]  # scikit-image is untyped


def _degree(residual_m: NDArray[np.float32], level_m: float) -> NDArray[np.float32]:
    """Return 1 for residuals up to half of what tells nothing, 0 from twice of it on, evenly in the logarithm."""
    with np.errstate(divide="ignore"):
        octaves = np.log2(residual_m / np.float32(level_m))
    return np.asarray(np.clip((1 - octaves) / 2, 0, 1), dtype=np.float32)

"""The systematic offset of a survey to the inventory: estimated and reported, never mistaken for change."""

from dataclasses import dataclass

import geopandas as gpd
import numpy as np
import shapely
from numpy.typing import NDArray

LIKE_OVERLAP = 0.6
"""Two footprints are taken for one building, to measure the offset, when they share this much of both."""

AGREEMENT_M = 0.5
"""Differences of height within this of one agree: a few times the noise of two surveys, far below a storey."""

MEDIAN_FACTOR = 1.4826
"""Times the median absolute deviation gives the standard deviation of normal errors."""


@dataclass(frozen=True, slots=True)
class Offset:
    """How a survey lies to the inventory: a place (x, y, h) of the inventory is (x + dx, y + dy, h + dz) there.

    ``dx_m``, ``dy_m`` and ``dz_m`` are 0 where too few pairs tell them; ``pairs`` counts the pairs of like buildings;
    ``spread_m`` is the robust standard deviation of a single pair's shift, NaN without pairs.
    """

    dx_m: float
    dy_m: float
    dz_m: float
    pairs: int
    spread_m: float


def estimate_offset(before: gpd.GeoDataFrame, after: gpd.GeoDataFrame, *, least_pairs: int) -> Offset:
    """Estimate the offset of a survey by the buildings that both sides have.

    Parameters
    ----------
    before, after : GeoDataFrame
        Footprints with their heights ``h_p90`` (metres), in one CRS; NaN heights tell no vertical offset.
    least_pairs : int
        Fewer pairs tell no offset: then it is zero.

    Returns
    -------
    Offset

    Notes
    -----
    The median, over pairs of footprints that share most of both, of the differences of the centres of their bounds: a
    building that changed moves no median. Bounds follow a shift even where the offset itself keeps footprints from
    lying on each other; so the pairs are sought again after a first shift. Heights change by storeys, so that half of
    a few buildings may have risen as one: theirs is the difference on which most pairs agree.
    """
    dx = dy = 0.0
    pairs = np.zeros((2, 0), dtype=np.int64)
    shift = np.zeros((0, 2))
    for _ in range(2):
        pairs = _like(before.geometry.to_numpy(), after.geometry.to_numpy(), dx, dy)
        if pairs.shape[1] < least_pairs:
            return Offset(0.0, 0.0, 0.0, pairs.shape[1], float("nan"))
        shift = _middles(after.geometry.to_numpy()[pairs[1]]) - _middles(before.geometry.to_numpy()[pairs[0]])
        dx, dy = (float(middle) for middle in np.median(shift, axis=0))
    rise = after["h_p90"].to_numpy(dtype=np.float64)[pairs[1]] - before["h_p90"].to_numpy(dtype=np.float64)[pairs[0]]
    known = rise[np.isfinite(rise)]
    dz = _agreed(known) if len(known) >= least_pairs else 0.0
    spread = MEDIAN_FACTOR * float(np.median(np.abs(shift - (dx, dy))))
    return Offset(dx, dy, dz, pairs.shape[1], spread)


def _agreed(rise: NDArray[np.float64]) -> float:
    """Return the median of the largest group of differences that lie close together, of equal groups the lowest."""
    near = np.abs(rise[:, None] - rise[None, :]) <= AGREEMENT_M
    first = np.lexsort((np.abs(rise), -near.sum(axis=1)))[0]
    return float(np.median(rise[near[first]]))


def moved(shapes: NDArray[np.object_], dx: float, dy: float) -> NDArray[np.object_]:
    """Return geometries shifted in plan."""
    return np.asarray(shapely.transform(shapes, lambda xy: xy + np.array([dx, dy])))


def _middles(shapes: NDArray[np.object_]) -> NDArray[np.float64]:
    """Return the centres of the geometries' bounds, (N, 2)."""
    bounds = shapely.bounds(shapes)
    return np.asarray((bounds[:, :2] + bounds[:, 2:]) / 2)


def _like(before: NDArray[np.object_], after: NDArray[np.object_], dx: float, dy: float) -> NDArray[np.int64]:
    """Return the pairs (2, N) of footprints that share most of both, once the inventory is shifted."""
    shifted = moved(before, dx, dy)
    found = shapely.STRtree(after).query(shifted, predicate="intersects")
    shared = shapely.area(shapely.intersection(shifted[found[0]], after[found[1]]))
    larger = np.maximum(shapely.area(shifted[found[0]]), shapely.area(after[found[1]]))
    return np.asarray(found[:, shared >= LIKE_OVERLAP * larger])

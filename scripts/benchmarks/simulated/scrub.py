"""Towns with scrub, hedges and crops: echoes of bare ground are lifted onto dense plants that are lower than a storey."""

from collections.abc import Callable

import laspy
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

GROUND, UNCLASSIFIED = 2, 1

CELL_M = 0.5
"""Cells on which patches and tops are drawn."""

LEAST_M = 0.3
"""Plants are at least so high."""

SEED = 5

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def scrub(east: Array, north: Array) -> tuple[Mask, Array]:
    """Return patches some metres wide, on 15 % of the ground, with tops of 2.8 m that differ by 0.5 m (sigma)."""
    return _drawn(east, north, 6.0, SEED) > 1.04, 2.8 + 0.5 * _drawn(east, north, 1.0, SEED + 1)


def clipped(east: Array, north: Array) -> tuple[Mask, Array]:
    """Return the same patches, with tops that differ by half as much."""
    where, top_m = scrub(east, north)
    return where, 2.8 + (top_m - 2.8) / 2


def hedges(east: Array, north: Array) -> tuple[Mask, Array]:
    """Return rows 1.8 m wide and 2.5 m high, 15 m apart, that run askew."""
    return (0.92 * east + 0.39 * north) % 15 < 1.8, np.full(east.shape, 2.5)


def crops(east: Array, north: Array) -> tuple[Mask, Array]:
    """Return a third of all squares of 40 m, with plants 2.6 m high."""
    return (np.floor(east / 40) + np.floor(north / 40)) % 3 == 0, np.full(east.shape, 2.6)


PLANTS: dict[str, tuple[Callable[[Array, Array], tuple[Mask, Array]], float, float]] = {
    "scrub": (scrub, 0.15, 0.25),
    "clipped": (clipped, 0.08, 0.1),
    "hedges": (hedges, 0.12, 0.1),
    "crops": (crops, 0.15, 0.2),
}
"""Where plants stand and how high, from metres to the east and to the north of a corner; how rough they are, metres (sigma of single
echoes), and the share of pulses that reach the ground. Such plants are too low to split a pulse."""


def overgrown(cloud: laspy.LasData, kind: str) -> laspy.LasData:
    """Return a copy of a tile with class 2 in which first echoes of the ground lie on plants."""
    where, rough_m, through = PLANTS[kind]
    x, y, z = (np.asarray(cloud[axis], dtype=np.float64) for axis in "xyz")
    random = np.random.default_rng(SEED)
    grown, top_m = where(x - x.min(), y - y.min())
    grown &= (np.asarray(cloud.classification) == GROUND) & (np.asarray(cloud.return_number) <= 1)
    grown &= random.random(len(x)) >= through
    copy = laspy.LasData(cloud.header, cloud.points.copy())
    copy.z = z + grown * np.maximum(top_m + random.normal(0, rough_m, len(x)), LEAST_M)
    copy.classification = np.where(grown, UNCLASSIFIED, np.asarray(cloud.classification)).astype(np.uint8)
    return copy


def _drawn(east: Array, north: Array, width_m: float, seed: int) -> Array:
    """Return normal noise at some places that changes over so many metres, with a mean of 0 and a deviation of 1."""
    row, col = ((axis / CELL_M).astype(np.int64) for axis in (north, east))
    field = np.random.default_rng(seed).standard_normal((int(row.max()) + 1, int(col.max()) + 1))
    field = gaussian_filter(field, width_m / CELL_M, mode="wrap")
    return np.asarray((field / field.std())[row, col])

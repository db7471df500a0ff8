"""The area filter of the bands before clustering (V34)."""

import numpy as np
from numpy.typing import NDArray

from msbdb.bands import Bands
from msbdb.morphology.area import area_closing, area_opening
from msbdb.threads import in_threads


def filter_bands(bands: Bands, inside: NDArray[np.bool_], area_m2: float, *, connectivity: int = 8) -> Bands:
    """Open and close every band with one area, within the cells that will be clustered.

    Small bright and dark objects (chimneys, cars, roof windows) take the value of what surrounds them, which lessens
    the diversity that k-means sees.

    Parameters
    ----------
    bands : Bands
        The bands to filter.
    inside : (H, W) ndarray of bool
        The cells to be clustered. Cells outside do not exist for the filter (and become invalid), so each island of
        cells is filtered apart from all others, whatever the tile that holds it.
    area_m2 : float
        Smallest object that stays, "a bit smaller than the smallest building". Below two cells nothing is filtered.
    connectivity : int
        4 or 8.

    Returns
    -------
    Bands
        On the same lattice, valid where ``inside`` and the bands are.

    Notes
    -----
    AOC (V5) of each band [1]_ (Section 3.2). An island smaller than the area has nothing to be compared with and
    keeps its values. The paper filters the whole image; within the mask, roofs do not take the colour of the street.

    References
    ----------
    .. [1] Vu, T.T., Yamazaki, F., Matsuoka, M., 2009. Multi-scale solution for building extraction from LiDAR and
       image data. International Journal of Applied Earth Observation and Geoinformation 11 (4), 281-289.
       doi:10.1016/j.jag.2009.03.005.
    """
    valid = bands.valid & inside
    threshold = round(area_m2 / bands.spec.cell_area_m2)
    values = np.zeros(bands.values.shape, dtype=np.float32)

    def write_band(number: int) -> None:
        band = bands.values[number]
        filtered = _filter(band, valid, threshold, connectivity) if threshold >= 2 else band
        np.copyto(values[number], filtered, where=valid)

    if valid.any():
        in_threads(write_band, range(len(values)))
    return Bands(values, bands.names, valid, bands.spec)


def _filter(
    band: NDArray[np.float32], valid: NDArray[np.bool_], threshold_px: int, connectivity: int
) -> NDArray[np.float32]:
    """Open and close one band; outside lies below all values for the opening and above all for the closing.

    What is returned there has no meaning.
    """
    below = np.float32(band[valid].min() - 1)
    above = np.float32(band[valid].max() + 1)
    opened = area_opening(np.where(valid, band, below), threshold_px, connectivity=connectivity)
    opened[opened <= below] = above  # islands that are too small, and what lies outside
    closed = area_closing(opened, threshold_px, connectivity=connectivity)
    return np.where(closed >= above, band, closed)

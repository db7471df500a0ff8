"""Single crowns by their shape: rough objects whose heights are domes."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import find_objects

from msbdb.grid import Grid
from msbdb.labels import Labels, sizes

Mask = NDArray[np.bool_]

DROP_M = 0.7
"""Ours, in sample: least fall of a crown to all sides, from its top to a circle of its area; 1 m does alike."""

SINGLE_M2 = 200.0
"""Ours, in sample: single crowns are no larger, as they are hardly wider than 16 m."""

NEAR_M = 0.6
"""Ours, in sample: half of the cells of a crown lie this near to its dome; 0.5 and 0.7 m do alike."""

DOMED = 0.3
"""Ours, in sample: a smaller share of a crown is even; 0.5 with twice the limit does alike."""

COARSE_M = 1.0
"""Ours: on larger cells hipped roofs of small houses are as rough as crowns, as simulated ones show."""


def single_crowns(labels: Labels, even: NDArray[np.float64], heights: Grid) -> Mask:
    """Return which objects are domes, of those that are no larger than crowns and of which little is even.

    A dome is the nearest quadratic surface, if it falls off by `DROP_M` at least to all sides within a circle of the
    object's area, and half of the object's cells lie within `NEAR_M` of it.

    Parameters
    ----------
    labels : (H, W) ndarray of int32
        Objects 1 to N; 0 for none.
    even : (N,) ndarray of float64
        Share of each object that is even; less than `DOMED` of a crown is.
    heights : Grid
        Heights above ground, metres; valid in all objects.

    Returns
    -------
    (N,) ndarray of bool

    Notes
    -----
    Border: an object that the lattice cuts is judged by what is left of it. Objects of more than `SINGLE_M2` are no
    single crowns.

    Examples
    --------
    A dome and a ridge, both rough:

    >>> from pyproj import CRS
    >>> from msbdb.grid import lattice
    >>> spec = lattice((0, 0.1, 16, 6.9), 1.0, CRS.from_epsg(2154))
    >>> row, col = np.indices((7, 17)) - 3
    >>> labels = np.where(col < 4, 1, np.where(col > 6, 2, 0)).astype(np.int32)
    >>> high = np.where(col < 4, 8 - 0.1 * (row**2 + col**2), 8 - 0.5 * abs(row))
    >>> single_crowns(labels, np.zeros(2), Grid(np.float32(high), labels > 0, spec))
    array([ True, False])
    """
    area_m2 = sizes(labels, len(even)) * heights.spec.cell_area_m2
    crowns: Mask = (area_m2 <= SINGLE_M2) & (even < DOMED)
    values, places = np.asarray(heights.values), find_objects(labels)
    for number in np.flatnonzero(crowns).tolist():
        inside = labels[places[number]] == number + 1
        crowns[number] = _is_dome(inside, values[places[number]], heights.spec.cell_m)
    return crowns


def _is_dome(inside: Mask, heights: NDArray[np.floating], cell_m: float) -> bool:
    """Return whether the cells of an object lie near to a quadratic surface that falls off to all sides."""
    # Coordinates begin at the mean of the object's own cells, so that tiles agree.
    row, col = (cell_m * (place - place.mean()) for place in np.nonzero(inside))
    high = heights[inside].astype(np.float64)
    surface = np.column_stack((np.ones(len(high)), row, col, row * row, row * col, col * col))
    factors, *_ = np.linalg.lstsq(surface, high, rcond=None)
    along, across, beside = factors[3:]
    bends = np.linalg.eigvalsh([[2 * along, across], [across, 2 * beside]])
    falls = bends.max() <= -2 * DROP_M / (cell_m**2 * len(high) / np.pi)
    return bool(falls and np.median(np.abs(high - surface @ factors)) <= NEAR_M)

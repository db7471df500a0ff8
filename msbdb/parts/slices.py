"""Slices of heights: storeys or steps above the mask, which do not cut a level roof (V17 to V19)."""

import numpy as np
from numpy.typing import NDArray

from msbdb.grid import Grid
from msbdb.morphology.levelzones import label_level_zones
from msbdb.params import SurfaceParams

MAX_SLICE = 2**16 - 1
"""Slices are counted in 16 bits; higher ones are cut off."""

CENTIMETRES = 100

NOISE_M = 0.03
"""Neighbouring cells of a level roof differ by this much, the range noise of a scanner."""


def slice_heights(ndsm: Grid, surface: SurfaceParams, *, connectivity: int = 8) -> NDArray[np.uint16]:
    """Slice an nDSM into storeys, or into steps of ``surface.step_m`` when ``surface.slicing`` is 'step'.

    Parameters
    ----------
    ndsm : Grid
        Heights above ground, metres.
    surface : SurfaceParams
        The mask, the way of slicing, the height of a storey or step, and what is level.
    connectivity : int
        4 or 8, as for the scale-space.

    Returns
    -------
    (H, W) ndarray of uint16
        H = 1 + floor((h - mask) / height) where the cell is valid and at least as high as the mask (V17, V18, A8);
        otherwise 0. Here h is the median height of the cell's level zone.

    Notes
    -----
    The paper slices by "an elevation slicing with the height of a story" without a rule for rounding; floor(h / 3)
    would take houses of 2 to 3 m for ground. By the cells' own heights, a level roof at the height of a boundary would
    fall into two storeys by its noise. So cells without a step above ``surface.level_m`` between them, and within one
    storey, are one level zone (`msbdb.morphology.label_level_zones`) and share its median. Where they rise by no more
    than ``surface.level_slope``, a zone may span more than a storey: the ground under a level hall slopes. A boundary
    lies on real steps of height alone; a steep slope is cut where it leaves a storey, cell by cell.

    Nodata: cells that are not valid are background.

    Examples
    --------
    A roof at 5 m, the boundary of two storeys, and a tower of 9 m:

    >>> from pyproj import CRS
    >>> from msbdb.grid import lattice
    >>> spec = lattice((0, 0.1, 5, 0.9), 1.0, CRS.from_epsg(2154))
    >>> heights = np.array([[0, 4.98, 5.02, 4.99, 9.0, 9.1]], dtype=np.float32)
    >>> slice_heights(Grid(heights, heights >= 0, spec), SurfaceParams()).tolist()
    [[0, 1, 1, 1, 3, 3]]
    """
    height_m = surface.storey_m if surface.slicing == "storey" else surface.step_m
    heights = np.asarray(ndsm.values, dtype=np.float32)
    above = ndsm.valid & (heights >= surface.mask_m)
    slices = np.zeros(ndsm.spec.shape, dtype=np.uint16)
    slices[above] = _slice(heights[above], surface.mask_m, height_m)
    if surface.level_m > 0:
        whole = np.zeros(ndsm.spec.shape, dtype=np.int32)
        whole[above] = np.rint(heights[above].astype(np.float64) * CENTIMETRES)
        zones = label_level_zones(
            whole,
            above,
            step=round(surface.level_m * CENTIMETRES),
            spread=round(height_m * CENTIMETRES),
            free_step=round(max(surface.level_slope * ndsm.spec.cell_m, NOISE_M) * CENTIMETRES),
            connectivity=connectivity,
        )
        cells, medians = _medians_of_cut_zones(zones, slices, heights)
        slices.ravel()[cells] = _slice(medians, surface.mask_m, height_m)
    return slices


def storeys(heights: NDArray[np.floating], surface: SurfaceParams) -> NDArray[np.int64]:
    """Return the storeys H = 1 + floor((h - mask) / storey) of building heights in metres, at least 1 (V18).

    Examples
    --------
    >>> storeys(np.array([2.0, 4.9, 5.0, 9.0]), SurfaceParams())
    array([1, 1, 2, 3])
    """
    return _slice(heights, surface.mask_m, surface.storey_m)


def _slice(heights: NDArray[np.floating], mask_m: float, height_m: float) -> NDArray[np.int64]:
    """Count the slices from the mask up; float64, so that a height on a border falls into the upper slice."""
    count = 1 + np.floor((heights.astype(np.float64) - mask_m) / height_m)
    slices: NDArray[np.int64] = np.clip(count, 1, MAX_SLICE).astype(np.int64)
    return slices


def _medians_of_cut_zones(
    zones: NDArray[np.int32], slices: NDArray[np.uint16], heights: NDArray[np.float32]
) -> tuple[NDArray[np.intp], NDArray[np.float32]]:
    """Return the cells of the zones that lie in several slices, and for each the lower median of its zone's heights."""
    cells = np.flatnonzero(zones)
    zone, slice_of = zones.ravel()[cells], slices.ravel()[cells]
    # A zone's number is the place of its first cell among these cells, plus 1.
    differs = slice_of != slice_of[zone - 1]
    is_cut = np.zeros(cells.size + 1, dtype=np.bool_)
    is_cut[zone[differs]] = True
    chosen = is_cut[zone]
    cells, zone = cells[chosen], zone[chosen]
    high = heights.ravel()[cells]
    order = np.lexsort((high, zone))
    starts = np.flatnonzero(np.diff(zone[order], prepend=-1))
    sizes = np.diff(starts, append=zone.size)
    medians = np.repeat(high[order][starts + (sizes - 1) // 2], sizes)
    return cells[order], medians

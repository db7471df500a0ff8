"""Slicing of heights into storeys or metric steps (V17-V19)."""

import numpy as np
from numpy.typing import NDArray

from msbdb.grid import Grid
from msbdb.params import SurfaceParams

MAX_SLICE = 2**16 - 1
"""Slices are counted in 16 bits; higher ones are cut off."""


def slice_heights(ndsm: Grid, surface: SurfaceParams) -> NDArray[np.uint16]:
    """Slice an nDSM into storeys, or into steps of ``surface.step_m`` when ``surface.slicing`` is 'step'.

    Parameters
    ----------
    ndsm : Grid
        Heights above ground, metres.
    surface : SurfaceParams
        The mask, the way of slicing, and the height of a storey or step.

    Returns
    -------
    (H, W) ndarray of uint16
        H = 1 + floor((h - mask) / height) where h is valid and at least the mask (V17, V18, A8); otherwise 0.

    Notes
    -----
    The paper slices by "an elevation slicing with the height of a story" without a rule for rounding; floor(h / 3)
    would take houses of 2 to 3 m for ground. Nodata: cells that are not valid are background.
    """
    height = surface.storey_m if surface.slicing == "storey" else surface.step_m
    heights = np.asarray(ndsm.values, dtype=np.float32)
    above = ndsm.valid & (heights >= surface.mask_m)
    slices = np.zeros(ndsm.spec.shape, dtype=np.uint16)
    slices[above] = _slice(heights[above], surface.mask_m, height)
    return slices


def storeys(heights: NDArray[np.floating], surface: SurfaceParams) -> NDArray[np.int64]:
    """Return the storeys (V18) of building heights in metres; at least 1, as a part is above ground by its zone."""
    return _slice(heights, surface.mask_m, surface.storey_m)


def _slice(heights: NDArray[np.floating], mask_m: float, height_m: float) -> NDArray[np.int64]:
    """Count the slices from the mask up; float64, so that a height on a border falls into the upper slice."""
    count = 1 + np.floor((heights.astype(np.float64) - mask_m) / height_m)
    slices: NDArray[np.int64] = np.clip(count, 1, MAX_SLICE).astype(np.int64)
    return slices

"""Ground by other programs' methods: a plain SMRF, and the authors' own cloth simulation.

Both run with the values that their authors publish for towns, untuned, and see no classes.
"""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import laspy
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import griddata
from scipy.ndimage import distance_transform_edt, grey_opening
from skimage.morphology import disk

Mask = NDArray[np.bool_]

CELL_M = 1.0
SMRF_WINDOW_M = 30.0
SMRF_SLOPE = 0.15
SMRF_NEAR_M = 0.5
SMRF_SCALING = 1.25
LOW_M = 5.0
CLOTH_NEAR_M = 0.5


def smrf(clouds: list[laspy.LasData]) -> list[Mask]:
    """Return the ground points by Pingel, Clarke and McBride (2013): openings of the lowest surface by growing disks.

    A cell that an opening of radius r lowers by more than the slope times r is an object. Points within a distance of
    the surface through the other cells are ground; the distance grows with its slope. The step that cuts a net into
    large buildings is left out, as in the authors' default.
    """
    x, y, z = (np.concatenate([np.asarray(getattr(cloud, axis)) for cloud in clouds]) for axis in "xyz")
    col = ((x - x.min()) / CELL_M).astype(np.int64)
    row = ((y - y.min()) / CELL_M).astype(np.int64)
    surface = np.full((row.max() + 1, col.max() + 1), np.inf)
    np.minimum.at(surface, (row, col), z)
    filled = _nearest(surface, np.isfinite(surface))
    lows = -grey_opening(-filled, footprint=disk(1)) - filled > LOW_M
    filled = _nearest(filled, ~lows)
    objects, opened = np.zeros(surface.shape, dtype=np.bool_), filled
    for radius in range(1, int(SMRF_WINDOW_M / CELL_M) + 1):
        lower = grey_opening(opened, footprint=disk(radius))
        objects |= opened - lower > SMRF_SLOPE * radius * CELL_M
        opened = lower
    bare = np.isfinite(surface) & ~objects & ~lows
    terrain = _linear(filled, bare)
    steep = np.hypot(*np.gradient(terrain, CELL_M))
    near = np.abs(z - terrain[row, col]) <= SMRF_NEAR_M + SMRF_SCALING * steep[row, col]
    return _split(near, clouds)


def cloth(clouds: list[laspy.LasData]) -> list[Mask]:
    """Return the ground points by Zhang et al. (2016), with the authors' library ``cloth-simulation-filter``."""
    import CSF

    filtering = CSF.CSF()
    filtering.params.bSloopSmooth = True
    filtering.params.cloth_resolution = CELL_M
    filtering.params.rigidness = 2
    filtering.params.class_threshold = CLOTH_NEAR_M
    xyz = np.concatenate([np.column_stack([cloud.x, cloud.y, cloud.z]) for cloud in clouds])
    filtering.setPointCloud(xyz - xyz.min(axis=0))
    ground, others = CSF.VecInt(), CSF.VecInt()
    with _silent():
        filtering.do_filtering(ground, others, False)
    near = np.zeros(len(xyz), dtype=np.bool_)
    near[np.fromiter(ground, dtype=np.int64, count=len(ground))] = True
    return _split(near, clouds)


OTHER_GROUNDS = {"smrf": smrf, "cloth": cloth}
"""Methods by the name of their column."""


@contextmanager
def _silent() -> Iterator[None]:
    """Send what a library of another language prints to nowhere while the block runs: tables go to standard output."""
    sys.stdout.flush()
    kept, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)


def _nearest(values: NDArray[np.float64], known: Mask) -> NDArray[np.float64]:
    """Give unknown cells the value of the nearest known one."""
    rows, cols = distance_transform_edt(~known, return_distances=False, return_indices=True)
    return np.asarray(values[rows, cols])


def _linear(values: NDArray[np.float64], known: Mask) -> NDArray[np.float64]:
    """Give unknown cells the value of the triangle of known ones around them, else of the nearest one."""
    surface = _nearest(values, known)
    unknown = np.argwhere(~known)
    inside = griddata(np.argwhere(known), values[known], unknown, method="linear")
    surface[~known] = np.where(np.isfinite(inside), inside, surface[~known])
    return surface


def _split(mask: Mask, clouds: list[laspy.LasData]) -> list[Mask]:
    """Return the part of each cloud."""
    return np.split(mask, np.cumsum([len(cloud.points) for cloud in clouds])[:-1])

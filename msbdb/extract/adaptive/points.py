"""The off-ground points in canonical order, with what the steps ask of them."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msbdb.errors import InputError
from msbdb.grid import GridSpec
from msbdb.morphology.points import index_cells
from msbdb.pointcloud import PointCloud

Floats = NDArray[np.float64]
Labels = NDArray[np.int32]

FIRST_CELL_M = 2.0
"""Cells on which the covered area is counted first."""

LEAST_A_CELL = 4.0
"""With fewer first echoes a cell on average, cells without any would be many by chance: they are taken larger."""

LARGEST_CELL_M = 100.0
"""Beyond it there is no survey, but single points."""

PLACES = 2**31
"""Width of the numbering of cells: a place is row times this plus column, both counted from its half."""


@dataclass(frozen=True, slots=True, eq=False)
class OffGround:
    """The points of at least the mask's height, sorted by x, y and z, then by all else that is known of them.

    Parameters
    ----------
    index : (N,) ndarray of int64
        Their places in the cloud.
    x, y, z : (N,) ndarray of float64, metres
        From an origin at a whole kilometre nearby.
    origin : (2,) ndarray of float64
        Easting and northing of the origin.
    heights : (N,) ndarray of float64, metres
        Above ground.
    area_m2 : (N,) ndarray of float64
        Area that each point stands for, of all points of the cloud: one over the local density (A17).
    split : (N,) ndarray of bool, optional
        Which points are of pulses with several echoes; None where the source knows no echoes.
    ndvi : (N,) ndarray of float32, optional
        NaN where a point has none.
    place : (N,) ndarray of int64
        Row-major number of the point's cell on the lattice.
    spacing_m : float
        Mean spacing of the first echoes, 1/sqrt(density).
    """

    index: NDArray[np.int64]
    x: Floats
    y: Floats
    z: Floats
    origin: Floats
    heights: Floats
    area_m2: Floats
    split: NDArray[np.bool_] | None
    ndvi: NDArray[np.float32] | None
    place: NDArray[np.int64]
    spacing_m: float

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.x)


def off_ground(
    cloud: PointCloud, heights: Floats, ndvi: NDArray[np.float32] | None, *, spec: GridSpec, mask_m: float
) -> OffGround:
    """Take the points at or above the mask, and measure the density.

    Raises
    ------
    InputError
        When heights or NDVI are not one a point, or coordinates or heights are not finite.
    """
    for name, values in (("heights", heights), ("NDVI values", ndvi)):
        if values is not None and values.shape != (len(cloud),):
            msg = f"The {name} must be one a point, {len(cloud)}; got the shape {values.shape}."
            raise InputError(msg)
    strange = len(cloud) - int(np.count_nonzero(np.isfinite(cloud.x + cloud.y + cloud.z + heights)))
    if strange:
        msg = (
            f"{strange} of {len(cloud)} points have a coordinate or a height above ground that is NaN or infinite. "
            "Drop these points, or give a terrain that covers them."
        )
        raise InputError(msg)
    spacing_m = mean_spacing(cloud)
    area_m2 = _areas(cloud.x, cloud.y, 2 * spacing_m)
    chosen = np.flatnonzero(heights >= mask_m)
    chosen = chosen[_canonical(cloud, heights, ndvi, chosen)]
    x, y = cloud.x[chosen], cloud.y[chosen]
    origin = np.round([float(v.mean()) if len(v) else 0.0 for v in (x, y)], -3)
    row, col = spec.rowcol(x, y)
    return OffGround(
        index=chosen,
        x=x - origin[0],
        y=y - origin[1],
        z=cloud.z[chosen],
        origin=origin,
        heights=heights[chosen].astype(np.float64),
        area_m2=area_m2[chosen],
        split=None if not cloud.has_echoes else np.greater(cloud.number_of_returns[chosen], 1),  # type: ignore[index]  # there are echoes
        ndvi=None if ndvi is None else ndvi[chosen].astype(np.float32),
        place=(row + PLACES // 2) * np.int64(PLACES) + (col + PLACES // 2),
        spacing_m=spacing_m,
    )


def mean_spacing(cloud: PointCloud) -> float:
    """Return the mean spacing of the first echoes over the cells that hold some, metres; 1 without any point.

    Later echoes lie where the first one does and make nothing denser. Cells of 2 m, or of larger ones where these
    would hold fewer than four.
    """
    chosen = cloud.first_echo if cloud.first_echo.any() else np.ones(len(cloud), dtype=np.bool_)
    x, y = cloud.x[chosen], cloud.y[chosen]
    if not len(x):
        return 1.0
    cell_m = FIRST_CELL_M
    cells = index_cells(x, y, cell_m)
    while cells.order.size < LEAST_A_CELL * cells.keys.size and cell_m < LARGEST_CELL_M:
        cell_m *= 1.5
        cells = index_cells(x, y, cell_m)
    return cell_m * math.sqrt(cells.keys.size / cells.order.size)


def _areas(x: Floats, y: Floats, cell_m: float) -> Floats:
    """Share the area of each cell among all of its points, so that all areas sum up to what is covered."""
    cells = index_cells(x, y, cell_m)
    points = np.diff(cells.starts)
    area = np.empty(len(x))
    area[cells.order] = np.repeat(cell_m**2 / points, points)
    return area


def _canonical(
    cloud: PointCloud, heights: Floats, ndvi: NDArray[np.float32] | None, chosen: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return the order of chosen points by x and y, then by z and all else where points share a place in plan."""
    # By ranks of x and y in one number, since sorting by one is much faster than by several.
    east, north = (np.unique(values[chosen], return_inverse=True)[1].astype(np.int64) for values in (cloud.x, cloud.y))
    key = east * (int(north.max(initial=0)) + 1) + north
    order = np.argsort(key)
    same = np.diff(key[order]) == 0
    tied = np.append(same, False) | np.append(False, same)
    if tied.any():
        some = order[tied]
        known = (ndvi, heights, cloud.number_of_returns, cloud.return_number, cloud.z)
        order[tied] = some[np.lexsort((*(v[chosen[some]] for v in known if v is not None), key[some]))]
    return np.asarray(order, dtype=np.int64)

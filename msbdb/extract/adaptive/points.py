"""The off-ground points in canonical order, with what the steps ask of them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msbdb.errors import InputError
from msbdb.extract.density import measure_density
from msbdb.extract.placed import PlacedPoints, places
from msbdb.grid import GridSpec
from msbdb.order import order_of_points
from msbdb.pointcloud import PointCloud

Floats = NDArray[np.float64]

KIND = "\0adaptive"
"""Follows the survey's name in the ids' keys, so that no region has the id of a part at the same place."""


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

    def placed(self, spec: GridSpec, survey: str) -> PlacedPoints:
        """Return the points on a survey's lattice."""
        return PlacedPoints(self.x, self.y, self.origin, self.area_m2, self.place, spec, survey + KIND)


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
    density = measure_density(cloud.x, cloud.y, cloud.first_echo)
    chosen = np.flatnonzero(heights >= mask_m)
    chosen = chosen[_canonical(cloud, heights, ndvi, chosen)]
    x, y = cloud.x[chosen], cloud.y[chosen]
    origin = np.round([float(v.mean()) if len(v) else 0.0 for v in (x, y)], -3)
    return OffGround(
        index=chosen,
        x=x - origin[0],
        y=y - origin[1],
        z=cloud.z[chosen],
        origin=origin,
        heights=heights[chosen].astype(np.float64),
        area_m2=density.area_m2[chosen],
        split=None if not cloud.has_echoes else np.greater(cloud.number_of_returns[chosen], 1),  # type: ignore[index]  # there are echoes
        ndvi=None if ndvi is None else ndvi[chosen].astype(np.float32),
        place=places(spec, cloud.x[chosen], cloud.y[chosen]),
        spacing_m=density.spacing_m,
    )


def _canonical(
    cloud: PointCloud, heights: Floats, ndvi: NDArray[np.float32] | None, chosen: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return the order of chosen points by x and y, then by z and all else where points share a place in plan."""
    known = [cloud.z, cloud.return_number, cloud.number_of_returns, heights, ndvi]
    ties = [values[chosen] for values in known if values is not None]
    return np.asarray(order_of_points(cloud.x[chosen], cloud.y[chosen], ties), dtype=np.int64)

"""Off-ground points and the vegetation among them, by the surface around each point, its echoes and its NDVI (S6).

The surface is measured by the residual of the plane through the neighbours, and by means over a wider disc.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from skimage.filters import threshold_otsu

from msbdb.detect.adaptive.surroundings import means_around, plane_residuals
from msbdb.detect.pointregions import PlacedPoints, places
from msbdb.errors import InputError
from msbdb.grid import GridSpec
from msbdb.order import order_of_points
from msbdb.params import AdaptiveParams
from msbdb.points.aside import let_go, set_aside
from msbdb.points.cloud import PointCloud
from msbdb.points.spacing import measure_density
from msbdb.surface.noise import without_noise
from msbdb.surveyplan import usual_split

Floats = NDArray[np.float64]

KIND = "\0adaptive"
"""Follows the survey's name in the ids' keys, so that no region has the id of a part at the same place."""

PLANE_POINTS = 7
"""On the typical ground a sphere holds so many other points of a level surface on average: nine of ten hold a plane."""

SPHERE_POWER = 0.7
"""Ours, in sample: residuals of roofs grow by this power of the sphere's radius, as wide ones span several planes."""

NOISE_LEFT = 0.5
"""Ours, in sample: share of the noise that is left of a residual. Its variance is known from few points alone."""

GREEN = 1
SCATTERED = 2


@dataclass(frozen=True, slots=True, eq=False)
class OffGround:
    """The points of at least the mask's height, sorted by x, y and z, then by all their other values.

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
        Area of each point: one over the local density of the cloud (A17).
    split : (N,) ndarray of bool, optional
        Which points are of pulses with several echoes; None where the source has no echoes.
    echo_trust : (N,) or (1,) ndarray of float32
        The trust in single echoes as a sign of a roof, from 0 to 1; 0 where the source has no echoes.
    ndvi : (N,) ndarray of float32, optional
        NaN where a point has none.
    noise_m : (N,) ndarray of float32, optional
        What noise adds to the residuals of planes, metres.
    place : (N,) ndarray of int64
        Row-major number of the point's cell on the lattice.
    spacing_m : float
        Mean spacing of the first echoes, 1/sqrt(density).
    typical_m : float
        Median of their spacing over the covered ground.
    step_m : float
        Least length of a step that reaches other points on all sides, also from one scan line to the next.
    """

    index: NDArray[np.int64]
    x: Floats
    y: Floats
    z: Floats
    origin: Floats
    heights: Floats
    area_m2: Floats
    split: NDArray[np.bool_] | None
    echo_trust: NDArray[np.float32]
    ndvi: NDArray[np.float32] | None
    noise_m: NDArray[np.float32] | None
    place: NDArray[np.int64]
    spacing_m: float
    typical_m: float
    step_m: float

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.x)

    def placed(self, spec: GridSpec, survey: str) -> PlacedPoints:
        """Return the points on a survey's lattice."""
        return PlacedPoints(self.x, self.y, self.origin, self.area_m2, self.place, spec, survey + KIND)


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceEvidence:
    """The surface around each point, as (N,) ndarrays of float32 from 0 to 1.

    Parameters
    ----------
    level : ndarray
        Mean degree to which the points around lie on planes, of those with neighbours enough for one.
    split : ndarray
        Share of the points around that are of pulses with several echoes, as far as these suggest leaves, and as a
        sensor of full trust would have split them (`msbdb.surveyplan.usual_split`); 0 where the source has no echoes.
    """

    level: NDArray[np.float32]
    split: NDArray[np.float32]


def off_ground(
    cloud: PointCloud,
    heights: Floats,
    ndvi: NDArray[np.float32] | None,
    noise_m: NDArray[np.float32] | None,
    *,
    recorded: NDArray[np.float32] | None = None,
    spec: GridSpec,
    mask_m: float,
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
    let_go()
    density = measure_density(cloud.x, cloud.y, cloud.first_echo, cloud.facts)
    chosen = np.flatnonzero(heights >= mask_m)
    area_m2 = density.area_m2[chosen]
    density = replace(density, area_m2=area_m2)  # of the others nobody asks
    order = _canonical(cloud, heights, ndvi, chosen)
    chosen, area_m2, heights = chosen[order], set_aside(area_m2[order]), set_aside(heights[chosen][order])
    x, y = cloud.x[chosen], cloud.y[chosen]
    origin = np.round([float(v.mean()) if len(v) else 0.0 for v in (x, y)], -3)
    trust = cloud.echo_trust(heights)
    if recorded is not None:
        trust = trust * recorded[chosen]
    return OffGround(
        index=set_aside(chosen),
        x=set_aside(x - origin[0]),
        y=set_aside(y - origin[1]),
        z=set_aside(cloud.z[chosen]),
        origin=origin,
        heights=heights.astype(np.float64, copy=False),
        area_m2=area_m2,
        split=None if not cloud.has_echoes else np.greater(cloud.number_of_returns[chosen], 1),  # type: ignore[index]  # there are echoes
        echo_trust=set_aside(trust),
        ndvi=None if ndvi is None else ndvi[chosen].astype(np.float32),
        noise_m=None if noise_m is None else noise_m[chosen],
        place=set_aside(places(spec, x, y)),
        spacing_m=density.spacing_m,
        typical_m=density.typical_m,
        step_m=density.step_m,
    )


def _canonical(
    cloud: PointCloud, heights: Floats, ndvi: NDArray[np.float32] | None, chosen: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return the order of chosen points by x and y, then by z and all else where points share a place in plan."""
    known = [cloud.z, cloud.return_number, cloud.number_of_returns, heights, ndvi]
    ties = [set_aside(values[chosen]) for values in known if values is not None]
    let_go()
    return np.asarray(order_of_points(cloud.x[chosen], cloud.y[chosen], ties), dtype=np.int64)


def structure(points: OffGround, params: AdaptiveParams) -> SurfaceEvidence:
    """Measure planes in a small sphere around each point, then the means of planes and echoes in a wider disc.

    Points with too few neighbours for a plane do not count in the mean of the planes: strips of a scanner leave gaps.
    The sphere is wide enough for planes on most of the ground, also where a dense strip raises the mean density, and
    reaches the next scan line: the points of one line always lie on some plane.
    Split echoes count in full up to ``leaf_level``, and not at all from ``glass_level`` on: such planes are glass or
    nets. They count for more where a sensor splits fewer pulses. Among points more than 1 m apart a sphere spans
    several planes of a roof, so that ``level_m`` grows with them.
    """
    enough_m = math.sqrt(PLANE_POINTS / math.pi) * points.typical_m
    small_m = max(params.surface_factor * points.spacing_m, params.surface_least_m, enough_m, points.step_m)
    wide_m = max(params.around_factor * points.spacing_m, params.around_least_m)
    residuals = plane_residuals(points.x, points.y, points.z, small_m)
    level_m = np.full(1, params.level_m * small_m**SPHERE_POWER, dtype=np.float32)
    if points.noise_m is not None:
        residuals = without_noise(residuals, points.noise_m)
        level_m = np.hypot(level_m, NOISE_LEFT * points.noise_m)
    values = np.zeros((len(points), 3), dtype=np.float32)
    values[:, 0] = _degree(residuals, level_m)
    values[:, 1] = np.isfinite(residuals)
    if points.split is not None:
        values[:, 2] = points.split
    around = means_around(points.x, points.y, values, wide_m)
    level = around[:, 0] / np.maximum(around[:, 1], np.float32(1e-6))
    # For glass a plane must be seen: here points without a plane count against it.
    leafy = (params.glass_level - around[:, 0]) / (params.glass_level - params.leaf_level)
    split = usual_split(around[:, 2], points.echo_trust)
    return SurfaceEvidence(level.astype(np.float32), split * np.clip(leafy, 0, 1).astype(np.float32))


def classify_vegetation(points: OffGround, found: SurfaceEvidence, params: AdaptiveParams) -> NDArray[np.int8]:
    """Return for each point `GREEN`, `SCATTERED`, or 0 for what may be a roof.

    Green points are vegetation, unless their surroundings are as level as only a planted roof is. Other points are
    vegetation where their surroundings scatter: by log-odds of the level share and the share of split echoes (ours;
    the slides have colours, and a sensor of up to four echoes, S8). The less single echoes are trusted, the more the
    level share has to decide.
    """
    trust = points.echo_trust
    bias = trust * params.bias + (1 - trust) * params.blind_bias
    level_weight = trust * params.level_weight + (1 - trust) * params.blind_level_weight
    odds = bias + level_weight * found.level - params.split_weight * found.split
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


def _degree(residual_m: NDArray[np.float32], level_m: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the degree to which residuals are level: 1 up to half of ``level_m``, 0 from twice of it.

    Examples
    --------
    In between the degree falls evenly in the logarithm:

    >>> _degree(np.float32([0.05, 0.1, 0.2, 0.4]), np.float32([0.1]))
    array([1. , 0.5, 0. , 0. ], dtype=float32)
    """
    with np.errstate(divide="ignore"):
        octaves = np.log2(residual_m / level_m)
    return np.asarray(np.clip((1 - octaves) / 2, 0, 1), dtype=np.float32)

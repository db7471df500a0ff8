"""Copies of a cloud as another sensor would have recorded it: fewer pulses or more, noise, first echoes only, or no classes."""

import itertools
import tempfile
from collections.abc import Sequence
from pathlib import Path

import laspy
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_closing, binary_dilation
from scipy.spatial import KDTree

from msbdb.io.crs import CrsLike
from msbdb.io.las import read_points
from msbdb.labels import label_zones, sizes
from msbdb.points.cloud import BUILDING_CLASS, GROUND_CLASS, UNCLASSIFIED_CLASS, PointCloud

SEED = 1
SHAKE_M = 0.02
"""Noise in height of repeated points."""

RAZE_M = 0.5
"""Cells on which houses are razed."""

LEAST_HOUSE_M2 = 30.0
"""Smaller houses are razed in any case."""

LOW_M = 0.3
"""Echoes up to this height above the ground of a razed house stay where they are."""

NEAREST = 8
"""The ground of a razed house is a mean of so many echoes around it, by their distance."""

FOOT_M, LEAST_WALL_M = 1.0, 2.5
"""A wall stands where an echo of the ground lies within the first of one of a roof, and lower by the second, metres."""

INWARD_M, OUTWARD_M = 0.05, 0.1
"""How far echoes of a wall lie from the roof's echo above it, towards the roof and away from it, metres."""

PULSE_TOLERANCE = 0.1
"""Times name pulses where there are as many of them as first echoes, but for this share."""

VIEW_M, HIDING_M, CLEAR_M = 0.75, 40.0, 0.5
"""Side of the squares whose highest echoes hide others, how far away, and by how much above the line of sight, metres."""


def pulses(cloud: laspy.LasData) -> NDArray[np.int64]:
    """Return (N,) the number of each echo's pulse.

    The echoes of a pulse have one time. Where times are missing, shared or changed, each echo is its own pulse.
    """
    times, pulse = np.unique(np.asarray(cloud.gps_time), return_inverse=True)
    first = np.count_nonzero(np.asarray(cloud.return_number) <= 1)
    if abs(len(times) - first) > PULSE_TOLERANCE * first:
        return np.arange(len(cloud.points))
    return np.asarray(pulse, dtype=np.int64)


def thinned(cloud: laspy.LasData, share: float) -> laspy.LasData:
    """Return a share of the pulses, chosen by a fixed seed, with all their echoes."""
    return taken(cloud, _drawn(cloud, share))


def thinned_east_of(cloud: laspy.LasData, x_m: float, share: float) -> laspy.LasData:
    """Return a share of the pulses, as `thinned` does, and all echoes that lie west of a line."""
    return taken(cloud, _drawn(cloud, share) | (np.asarray(cloud.x) < x_m))


def _drawn(cloud: laspy.LasData, share: float) -> NDArray[np.bool_]:
    """Return (N,) bool, the echoes of a share of the pulses, chosen by a fixed seed."""
    pulse = pulses(cloud)
    kept = np.random.default_rng(SEED).random(int(pulse.max(initial=-1)) + 1) < share
    return np.asarray(kept[pulse])


def thickened(cloud: laspy.LasData, target: float, density: float) -> laspy.LasData:
    """Return a copy of so many first echoes a square metre: repeated points, shaken over half of a spacing and 2 cm in height."""
    times, count = round(target / density), len(cloud.points)
    copy = taken(cloud, np.tile(np.arange(count), times))
    random, new = np.random.default_rng(SEED), np.arange(times * count) >= count
    reach = 0.5 * density**-0.5
    copy.x, copy.y = (np.asarray(axis) + new * random.uniform(-reach, reach, new.size) for axis in (copy.x, copy.y))
    copy.z = np.asarray(copy.z) + new * random.normal(0, SHAKE_M, new.size)
    return copy


def on_lines(cloud: laspy.LasData, ratio: float, spacing_m: float) -> laspy.LasData:
    """Return the echoes of bands one spacing wide and ``ratio`` spacings apart, as scan lines from west to east."""
    return taken(cloud, np.asarray(cloud.y) / (ratio * spacing_m) % 1 < 1 / ratio)


def shaken(cloud: laspy.LasData, *, plan_m: float = 0.0, height_m: float = 0.0) -> laspy.LasData:
    """Return a copy whose echoes each lie beside their places, along each axis in plan and in height, by normal noise."""
    copy, random = copied(cloud), np.random.default_rng(SEED)
    for axis, sigma in (("x", plan_m), ("y", plan_m), ("z", height_m)):
        copy[axis] = np.asarray(cloud[axis]) + random.normal(0, sigma, len(cloud.points))
    return copy


def of_two_strips(cloud: laspy.LasData, *, aside_m: float, up_m: float) -> laspy.LasData:
    """Return a copy in which half of the pulses lie higher and to the east, as where two strips do not fit."""
    copy = copied(cloud)
    other = _drawn(cloud, 0.5)
    copy.x, copy.z = np.asarray(cloud.x) + aside_m * other, np.asarray(cloud.z) + up_m * other
    return copy


def with_echoes_on_walls(cloud: laspy.LasData, share: float, density: float) -> laspy.LasData:
    """Return a copy of a tile with classes and with single echoes on its walls, as oblique sensors record them.

    Parameters
    ----------
    cloud : LasData
        With classes of ground and of roofs.
    share : float
        Echoes a square metre of wall, per first echo a square metre of ground.
    density : float
        First echoes a square metre of ground.
    """
    places, classes = np.column_stack((cloud.x, cloud.y, cloud.z)), np.asarray(cloud.classification)
    ground = np.flatnonzero(classes == GROUND_CLASS)
    roofs = np.flatnonzero((classes == BUILDING_CLASS) & (np.asarray(cloud.return_number) <= 1))
    spacing_m = density**-0.5
    reach_m = max(FOOT_M, 1.5 * spacing_m)
    distance, nearest = KDTree(places[roofs, :2]).query(places[ground, :2], distance_upper_bound=reach_m)
    near = np.flatnonzero(np.isfinite(distance))
    near = near[np.argsort(distance[near], kind="stable")]
    # Each echo at the edge of a roof stands for one spacing of wall, above the ground that is nearest to it.
    edges, first = np.unique(roofs[nearest[near]], return_index=True)
    feet = ground[near[first]]
    high = places[edges, 2] - places[feet, 2] > LEAST_WALL_M
    edges, feet = edges[high], feet[high]
    random = np.random.default_rng(SEED)
    of = np.repeat(
        np.arange(edges.size), random.poisson(share * density * spacing_m * (places[edges, 2] - places[feet, 2]))
    )
    away = places[feet, :2] - places[edges, :2]
    away /= np.maximum(np.hypot(*away.T), 0.1)[:, None]
    new = np.empty((of.size, 3))
    new[:, :2] = places[edges[of], :2] + random.uniform(-INWARD_M, OUTWARD_M, (of.size, 1)) * away[of]
    new[:, 2] = random.uniform(places[feet[of], 2], places[edges[of], 2])
    count = len(cloud.points)
    copy = taken(cloud, np.concatenate((np.arange(count), edges[of])))
    copy.x, copy.y, copy.z = np.concatenate((places, new)).T
    for name in ("return_number", "number_of_returns"):
        echo = np.asarray(copy[name]).copy()
        echo[count:] = 1
        copy[name] = echo
    return copy


def seen_from_aside(cloud: laspy.LasData, slope: float, azimuth_deg: float) -> laspy.LasData:
    """Return a copy without the pulses that buildings hide from a single strip that looks aside.

    Parameters
    ----------
    cloud : LasData
        In metres, with classes of roofs.
    slope : float
        Tangent of the angle of view off the nadir: what stands H metres high hides this many times H.
    azimuth_deg : float
        Where the sensor flies, degrees from north to the east.

    Notes
    -----
    The highest echoes of roofs in squares of `VIEW_M` hide the first echoes behind them. Crowns hide nothing, as pulses
    go through them. A pulse goes as a whole.
    """
    x, y, z = (np.asarray(cloud[axis], dtype=np.float64) for axis in "xyz")
    col, row = (((axis - axis.min()) / VIEW_M).astype(np.int64) for axis in (x, y))
    highest = np.full((row.max() + 1, col.max() + 1), -np.inf)
    roofs = np.asarray(cloud.classification) == BUILDING_CLASS
    np.maximum.at(highest, (row[roofs], col[roofs]), z[roofs])
    east, north = np.sin(np.radians(azimuth_deg)), np.cos(np.radians(azimuth_deg))
    hidden, first = np.zeros(len(x), dtype=bool), np.asarray(cloud.return_number) <= 1
    for away_m in np.arange(2 * VIEW_M, HIDING_M, VIEW_M):
        there_col, there_row = (
            np.floor((axis + away_m * step - axis.min()) / VIEW_M).astype(np.int64)
            for axis, step in ((x, east), (y, north))
        )
        inside = (there_row >= 0) & (there_row < len(highest)) & (there_col >= 0) & (there_col < highest.shape[1])
        top_m = highest[there_row[inside], there_col[inside]]
        hidden[inside] |= top_m > z[inside] + away_m / slope + CLEAR_M
    of = pulses(cloud)
    return taken(cloud, ~np.isin(of, of[hidden & first]))


def with_outliers(cloud: laspy.LasData, share: float, low_m: float, high_m: float) -> laspy.LasData:
    """Return a copy in which a share of the echoes lies anywhere from so far below its place to so far above."""
    copy, random = copied(cloud), np.random.default_rng(SEED)
    chosen = random.random(len(cloud.points)) < share
    copy.z = np.asarray(cloud.z) + chosen * random.uniform(-low_m, high_m, len(cloud.points))
    return copy


def razed(cloud: laspy.LasData, kept_share: float) -> laspy.LasData:
    """Return a copy of a tile with classes in which most houses are gone: single echoes of bare ground are in their place.

    Houses are connected roofs. They are kept in an order by chance until they cover this share of all roofs.
    """
    x, y, z = (np.asarray(cloud[axis], dtype=np.float64) for axis in "xyz")
    classes, random = np.asarray(cloud.classification), np.random.default_rng(SEED)
    row, col = (((axis - axis.min()) / RAZE_M).astype(np.intp) for axis in (y, x))
    roofs = np.zeros((row.max() + 1, col.max() + 1), dtype=np.bool_)
    roofs[row[classes == BUILDING_CLASS], col[classes == BUILDING_CLASS]] = True
    houses, count = label_zones(roofs | binary_closing(roofs, iterations=2))
    area_m2 = sizes(houses, count) * RAZE_M**2
    order = random.permutation(np.flatnonzero(area_m2 >= LEAST_HOUSE_M2))
    kept, left_m2 = np.zeros(count + 1, dtype=np.bool_), kept_share * area_m2.sum()
    for house in order.tolist():
        kept[house + 1] = area_m2[house] <= left_m2
        left_m2 -= area_m2[house] * kept[house + 1]
    stays = kept[houses]
    gone = np.flatnonzero((binary_dilation((houses > 0) & ~stays, iterations=2) & ~stays)[row, col])
    bare = classes == GROUND_CLASS
    far, near = KDTree(np.column_stack((x, y))[bare]).query(np.column_stack((x, y))[gone], k=NEAREST)
    ground = np.average(z[bare][near], axis=1, weights=1 / (far + 0.1)) + random.normal(0, SHAKE_M, len(gone))
    high = z[gone] > ground + LOW_M
    ground, gone = ground[high], gone[high]
    copy = copied(cloud)
    z[gone] = ground
    copy.z = z
    copy.classification[gone], copy.number_of_returns[gone] = GROUND_CLASS, 1
    later = np.zeros(len(z), dtype=np.bool_)
    later[gone] = np.asarray(cloud.return_number)[gone] > 1
    return taken(copy, ~later)


def mirrored(cloud: laspy.LasData, times: int) -> laspy.LasData:
    """Return a cloud side by side ``times`` times along both axes; every second copy is mirrored, so that edges meet."""
    parts = []
    for column, row in itertools.product(range(times), repeat=2):
        copy = copied(cloud)
        for name, number in (("X", column), ("Y", row)):
            axis = np.asarray(cloud[name], dtype=np.int64)
            side, place = axis.max() - axis.min() + 1, axis - axis.min()
            copy[name] = (axis.min() + number * side + (side - 1 - place if number % 2 else place)).astype(np.int32)
        parts.append(copy.points.array)
    record = laspy.ScaleAwarePointRecord(
        np.concatenate(parts), cloud.point_format, cloud.header.scales, cloud.header.offsets
    )
    return laspy.LasData(cloud.header, record)


def first_only(cloud: laspy.LasData) -> laspy.LasData:
    """Return what a sensor of one echo records: the first one of each pulse, numbered 1 of 1."""
    copy = taken(cloud, np.asarray(cloud.return_number) <= 1)
    copy.return_number = np.ones(len(copy.points), dtype=np.uint8)
    copy.number_of_returns = np.ones(len(copy.points), dtype=np.uint8)
    return copy


def with_fewer_later(cloud: laspy.LasData, share: float) -> laspy.LasData:
    """Return what a weaker sensor records: a share of the pulses keeps its later echoes, the others their first one."""
    drawn, first = _drawn(cloud, share), np.asarray(cloud.return_number) <= 1
    copy = taken(cloud, drawn | first)
    copy.number_of_returns = np.where(drawn, np.asarray(cloud.number_of_returns), 1).astype(np.uint8)[drawn | first]
    return copy


def with_echoes_apart(cloud: laspy.LasData, least_m: float) -> laspy.LasData:
    """Return what a sensor records that separates echoes of a pulse only so many metres below one another."""
    pulse, z, number = pulses(cloud), np.asarray(cloud.z), np.asarray(cloud.return_number)
    last, count = (
        np.full(int(pulse.max(initial=-1)) + 1, -np.inf),
        np.zeros(int(pulse.max(initial=-1)) + 1, dtype=np.uint8),
    )
    kept, own = np.zeros(len(z), dtype=np.bool_), np.ones(len(z), dtype=np.uint8)
    for order in np.unique(number).tolist():
        at = np.flatnonzero(number == order)
        at = at[(order <= 1) | (last[pulse[at]] - z[at] >= least_m)]
        kept[at], last[pulse[at]] = True, z[at]
        count[pulse[at]] += 1
        own[at] = count[pulse[at]]
    copy = taken(cloud, kept)
    copy.return_number, copy.number_of_returns = own[kept], count[pulse][kept]
    return copy


def of_two_sensors(cloud: laspy.LasData, other: laspy.LasData, x_m: float) -> laspy.LasData:
    """Return the points of another copy west of a line, and those of the cloud itself east of it."""
    west, east = taken(other, np.asarray(other.x) < x_m), taken(cloud, np.asarray(cloud.x) >= x_m)
    both = laspy.LasData(cloud.header)
    header, points = cloud.header, np.concatenate([west.points.array, east.points.array])
    both.points = laspy.ScaleAwarePointRecord(points, header.point_format, header.scales, header.offsets)
    return both


def with_class_alone(cloud: laspy.LasData, kept: int | None) -> laspy.LasData:
    """Return a copy in which all points are unclassified, but for those of one class."""
    copy = copied(cloud)
    classes = np.asarray(cloud.classification)
    copy.classification = np.where(classes == kept, classes, UNCLASSIFIED_CLASS).astype(np.uint8)
    return copy


def copied(cloud: laspy.LasData) -> laspy.LasData:
    """Return a copy of all points."""
    return laspy.LasData(cloud.header, cloud.points.copy())


def taken(cloud: laspy.LasData, chosen: NDArray[np.generic]) -> laspy.LasData:
    """Return a copy of the chosen points, by mask or number."""
    return laspy.LasData(cloud.header, cloud.points[chosen].copy())


def as_cloud(clouds: Sequence[laspy.LasData], crs: CrsLike | None) -> PointCloud:
    """Return the points of files as one cloud, with their classes, as msbdb reads them."""
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder) / f"{number}.las" for number in range(len(clouds))]
        for cloud, file in zip(clouds, files, strict=True):
            cloud.write(file)
        return read_points(files, crs=crs)

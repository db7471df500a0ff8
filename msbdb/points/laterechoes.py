"""Later echoes among points without numbers: points that lie under others on all sides."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from msbdb.points.cellindex import MARGIN, CellIndex, cell_place, index_cells, parts_of, strip
from msbdb.points.cloud import PointCloud
from msbdb.points.lots import drawn
from msbdb.points.spacing import measure_spacing
from msbdb.threads import in_threads, kernel

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

BELOW_M = 1.0
"""A point lies under others that are so much higher: more than steps of roofs and crowns' own leaves."""

AROUND_SPACINGS = 2.0
"""Others are looked for within so many mean spacings of all points."""

SAMPLE_SPACING_M = 1.0
"""Denser points are thinned to this spacing to find out whether later echoes are among them."""

MIXED_SHARE = 0.23
"""Ours, in sample: later echoes are there where more of the points in uneven places lie under others on all sides. All
echoes of nine places have 0.20 to 0.40, and their first echoes alone 0.15 to 0.21."""

SECTORS, EMPTY = 12, 5
"""Of so many sectors around a point, so many beside each other may hold no higher point: about half a circle."""


def under_distance(cloud: PointCloud) -> float:
    """Return the distance within which later echoes lie under others, metres; 0 without any, or if they are known.

    Parameters
    ----------
    cloud : PointCloud
        A whole survey. Where its file numbers the echoes, it is believed, also where all are single ones.

    Notes
    -----
    A pulse that gives one echo passes through a crown by chance alone. With all echoes of all pulses, most points of a
    crown are later ones. So the share of points under others is taken over the points of uneven places: those
    with a neighbour higher or lower by `BELOW_M`. Walls count less, as others stand on one side of them alone.
    """
    if cloud.return_number is not None or not len(cloud):
        return 0.0
    spacing_m = _all_spacing(cloud)
    sample = cloud.take(drawn(cloud, (spacing_m / SAMPLE_SPACING_M) ** 2))
    under, uneven = _placed(sample, AROUND_SPACINGS * max(spacing_m, SAMPLE_SPACING_M))
    return AROUND_SPACINGS * spacing_m if under.sum() > MIXED_SHARE * uneven.sum() else 0.0


def numbered_by_place(cloud: PointCloud, around_m: float) -> PointCloud:
    """Return a cloud in which points under others are later echoes, of pulses of unknown number; all others are first.

    So the surface is that of the upper points, and echoes are no evidence for or against vegetation.

    Examples
    --------
    Of a crown over ground, what lies under leaves on all sides is a later echo:

    >>> from pyproj import CRS
    >>> x, y = (place.ravel() for place in np.meshgrid(np.arange(5.0), np.arange(5.0)))
    >>> z = np.where((x == 2) & (y == 2), 0.0, 9.0)
    >>> numbered_by_place(PointCloud(x, y, z, CRS.from_epsg(2154)), 2.0).first_echo.reshape(5, 5)[2]
    array([ True,  True, False,  True,  True])
    """
    under, _ = _placed(cloud, around_m)
    number, of = np.where(under, 2, 1).astype(np.uint8), np.ones(len(cloud), dtype=np.uint8)
    return replace(cloud, return_number=number, number_of_returns=of)


def _all_spacing(cloud: PointCloud) -> float:
    """Return the mean spacing of all points, metres."""
    return measure_spacing(cloud.x, cloud.y, np.ones(len(cloud), dtype=np.bool_))[0]


def _placed(cloud: PointCloud, around_m: float) -> tuple[Mask, Mask]:
    """Return which points lie under others on all sides, and which have a much higher or lower one near."""
    index = index_cells(cloud.x, cloud.y, around_m * (1 + MARGIN))
    places = (cloud.x[index.order], cloud.y[index.order], cloud.z[index.order])
    under, uneven = (np.zeros(len(cloud), dtype=np.bool_) for _ in range(2))
    in_threads(lambda part: _look_around(index, places, around_m, part, (under, uneven)), parts_of(index))
    return under, uneven


@kernel
def _look_around(
    index: CellIndex,
    places: tuple[Floats, Floats, Floats],
    around_m: float,
    part: tuple[int, int],
    found: tuple[Mask, Mask],
) -> None:
    """Fill in what lies around the points of a part of the cells; the places come in the order of the cells."""
    x, y, z = places
    under, uneven = found
    limit = around_m * around_m
    held = np.zeros(2 * SECTORS, dtype=np.bool_)
    for cell in range(part[0], part[1]):
        row, col = cell_place(index, cell)
        strips = [strip(index, other, col - 1, col + 1) for other in range(row - 1, row + 2)]
        for point in range(index.starts[cell], index.starts[cell + 1]):
            held[:] = False
            higher, lower = False, False
            for first, stop in strips:
                for other in range(first, stop):
                    rise = z[other] - z[point]
                    if abs(rise) <= BELOW_M:
                        continue
                    dx, dy = x[other] - x[point], y[other] - y[point]
                    if dx * dx + dy * dy > limit:
                        continue
                    if rise < 0:
                        lower = True
                        continue
                    higher = True
                    sector = int((math.atan2(dy, dx) / math.pi + 1) / 2 * SECTORS) % SECTORS
                    held[sector] = held[sector + SECTORS] = True
            place = index.order[point]
            uneven[place] = higher or lower
            if higher:
                empty, most = 0, 0
                for sector in range(2 * SECTORS):
                    empty = 0 if held[sector] else empty + 1
                    most = max(most, empty)
                under[place] = most <= EMPTY

"""Clusters as rows: ids, attributes, and the ledger of what was rejected."""

import numpy as np
import pandas as pd
import shapely

from msbdb.extract.adaptive.points import Floats, OffGround
from msbdb.extract.placed import PlacedPoints
from msbdb.labels import HeightOrder, Labels, height_statistics, region_means, sizes
from msbdb.tables import CANDIDATE_REGION

METHOD = "adaptive"
RULE = "clustering"


def describe(points: OffGround, labels: Labels, count: int, placed: PlacedPoints) -> pd.DataFrame:
    """Return the rows of labelled regions (``tables.CANDIDATE_REGION``, without geometry), in the labels' order.

    No edge points are sought: the perimeter is 0, and compactness, linearity and directions are not known.
    """
    inside = np.flatnonzero(labels)
    order = inside[np.argsort(points.heights[inside], kind="stable")]
    statistics = height_statistics(labels, slice(0, count), HeightOrder(order.astype(np.int32), points.heights[order]))
    area = placed.areas(labels, count)
    mbr = bounding_rectangles(points, labels, count)
    xcen, ycen = placed.centroids(labels, count)
    unknown = np.full(count, np.nan)
    rows = pd.DataFrame(
        {
            "candidate_id": placed.ids(labels, count),
            "method": METHOD,
            "rule": RULE,
            "height_scale_m": unknown,
            "points": sizes(labels, count),
            "area_m2": area,
            "perimeter": 0,
            "mbr_m2": mbr,
            "rectangularity": area / mbr,
            "compactness": unknown,
            "linearity": unknown,
            "direction_1": unknown,
            "direction_2": unknown,
            "ndvi": unknown if points.ndvi is None else region_means(points.ndvi, labels, count),
            **{name: statistics[name].to_numpy() for name in statistics.columns},
            "xcen": xcen,
            "ycen": ycen,
        }
    )
    return CANDIDATE_REGION.typed(rows)


def bounding_rectangles(points: OffGround, labels: Labels, count: int) -> Floats:
    """Return the areas of the minimum bounding rectangles, m2.

    Rectangles reach half a spacing beyond the points, as the areas do, so that points in a row have one.
    """
    if not count:
        return np.zeros(0)
    inside = np.flatnonzero(labels)
    order = inside[np.argsort(labels[inside], kind="stable")]
    # As lines, which shapely builds faster than points; each begins with its first point twice, for it needs two.
    first = np.flatnonzero(np.diff(labels[order], prepend=0))
    order = np.insert(order, first, order[first])
    lines = shapely.linestrings(np.column_stack((points.x[order], points.y[order])), indices=labels[order] - 1)
    hulls = shapely.buffer(shapely.convex_hull(lines), points.spacing_m / 2, join_style="mitre", cap_style="square")
    return np.asarray(shapely.area(shapely.minimum_rotated_rectangle(hulls)))

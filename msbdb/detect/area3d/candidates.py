"""Candidate regions as rows: ids, attributes, and the ledger of what was rejected."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from msbdb.detect.area3d.regionshape import Shapes
from msbdb.detect.pointregions import PlacedPoints
from msbdb.grid import GridSpec
from msbdb.labels import HeightOrder, Labels, height_statistics, region_means
from msbdb.tables import CANDIDATE_REGION

METHOD = "area3d"

KIND = "\0area3d"
"""Follows the survey's name in the ids' keys, so that no region has the id of a part at the same place."""

STAGES = ("fusion", "opening", "curvature", "crowns", "rules")
"""The stages that reject regions, in order."""


@dataclass(frozen=True, slots=True, eq=False)
class NormalisedCloud:
    """The points in canonical order, as the steps take them.

    Parameters
    ----------
    points : (N, 3) ndarray of float64, metres
        From an origin at a whole kilometre nearby.
    heights : (N,) ndarray of float64, metres
        Above ground.
    area_m2 : (N,) ndarray of float64
        Area that each point stands for.
    several : (N,) ndarray of bool, optional
        Which points are of pulses with several echoes; None where nothing is known of echoes.
    ndvi : (N,) ndarray of float64, optional
        NaN where a point has none.
    place : (N,) ndarray of int64
        Row-major number of the point's cell on the lattice.
    origin : (2,) ndarray of float64
        Easting and northing of the points' origin.
    """

    points: NDArray[np.float64]
    heights: NDArray[np.float64]
    area_m2: NDArray[np.float64]
    several: NDArray[np.bool_] | None
    ndvi: NDArray[np.float64] | None
    place: NDArray[np.int64]
    origin: NDArray[np.float64]

    def placed(self, spec: GridSpec, survey: str) -> PlacedPoints:
        """Return the points on a survey's lattice."""
        x, y = self.points[:, 0], self.points[:, 1]
        return PlacedPoints(x, y, self.origin, self.area_m2, self.place, spec, survey + KIND)


def describe_candidates(
    cloud: NormalisedCloud,
    labels: Labels,
    shapes: Shapes,
    *,
    placed: PlacedPoints,
    rule: NDArray[np.int8],
    height_scale_m: NDArray[np.float64],
) -> pd.DataFrame:
    """Return the rows of accepted regions (``tables.CANDIDATE_REGION``, without geometry), in the labels' order.

    Parameters
    ----------
    labels : (N,) ndarray of int32
        1 to M without a gap; 0 for none.
    shapes : Shapes
        Of the M regions.
    placed : PlacedPoints
        The same points on the lattice.
    rule : (M,) ndarray of int8
        The rule that accepted each.
    height_scale_m : (M,) ndarray of float64
        The lowest height scale at which it was accepted.
    """
    count = len(rule)
    inside = np.flatnonzero(labels > 0)
    order = inside[np.argsort(cloud.heights[inside], kind="stable")]
    statistics = height_statistics(labels, slice(0, count), HeightOrder(order.astype(np.int32), cloud.heights[order]))
    xcen, ycen = placed.centroids(labels, count)
    rows = pd.DataFrame(
        {
            "candidate_id": placed.ids(labels, count),
            "method": METHOD,
            "rule": np.array(["", "rule 1", "rule 2"], dtype=object)[rule],
            "height_scale_m": height_scale_m,
            "points": shapes.points,
            "area_m2": shapes.area_m2,
            "perimeter": shapes.perimeter,
            "mbr_m2": shapes.mbr_m2,
            "rectangularity": shapes.rectangularity,
            "compactness": shapes.compactness,
            "linearity": shapes.linearity,
            "direction_1": shapes.directions[:, 0],
            "direction_2": shapes.directions[:, 1],
            "ndvi": np.nan if cloud.ndvi is None else region_means(cloud.ndvi, labels, count),
            **{name: statistics[name].to_numpy() for name in statistics.columns},
            "xcen": xcen,
            "ycen": ycen,
        }
    )
    return CANDIDATE_REGION.typed(rows)

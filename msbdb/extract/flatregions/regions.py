"""Flat regions as rows: ids, attributes, and the ledger of what was rejected."""

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from msbdb.extract.books import Books
from msbdb.extract.flatregions.binarise import Binarised
from msbdb.extract.flatregions.recognise import measure_shapes
from msbdb.grid import Grid, GridSpec
from msbdb.identity import part_ids
from msbdb.labels import Labels, centroids, height_statistics, label_zones, measure, order_heights, shared_cells, sums
from msbdb.tables import FLAT_REGION, REJECTION

KIND = "\0flat region"
"""Follows the survey's name in the ids' keys, so that no region has the id of a part at the same place."""

METHOD = "flatregions"

STAGES = ("denoising", "ratio", "opening", "compactness")
"""The stages that reject regions, in order."""


class FlatBooks(Books):
    """The books of the flat regions: lost regions of cells become ``tables.REJECTION``."""

    def __init__(self, spec: GridSpec, survey: str) -> None:
        super().__init__(METHOD)
        self.spec, self.survey = spec, survey

    def reject(self, stage: str, reason: str, regions: NDArray[np.bool_] | Labels) -> int:
        """Write the 8-connected regions of a mask, or those of labels, into the ledger, a row each; return how many."""
        labels, count = label_zones(regions)
        table = measure(labels, count)
        xcen, ycen = centroids(table, self.spec)
        rows = pd.DataFrame(
            {
                "region_id": region_ids(table, self.spec, self.survey, stage=1 + STAGES.index(stage)),
                "reason": reason,
                "scale": 0,
                "area_m2": table["area"] * self.spec.cell_area_m2,
                "xcen": xcen,
                "ycen": ycen,
            }
        )
        return self.write(stage, rows)

    def rejections(self) -> pd.DataFrame:
        """Return all lost regions in the order of the stages."""
        return REJECTION.typed(self.lost(REJECTION.empty()))


def describe(labels: Labels, binarised: Binarised, heights: Grid, survey: str) -> pd.DataFrame:
    """Return the rows of labelled flat regions (``tables.FLAT_REGION``, without geometry).

    Parameters
    ----------
    labels : (H, W) ndarray of int32
        1 to N without a gap; 0 for none.
    binarised : Binarised
        Zones and gradients of the cells.
    heights : Grid
        Heights above ground, metres.
    survey : str
        Name of the survey; part of the ids.

    Notes
    -----
    Closing and growth add cells that are in no flat component, and joined components may be of several zones: the
    zone of a region is that of most of its cells that have one, the larger of equal ones.
    """
    spec = heights.spec
    count = int(labels.max(initial=0))
    table = measure(labels, count)
    inside = labels > 0
    gradient_sum = sums(labels[inside], binarised.gradient[inside].astype(np.float64), count)
    zone = most_frequent_zone(labels, binarised.zones, count)
    shapes = measure_shapes(labels, spec.cell_m)
    statistics = height_statistics(labels, slice(0, count), order_heights(heights, inside))
    xcen, ycen = centroids(table, spec)
    rows = pd.DataFrame(
        {
            "region_id": region_ids(table, spec, survey),
            "zone": zone,
            "lambda_low_m2": binarised.thresholds[np.maximum(zone - 1, 0)],
            "lambda_m2": binarised.thresholds[zone],
            "gradient_sum": gradient_sum * spec.cell_area_m2,
            "mean_gradient": gradient_sum / np.maximum(table["area"].to_numpy(), 1),
            **{name: shapes[name].to_numpy() for name in shapes.columns},
            **{name: statistics[name].to_numpy() for name in statistics.columns},
            "xcen": xcen,
            "ycen": ycen,
        }
    )
    return FLAT_REGION.typed(rows)


def most_frequent_zone(labels: Labels, zones: NDArray[np.int32], count: int) -> NDArray[np.int64]:
    """Return the zone of most of the cells of each region that have one, the larger of equal ones; 0 without any."""
    label, zone, cells = shared_cells(labels, zones)
    order = np.lexsort((zone, cells, label))
    found = np.zeros(count + 1, dtype=np.int64)
    found[label[order]] = zone[order]  # the last of each label is its most frequent one
    return found[1:]


def region_ids(table: pd.DataFrame, spec: GridSpec, survey: str, *, stage: int = 0) -> NDArray[np.int64]:
    """Return ids of measured regions from their first cells; those that a stage rejected have ids of their own."""
    row, col = np.divmod(table["first"].to_numpy().astype(np.int64), spec.shape[1])
    row, col = row + spec.origin[0], col + spec.origin[1]
    return part_ids(survey + KIND, spec.cell_m, threshold_px=0, row=row, col=col, piece=np.full(row.size, stage))

"""Recognition: the shape of flat regions decides, and each region becomes a row (Mongus et al. 2013, section 3.4)."""

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from skimage.measure import regionprops

from msbdb.detect.flatregions.binarisation import Binarised
from msbdb.detect.flatregions.initialisation import window_px
from msbdb.grid import Grid, GridSpec
from msbdb.identity import part_ids
from msbdb.labels import Labels, centroids, height_statistics, label_zones, measure, order_heights, shared_cells, sums
from msbdb.ledger import Ledger
from msbdb.morphology.windows import opening
from msbdb.tables import FLAT_REGION, REJECTION

SIDES = ((-1, 0), (0, -1), (0, 1), (1, 0))
CORNERS = ((-1, -1), (-1, 1), (1, -1), (1, 1))

KIND = "\0flat region"
"""Follows the survey's name in the ids' keys, so that no region has the id of a part at the same place."""

METHOD = "flatregions"

STAGES = ("denoising", "ratio", "leaves", "opening", "compactness")
"""The stages that reject regions, in order."""


class FlatRegionLedger(Ledger):
    """The ledger of the flat regions: lost regions of cells become ``tables.REJECTION``, and their cells are marked."""

    def __init__(self, spec: GridSpec, survey: str, least_m2: float) -> None:
        super().__init__(METHOD, least_m2)
        self.spec, self.survey = spec, survey

    def reject(self, stage: str, reason: str, regions: NDArray[np.bool_] | Labels) -> int:
        """Write the 8-connected regions of a mask, or those of labels, into the ledger, a row each; return how many."""
        labels, count = label_zones(regions)
        table = measure(labels, count)
        xcen, ycen = centroids(table, self.spec)
        area_m2 = table["area"].to_numpy() * self.spec.cell_area_m2
        ids, wanted = np.zeros(count, dtype=np.int64), area_m2 >= self.least_m2
        ids[wanted] = region_ids(table[wanted], self.spec, self.survey, stage=1 + STAGES.index(stage))
        rows = pd.DataFrame(
            {
                "region_id": ids,
                "reason": reason,
                "scale": 0,
                "area_m2": area_m2,
                "xcen": xcen,
                "ycen": ycen,
            }
        )
        cells = np.flatnonzero(labels != 0)
        self.mark(stage, np.full(count, reason, dtype=object), labels.ravel()[cells], cells)
        return self.write(stage, rows)

    def rejections(self) -> pd.DataFrame:
        """Return all dropped regions in the order of the stages."""
        return REJECTION.typed(self.lost(REJECTION.empty()))


def clean(flat: NDArray[np.bool_], size_m: float, cell_m: float) -> NDArray[np.bool_]:
    """Remove thin extensions and fill small holes: Φ_w(Γ_w(G)) with a square w (M19).

    Parameters
    ----------
    flat : (H, W) ndarray of bool
        The set G. Not modified.
    size_m : float
        Side of the window; 3 m in the paper (A14).
    cell_m : float
        Side of a cell.

    Notes
    -----
    Border: what lies outside of the array does not count, so that a roof cut by the border is no thinner for it.
    """
    window = window_px(size_m, cell_m)
    opened = opening(flat.astype(np.float32), window, None)
    return np.asarray(opening(1 - opened, window, None) < 0.5)


def grow(labels: Labels, heights: Grid, *, steps: int, step_m: float, least_m: float) -> Labels:
    """Return labels with the cells at the edges of regions added to them (ours).

    Parameters
    ----------
    labels : (H, W) ndarray of int32
        Regions; 0 for none. Not modified.
    heights : Grid
        Heights above ground of the first echoes, metres.
    steps : int
        How often a ring of cells may be added.
    step_m : float
        Largest difference in height to the cell of the region beside it.
    least_m : float
        Lower cells belong to no region.

    Notes
    -----
    The lowest point of a cell on a roof's edge often lies on the wall or the ground. So roofs are smaller in the
    surface of lowest points than in that of the first echoes. Regions grow in rings, never into each other. A cell
    beside several regions goes to one that shares a side, in row-major order of the neighbours.
    """
    high = np.asarray(heights.values)
    free = np.asarray(heights.valid) & (high >= least_m)
    grown = labels.copy()
    for _ in range(steps):
        before = np.pad(grown, 1)
        beside = np.pad(high, 1)
        for down, right in (*SIDES, *CORNERS):
            window = np.s_[1 + down : before.shape[0] - 1 + down, 1 + right : before.shape[1] - 1 + right]
            joins = free & (grown == 0) & (before[window] > 0) & (np.abs(high - beside[window]) <= step_m)
            grown[joins] = before[window][joins]
    return grown


def measure_shapes(labels: Labels, cell_m: float) -> pd.DataFrame:
    """Return area, perimeter and compactness of labelled regions (Eq. 15; M20).

    Parameters
    ----------
    labels : (H, W) ndarray of int32
        From 1 without a gap; 0 for none.
    cell_m : float
        Side of a cell.

    Returns
    -------
    DataFrame
        ``area_m2``, ``perimeter_m`` and ``compactness``, one row a region in the labels' order.

    Notes
    -----
    Ψ' = P²/(4πA) (A9): 1 for a disc, 1.3 for a square, (a + b)²/(πab) for a rectangle of a by b. P is the Crofton
    estimate over four directions, of outer outlines and holes. Counting cells' edges is up to 41 % too long for
    oblique walls, which doubles Ψ'. The estimate is a few per cent short for walls along the lattice.

    Examples
    --------
    A hall of 8 m by 8 m (exactly P = 32 m, Ψ' = 1.3), and a wall of 2 m by 20 m (P = 44 m, Ψ' = 3.9):

    >>> labels = np.zeros((60, 30), dtype=np.int32)
    >>> labels[2:18, 2:18], labels[2:42, 22:26] = 1, 2
    >>> measure_shapes(labels, 0.5).round(1)
       area_m2  perimeter_m  compactness
    0     64.0         29.8          1.1
    1     40.0         41.2          3.4
    """
    found = regionprops(labels)  # type: ignore[no-untyped-call]  # scikit-image has no types here
    area = np.array([region.area for region in found], dtype=np.float64) * cell_m**2
    perimeter = np.array([region.perimeter_crofton for region in found], dtype=np.float64) * cell_m
    table = pd.DataFrame({"area_m2": area, "perimeter_m": perimeter})
    table["compactness"] = perimeter**2 / (4 * np.pi * area)
    return table


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
    """Return for each region the most frequent zone of its cells, the larger of equal ones; 0 without any.

    Examples
    --------
    >>> labels = np.array([[1, 1, 1, 1, 2, 2]], dtype=np.int32)
    >>> zones = np.array([[2, 2, 5, 0, 1, 4]], dtype=np.int32)
    >>> most_frequent_zone(labels, zones, 2)
    array([2, 4])
    """
    label, zone, cells = shared_cells(labels, zones)
    order = np.lexsort((zone, cells, label))
    found = np.zeros(count + 1, dtype=np.int64)
    found[label[order]] = zone[order]  # the last of each label is its most frequent one
    return found[1:]


def region_ids(table: pd.DataFrame, spec: GridSpec, survey: str, *, stage: int = 0) -> NDArray[np.int64]:
    """Return ids of measured regions from their first cells; rejected regions, of a stage above 0, have their own."""
    row, col = np.divmod(table["first"].to_numpy().astype(np.int64), spec.shape[1])
    row, col = row + spec.origin[0], col + spec.origin[1]
    return part_ids(survey + KIND, spec.cell_m, threshold_px=0, row=row, col=col, piece=np.full(row.size, stage))

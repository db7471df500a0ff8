"""Clusters as rows: ids, attributes, and the ledger of what was rejected."""

import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray

from msbdb.errors import TableError
from msbdb.extract.adaptive.points import PLACES, Floats, Labels, OffGround
from msbdb.extract.multiscale.heights import HeightOrder, height_statistics
from msbdb.grid import GridSpec
from msbdb.identity import part_ids
from msbdb.tables import CANDIDATE_REGION, REJECTION, Table

METHOD = "adaptive"
RULE = "clustering"

KIND = "\0adaptive"
"""Follows the survey's name in the ids' keys, so that no region has the id of a part at the same place."""


class Books:
    """What the stages took in, kept and dropped; and the regions that were lost, to become ``tables.REJECTION``."""

    def __init__(self, points: OffGround, spec: GridSpec, survey: str) -> None:
        self.points, self.spec, self.survey = points, spec, survey
        self.counts: dict[str, dict[str, int]] = {}
        self._lost: list[pd.DataFrame] = [_typed(REJECTION.empty(), REJECTION)]

    def count(self, stage: str, entered: int, kept: int, dropped: int, pieces: int = 0) -> None:
        """Note the numbers of a stage, which cut so many pieces itself; negative where it joined regions.

        To be called when all that the stage rejected is written.

        Raises
        ------
        TableError
            When in = kept + dropped does not hold, or the ledger holds another number of its rows.
        """
        if entered + pieces != kept + dropped:
            msg = (
                f"The stage '{stage}' does not balance: {entered} regions in and {pieces} pieces cut, "
                f"but {kept} kept and {dropped} dropped. This is a fault of msbdb; please report it."
            )
            raise TableError(msg)
        rows = sum(int((frame["stage"] == stage).sum()) for frame in self._lost)
        if rows != dropped:
            msg = (
                f"The stage '{stage}' dropped {dropped} regions, but the ledger has {rows} of them. "
                "This is a fault of msbdb; please report it."
            )
            raise TableError(msg)
        self.counts[stage] = {"in": entered + pieces, "pieces": pieces, "kept": kept, "dropped": dropped}

    def reject(self, stage: str, reasons: NDArray[np.object_], labels: Labels, number: int) -> int:
        """Write labelled clusters into the ledger; return how many.

        Parameters
        ----------
        stage : str
            Its name.
        reasons : (M,) ndarray of str
            One a cluster.
        labels : (N,) ndarray of int32
            1 to M, each with a point; 0 for none.
        number : int
            Number of the stage and kind, from 1; part of the ids.
        """
        count = len(reasons)
        first, piece = first_places(self.points, labels, count)
        xcen, ycen = centroids(self.points, labels, count)
        rows = pd.DataFrame(
            {
                "region_id": region_ids(first, piece, self.spec, self.survey, stage=number),
                "stage": stage,
                "reason": reasons,
                "scale": 0,
                "area_m2": np.bincount(labels, self.points.area_m2, count + 1)[1:],
                "xcen": xcen,
                "ycen": ycen,
            }
        )
        self._lost.append(_typed(rows, REJECTION))
        return count

    def rejections(self) -> pd.DataFrame:
        """Return all lost regions in the order of the stages."""
        return pd.concat([rows for rows in self._lost if len(rows)] or self._lost, ignore_index=True)


def describe(points: OffGround, labels: Labels, count: int, *, spec: GridSpec, survey: str) -> pd.DataFrame:
    """Return the rows of labelled regions (``tables.CANDIDATE_REGION``, without geometry), in the labels' order.

    No edge points are sought: the perimeter is 0, and compactness, linearity and directions are not known.
    """
    inside = np.flatnonzero(labels)
    order = inside[np.argsort(points.heights[inside], kind="stable")]
    statistics = height_statistics(labels, slice(0, count), HeightOrder(order.astype(np.int32), points.heights[order]))
    area = np.bincount(labels, points.area_m2, count + 1)[1:]
    mbr = bounding_rectangles(points, labels, count)
    first, piece = first_places(points, labels, count)
    xcen, ycen = centroids(points, labels, count)
    unknown = np.full(count, np.nan)
    rows = pd.DataFrame(
        {
            "candidate_id": region_ids(first, piece, spec, survey),
            "method": METHOD,
            "rule": RULE,
            "height_scale_m": unknown,
            "points": np.bincount(labels, minlength=count + 1)[1:],
            "area_m2": area,
            "perimeter": 0,
            "mbr_m2": mbr,
            "rectangularity": area / mbr,
            "compactness": unknown,
            "linearity": unknown,
            "direction_1": unknown,
            "direction_2": unknown,
            "ndvi": unknown if points.ndvi is None else _mean(points.ndvi, labels, count),
            **{name: statistics[name].to_numpy() for name in statistics.columns},
            "xcen": xcen,
            "ycen": ycen,
        }
    )
    return _typed(rows, CANDIDATE_REGION)


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


def first_places(points: OffGround, labels: Labels, count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first cell of each region, and how many regions before it have the same one."""
    first = np.full(count + 1, np.iinfo(np.int64).max)
    np.minimum.at(first, labels, points.place)
    first = first[1:]
    order = np.argsort(first, kind="stable")
    begins = np.diff(first[order], prepend=-1) != 0
    run = np.maximum.accumulate(np.where(begins, np.arange(count), 0))
    piece = np.empty(count, dtype=np.int64)
    piece[order] = np.arange(count) - run
    return first, piece


def centroids(points: OffGround, labels: Labels, count: int) -> tuple[Floats, Floats]:
    """Return easting and northing of the mean place of the points of each region, metres."""
    return (
        _mean(points.x, labels, count) + points.origin[0],
        _mean(points.y, labels, count) + points.origin[1],
    )


def region_ids(
    first: NDArray[np.int64], piece: NDArray[np.int64], spec: GridSpec, survey: str, *, stage: int = 0
) -> NDArray[np.int64]:
    """Return ids of regions from their first cells; those that a stage rejected have ids of their own."""
    row, col = np.divmod(first, PLACES)
    row, col = row - PLACES // 2 + spec.origin[0], col - PLACES // 2 + spec.origin[1]
    return part_ids(survey + KIND, spec.cell_m, threshold_px=stage, row=row, col=col, piece=piece)


def _mean(values: NDArray[np.floating], labels: Labels, count: int) -> Floats:
    """Return the mean of the finite values of each region; NaN where there is none."""
    use = np.flatnonzero((labels > 0) & np.isfinite(values))
    total = np.bincount(labels[use], values[use], count + 1)[1:]
    size = np.bincount(labels[use], minlength=count + 1)[1:]
    return np.where(size > 0, total / np.maximum(size, 1), np.nan)


def _typed(frame: pd.DataFrame, table: Table) -> pd.DataFrame:
    """Return the declared columns in order and of their dtypes."""
    return frame[table.names].astype({column.name: column.dtype for column in table.columns})

"""Candidate regions as rows: ids, attributes, and the ledger of what was rejected."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from msbdb.errors import TableError
from msbdb.extract.area3d.shape import Shapes
from msbdb.extract.multiscale.heights import HeightOrder, height_statistics
from msbdb.grid import GridSpec
from msbdb.identity import part_ids
from msbdb.tables import CANDIDATE_REGION, REJECTION, Table

METHOD = "area3d"

KIND = "\0area3d"
"""Follows the survey's name in the ids' keys, so that no region has the id of a part at the same place."""

STAGES = ("area3d fusion", "area3d opening", "area3d curvature", "area3d crowns", "area3d rules")
"""The stages that reject regions, in order."""

Labels = NDArray[np.int32]


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
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

    def mean(self, values: NDArray[np.generic], labels: Labels, count: int) -> NDArray[np.float64]:
        """Return the mean of finite values over the points of each region; NaN where there is none."""
        use = np.flatnonzero((labels > 0) & np.isfinite(values.astype(np.float64)))
        total = np.bincount(labels[use], values[use].astype(np.float64), count + 1)[1:]
        size = np.bincount(labels[use], minlength=count + 1)[1:]
        return np.where(size > 0, total / np.maximum(size, 1), np.nan)

    def centroids(self, labels: Labels, count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return easting and northing of the mean place of the points of each region, metres."""
        east, north = (self.mean(self.points[:, axis], labels, count) + self.origin[axis] for axis in range(2))
        return east, north

    def first_places(self, labels: Labels, count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the first cell of each region, and how many regions before it have the same one."""
        first = np.full(count + 1, np.iinfo(np.int64).max)
        np.minimum.at(first, labels, self.place)
        first = first[1:]
        order = np.argsort(first, kind="stable")
        begins = np.flatnonzero(np.append(True, np.diff(first[order]) != 0)) if count else np.zeros(0, dtype=np.int64)
        piece = np.empty(count, dtype=np.int64)
        piece[order] = np.arange(count) - np.repeat(begins, np.diff(np.append(begins, count)))
        return first, piece


class Books:
    """What the stages took in, kept and dropped; and the regions that were lost, to become ``tables.REJECTION``."""

    def __init__(self, cloud: Cloud, spec: GridSpec, survey: str) -> None:
        self.cloud, self.spec, self.survey = cloud, spec, survey
        self.counts: dict[str, dict[str, int]] = {}
        self._lost: list[pd.DataFrame] = [_typed(REJECTION.empty(), REJECTION)]

    def count(self, stage: str, entered: int, kept: int, dropped: int, pieces: int = 0) -> None:
        """Add the numbers of a stage at one height scale, when all that it rejected there is written.

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
        sums = self.counts.setdefault(stage, dict.fromkeys(("in", "pieces", "kept", "dropped"), 0))
        for name, value in (("in", entered + pieces), ("pieces", pieces), ("kept", kept), ("dropped", dropped)):
            sums[name] += value
        rows = sum(int((frame["stage"] == stage).sum()) for frame in self._lost)
        if rows != sums["dropped"]:
            msg = (
                f"The stage '{stage}' dropped {sums['dropped']} regions, but the ledger has {rows} of them. "
                "This is a fault of msbdb; please report it."
            )
            raise TableError(msg)

    def reject(self, stage: str, reasons: NDArray[np.object_], labels: Labels, *, scale: int) -> None:
        """Write labelled regions into the ledger.

        Parameters
        ----------
        stage : str
            One of ``STAGES``.
        reasons : (M,) ndarray of str
            One a region, in the labels' order.
        labels : (N,) ndarray of int32
            1 to M; 0 for none.
        scale : int
            Number of the height scale, from 1.
        """
        count = len(reasons)
        first, piece = self.cloud.first_places(labels, count)
        xcen, ycen = self.cloud.centroids(labels, count)
        number = len(STAGES) * scale + STAGES.index(stage) + 1
        rows = pd.DataFrame(
            {
                "region_id": region_ids(first, piece, self.spec, self.survey, stage=number),
                "stage": stage,
                "reason": reasons,
                "scale": scale,
                "area_m2": np.bincount(labels, self.cloud.area_m2, count + 1)[1:],
                "xcen": xcen,
                "ycen": ycen,
            }
        )
        self._lost.append(_typed(rows, REJECTION))

    def rejections(self) -> pd.DataFrame:
        """Return all lost regions in the order of the height scales and stages."""
        return pd.concat([rows for rows in self._lost if len(rows)] or self._lost, ignore_index=True)


def describe(
    cloud: Cloud,
    labels: Labels,
    shapes: Shapes,
    *,
    rule: NDArray[np.int8],
    height_scale_m: NDArray[np.float64],
    spec: GridSpec,
    survey: str,
) -> pd.DataFrame:
    """Return the rows of accepted regions (``tables.CANDIDATE_REGION``, without geometry), in the labels' order.

    Parameters
    ----------
    labels : (N,) ndarray of int32
        1 to M without a gap; 0 for none.
    shapes : Shapes
        Of the M regions.
    rule : (M,) ndarray of int8
        The rule that accepted each.
    height_scale_m : (M,) ndarray of float64
        The lowest height scale at which it was accepted.
    """
    count = len(rule)
    inside = np.flatnonzero(labels > 0)
    order = inside[np.argsort(cloud.heights[inside], kind="stable")]
    statistics = height_statistics(labels, slice(0, count), HeightOrder(order.astype(np.int32), cloud.heights[order]))
    xcen, ycen = cloud.centroids(labels, count)
    rows = pd.DataFrame(
        {
            "candidate_id": region_ids(*cloud.first_places(labels, count), spec, survey),
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
            "ndvi": np.nan if cloud.ndvi is None else cloud.mean(cloud.ndvi, labels, count),
            **{name: statistics[name].to_numpy() for name in statistics.columns},
            "xcen": xcen,
            "ycen": ycen,
        }
    )
    return _typed(rows, CANDIDATE_REGION)


def region_ids(
    first: NDArray[np.int64], piece: NDArray[np.int64], spec: GridSpec, survey: str, *, stage: int = 0
) -> NDArray[np.int64]:
    """Return ids of regions from their first cells; those that a stage rejected have ids of their own."""
    row, col = np.divmod(first, PLACES)
    row, col = row - PLACES // 2 + spec.origin[0], col - PLACES // 2 + spec.origin[1]
    return part_ids(survey + KIND, spec.cell_m, threshold_px=stage, row=row, col=col, piece=piece)


PLACES = 2**31
"""Width of the numbering of cells: a place is row times this plus column, both counted from its half."""


def places(spec: GridSpec, easting: NDArray[np.float64], northing: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the row-major numbers of the cells that hold points, also outside of the lattice's extent."""
    row, col = spec.rowcol(easting, northing)
    return (row + PLACES // 2) * np.int64(PLACES) + (col + PLACES // 2)


def _typed(frame: pd.DataFrame, table: Table) -> pd.DataFrame:
    """Return the declared columns in order and of their dtypes."""
    return frame[table.names].astype({column.name: column.dtype for column in table.columns})

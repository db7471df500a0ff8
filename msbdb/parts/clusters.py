"""Clusters: sliced heights, their flat zones on every scale as rows, and the ledger of dropped ones (V17 to V26)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from msbdb.grid import Grid
from msbdb.labels import CellList, Labels, look_up
from msbdb.ledger import Ledger
from msbdb.morphology.levelzones import label_level_zones
from msbdb.params import SurfaceParams
from msbdb.tables import Reason
from msbdb.threads import in_threads

T = TypeVar("T", bound=np.generic)

MAX_SLICE = 2**16 - 1
"""Slices are counted in 16 bits; higher ones are cut off."""

CENTIMETRES = 100

NOISE_M = 0.03
"""Neighbouring cells of a level roof differ by this much, the range noise of a scanner."""


def slice_heights(ndsm: Grid, surface: SurfaceParams, *, connectivity: int = 8) -> NDArray[np.uint16]:
    """Slice an nDSM into storeys, or into steps of ``surface.step_m`` when ``surface.slicing`` is 'step'.

    Parameters
    ----------
    ndsm : Grid
        Heights above ground, metres.
    surface : SurfaceParams
        The mask, the way of slicing, the height of a storey or step, and what is level.
    connectivity : int
        4 or 8, as for the scale-space.

    Returns
    -------
    (H, W) ndarray of uint16
        H = 1 + floor((h - mask) / height) where the cell is valid and at least as high as the mask (V17, V18, A8);
        otherwise 0. Here h is the median height of the cell's level zone.

    Notes
    -----
    The paper slices by "an elevation slicing with the height of a story" without a rule for rounding; floor(h / 3)
    would take houses of 2 to 3 m for ground. By the cells' own heights, a level roof at the height of a boundary would
    fall into two storeys by its noise. So cells without a step above ``surface.level_m`` between them, and within one
    storey, are one level zone (`msbdb.morphology.label_level_zones`) and share its median. Where they rise by no more
    than ``surface.level_slope``, a zone may span more than a storey: the ground under a level hall slopes. A boundary
    lies on real steps of height alone; a steep slope is cut where it leaves a storey, cell by cell.

    Nodata: cells that are not valid are background.

    Examples
    --------
    A roof at 5 m, the boundary of two storeys, and a tower of 9 m:

    >>> from pyproj import CRS
    >>> from msbdb.grid import lattice
    >>> spec = lattice((0, 0.1, 5, 0.9), 1.0, CRS.from_epsg(2154))
    >>> heights = np.array([[0, 4.98, 5.02, 4.99, 9.0, 9.1]], dtype=np.float32)
    >>> slice_heights(Grid(heights, heights >= 0, spec), SurfaceParams()).tolist()
    [[0, 1, 1, 1, 3, 3]]
    """
    height_m = surface.storey_m if surface.slicing == "storey" else surface.step_m
    heights = np.asarray(ndsm.values, dtype=np.float32)
    above = ndsm.valid & (heights >= surface.mask_m)
    slices = np.zeros(ndsm.spec.shape, dtype=np.uint16)
    slices[above] = _slice(heights[above], surface.mask_m, height_m)
    if surface.level_m > 0:
        whole = np.zeros(ndsm.spec.shape, dtype=np.int32)
        whole[above] = np.rint(heights[above].astype(np.float64) * CENTIMETRES)
        zones = label_level_zones(
            whole,
            above,
            step=round(surface.level_m * CENTIMETRES),
            spread=round(height_m * CENTIMETRES),
            free_step=round(max(surface.level_slope * ndsm.spec.cell_m, NOISE_M) * CENTIMETRES),
            connectivity=connectivity,
        )
        cells, medians = _medians_of_cut_zones(zones, slices, heights)
        slices.ravel()[cells] = _slice(medians, surface.mask_m, height_m)
    return slices


def storeys(heights: NDArray[np.floating], surface: SurfaceParams) -> NDArray[np.int64]:
    """Return the storeys H = 1 + floor((h - mask) / storey) of building heights in metres, at least 1 (V18).

    Examples
    --------
    >>> storeys(np.array([2.0, 4.9, 5.0, 9.0]), SurfaceParams())
    array([1, 1, 2, 3])
    """
    return _slice(heights, surface.mask_m, surface.storey_m)


def _slice(heights: NDArray[np.floating], mask_m: float, height_m: float) -> NDArray[np.int64]:
    """Count the slices from the mask up; float64, so that a height on a border falls into the upper slice."""
    count = 1 + np.floor((heights.astype(np.float64) - mask_m) / height_m)
    slices: NDArray[np.int64] = np.clip(count, 1, MAX_SLICE).astype(np.int64)
    return slices


def _medians_of_cut_zones(
    zones: NDArray[np.int32], slices: NDArray[np.uint16], heights: NDArray[np.float32]
) -> tuple[NDArray[np.intp], NDArray[np.float32]]:
    """Return the cells of the zones that lie in several slices, and for each the lower median of its zone's heights."""
    cells = np.flatnonzero(zones > 0)
    zone, slice_of = zones.ravel()[cells], slices.ravel()[cells]
    # A zone's number is the place of its first cell among these cells, plus 1.
    differs = slice_of != slice_of[zone - 1]
    is_cut = np.zeros(cells.size + 1, dtype=np.bool_)
    is_cut[zone[differs]] = True
    chosen = is_cut[zone]
    cells, zone = cells[chosen], zone[chosen]
    high = heights.ravel()[cells]
    order = np.lexsort((high, zone))
    starts = np.flatnonzero(np.diff(zone[order], prepend=-1))
    sizes = np.diff(starts, append=zone.size)
    medians = np.repeat(high[order][starts + (sizes - 1) // 2], sizes)
    return cells[order], medians


@dataclass(frozen=True, slots=True, eq=False)
class Clusters:
    """The clusters of all scales on one lattice; no stage changes one in place.

    Parameters
    ----------
    labels : tuple of (K,) ndarray of int32
        For each scale, finest first, the label of each of ``cells``: 0 for none, otherwise row number + 1 in ``rows``.
    cells : CellList
        The cells that had a label on some scale when the clusters were made. No stage labels any other cell.
    rows : DataFrame
        One row a cluster, of all scales together:

        - ``level``: the scale, 0 = finest; ``hzone``: value of the flat zone, slices;
        - ``first``: flat index of the first cell in row order; ``area``: cells;
        - ``row_sum``, ``col_sum``: sums of its cells' rows and columns, from which the centroid follows;
        - ``origin``, ``piece``: ``first`` when it was made, and how many cuts lie between it and its flat zone;
        - ``made``: the scale on which it was made, which its id names;
        - ``alive``: False once a stage has dropped it. Its cells keep their label.
    """

    labels: tuple[Labels, ...]
    cells: CellList
    rows: pd.DataFrame

    @property
    def alive(self) -> NDArray[np.bool_]:
        """(N,) which rows no stage has dropped."""
        return self.rows["alive"].to_numpy()

    def at(self, level: int) -> NDArray[np.intp]:
        """Return the row numbers of the living clusters of one scale."""
        return np.flatnonzero(self.alive & (self.rows["level"].to_numpy() == level))

    def flags(self, rows: NDArray[np.integer]) -> NDArray[np.bool_]:
        """Return an array to look labels up in: True for the rows given, False for others and for label 0."""
        wanted = np.zeros(len(self.rows) + 1, dtype=np.bool_)
        wanted[rows + 1] = True
        return wanted

    def image(self, level: int) -> Labels:
        """Return the (H, W) labels of one scale."""
        return self.cells.image(self.labels[level])

    def in_cells(self, values: NDArray[T]) -> NDArray[T]:
        """Return (K,) the largest value of the clusters in each cell, of all scales; of (N,) values, none below 0."""
        table = np.concatenate([np.zeros(1, dtype=values.dtype), values])
        found = look_up(table, self.labels[0])
        for labels in self.labels[1:]:
            np.maximum(found, look_up(table, labels), out=found)
        return found

    def relabelled(self, labels: Mapping[int, Labels], rows: pd.DataFrame) -> "Clusters":
        """Return the clusters with other rows, and with other labels of some scales."""
        return Clusters(tuple(labels.get(n, own) for n, own in enumerate(self.labels)), self.cells, rows)

    def without(self, rows: NDArray[np.integer]) -> "Clusters":
        """Return the clusters with some rows dropped."""
        alive = self.alive.copy()
        alive[rows] = False
        return replace(self, rows=self.rows.assign(alive=alive))


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """The result of a stage: clusters, dropped regions (as rows with a ``reason``), and the number of new pieces."""

    clusters: Clusters
    dropped: pd.DataFrame
    pieces: int = 0


class ClusterLedger(Ledger):
    """Counts by stage, checked to balance, and the clusters that were lost; ``level`` is -1 where no scale applies.

    Parameters
    ----------
    method : str
        Name of the detector.
    least_m2 : float
        Smaller regions have the id 0.

    Attributes
    ----------
    reasons : (H, W) ndarray of uint8
        `msbdb.tables.Reason` of the cells above the mask that a stage dropped; 0 elsewhere. None before `begin`.
    """

    def __init__(self, method: str, least_m2: float = 0.0) -> None:
        super().__init__(method, least_m2)
        self.reasons: NDArray[np.uint8] | None = None
        self._above = np.zeros(0, dtype=np.intp)

    def begin(self, above: NDArray[np.bool_]) -> None:
        """Follow these cells, (H, W), from stage to stage."""
        self.reasons = np.zeros(above.shape, dtype=np.uint8)
        self._above = np.flatnonzero(above)

    def lose(self, cells: NDArray[np.bool_], reason: Reason) -> None:
        """Mark cells, (H, W), as lost for a reason, and follow them no longer."""
        if self.reasons is not None:
            gone = cells.ravel()[self._above]
            self.reasons.ravel()[self._above[gone]] = reason
            self._above = self._above[~gone]

    def _lose_uncovered(self, clusters: Clusters, reason: Reason) -> None:
        """Mark the cells that no living cluster of any scale covers."""
        covered = clusters.cells.image(clusters.in_cells(clusters.alive)).ravel()[self._above]
        if self.reasons is not None:
            self.reasons.ravel()[self._above[~covered]] = reason
            self._above = self._above[covered]

    def record(self, stage: str, before: Clusters, step: Step, reason: Reason | None = None) -> Clusters:
        """Record a stage and return the clusters that it leaves.

        Parameters
        ----------
        stage : str
            Name of the stage.
        before : Clusters
            The clusters before the stage.
        step : Step
            The result of the stage.
        reason : Reason, optional
            Why the dropped regions are lost; they go to the ledger, and cells that no other cluster covers are marked.
            Duplicates have none: they are only counted, as the coarser cluster covers them.
        """
        lost = reason is not None
        if reason is not None:
            self.write(stage, step.dropped)
            self._lose_uncovered(step.clusters, reason)
        entered, kept = int(before.alive.sum()), int(step.clusters.alive.sum())
        self.count(stage, entered, kept, len(step.dropped), pieces=step.pieces, written=lost)
        return step.clusters


def label_clusters(levels: Sequence[NDArray[Any]], *, connectivity: int, houses: Labels | None = None) -> Clusters:
    """Give every flat zone above 0 of every scale its row and attributes.

    Parameters
    ----------
    levels : sequence of (H, W) ndarray of int
        The scale-space, finest first; 0 is background and no cluster (V25).
    connectivity : int
        4 or 8, as for the scale-space (V10).
    houses : (H, W) ndarray of int32, optional
        The house of each cell, from 1 to less than 2**31. A flat zone ends where another house begins.

    Notes
    -----
    Rows are in order of the scale, and within it of the first cell. Linear in the cells of each scale.
    """
    covered = np.zeros(levels[0].shape, dtype=np.bool_)
    for image in levels:
        covered |= image > 0
    cells = CellList.covering(covered)
    # A value and a house in one number: slices have 16 bits.
    apart = None if houses is None else cells.of(houses).astype(np.int64) << 16

    def label(image: NDArray[Any]) -> tuple[Labels, pd.DataFrame]:
        values = cells.of(image).astype(np.int64)
        zones = values if apart is None else np.where(values > 0, values + apart, 0)
        labels, count = cells.zones(zones, connectivity=connectivity)
        table = cells.measure(labels, count)
        return labels, table.assign(hzone=image.ravel()[table["first"]].astype(np.int64))

    lines, tables, offset = [], [], 0
    for level, (labels, table) in enumerate(in_threads(label, levels)):
        table.insert(0, "level", level)
        np.add(labels, np.int32(offset), out=labels, where=labels > 0)
        lines.append(labels)
        tables.append(table)
        offset += len(table)
    rows = pd.concat(tables, ignore_index=True)
    rows = rows.assign(origin=rows["first"], piece=0, made=rows["level"], alive=True)
    return Clusters(tuple(lines), cells, rows)

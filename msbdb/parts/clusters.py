"""Clusters: the flat zones of sliced heights on every scale, as rows, with the ledger of dropped ones (V17 to V26)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from msbdb.labels import Labels, label_zones, measure
from msbdb.ledger import Ledger
from msbdb.tables import Reason
from msbdb.threads import in_threads


@dataclass(frozen=True, slots=True, eq=False)
class Clusters:
    """The clusters of all scales on one lattice; no stage changes one in place.

    Parameters
    ----------
    labels : tuple of (H, W) ndarray of int32
        One image a scale, finest first: 0 for none, otherwise row number + 1 in ``rows``.
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

    Attributes
    ----------
    reasons : (H, W) ndarray of uint8
        `msbdb.tables.Reason` of the cells above the mask that a stage dropped; 0 elsewhere. None before `begin`.
    """

    def __init__(self, method: str) -> None:
        super().__init__(method)
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
        covered = np.zeros(self._above.size, dtype=np.bool_)
        living = clusters.flags(np.flatnonzero(clusters.alive))
        for labels in clusters.labels:
            covered |= living[labels.ravel()[self._above]]
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

    def label(values: NDArray[Any]) -> tuple[Labels, int, pd.DataFrame]:
        # A value and a house in one number: slices have 16 bits.
        zones = values if houses is None else np.where(values > 0, values + (houses.astype(np.int64) << 16), 0)
        labels, count = label_zones(zones, connectivity=connectivity)
        return labels, count, measure(labels, count)

    images, tables, offset = [], [], 0
    for level, (values, (labels, count, table)) in enumerate(zip(levels, in_threads(label, levels), strict=True)):
        table.insert(0, "level", level)
        table.insert(1, "hzone", values.ravel()[table["first"]].astype(np.int64))
        np.add(labels, np.int32(offset), out=labels, where=labels > 0)
        images.append(labels)
        tables.append(table)
        offset += count
    rows = pd.concat(tables, ignore_index=True)
    return Clusters(tuple(images), rows.assign(origin=rows["first"], piece=0, made=rows["level"], alive=True))

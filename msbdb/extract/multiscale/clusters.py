"""Clusters: the flat zones of every scale, their attributes (V22-V26)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from msbdb.extract.multiscale.kernels import grow
from msbdb.labels import Labels, chosen_cells, label_zones, measure, sizes


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
    """What a stage leaves: the clusters, the regions that it dropped (as rows with a ``reason``), new pieces."""

    clusters: Clusters
    dropped: pd.DataFrame
    pieces: int = 0


def label_clusters(levels: Sequence[NDArray[Any]], *, connectivity: int) -> Clusters:
    """Give every flat zone above 0 of every scale its row and attributes.

    Parameters
    ----------
    levels : sequence of (H, W) ndarray of int
        The scale-space, finest first; 0 is background and no cluster (V25).
    connectivity : int
        4 or 8, as for the scale-space (V10).

    Notes
    -----
    Rows are in order of the scale, and within it of the first cell. Linear in the cells of each scale.
    """
    images, tables, offset = [], [], 0
    for level, values in enumerate(levels):
        labels, count = label_zones(values, connectivity=connectivity)
        table = measure(labels, count)
        table.insert(0, "level", level)
        table.insert(1, "hzone", values.ravel()[table["first"]].astype(np.int64))
        np.add(labels, np.int32(offset), out=labels, where=labels > 0)
        images.append(labels)
        tables.append(table)
        offset += count
    rows = pd.concat(tables, ignore_index=True)
    return Clusters(tuple(images), rows.assign(origin=rows["first"], piece=0, alive=True))


def merge_slivers(level: NDArray[Any], smallest_px: int, *, connectivity: int) -> NDArray[Any]:
    """Give the flat zones that are too small the value of the nearest zone that is large enough.

    Parameters
    ----------
    level : (H, W) ndarray of int
        The finest level of the scale-space; 0 is background and neither grows nor shrinks.
    smallest_px : int
        Zones with fewer cells are slivers.
    connectivity : int
        4 or 8.

    Returns
    -------
    (H, W) ndarray
        Of the same dtype. A sliver without a larger neighbour on its island stays.

    Notes
    -----
    Ours. Opening and closing take away small extrema, but not the narrow zones between them, such as mixed cells
    along a high wall. As parts these would be buildings of a few cells. Zones only merge, so V11 holds on.
    """
    labels, count = label_zones(level, connectivity=connectivity)
    small = sizes(labels, count) < smallest_px
    if not small.any():
        return level
    seeds = np.where(chosen_cells(labels, small), 0, level).astype(np.int32)
    grown = grow(seeds, (level > 0).astype(np.uint8), connectivity)
    return np.where(grown > 0, grown, level).astype(level.dtype)

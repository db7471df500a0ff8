"""Regions of cells, measured: first cells, areas and centroids."""

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from msbdb.grid import GridSpec

Labels = NDArray[np.int32]


def measure(labels: Labels, count: int) -> pd.DataFrame:
    """Measure labelled regions: first cell, area, and the sums that give their centroids.

    Parameters
    ----------
    labels : (H, W) ndarray of int32
        1 to ``count``; 0 for none.
    count : int
        Number of regions; each has a cell.

    Returns
    -------
    DataFrame
        ``first``, ``area``, ``row_sum``, ``col_sum`` (int64), one row a region in the labels' order.
    """
    label, start, length = _runs(labels)
    row, col = np.divmod(start, labels.shape[1])
    first = np.zeros(count, dtype=np.int64)
    first[label[::-1]] = start[::-1]
    sums = {"area": length, "row_sum": length * row, "col_sum": length * col + length * (length - 1) // 2}
    # The sums are whole numbers below 2**53, hence exact in the float64 of bincount.
    exact = {name: np.bincount(label, part, count).astype(np.int64) for name, part in sums.items()}
    return pd.DataFrame({"first": first, **exact})


def offsets(rows: pd.DataFrame, width: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return how far the centroids of clusters lie below and right of their first cells, in cells.

    From differences of whole numbers, so that the result is the same, to the bit, wherever the cluster lies in the
    array of that width.
    """
    area, first = rows["area"].to_numpy().astype(np.int64), rows["first"].to_numpy().astype(np.int64)
    row, col = np.divmod(first, width)
    down, right = rows["row_sum"].to_numpy() - area * row, rows["col_sum"].to_numpy() - area * col
    return down.astype(np.float64) / area, right.astype(np.float64) / area


def centroids(table: pd.DataFrame, spec: GridSpec) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return easting and northing of the centroids of measured regions, metres."""
    width = spec.shape[1]
    down, right = offsets(table, width)
    east, north = spec.xy(*np.divmod(table["first"].to_numpy().astype(np.int64), width))
    return east + right * spec.cell_m, north - down * spec.cell_m


def _runs(labels: Labels) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return region (from 0), first cell and length of the row runs: far fewer than cells."""
    changes = np.ones(labels.shape, dtype=np.bool_)
    np.not_equal(labels[:, 1:], labels[:, :-1], out=changes[:, 1:])
    start = np.flatnonzero(changes)
    length = np.diff(start, append=labels.size)
    label = labels.ravel()[start].astype(np.int64) - 1
    inside = label >= 0
    return label[inside], start[inside], length[inside]

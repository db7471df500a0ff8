"""Statistics of many labelled regions at once: first cells, areas, centroids, cells inside, heights (V24, V30)."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import sparse

from msbdb.grid import Grid, GridSpec
from msbdb.labels.numbering import Labels, sizes, sums

STATISTICS = ("h_max", "h_mean", "h_p50", "h_p90", "h_std")
"""Columns of `height_statistics`."""


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
        ``first``, ``area``, ``row_sum``, ``col_sum`` (int64), one row a region in the labels' order. ``first`` is a
        flat index, the other three count in cells.

    Examples
    --------
    >>> measure(np.array([[0, 1, 1], [2, 2, 1]], dtype=np.int32), 2).to_dict("list")
    {'first': [1, 3], 'area': [3, 2], 'row_sum': [1, 2], 'col_sum': [5, 1]}
    """
    label, start, length = _runs(labels)
    return measure_runs(label, start, length, width=labels.shape[1], count=count)


def measure_runs(
    label: NDArray[np.int64], start: NDArray[np.int64], length: NDArray[np.int64], *, width: int, count: int
) -> pd.DataFrame:
    """Measure regions by runs of cells in rows of that width: region from 0, first cell and length of each, in order.

    Returns what `measure` does.
    """
    row, col = np.divmod(start, width)
    first = np.zeros(count, dtype=np.int64)
    first[label[::-1]] = start[::-1]
    totals = {"area": length, "row_sum": length * row, "col_sum": length * col + length * (length - 1) // 2}
    # The sums are whole numbers below 2**53, hence exact in the float64 of bincount.
    exact = {name: np.bincount(label, part, count).astype(np.int64) for name, part in totals.items()}
    return pd.DataFrame({"first": first, **exact})


def offsets(rows: pd.DataFrame, width: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return how far the centroids of clusters lie below and right of their first cells, in cells.

    They come from differences of whole numbers. So the result is the same, to the bit, wherever the cluster lies in the
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


def region_means(values: NDArray[np.generic], labels: Labels, count: int) -> NDArray[np.float64]:
    """Return the mean of the finite values over the cells or points of each region; NaN for a region without any.

    Examples
    --------
    >>> region_means(np.array([4.0, 6.0, np.nan, 1.0]), np.array([1, 1, 2, 0]), 2)
    array([ 5., nan])
    """
    numbers = values.astype(np.float64, copy=False)
    labels = np.where((labels > 0) & np.isfinite(numbers), labels, labels.dtype.type(0))
    total, size = sums(labels, numbers, count), sizes(labels, count)
    return np.where(size > 0, total / np.maximum(size, 1), np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class HeightOrder:
    """The valid cells of an nDSM in ascending order of their height, to be sorted once for all scales.

    Parameters
    ----------
    cells : (N,) ndarray of int32
        Flat indices.
    heights : (N,) ndarray of float64
        Metres, ascending.
    """

    cells: NDArray[np.int32]
    heights: NDArray[np.float64]


def order_heights(ndsm: Grid, inside: NDArray[np.bool_]) -> HeightOrder:
    """Sort the valid cells of an nDSM inside of a mask by height, equal ones in any order. O(n log n)."""
    cells = np.flatnonzero(ndsm.valid & inside).astype(np.int32)
    heights = np.asarray(ndsm.values).ravel()[cells]
    order = np.argsort(heights)
    return HeightOrder(cells[order], heights[order].astype(np.float64))


def height_statistics(labels: Labels, span: slice, order: HeightOrder) -> pd.DataFrame:
    """Return maximum, mean, median, 90th percentile and standard deviation of the heights in each region.

    Parameters
    ----------
    labels : (H, W) ndarray of int32
        Regions; 0 for none.
    span : slice
        The labels are ``span.start + 1`` to ``span.stop``.
    order : HeightOrder
        The sorted cells; those that are missing do not count.

    Returns
    -------
    DataFrame
        One row a region, columns ``STATISTICS``, float64 metres; 0 for a region without a valid cell. Percentiles
        are interpolated linearly between the two nearest heights; the deviation is that of the population.

    Notes
    -----
    The heights are put in order once; a counting sort by region, which keeps that order, then leaves each region's
    heights ascending. Linear in the cells for each call.
    """
    member = labels.ravel()[order.cells]
    chosen = member > 0
    count = span.stop - span.start
    member = member[chosen] - np.int32(span.start + 1)
    heights = order.heights[chosen]
    # Turning a sparse matrix from rows to columns is a counting sort.
    table = sparse.csr_array((heights, member, np.arange(member.size + 1)), shape=(member.size, count)).tocsc()
    grouped, starts = table.data, table.indptr.astype(np.int64)
    size = np.diff(starts)
    some = size > 0
    mean = np.bincount(member, heights, count) / np.maximum(size, 1)
    variance = np.bincount(member, (heights - mean[member]) ** 2, count) / np.maximum(size, 1)
    found = {
        "h_max": _quantile(grouped, starts, some, 1.0),
        "h_mean": mean,
        "h_p50": _quantile(grouped, starts, some, 0.5),
        "h_p90": _quantile(grouped, starts, some, 0.9),
        "h_std": np.sqrt(variance),
    }
    return pd.DataFrame({name: found[name] for name in STATISTICS})


def _quantile(
    grouped: NDArray[np.float64], starts: NDArray[np.int64], some: NDArray[np.bool_], share: float
) -> NDArray[np.float64]:
    """Return a quantile of each group of ascending values, interpolated linearly; 0 for empty groups."""
    result = np.zeros(some.size)
    place = (np.diff(starts)[some] - 1) * share
    low = np.floor(place).astype(np.int64)
    below = grouped[starts[:-1][some] + low]
    above = grouped[starts[:-1][some] + np.minimum(low + 1, np.diff(starts)[some] - 1)]
    result[some] = below + (place - low) * (above - below)
    return result


def quantiles(
    labels: NDArray[np.int32], values: NDArray[np.floating], count: int, *shares: float
) -> list[NDArray[np.float64]]:
    """Return quantiles of the values over the cells or points of each region; NaN for a region without any.

    Parameters
    ----------
    labels : ndarray of int32
        0 for none, otherwise 1 to ``count``.
    values : ndarray of float, of the same shape
        Without NaN.
    count : int
        Number of regions.
    *shares : float
        0 for the lowest value, 0.5 for the median, 1 for the highest; interpolated linearly between the two nearest.

    Returns
    -------
    list of (count,) ndarray of float64
        An array for each share.

    Examples
    --------
    >>> quantiles(np.array([1, 1, 1, 3, 0]), np.array([4.0, 6.0, 9.0, 1.0, 7.0]), 3, 0.5)
    [array([ 6., nan,  1.])]
    """
    use = labels > 0
    member, numbers = labels[use], values[use].astype(np.float64)
    order = np.lexsort((numbers, member))
    starts = np.concatenate([[0], np.cumsum(sizes(member, count))])
    some = np.diff(starts) > 0
    grouped = numbers[order]
    return [np.where(some, _quantile(grouped, starts, some, share), np.nan) for share in shares]


def central_cells(
    labels: Labels,
    span: slice,
    *,
    area: NDArray[np.int64],
    row_sum: NDArray[np.int64],
    col_sum: NDArray[np.int64],
) -> NDArray[np.int64]:
    """Return for each region its cell that is nearest to its centroid; of equal ones the first in row order.

    Parameters
    ----------
    labels : (H, W) ndarray of int32
        Regions; 0 for none.
    span : slice
        The labels are ``span.start + 1`` to ``span.stop``; each has a cell.
    area, row_sum, col_sum : (N,) ndarray of int64
        Number of cells, and the sums of their rows and columns.

    Returns
    -------
    (N,) ndarray of int64
        Flat indices: points that lie on the regions, rings included (V24).
    """
    cells = np.flatnonzero(labels != 0)
    member = labels.ravel()[cells] - np.int32(span.start + 1)
    at_row, at_col = np.divmod(cells, labels.shape[1])
    # Area times the distance, from differences of whole numbers: the same wherever the region lies.
    down, right = area[member] * at_row - row_sum[member], area[member] * at_col - col_sum[member]
    distance = down.astype(np.float64) ** 2 + right.astype(np.float64) ** 2
    table = sparse.csr_array((distance, member, np.arange(cells.size + 1)), shape=(cells.size, area.size)).tocsc()
    if not area.size:
        return np.zeros(0, dtype=np.int64)
    nearest = np.minimum.reduceat(table.data, table.indptr[:-1])
    match = np.flatnonzero(distance == nearest[member])
    result = np.zeros(area.size, dtype=np.int64)
    result[member[match[::-1]]] = cells[match[::-1]]
    return result

"""Statistics of labelled regions against the definition, region by region."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from pyproj import CRS

from msbdb.grid import Grid, lattice
from msbdb.labels import (
    central_cells,
    centroids,
    height_statistics,
    label_zones,
    measure,
    order_heights,
    quantiles,
    region_means,
    sizes,
)

SEEDS = st.integers(0, 2**32 - 1)


def zones(seed):
    """Return a labelled image of several zones, and their number."""
    rng = np.random.default_rng(seed)
    return label_zones(rng.integers(0, 3, rng.integers(2, 12, 2)), connectivity=4)


@given(SEEDS)
def test_measures_are_those_of_the_cells(seed):
    """First cell, area and sums, and the centroid that follows from them on a lattice."""
    labels, count = zones(seed)
    rows, cols = labels.shape
    spec = lattice((100.0, 50.0, 100.0 + cols * 0.5 - 0.1, 50.0 + rows * 0.5 - 0.1), 0.5, CRS.from_epsg(28992))
    table = measure(labels, count)
    np.testing.assert_array_equal(table["area"], sizes(labels, count))
    east, north = centroids(table, spec)
    for number, found in enumerate(table.itertuples(index=False), start=1):
        row, col = np.nonzero(labels == number)
        assert (found.first, found.row_sum, found.col_sum) == (row[0] * cols + col[0], row.sum(), col.sum())
        x, y = spec.xy(row, col)
        np.testing.assert_allclose((east[number - 1], north[number - 1]), (x.mean(), y.mean()), atol=1e-9)


@given(SEEDS)
def test_central_cells_lie_on_their_regions_nearest_to_the_centroid(seed):
    """Of cells equally near the first in row order."""
    labels, count = zones(seed)
    table = measure(labels, count)
    sums = {name: table[name].to_numpy() for name in ("area", "row_sum", "col_sum")}
    found = central_cells(labels, slice(0, count), **sums)
    for number, cell in enumerate(found, start=1):
        row, col = np.nonzero(labels == number)
        away = (len(row) * row - row.sum()) ** 2 + (len(col) * col - col.sum()) ** 2
        best = np.argmin(away)
        assert cell == row[best] * labels.shape[1] + col[best]


@given(SEEDS)
def test_heights_are_those_of_the_valid_cells(seed):
    """Regions without a valid cell have zeros."""
    labels, count = zones(seed)
    rng = np.random.default_rng(seed)
    rows, cols = labels.shape
    spec = lattice((0, 0.1, cols - 0.1, rows), 1.0, CRS.from_epsg(28992))
    values, valid = rng.normal(8, 3, labels.shape).astype(np.float32), rng.random(labels.shape) < 0.7
    heights = Grid(np.where(valid, values, 0), valid, spec)
    found = height_statistics(labels, slice(0, count), order_heights(heights, labels > 0))
    for number in range(1, count + 1):
        own = values[(labels == number) & valid].astype(np.float64)
        expected = [own.max(), own.mean(), *np.percentile(own, [50, 90]), own.std()] if own.size else [0.0] * 5
        np.testing.assert_allclose(found.iloc[number - 1], expected, atol=1e-9)


def test_means_leave_out_what_is_not_finite():
    """A region without a finite value has none."""
    labels = np.array([1, 1, 1, 2, 0], dtype=np.int32)
    values = np.array([1.0, np.nan, 3.0, np.inf, 9.0])
    np.testing.assert_array_equal(region_means(values, labels, 3), [2.0, np.nan, np.nan])


@given(SEEDS, st.sampled_from([0.0, 0.2, 0.5, 0.98, 1.0]))
def test_quantiles_are_those_of_each_region(seed, share):
    """NumPy's own, region by region; NaN for regions without a cell."""
    rng = np.random.default_rng(seed)
    labels = rng.integers(0, 5, (7, 9)).astype(np.int32)
    values = rng.normal(size=labels.shape)
    [found] = quantiles(labels, values, 6, share)
    for number in range(1, 7):
        own = values[labels == number]
        expected = np.quantile(own, share) if own.size else np.nan
        np.testing.assert_allclose(found[number - 1], expected)

"""The kernels against the plain array operations that they stand for: equal to the last bit."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage
from support.sizes import examples

from msbdb.grid import Frame
from msbdb.spectral.colours import bilinear, cells_of, counts, fill_gaps, means
from msbdb.spectral.kmeans import nearest_centres

FRAME = Frame(row=-625, col=250, cell_m=0.4, east_m=0.0, north_m=0.0)
SHAPE = (9, 7)


def _points(seed, count=300):
    """Return points in and around the lattice of 0.4 m cells, some of them on cell edges."""
    rng = np.random.default_rng(seed)
    x = 100 + rng.uniform(-1, 4, count)
    y = 250 - rng.uniform(-1, 5, count)
    x[::5] = 100 + np.round((x[::5] - 100) / 0.4) * 0.4
    return x, y, rng.random(count) < 0.8, rng.integers(0, 2**16, (count, 3)).astype(np.uint16)


@pytest.mark.parametrize("seed", range(5))
def test_means_of_cells_are_those_of_weighted_counts(seed):
    """Columns of an array of colours serve without a copy."""
    x, y, used, colours = _points(seed)
    col, row = (np.floor(way / 0.4 + 1e-6).astype(int) for way in (x - 100.0, 250.0 - y))
    inside = used & (row >= 0) & (row < SHAPE[0]) & (col >= 0) & (col < SHAPE[1])
    expected_cells = np.where(inside, row * SHAPE[1] + col, -1)
    cells = cells_of(x, y, used, FRAME, SHAPE)
    np.testing.assert_array_equal(cells, expected_cells)
    count = counts(cells, 63)
    np.testing.assert_array_equal(count, np.bincount(cells[inside], minlength=63))
    out = np.full(63, np.nan, dtype=np.float32)
    means(cells, colours[:, 1], count, out)
    total = np.bincount(cells[inside], weights=colours[inside, 1], minlength=63)
    np.testing.assert_array_equal(out, (total / np.maximum(count, 1)).astype(np.float32))


@pytest.mark.parametrize("seed", range(5))
def test_bilinear_means_are_those_of_four_weighted_counts(seed):
    """One count for each of the four cell centres around the points; cells without weight are zero."""
    x, y, used, colours = _points(seed)
    right = np.round((x[used] - 100.0) / 0.4 * 256 - 128).astype(np.int64)
    down = np.round((250.0 - y[used]) / 0.4 * 256 - 128).astype(np.int64)
    (col, east), (row, south) = np.divmod(right, 256), np.divmod(down, 256)
    weight, total = np.zeros(63), np.zeros(63)
    for i, j in np.ndindex(2, 2):
        inside = (row + i >= 0) & (row + i < SHAPE[0]) & (col + j >= 0) & (col + j < SHAPE[1])
        cell = ((row + i) * SHAPE[1] + col + j)[inside]
        share = ((south if i else 256 - south) * (east if j else 256 - east)).astype(float)[inside]
        weight += np.bincount(cell, weights=share, minlength=63)
        total += np.bincount(cell, weights=share * colours[used, 0][inside], minlength=63)
    values, known = bilinear((x, y), used, colours[:, 0], FRAME, SHAPE)
    np.testing.assert_array_equal(known.ravel(), weight > 0)
    np.testing.assert_array_equal(values.ravel(), (total / np.maximum(weight, 1)).astype(np.float32))


@examples(100)
@given(
    st.integers(1, 12),
    st.integers(1, 12),
    st.floats(0.02, 0.6),
    st.sampled_from([0.0, 0.4, 0.8, 1.0, 2.0, 50.0]),
    st.integers(0, 2**32 - 1),
)
def test_gaps_are_filled_as_by_a_distance_transform(height, width, share, reach_m, seed):
    """Ties too: the western, then the northern of cells equally near, as SciPy's transform has it."""
    rng = np.random.default_rng(seed)
    measured = rng.random((height, width)) < share
    measured[rng.integers(height), rng.integers(width)] = True
    values = np.where(measured, np.arange(2 * height * width).reshape(2, height, width), -1).astype(np.float32)
    distance, nearest = ndimage.distance_transform_edt(~measured, return_indices=True)
    reached = distance * 0.4 <= reach_m
    expected = np.where(reached, values[:, nearest[0], nearest[1]], values)
    kept = measured.copy()
    valid = fill_gaps(values, measured, 0.4, reach_m)
    np.testing.assert_array_equal(valid, reached)
    np.testing.assert_array_equal(values, expected)
    np.testing.assert_array_equal(measured, kept)


def test_nothing_measured_fills_nothing():
    """And does not search for ever."""
    values = np.zeros((1, 3, 3), dtype=np.float32)
    assert not fill_gaps(values, np.zeros((3, 3), dtype=np.bool_), 1.0, 1e9).any()


def test_of_equally_near_centres_the_lower_counts():
    """Values beyond the scaling are clipped first."""
    centres = np.array([[0.0], [0.5], [0.5], [1.0]])
    rows = np.array([[-9.0], [10.0], [12.5], [15.0], [20.0], [99.0]])
    nearest = nearest_centres(rows, np.array([10.0]), np.array([10.0]), centres)
    assert nearest.tolist() == [1, 1, 1, 2, 4, 4]

"""The cells hold each point once, and a stretch of a row finds just the points in it."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.strategies import clouds

from msbdb.errors import InputError, ParameterError
from msbdb.points.cellindex import CellIndex, cell_place, index_cells, most_in_a_cell, places_around, strip
from msbdb.threads import kernel

SIZES = st.sampled_from([0.3, 1.0, 2.5, 100.0])


def places(x, y, index):
    """Return the row and the column of each point, by the definition: on an edge within a millionth of a cell."""
    rows = np.floor(y / index.cell_m + 1e-6).astype(int) - round(index.south / index.cell_m)
    cols = np.floor(x / index.cell_m + 1e-6).astype(int) - round(index.west / index.cell_m)
    return rows, cols


@given(clouds(), SIZES)
def test_each_point_is_in_its_cell_once(cloud, cell_m):
    """The order is a permutation; the points of a cell lie in it, ascending; no cell is empty; cells ascend."""
    x, y, _ = cloud
    index = index_cells(x, y, cell_m)
    assert index.order.dtype == index.starts.dtype == np.int32
    np.testing.assert_array_equal(np.sort(index.order), np.arange(x.size))
    assert index.starts[0] == 0
    assert index.starts[-1] == x.size
    rows, cols = places(x, y, index)
    assert (np.diff(index.keys) > 0).all()
    for cell, key in enumerate(index.keys):
        points = index.order[index.starts[cell] : index.starts[cell + 1]]
        assert points.size > 0
        assert (np.diff(points) > 0).all()
        assert {(row, col) for row, col in zip(rows[points], cols[points], strict=True)} == {cell_place(index, cell)}
        assert cell_place(index, cell) == divmod(key, index.shape[1])


@given(clouds(), SIZES, st.tuples(*[st.integers(-3, 9)] * 3))
def test_a_stretch_of_a_row_finds_all_points_in_it(cloud, cell_m, where):
    """Also where it begins, ends or lies wholly beside the lattice; it does not run on into the next row."""
    x, y, _ = cloud
    index = index_cells(x, y, cell_m)
    row, one, other = where
    first, last = min(one, other), max(one, other)
    start, stop = strip(index, row, first, last)
    rows, cols = places(x, y, index)
    expected = np.flatnonzero((rows == row) & (cols >= first) & (cols <= last))
    np.testing.assert_array_equal(np.sort(index.order[start:stop]), expected)


@given(clouds(), SIZES)
def test_the_lattice_holds_all_points_and_starts_at_multiples(cloud, cell_m):
    """Row and column 0 hold the least coordinates; so a part of a survey has the cells of the whole."""
    x, y, _ = cloud
    index = index_cells(x, y, cell_m)
    if x.size == 0:
        assert index.shape == (0, 0)
        return
    rows, cols = places(x, y, index)
    assert (rows.min(), cols.min()) == (0, 0)
    assert (rows.max() + 1, cols.max() + 1) == index.shape
    assert index.west / cell_m == pytest.approx(round(index.west / cell_m), abs=1e-6)


def test_islands_far_apart_need_no_cells_between():
    """Two islands 1e6 m apart in both directions have cells for their own points only, and are found exactly."""
    x = np.concatenate([np.arange(50) * 0.1, 1e6 + np.arange(50) * 0.1]) + 5e6
    index = index_cells(x, x, 0.1)
    assert index.keys.size <= 100
    assert index.keys.nbytes + index.order.nbytes + index.starts.nbytes < 2000
    rows, cols = places(x, x, index)
    start, stop = strip(index, rows[99], cols[99], cols[99])
    assert 99 in index.order[start:stop]


@given(st.sets(st.tuples(st.integers(0, 6), st.integers(0, 6)), min_size=25))
def test_rows_of_a_dense_lattice_are_found_at_once(cells):
    """With holes in any row: rows begin by the definition, and stretches are those of a lattice that is not dense."""
    x, y = np.array(sorted(cells), dtype=np.float64).T + 0.5
    dense, sparse = index_cells(x, y, 1.0), index_cells(np.append(x, 1e6), np.append(y, 1e6), 1.0)
    begins = [np.count_nonzero(dense.keys < row * dense.shape[1]) for row in range(dense.shape[0] + 1)]
    assert dense.rows.tolist() == begins
    assert sparse.rows.size == 0
    for row, first, last in itertools.product(range(-1, 8), repeat=3):
        one, other = (index.order[slice(*strip(index, row, first, last))].tolist() for index in (dense, sparse))
        assert one == other or first > last


def test_many_lattice_cells_sort_the_same():
    """Whether 32 bits hold the cells' numbers or not, the points of a cell ascend."""
    random = np.random.default_rng(3)
    x, y = random.integers(0, 3, (2, 500)) * 1.0
    near = index_cells(x, y, 1.0)
    far = index_cells(np.append(x, 1e6), np.append(y, 1e6), 1.0)
    np.testing.assert_array_equal(far.order, np.append(near.order, 500))


def test_a_kernel_counts_the_points_of_a_window():
    """A kernel of its own can take the index and use its helpers."""

    @kernel
    def count_around(index: CellIndex, row: int, col: int, reach: int) -> int:
        count = 0
        for other in range(row - reach, row + reach + 1):
            start, stop = strip(index, other, col - reach, col + reach)
            count += stop - start
        return count

    x, y = (grid.ravel() + 0.5 for grid in np.meshgrid(np.arange(10.0), np.arange(10.0)))
    index = index_cells(x, y, 1.0)
    assert [count_around(index, 4, 4, reach) for reach in (0, 1, 2)] == [1, 9, 25]
    assert count_around(index, -1, -1, 1) == 1


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_coordinate_that_is_no_number_is_refused(bad):
    """The message counts the points."""
    x = np.array([0.0, bad, bad, 1.0])
    with pytest.raises(InputError, match="y is NaN or infinite at 2 of 4"):
        index_cells(np.zeros(4), x, 1.0)


def test_arrays_of_different_lengths_are_refused():
    """Coordinates belong to points, in one dimension."""
    with pytest.raises(InputError, match="one length"):
        index_cells(np.zeros(4), np.zeros(3), 1.0)
    with pytest.raises(InputError, match="one length"):
        index_cells(np.zeros((2, 2)), np.zeros((2, 2)), 1.0)


@pytest.mark.parametrize("size", [0.0, -1.0, math.nan, math.inf])
def test_a_size_that_is_none_is_refused(size):
    """A cell has a side."""
    with pytest.raises(ParameterError, match="cell size must be a finite number of metres above 0"):
        index_cells(np.zeros(2), np.zeros(2), size)


def test_cells_that_cannot_be_numbered_are_refused():
    """Dust-sized cells over half the world."""
    with pytest.raises(ParameterError, match="larger cells"):
        index_cells(np.array([0.0, 1e8]), np.array([0.0, 1e8]), 0.01)


@given(clouds(), SIZES, st.data())
def test_points_around_a_range_of_cells_are_one_slice(cloud, cell_m, data):
    """By the definition, over all cells and any range of them: all points of cells that touch it, and the order's."""
    x, y, _ = cloud
    index = index_cells(x, y, cell_m)
    first, stop = sorted(data.draw(st.tuples(*[st.integers(0, index.keys.size)] * 2)))
    begin, end = places_around(index, (first, stop))
    row, col = np.divmod(index.keys, max(index.shape[1], 1))
    apart = np.maximum(abs(row[:, None] - row[first:stop]), abs(col[:, None] - col[first:stop]))
    for cell in np.flatnonzero((apart <= 1).any(axis=1)):
        assert begin <= index.starts[cell] <= index.starts[cell + 1] <= end


@pytest.mark.parametrize("side_m", [4.0, 1e5])
def test_the_fullest_cell_is_found_without_sorting(side_m):
    """On a dense lattice, and on one of which most cells are empty."""
    x, y = np.random.default_rng(2).uniform(-side_m, side_m, (2, 500))
    x[:7], y[:7] = x[0], y[0]
    assert most_in_a_cell(x, y, 1.0) == np.diff(index_cells(x, y, 1.0).starts).max() >= 7
    assert most_in_a_cell(x[:0], y[:0], 1.0) == 0

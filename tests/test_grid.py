"""Lattices: which cells hold points, values at points, and tiles of the absolute lattice."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyproj import CRS

from msbdb.errors import GridMismatchError
from msbdb.grid import GridSpec, lattice

METRIC = CRS.from_epsg(28992)


@st.composite
def specs(draw) -> GridSpec:
    """Return grids of a few cells anywhere on the absolute lattice, west and south of its origin too."""
    west, south = draw(st.integers(-60, 60)), draw(st.integers(-60, 60))
    width, height = draw(st.integers(1, 20)), draw(st.integers(1, 20))
    return lattice((west / 2, south / 2, (west + width) / 2 - 0.1, (south + height) / 2 - 0.1), 0.5, METRIC)


@given(specs(), st.integers(0, 2**32 - 1))
def test_a_point_has_the_value_of_its_cell(spec, seed):
    """Anywhere in the cell; a point beside the grid has the value for outside."""
    rng = np.random.default_rng(seed)
    values = rng.integers(1, 1000, spec.shape).astype(np.int32)
    row, col = (rng.integers(-2, count + 2, 50) for count in spec.shape)
    east, north = spec.xy(row, col)
    found = spec.sample(values, east + rng.uniform(-0.2, 0.2, 50), north + rng.uniform(-0.2, 0.2, 50), outside=-7)
    within = [0 <= r < spec.shape[0] and 0 <= c < spec.shape[1] for r, c in zip(row, col, strict=True)]
    np.testing.assert_array_equal(spec.inside(row, col), within)
    expected = [values[r, c] if held else -7 for r, c, held in zip(row, col, within, strict=True)]
    np.testing.assert_array_equal(found, expected)
    assert found.dtype == values.dtype


@given(specs())
def test_a_grid_sampled_at_its_own_centres_is_itself(spec):
    """The centres broadcast to the shape of the grid."""
    values = np.arange(spec.shape[0] * spec.shape[1], dtype=np.float32).reshape(spec.shape)
    np.testing.assert_array_equal(spec.sample(values, *spec.centres(), outside=np.nan), values)


@given(specs(), specs())
def test_what_two_grids_share_has_the_value_of_one_in_the_other(one, other):
    """By the absolute lattice: cells that the other grid lacks are not a number."""
    rows, cols = np.indices(other.shape)
    numbers = (rows + other.origin[0]) * 1000.0 + cols + other.origin[1]
    found = other.sample(numbers, *one.centres(), outside=np.nan)
    rows, cols = np.indices(one.shape)
    row, col = rows + one.origin[0], cols + one.origin[1]
    shared = other.inside(row - other.origin[0], col - other.origin[1])
    np.testing.assert_array_equal(found, np.where(shared, row * 1000.0 + col, np.nan))


def test_values_of_another_shape_are_not_sampled():
    """The message names both shapes."""
    spec = lattice((0, 0, 2, 3), 1.0, METRIC)
    with pytest.raises(GridMismatchError, match=r"\(4, 3\).*\(3, 4\)"):
        spec.sample(np.zeros((3, 4)), np.zeros(1), np.zeros(1), outside=0)


@given(specs(), st.data())
def test_a_crop_has_its_cells_at_their_places(spec, data):
    """A window of a grid is a grid of the same lattice."""
    values = np.arange(spec.shape[0] * spec.shape[1]).reshape(spec.shape)
    start = [data.draw(st.integers(0, count - 1)) for count in spec.shape]
    stop = [data.draw(st.integers(first + 1, count)) for first, count in zip(start, spec.shape, strict=True)]
    window = tuple(slice(*ends) for ends in zip(start, stop, strict=True))
    crop = spec.crop(*window)
    assert crop.origin == (spec.origin[0] + start[0], spec.origin[1] + start[1])
    np.testing.assert_array_equal(spec.sample(values, *crop.centres(), outside=-1), values[window])
    inner = tuple(slice(0, max(count // 2, 1)) for count in crop.shape)
    assert (crop.frame[2:], crop.crop(*inner).frame[2:]) == (spec.frame[2:], spec.frame[2:])


@given(specs(), st.tuples(*[st.floats(-30, 30)] * 4))
def test_the_cells_within_bounds_are_those_that_it_holds(spec, edges):
    """As slices and as a mask they are the same cells."""
    west, south, _, _ = spec.bounds
    left, right, low, high = (edge * spec.cell_m for edge in edges)
    bounds = (west + left, south + low, west + right, south + high)
    mask = np.zeros(spec.shape, bool)
    mask[spec.within(bounds)] = True
    np.testing.assert_array_equal(mask, spec.holding(bounds))

"""The nearest points in space: those that a search of all points finds."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.sizes import examples

from msbdb.errors import InputError, ParameterError
from msbdb.points.nearest import nearest

CLOUDS = {
    "even": lambda random, count: random.uniform(0, 10, (count, 3)),
    "on a lattice, with duplicates": lambda random, count: random.integers(0, 4, (count, 3)).astype(float),
    "dense here and sparse there": lambda random, count: (
        random.normal(0, 1, (count, 3)) * 10.0 ** random.integers(-3, 7, (count, 1))
    ),
    "two far islands on a line": lambda random, count: np.column_stack(
        [random.integers(0, 2, count) * 1e7, np.zeros(count), random.uniform(0, 1, count)]
    ),
}


@pytest.mark.parametrize("kind", CLOUDS)
@examples(40)
@given(st.integers(0, 10**6), st.integers(1, 80), st.integers(1, 20))
def test_nearest_points_are_those_of_all_distances(kind, seed, count, wanted):
    """By distance, and by the points' order where distances are equal."""
    points = CLOUDS[kind](np.random.default_rng(seed), count)
    x, y, z = np.ascontiguousarray(points.T)
    dx, dy, dz = (values[:, None] - values for values in (x, y, z))
    expected = np.argsort(dx * dx + dy * dy + dz * dz, axis=1, kind="stable")[:, :wanted]
    np.testing.assert_array_equal(nearest(x, y, z, wanted), expected)


def test_no_points_have_no_nearest():
    """An empty cloud gives an empty table."""
    assert nearest(np.zeros(0), np.zeros(0), np.zeros(0), 3).shape == (0, 0)


def test_bad_input_is_refused():
    """The message tells what is wrong."""
    with pytest.raises(InputError, match="NaN"):
        nearest(np.array([0.0, np.nan]), np.zeros(2), np.zeros(2), 1)
    with pytest.raises(ParameterError, match="1 or more"):
        nearest(np.zeros(2), np.zeros(2), np.zeros(2), 0)

"""The nearest points in space: those that a search of all points finds."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from support.sizes import examples

from msbdb.errors import InputError, ParameterError
from msbdb.points.nearest import nearest, nearest_in_plan

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


@pytest.mark.parametrize("kind", CLOUDS)
def test_points_that_have_others_near_in_plan_find_the_nearest_of_these(kind):
    """What is left out has none within the distance: by all distances, at any distance and number of points."""
    left_out = 0
    for seed in range(100):
        random = np.random.default_rng(seed)
        points = CLOUDS[kind](random, int(random.integers(2, 60)))[:, :2]
        known = random.random(len(points)) < random.choice([0.05, 0.5])
        known[0] = True
        asking, within_m = np.flatnonzero(~known), float(random.choice([0.3, 1.0, 2.5, 1e4]))
        tree, plan = cKDTree(points[known]), (points[:, 0].copy(), points[:, 1].copy())
        found = {}
        for some, distance, number in nearest_in_plan(tree, plan, asking, 1, within_m):
            found.update(zip(some.tolist(), zip(distance[:, 0], number[:, 0], strict=True), strict=True))
        left_out += len(asking) - len(found)
        for point in asking.tolist():
            distances = np.hypot(*(points[known] - points[point]).T)
            distance, number = found.get(point, (np.inf, len(distances)))
            if distances.min() < within_m:
                assert distance == pytest.approx(distances.min())
                assert distances[number] == pytest.approx(distances.min())
            else:
                assert np.isinf(distance)
    assert left_out > 0


def test_no_points_have_no_nearest():
    """An empty cloud gives an empty table."""
    assert nearest(np.zeros(0), np.zeros(0), np.zeros(0), 3).shape == (0, 0)


def test_bad_input_is_refused():
    """The message tells what is wrong."""
    with pytest.raises(InputError, match="NaN"):
        nearest(np.array([0.0, np.nan]), np.zeros(2), np.zeros(2), 1)
    with pytest.raises(ParameterError, match="1 or more"):
        nearest(np.zeros(2), np.zeros(2), np.zeros(2), 0)

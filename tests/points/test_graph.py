"""The graph connects just the pairs that the definition connects, whatever the cloud."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support import oracles
from support.strategies import clouds

from msbdb.errors import InputError, ParameterError
from msbdb.points import graph
from msbdb.points.graph import PointGraph, connect

DISTANCES = st.sampled_from([0.2, 0.5, 1.0, math.sqrt(2), 2.5, 50.0])


def pairs(found):
    """Return the directed pairs of a graph, in its own order."""
    points = np.repeat(np.arange(len(found)), np.diff(found.indptr))
    return list(zip(points.tolist(), found.indices.tolist(), strict=True))


@given(clouds(), DISTANCES)
def test_the_graph_is_the_definition(cloud, distance):
    """All pairs nearer than T_c in space and no others (C2), from both ends, neighbours ascending."""
    found = connect(*cloud, distance)
    assert (found.indptr.dtype, found.indices.dtype) == (np.int64, np.int32)
    assert len(found) == cloud[0].size
    assert pairs(found) == oracles.connected_pairs(*cloud, distance)


@given(clouds(), DISTANCES)
def test_each_pair_can_be_held_once(cloud, distance):
    """From one of its ends."""
    both, once = connect(*cloud, distance), connect(*cloud, distance, once=True)
    held = sorted((max(pair), min(pair)) for pair in pairs(once))
    assert held == [(point, other) for point, other in pairs(both) if other < point]


@given(clouds(), DISTANCES, st.integers(0, 2**32 - 1), st.booleans())
def test_the_neighbours_of_a_set_are_those_of_its_points(cloud, distance, seed, once):
    """Whichever point holds the pair."""
    chosen = np.random.default_rng(seed).random(cloud[0].size) < 0.6
    found = connect(*cloud, distance, once=once)
    beside = {end for pair in pairs(found) if chosen[list(pair)].any() for end in pair}
    assert set(np.flatnonzero(found.with_neighbours(chosen))) == beside | set(np.flatnonzero(chosen))


@given(clouds(), DISTANCES, st.integers(0, 2**32 - 1))
def test_the_order_of_the_points_only_renames_them(cloud, distance, seed):
    """A shuffled cloud has the same pairs, under other numbers."""
    order = np.random.default_rng(seed).permutation(cloud[0].size)
    shuffled = connect(*(column[order] for column in cloud), distance)
    renamed = sorted((order[one], order[other]) for one, other in pairs(shuffled))
    assert renamed == pairs(connect(*cloud, distance))


def test_many_points_are_connected_as_a_tree_finds_them():
    """Enough points for several parts of the work, with crowds of more neighbours than are sorted by insertion."""
    random = np.random.default_rng(5)
    points = random.uniform(0, 50, (3, 50_000))
    points[2] /= 25
    points[:, :400] = points[:, :400] / 50 + 20
    found = connect(*points, 0.9)
    assert np.diff(found.indptr).max() > graph.FEW
    assert pairs(found) == oracles.tree_pairs(*points, 0.9)


def test_a_distance_of_just_the_threshold_does_not_connect():
    """Smaller than T_c, strictly (Definition 1)."""
    x, y, z = np.array([0.0, 3.0]), np.array([0.0, 4.0]), np.zeros(2)
    assert connect(x, y, z, 5.0).indices.size == 0
    assert connect(x, y, z, np.nextafter(5.0, 6.0)).indices.tolist() == [1, 0]


def test_height_parts_a_roof_from_the_ground_below():
    """The distance is that in space, not in plan."""
    assert connect(np.zeros(2), np.zeros(2), np.array([0.0, 6.0]), 1.0).indices.size == 0


def test_duplicates_are_neighbours_of_each_other():
    """Points at one place have the distance 0; none is its own neighbour."""
    found = connect(np.full(4, 7.0), np.full(4, 7.0), np.full(4, 7.0), 0.1)
    assert found.indices.reshape(4, 3).tolist() == [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]


def test_points_in_a_line_form_a_chain():
    """Each has the one before and the one after."""
    line = np.arange(6.0)
    assert np.diff(connect(line, np.zeros(6), np.zeros(6), 1.5).indptr).tolist() == [1, 2, 2, 2, 2, 1]


def test_huge_offsets_and_far_islands_change_nothing():
    """Two islands 1e6 m apart, 1e7 m from the origin, are connected as they are near it; coordinates are exact."""
    random = np.random.default_rng(6)
    points = random.integers(0, 40, (3, 300)) / 16
    near = connect(*points, 0.3)
    far = [np.concatenate([column + 1e7, column + 1e7 + 1e6]) for column in points]
    found = connect(*far, 0.3)
    np.testing.assert_array_equal(found.indptr, np.append(near.indptr, near.indptr[1:] + near.indices.size))
    np.testing.assert_array_equal(found.indices, np.append(near.indices, near.indices + 300))


@pytest.mark.parametrize("count", [0, 1])
def test_no_points_and_one_point_have_no_neighbours(count):
    """Nothing to connect is no error."""
    found = connect(np.zeros(count), np.zeros(count), np.zeros(count), 1.0)
    assert len(found) == count
    assert found.indices.size == 0


def test_strided_and_integer_coordinates_are_taken_as_they_are():
    """Columns of a matrix, and whole numbers."""
    matrix = np.random.default_rng(7).integers(0, 5, (30, 3))
    expected = connect(*(np.ascontiguousarray(column, dtype=np.float64) for column in matrix.T), 1.1)
    found = connect(*matrix.T, 1.1)
    np.testing.assert_array_equal(found.indices, expected.indices)


@pytest.mark.parametrize("axis", ["x", "y", "z"])
@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_coordinate_that_is_no_number_is_refused(axis, bad):
    """NaN and infinity are no places; the message names the axis."""
    cloud = {name: np.zeros(3) for name in "xyz"}
    cloud[axis][1] = bad
    with pytest.raises(InputError, match=f"{axis} is NaN or infinite at 1 of 3"):
        connect(**cloud, distance_m=1.0)


@pytest.mark.parametrize("distance", [0.0, -1.0, math.nan, math.inf])
def test_a_distance_that_is_none_is_refused(distance):
    """T_c is above 0."""
    with pytest.raises(ParameterError, match="T_c below which points are connected must be"):
        connect(np.zeros(2), np.zeros(2), np.zeros(2), distance)


@pytest.mark.parametrize(("limit", "most"), [("MOST_CANDIDATES", 80), ("MOST_NEIGHBOURS", 80)])
def test_a_distance_that_pairs_all_with_all_is_refused(monkeypatch, limit, most):
    """Before it fills the memory, with a word on which T_c to take."""
    monkeypatch.setattr(graph, limit, most)
    with pytest.raises(ParameterError, match=r"1\.5 to 2 times the spacing"):
        connect(np.zeros(10), np.zeros(10), np.zeros(10), 99.0)


@pytest.mark.parametrize(
    ("indptr", "indices"), [([0, 2], [0]), ([0, 1, 1], [2]), ([0, 2, 1, 2], [1, 0]), ([1, 1], []), ([], [])]
)
def test_rows_that_do_not_fit_are_no_graph(indptr, indices):
    """A kernel would read beyond the arrays."""
    with pytest.raises(InputError, match="do not fit"):
        PointGraph(np.array(indptr, dtype=np.int64), np.array(indices, dtype=np.int32))

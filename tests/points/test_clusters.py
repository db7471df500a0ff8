"""Clusters of points by distance: the components of the graph of all near pairs."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.sizes import examples

from msbdb.errors import InputError, ParameterError
from msbdb.points.graph import components, connect
from msbdb.points.linkage import linked, near_others


@examples(100)
@given(
    st.integers(0, 10**6), st.integers(0, 80), st.sampled_from([0.5, 1.0, 1.5, 4.0]), st.sampled_from([1, 8, 40, 10**7])
)
def test_clusters_are_the_components_of_the_graph(seed, count, distance_m, extent):
    """On a lattice, where many pairs are just so far apart, duplicates and far islands included."""
    x, y, z = np.random.default_rng(seed).integers(0, extent, (3, count)).astype(float)
    labels, number = linked(x, y, z / max(extent / 8, 1), distance_m)
    expected, wanted = components(np.ones(count, dtype=np.bool_), connect(x, y, z / max(extent / 8, 1), distance_m))
    assert number == wanted
    np.testing.assert_array_equal(labels, expected)


@examples(100)
@given(st.integers(0, 10**6), st.integers(0, 4), st.sampled_from([1.0, 1.5, 4.0]), st.sampled_from([1, 8, 10**7]))
def test_points_near_others_are_found_by_all_distances(seed, others, distance_m, extent):
    """Few others above or below many points: just so far apart is not near, and nothing is near none."""
    places = np.random.default_rng(seed).integers(0, extent, (500, 3)).astype(float) / [1, 1, max(extent / 8, 1)]
    chosen = np.arange(500) >= others
    near = np.linalg.norm(places[:, None] - places[~chosen], axis=-1) < distance_m
    np.testing.assert_array_equal(near_others(*places.T, distance_m, chosen), chosen & near.any(axis=1))


def test_bad_input_is_refused():
    """The message tells what is wrong."""
    with pytest.raises(InputError, match="NaN"):
        linked(np.array([0.0, np.nan]), np.zeros(2), np.zeros(2), 1.0)
    with pytest.raises(ParameterError, match="above 0"):
        linked(np.zeros(2), np.zeros(2), np.zeros(2), 0.0)

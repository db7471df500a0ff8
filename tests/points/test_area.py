"""Area filters on points obey their laws, and equal the definition at each height."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support import oracles
from support.strategies import clouds

from msbdb.errors import InputError, ParameterError
from msbdb.points.graph import PointGraph, components, connect
from msbdb.points.pointarea import (
    PointScaleSpace,
    area_closing,
    area_open_close,
    area_opening,
    build_point_scale_space,
    open_close_linked,
    open_close_on_sets,
)

FILTERS = st.sampled_from([area_opening, area_closing, area_open_close])
AREAS = st.integers(1, 12)


@st.composite
def functions(draw):
    """Draw a graph and a function over its points: heights with many ties, as integers or floats, or all different."""
    x, y, z = draw(clouds())
    graph = connect(x, y, z, draw(st.sampled_from([0.5, 1.1, 2.0])))
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    heights = random.integers(0, draw(st.sampled_from([2, 5, 1000])), x.size)
    dtype = draw(st.sampled_from([np.int16, np.int64, np.float32, np.float64]))
    return (heights * 0.1).astype(dtype) if np.issubdtype(dtype, np.floating) else heights.astype(dtype), graph


def weights_for(count, seed):
    """Return weights that sum without rounding, some of them 0."""
    return np.random.default_rng(seed).integers(0, 12, count) * 0.25


@given(functions(), AREAS)
def test_opening_is_the_definition_at_every_height(function, threshold):
    """{γ(z) >= h} is the opened on-set S_h (C4), for every h above the lowest value."""
    values, graph = function
    result = area_opening(values, graph, threshold)
    assert result.dtype == values.dtype
    for height in np.unique(values)[1:]:
        np.testing.assert_array_equal(result >= height, oracles.point_opening(values >= height, graph, threshold))


@given(functions(), AREAS)
def test_closing_is_the_definition_at_every_height(function, threshold):
    """{φ(z) >= h} is S_h with the small components of the off-set (C5), for every h up to the highest value."""
    values, graph = function
    result = area_closing(values, graph, threshold)
    assert result.dtype == values.dtype
    for height in np.unique(values)[1:]:
        np.testing.assert_array_equal(result >= height, oracles.point_closing(values >= height, graph, threshold))


@given(functions(), AREAS)
def test_open_close_is_the_definition_at_every_height(function, threshold):
    """{AOC(z) >= h} is AOC of S_h (C6), up to the highest value that the opening leaves."""
    values, graph = function
    opened = area_opening(values, graph, threshold)
    result = area_open_close(values, graph, threshold)
    for height in np.unique(values)[1:]:
        if height <= opened.max():
            on = oracles.point_opening(values >= height, graph, threshold)
            np.testing.assert_array_equal(result >= height, oracles.point_closing(on, graph, threshold))


@given(functions(), st.integers(0, 2**32 - 1), st.floats(0.25, 30))
def test_on_sets_are_filtered_as_by_the_sweep_over_all_heights(function, seed, threshold):
    """At every height that the opening leaves, on islands of enough area; smaller ones are never on."""
    values, graph = function
    weights = weights_for(values.size, seed)
    opened = area_opening(values, graph, threshold, weights=weights)
    swept = area_open_close(values, graph, threshold, weights=weights)
    islands, count = components(np.ones(values.size, dtype=np.bool_), graph)
    small = (np.bincount(islands, weights, count + 1) < threshold)[islands]
    heights = [height for height in np.unique(values)[1:] if height <= opened.max()]
    for chosen in (heights, heights[::3], heights[1:]):
        found = open_close_on_sets(values, graph, threshold, chosen, weights=weights)
        assert (found[small] == -np.inf).all()
        for height in chosen:
            np.testing.assert_array_equal(found[~small] >= height, swept[~small] >= height)


@given(clouds(), st.sampled_from([0.5, 1.1, 2.0]), st.integers(0, 2**32 - 1), st.floats(0.25, 30), st.floats(0, 1))
def test_on_sets_need_no_graph_of_what_is_off(cloud, distance_m, seed, threshold, share):
    """The lowest on-set by linkage, the higher ones among its points and any others: as with all points."""
    x, y, z = cloud
    values = np.random.default_rng(seed).integers(0, 5, x.size)
    weights = weights_for(x.size, seed)
    heights = (2, 3, 4)
    whole = open_close_on_sets(values, connect(x, y, z, distance_m), threshold, heights, weights=weights)
    on, rim = open_close_linked(values >= 2, cloud, distance_m, threshold, weights=weights)
    some = on | (np.random.default_rng(seed).random(x.size) < share)
    graph = connect(x[some], y[some], z[some], distance_m)
    found = open_close_on_sets(
        values[some], graph, threshold, heights, weights=weights[some], lowest=(on[some], rim[some])
    )
    np.testing.assert_array_equal(found, whole[some])
    assert (whole[~some] == -np.inf).all()


@given(functions(), st.integers(0, 2**32 - 1), st.floats(0.25, 30))
def test_on_sets_need_each_pair_once(function, seed, threshold):
    """A graph that holds each pair by its later point gives the same."""
    values, graph = function
    weights = weights_for(values.size, seed)
    point = np.repeat(np.arange(values.size), np.diff(graph.indptr))
    earlier = graph.indices < point
    kept = np.bincount(point[earlier], minlength=values.size)
    half = PointGraph(np.concatenate([[0], np.cumsum(kept)]), graph.indices[earlier])
    heights = np.unique(values)
    one, other = (open_close_on_sets(values, each, threshold, heights, weights=weights) for each in (graph, half))
    np.testing.assert_array_equal(one, other)


@given(functions(), st.integers(0, 2**32 - 1), st.floats(0.25, 30))
def test_weights_are_areas(function, seed, threshold):
    """A component's area is the sum of its points' weights (C3 for weights of 1)."""
    values, graph = function
    weights = weights_for(values.size, seed)
    opened = area_opening(values, graph, threshold, weights=weights)
    closed = area_closing(values, graph, threshold, weights=weights)
    for height in np.unique(values)[1:]:
        on = values >= height
        np.testing.assert_array_equal(opened >= height, oracles.point_opening(on, graph, threshold, weights))
        np.testing.assert_array_equal(closed >= height, oracles.point_closing(on, graph, threshold, weights))


@given(functions(), AREAS)
def test_a_set_is_filtered_by_the_definition_itself(function, threshold):
    """An on-set of booleans, also an empty or a full one, is opened and closed as the definitions say."""
    values, graph = function
    for on in (values >= 2, np.zeros(values.size, dtype=bool), np.ones(values.size, dtype=bool)):
        opened = oracles.point_opening(on, graph, threshold)
        np.testing.assert_array_equal(area_opening(on, graph, threshold), opened)
        np.testing.assert_array_equal(area_closing(on, graph, threshold), oracles.point_closing(on, graph, threshold))
        both = oracles.point_closing(opened, graph, threshold)
        np.testing.assert_array_equal(area_open_close(on, graph, threshold), both)


@given(functions(), AREAS)
def test_opening_lowers_and_closing_raises(function, threshold):
    """γ is anti-extensive, φ extensive."""
    values, graph = function
    assert (area_opening(values, graph, threshold) <= values).all()
    assert (area_closing(values, graph, threshold) >= values).all()


@given(functions(), AREAS, FILTERS)
def test_a_second_pass_changes_nothing(function, threshold, area_filter):
    """Opening, closing and AOC are idempotent, and leave their input as it is."""
    values, graph = function
    values.flags.writeable = False
    once = area_filter(values, graph, threshold)
    np.testing.assert_array_equal(area_filter(once, graph, threshold), once)
    assert np.isin(once, values).all()


@given(functions(), AREAS, FILTERS, st.integers(0, 2**32 - 1))
def test_a_higher_function_gives_a_higher_result(function, threshold, area_filter, seed):
    """Opening, closing and AOC are increasing."""
    values, graph = function
    raised = values + np.random.default_rng(seed).integers(0, 3, values.size).astype(values.dtype)
    assert (area_filter(values, graph, threshold) <= area_filter(raised, graph, threshold)).all()


@given(functions(), AREAS)
def test_closing_is_the_dual_of_opening(function, threshold):
    """φ(z) = -γ(-z)."""
    values, graph = function
    np.testing.assert_array_equal(area_closing(values, graph, threshold), -area_opening(-values, graph, threshold))


@given(functions(), AREAS, AREAS, st.sampled_from([area_opening, area_closing]))
def test_the_larger_threshold_absorbs_the_smaller(function, one, other, area_filter):
    """γ_a γ_b = γ_max(a, b), in either order, and likewise for closings."""
    values, graph = function
    twice = area_filter(area_filter(values, graph, one), graph, other)
    np.testing.assert_array_equal(twice, area_filter(values, graph, max(one, other)))


@given(clouds(), AREAS, FILTERS, st.integers(0, 2**32 - 1))
def test_the_order_of_the_points_does_not_matter(cloud, threshold, area_filter, seed):
    """A shuffled cloud has the shuffled result, ties of heights and duplicates included."""
    order = np.random.default_rng(seed).permutation(cloud[0].size)
    values = np.floor(cloud[2] * 2)
    result = area_filter(values, connect(*cloud, 1.1), threshold)
    shuffled = [column[order] for column in cloud]
    np.testing.assert_array_equal(area_filter(values[order], connect(*shuffled, 1.1), threshold), result[order])


@given(functions(), st.sets(AREAS, min_size=1, max_size=4).map(sorted))
def test_each_scale_is_fed_by_the_one_before(function, thresholds):
    """SP_k = φ_k(γ_k(SP_{k-1})), finest first (C7); its on-sets are those of the definition."""
    values, graph = function
    space = build_point_scale_space(values, graph, thresholds)
    assert space.thresholds == tuple(thresholds)
    expected = values
    for index, threshold in enumerate(thresholds):
        expected = area_open_close(expected, graph, threshold)
        np.testing.assert_array_equal(space.levels[index], expected)
        for height in np.unique(values):
            np.testing.assert_array_equal(space.on_set(index, height), expected >= height)


@given(functions(), AREAS, AREAS)
def test_a_larger_opening_is_a_subset_of_a_smaller(function, one, other):
    """The paper's claim of area scales holds for openings (C15)."""
    values, graph = function
    small, large = min(one, other), max(one, other)
    assert (area_opening(values, graph, large) <= area_opening(values, graph, small)).all()


def test_a_larger_open_close_is_no_subset_of_a_smaller():
    """After the closing the claim fails (C15): the larger scale fills the gap in the roof that the smaller leaves."""
    line = np.arange(12.0)
    graph = connect(line, np.zeros(12), np.zeros(12), 1.5)
    roof = np.array([0, 0, 0, 5, 5, 5, 0, 0, 5, 5, 5, 5])
    small, large = (area_open_close(roof, graph, threshold) >= 5 for threshold in (2, 3))
    assert (large & ~small).tolist() == [False] * 6 + [True, True] + [False] * 4


def test_an_island_below_the_area_is_removed_and_then_joined():
    """Three points apart from all others: off after opening at every height, on after closing (C4, C5)."""
    x = np.append(np.arange(20.0), [100.0, 101.0, 102.0])
    graph = connect(x, np.zeros(23), np.zeros(23), 1.5)
    heights = np.where(np.arange(23) < 10, 0.0, 8.0)
    heights[20:] = 4.0
    assert (area_opening(heights, graph, 5)[20:] == 0).all()
    assert (area_closing(heights, graph, 5)[20:] == 8).all()
    assert (area_open_close(heights, graph, 5)[:20] == heights[:20]).all()
    assert not area_opening(heights >= 4, graph, 5)[20:].any()
    assert area_open_close(heights >= 6, graph, 5)[20:].all()


def test_a_component_of_exactly_the_area_stays():
    """At least T_a (C4); a fraction of a point needs the next whole one; more than all points flattens."""
    graph = connect(np.arange(9.0), np.zeros(9), np.zeros(9), 1.5)
    heights = np.array([0, 0, 7, 7, 7, 7, 0, 0, 0], dtype=np.int16)
    np.testing.assert_array_equal(area_opening(heights, graph, 4), heights)
    np.testing.assert_array_equal(area_opening(heights, graph, 3.2), heights)
    for threshold in (4.01, 5, 10, 1e300):
        assert not area_opening(heights, graph, threshold).any()


@given(functions(), st.integers(0, 6))
def test_components_are_those_of_the_subgraph(function, height):
    """Labels follow the components' first points; 0 outside of the set (Definition 2)."""
    values, graph = function
    on = values >= height / 2
    labels, count = components(on, graph)
    assert labels.dtype == np.int32
    assert count == labels.max(initial=0)
    np.testing.assert_array_equal(labels, oracles.point_components(on, graph))


def test_no_points_and_one_point_are_filtered():
    """Nothing stays nothing; one point is a component of area 1."""
    nothing, one = (connect(*np.zeros((3, count)), 1.0) for count in (0, 1))
    assert area_open_close(np.zeros(0, dtype=np.float32), nothing, 5).dtype == np.float32
    assert components(np.zeros(0, dtype=bool), nothing)[1] == 0
    assert area_open_close(np.array([3.5]), one, 1).tolist() == [3.5]
    assert components(np.array([True]), one)[0].tolist() == [1]


@pytest.mark.parametrize("threshold", [0, -3, np.nan, np.inf, True, "9"])
def test_an_area_that_is_none_is_refused(threshold):
    """T_a is a finite number above 0."""
    graph = connect(*np.zeros((3, 2)), 1.0)
    with pytest.raises(ParameterError, match="T_a must be a finite number above 0"):
        area_opening(np.zeros(2), graph, threshold)


@pytest.mark.parametrize(
    ("values", "message"),
    [(np.zeros(3), "2 booleans"), (np.zeros((1, 2)), "2 booleans"), (np.array(["a", "b"]), "booleans, integers"),
     (np.array([0.0, np.nan]), "NaN at 1 points")],
)  # fmt: skip
def test_what_is_no_function_over_the_points_is_refused(values, message):
    """One number a point, with an order."""
    graph = connect(*np.zeros((3, 2)), 1.0)
    with pytest.raises(InputError, match=message):
        area_closing(values, graph, 2)


@pytest.mark.parametrize("weights", [[1.0], [1.0, -1.0], [1.0, np.nan], [1.0, np.inf]])
def test_weights_that_are_no_areas_are_refused(weights):
    """One finite area a point, from 0."""
    with pytest.raises(InputError, match="2 finite numbers from 0"):
        area_opening(np.zeros(2), connect(*np.zeros((3, 2)), 1.0), 2, weights=np.array(weights))


@pytest.mark.parametrize("mask", [np.zeros(2), np.zeros(3, dtype=bool)])
def test_what_is_no_set_of_the_points_has_no_components(mask):
    """One boolean a point."""
    with pytest.raises(InputError, match="2 booleans, one a point"):
        components(mask, connect(*np.zeros((3, 2)), 1.0))


@pytest.mark.parametrize("thresholds", [[], [5, 5], [9, 4], [0, 3]])
def test_the_areas_of_a_scale_space_must_ascend(thresholds):
    """Scales are areas in strictly rising order."""
    with pytest.raises(ParameterError, match=r"ascending|above 0"):
        build_point_scale_space(np.zeros(2), connect(*np.zeros((3, 2)), 1.0), thresholds)


def test_a_scale_space_is_a_value():
    """Its levels are read-only and as many as its thresholds."""
    space = build_point_scale_space(np.zeros(2), connect(*np.zeros((3, 2)), 1.0), [1])
    with pytest.raises(ValueError, match="read-only"):
        space.levels[0, 0] = 1
    with pytest.raises(InputError, match="one level a threshold"):
        PointScaleSpace(np.zeros((2, 3)), (1.0,))

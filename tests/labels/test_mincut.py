"""The minimum cut against all divisions of a few nodes."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from msbdb.errors import ParameterError
from msbdb.labels import Pairs, mincut, minimum_cut

QUARTERS = st.integers(-12, 12).map(lambda k: k / 4)
COSTS = st.integers(0, 8).map(lambda k: k / 4)


@st.composite
def networks(draw):
    """Costs of up to six nodes, and of pairs of them in which like kinds cost no more than unlike ones."""
    count = draw(st.integers(1, 6))
    costs = draw(st.lists(QUARTERS, min_size=count, max_size=count))
    places = st.tuples(st.integers(0, count - 1), st.integers(0, count - 1)).filter(lambda pair: pair[0] != pair[1])
    rows = []
    for first, second in draw(st.lists(places, max_size=8)) if count > 1 else []:
        both_0, both_1, only_second, more = (draw(COSTS) for _ in range(4))
        rows.append((first, second, both_0, only_second, max(both_0 + both_1 - only_second, 0) + more, both_1))
    columns = list(zip(*rows, strict=True)) or [()] * 6
    nodes = [np.array(column, dtype=np.int32) for column in columns[:2]]
    return np.array(costs, dtype=float), Pairs(*nodes, *(np.array(c, dtype=float) for c in columns[2:]))


def total(kinds, costs, pairs):
    """Add up what a division costs, by the definition."""
    first, second = np.asarray(kinds)[pairs.first], np.asarray(kinds)[pairs.second]
    of_pairs = np.select(
        [first & second, first, second], [pairs.both_1, pairs.only_first, pairs.only_second], pairs.both_0
    )
    return float(costs[np.asarray(kinds)].sum() + of_pairs.sum())


@given(networks())
def test_no_division_is_cheaper_and_of_the_cheapest_none_has_fewer_of_kind_1(network):
    """All divisions of six nodes are tried; quarters are exact in the cut's units."""
    costs, pairs = network
    kinds = minimum_cut(costs, pairs)
    every = [np.array(k, dtype=bool) for k in product((False, True), repeat=len(costs))]
    least = min(total(k, costs, pairs) for k in every)
    assert total(kinds, costs, pairs) == least
    cheapest = [k for k in every if total(k, costs, pairs) == least]
    assert all((kinds <= k).all() for k in cheapest)


@given(networks(), st.randoms())
def test_the_order_of_the_pairs_does_not_matter(network, random):
    """The same network in another order has the same cut."""
    costs, pairs = network
    order = list(range(pairs.first.size))
    random.shuffle(order)
    mixed = Pairs(*(getattr(pairs, name)[order] for name in Pairs.__slots__))
    np.testing.assert_array_equal(minimum_cut(costs, mixed), minimum_cut(costs, pairs))


def test_costs_without_a_minimum_cut_are_refused():
    """Two nodes that would rather differ."""
    one = np.ones(1)
    with pytest.raises(ParameterError, match="1 of 1 pairs"):
        minimum_cut(np.zeros(2), Pairs(np.array([0], np.int32), np.array([1], np.int32), one, one * 0, one * 0, one))


@given(seed=st.integers(0, 10_000), size=st.sampled_from([1, 3, 10]))
def test_parts_that_are_not_connected_are_divided_as_together(seed, size):
    """Whether groups are small or all nodes are one, the division is the same."""
    rng = np.random.default_rng(seed)
    count, links = 30, 25
    first, second = (rng.integers(0, count, links).astype(np.int32) for _ in range(2))
    apart = first != second
    unlike, none = rng.integers(0, 5, apart.sum()) / 4, np.zeros(apart.sum())
    pairs = Pairs(first[apart], second[apart], none, unlike, unlike, none)
    costs = rng.integers(-8, 9, count) / 4
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mincut, "GROUP", 1_000)
        together = minimum_cut(costs, pairs)
        patch.setattr(mincut, "GROUP", size)
        assert (minimum_cut(costs, pairs) == together).all()
        _, ends = mincut._groups(count, pairs.first, pairs.second)
        assert len(ends) > 1

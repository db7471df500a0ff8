"""Order of values and of points."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from support.sizes import examples

from msbdb.order import order_in_groups, order_of, order_of_points, ranks

DTYPES = ["bool", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "f2", "f4", "f8"]


@pytest.mark.parametrize("descending", [False, True])
@pytest.mark.parametrize("dtype", DTYPES)
@examples(40)
@given(data=st.data())
def test_order_sorts_any_values(dtype, descending, data):
    """Each index once, and the values in order: extremes of the type, infinities and negative zeros included."""
    values = data.draw(
        hnp.arrays(dtype, st.integers(0, 30), elements={"allow_nan": False} if dtype[0] == "f" else None)
    )
    order = order_of(values, descending=descending)
    assert order.dtype == np.int32
    np.testing.assert_array_equal(np.sort(order), np.arange(values.size))
    expected = np.sort(values)
    np.testing.assert_array_equal(values[order], expected[::-1] if descending else expected)


@pytest.mark.parametrize("dtype", ["f4", "int32", "uint16"])
def test_order_of_many_values_is_that_of_a_comparing_sort(dtype):
    """Values that differ in every digit of the sort."""
    values = (np.random.default_rng(5).normal(size=20_000) * 1e4).astype("int32").astype(dtype)
    np.testing.assert_array_equal(values[order_of(values, descending=False)], np.sort(values))


@pytest.mark.parametrize("descending", [False, True])
@pytest.mark.parametrize("dtype", ["f4", "int64", "uint16", "bool"])
@given(seed=st.integers(0, 10**6), count=st.integers(0, 200))
def test_equal_values_of_32_bits_keep_their_order(dtype, descending, seed, count):
    """As in a stable sort, of the negative values where the order descends."""
    values = np.random.default_rng(seed).integers(0, 5, count).astype(dtype)
    key = -values.astype(np.int64) if descending else values
    np.testing.assert_array_equal(order_of(values, descending=descending), np.argsort(key, kind="stable"))


@examples(100)
@given(
    st.integers(0, 10**6),
    st.integers(0, 60),
    st.sampled_from([(1, 1.0), (3, 1e-9), (40, 1e6), (10**6, 0.01)]),
    st.sampled_from([0.0, -5.0, 7e6, 1e15]),
    st.sampled_from([None, 1, 5, 2**32]),
)
def test_order_of_points_is_that_of_a_sort_by_all_keys(seed, count, lattice, offset_m, groups):
    """Few places or many, near or so far apart that leading digits tell nothing: by group, x, y and the rest."""
    places, step_m = lattice
    random = np.random.default_rng(seed)
    x, y = random.integers(0, places, (2, count)) * step_m + offset_m
    x[: count // 10] = 1e12
    z, echo = random.integers(0, 2, (2, count))
    group = None if groups is None else random.integers(0, groups, count)
    keys = (echo, z, y, x) if group is None else (echo, z, y, x, group)
    expected = np.lexsort(keys)
    np.testing.assert_array_equal(order_of_points(x, y, [z, echo], group=group), expected)
    grouped = np.zeros(count, dtype=np.int64) if group is None else group
    points = random.permutation(count)
    points = points[np.argsort(grouped[points], kind="stable")].astype(np.int32)
    starts = np.append(0, np.cumsum(np.unique(grouped, return_counts=True)[1]))
    np.testing.assert_array_equal(order_in_groups((points, starts), x, y, [z, echo]), expected)


@given(hnp.arrays(np.int64, st.integers(1, 30), elements=st.integers(-5, 5) | st.integers(-(2**40), 2**40)))
def test_ranks_are_those_of_a_sort(numbers):
    """Near together or far apart."""
    for found, expected in zip(ranks(numbers), np.unique(numbers, return_inverse=True), strict=True):
        np.testing.assert_array_equal(found, expected)

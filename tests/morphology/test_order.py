"""Order of values by radix sort."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from msbdb.morphology.order import order_of

DTYPES = ["bool", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "f2", "f4", "f8"]


@pytest.mark.parametrize("descending", [False, True])
@pytest.mark.parametrize("dtype", DTYPES)
@settings(max_examples=40, deadline=None)
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

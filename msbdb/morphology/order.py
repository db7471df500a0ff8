"""The order of values, by radix sort where they fit into 32 bits."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msbdb.morphology.kernels import kernel

BITS = 11
"""Bits of a digit: three digits make 32 bits, and the places of a digit's values fit into the nearest cache."""


def order_of(values: NDArray[Any], *, descending: bool) -> NDArray[np.int32]:
    """Return the index that sorts the values; ties come in any order.

    Parameters
    ----------
    values : (N,) ndarray
        Booleans, integers or floats without NaN, fewer than 2^31.
    descending : bool
        From the highest down.

    Notes
    -----
    Floats of 32 bits and integers of a range below 2^32 are sorted by radix, in O(N); others by comparison.
    """
    keys = _keys(values)
    if keys is None:
        order = np.argsort(values).astype(np.int32)
        return np.ascontiguousarray(order[::-1]) if descending else order
    return _radix(~keys if descending else keys)


def _keys(values: NDArray[Any]) -> NDArray[np.uint32] | None:
    """Return whole numbers that are ordered as the values are; None where 32 bits cannot hold them."""
    if values.dtype.kind == "f":
        return _float_keys(values) if values.dtype.itemsize <= 4 else None
    if values.size == 0:
        return values.astype(np.uint32)
    if values.dtype.itemsize < 4:
        values = values.astype(np.int32)
    low = values.min()
    if int(values.max()) - int(low) >= 2**32:
        return None
    # A difference that leaves a signed type wraps, and is right again as an unsigned number.
    keys: NDArray[np.uint32] = (values - low).astype(np.uint32)
    return keys


def _float_keys(values: NDArray[np.floating]) -> NDArray[np.uint32]:
    """Return the bits of floats, with the order of the negative ones turned round (IEEE 754)."""
    # Adding zero makes negative zeros positive.
    bits = (values.astype(np.float32) + np.float32(0)).view(np.uint32)
    negative = (bits >> np.uint32(31)).astype(np.bool_)
    return np.where(negative, ~bits, bits | np.uint32(2**31))


@kernel
def _radix(keys: NDArray[np.uint32]) -> NDArray[np.int32]:
    """Sort stably by each digit, from the least; digits that are the same in all keys are passed over."""
    count = keys.size
    digits = 2**BITS
    order = np.arange(count, dtype=np.int32)
    other = np.empty(count, dtype=np.int32)
    for shift in range(0, 32, BITS):
        places = np.zeros(digits, dtype=np.int64)
        for key in keys:
            places[(key >> shift) & (digits - 1)] += 1
        if places.max() == count:
            continue
        before = 0
        for digit in range(digits):
            before += places[digit]
            places[digit] = before - places[digit]
        for index in order:
            digit = (keys[index] >> shift) & (digits - 1)
            other[places[digit]] = index
            places[digit] += 1
        order, other = other, order
    return order

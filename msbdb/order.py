"""The order of values and of points by their places, with numpy's sorts."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msbdb.threads import kernel

MOST_MARKS = 1_000_000
"""Up to this span of numbers, those that occur are marked; beyond, they are sorted."""

KEY_BITS = 64
"""Bits of the numbers by which points are sorted: group first, then about as many for x as for y."""


def order_of(values: NDArray[Any], *, descending: bool) -> NDArray[np.int32]:
    """Return the index that sorts the values.

    Parameters
    ----------
    values : (N,) ndarray
        Booleans, integers or floats without NaN, fewer than 2^31.
    descending : bool
        From the highest down.

    Notes
    -----
    Floats of up to 32 bits and integers of a range below 2^32 are packed with their place into one number of 64 bits.
    Sorting these numbers is several times as fast as `numpy.argsort`, and equal values keep their order. Other values
    are sorted by `numpy.argsort`, where equal values come in any order.

    Examples
    --------
    >>> order_of(np.array([3, -1, 3, 7]), descending=True)
    array([3, 0, 2, 1], dtype=int32)
    """
    keys = sort_keys(values)
    if keys is None:
        order = np.argsort(values).astype(np.int32)
        return np.ascontiguousarray(order[::-1]) if descending else order
    both = (~keys if descending else keys).astype(np.uint64) << np.uint64(32)
    both |= np.arange(both.size, dtype=np.uint64)
    both.sort()
    return both.astype(np.uint32).view(np.int32)


def order_of_points(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    ties: Sequence[NDArray[Any]] = (),
    *,
    group: NDArray[np.integer] | None = None,
) -> NDArray[np.intp]:
    """Return the index that sorts points by group, x and y, then by what breaks ties; equal points keep their order.

    Parameters
    ----------
    x, y : (N,) ndarray of float64
        Finite coordinates.
    ties : sequence of (N,) ndarray
        What orders points at one place, the first of them first.
    group : (N,) ndarray of int, optional
        Whole numbers from 0, below 2^32, that come before x; all the same by default.

    Notes
    -----
    ``np.lexsort((*reversed(ties), y, x, group))`` gives the same, but sorts once for each of them. Here points are
    sorted by one number of 64 bits, of the group and the leading digits of x and y. The few points that this number
    does not separate are sorted by all keys.

    Examples
    --------
    >>> order_of_points(np.array([2.0, 1.0, 1.0, 1.0]), np.array([0.0, 5.0, 3.0, 3.0]), [np.array([0, 0, 7, 6])])
    array([3, 2, 1, 0])
    """
    groups = 0 if group is None or not len(group) else int(group.max()).bit_length()
    bits = (KEY_BITS - groups) // 2
    before = np.zeros(len(x), dtype=np.uint8) if group is None else group
    key = _packed(before, (x, *_scale(x, bits)), (y, *_scale(y, bits)), np.uint64(bits))
    order = np.argsort(key)
    some = _undecided(key, order, x, np.uint64(bits))
    if some.any():
        few = np.sort(order[some])
        keys = [values[few] for values in (*reversed(ties), y, x)]
        order[some] = few[np.lexsort(keys if group is None else [*keys, group[few]])]
    return order


def order_in_groups(
    groups: tuple[NDArray[np.int32], NDArray[np.integer]],
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    ties: Sequence[NDArray[Any]] = (),
) -> NDArray[np.int32]:
    """Return what `order_of_points` does for points that are sorted by small groups already, in half of the time.

    Parameters
    ----------
    groups : (N,) ndarray of int32, (G + 1,) ndarray of int
        The points of the groups one after the other, and where each group begins; the last number is N.
    x, y, ties
        As for `order_of_points`.

    Examples
    --------
    >>> groups = np.array([0, 2, 1, 3], dtype=np.int32), np.array([0, 2, 4])
    >>> order_in_groups(groups, np.array([2.0, 1.0, 1.0, 0.0]), np.zeros(4))
    array([2, 0, 3, 1], dtype=int32)
    """
    points, starts = groups
    bits = KEY_BITS // 2
    order, some = _sorted_groups(points, starts, (x, *_scale(x, bits)), (y, *_scale(y, bits)), np.uint64(bits))
    places = np.flatnonzero(some)
    few, group = order[places], np.searchsorted(starts, places, side="right")
    order[places] = few[np.lexsort((few, *(values[few] for values in (*reversed(ties), y, x)), group))]
    return order


def ranks(numbers: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the numbers that occur, ascending, and the place of each in them; without sorting where few can occur.

    ``np.unique(numbers, return_inverse=True)`` gives the same.

    Parameters
    ----------
    numbers : (N,) ndarray of int64
        One at least.
    """
    low = int(numbers.min())
    span = int(numbers.max()) - low + 1
    if span > MOST_MARKS:
        occurring, place = np.unique(numbers, return_inverse=True)
        return occurring, place
    occurs = np.zeros(span, dtype=np.bool_)
    occurs[numbers - low] = True
    return np.flatnonzero(occurs) + low, (np.cumsum(occurs) - 1)[numbers - low]


def _scale(values: NDArray[np.float64], bits: int) -> tuple[float, float]:
    """Return the lowest value, and the factor that makes whole numbers of so many bits of what is above it."""
    if not values.size:
        return 0.0, 0.0
    low, high = float(values.min()), float(values.max())
    # Half of the numbers at most, so that no rounding leads beyond them.
    return low, (2.0 ** (bits - 1) - 1) / (high - low) if high > low else 0.0


@kernel
def _packed(
    group: NDArray[np.integer],
    columns: tuple[NDArray[np.float64], float, float],
    rows: tuple[NDArray[np.float64], float, float],
    bits: np.uint64,
) -> NDArray[np.uint64]:
    """Return numbers of 64 bits that never fall where group, x and y rise, in this order."""
    (x, west, across), (y, south, along) = columns, rows
    key = np.empty(x.size, dtype=np.uint64)
    for point in range(x.size):
        column = np.uint64(group[point]) << bits | np.uint64((x[point] - west) * across)
        key[point] = column << bits | np.uint64((y[point] - south) * along)
    return key


@kernel
def _undecided(
    key: NDArray[np.uint64], order: NDArray[np.intp], x: NDArray[np.float64], bits: np.uint64
) -> NDArray[np.bool_]:
    """Return which points, in the order of the keys, the keys do not separate: equal keys, or x of equal digits."""
    undecided = np.zeros(key.size, dtype=np.bool_)
    first = 0
    for stop in range(1, key.size + 1):
        if stop < key.size and key[order[stop]] >> bits == key[order[first]] >> bits:
            continue
        mixed = False  # whether the x of this column differ, which its digits do not show
        for place in range(first + 1, stop):
            mixed = mixed or x[order[place]] != x[order[place - 1]]
        for place in range(first + 1, stop):
            if mixed or key[order[place]] == key[order[place - 1]]:
                undecided[place] = undecided[place - 1] = True
        first = stop
    return undecided


@kernel
def _sorted_groups(
    points: NDArray[np.int32],
    starts: NDArray[np.integer],
    columns: tuple[NDArray[np.float64], float, float],
    rows: tuple[NDArray[np.float64], float, float],
    bits: np.uint64,
) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """Return the points of each group by their keys, and which of them the keys do not separate."""
    (x, west, across), (y, south, along) = columns, rows
    order, undecided = np.empty_like(points), np.zeros(points.size, dtype=np.bool_)
    for group in range(starts.size - 1):
        begin, end = starts[group], starts[group + 1]
        own = points[begin:end]
        here = x[own]
        key = _packed(np.zeros(own.size, dtype=np.uint8), (here, west, across), (y[own], south, along), bits)
        places = np.argsort(key)
        order[begin:end] = own[places]
        undecided[begin:end] = _undecided(key, places, here, bits)
    return order, undecided


def sort_keys(values: NDArray[Any]) -> NDArray[np.uint32] | None:
    """Return whole numbers that are ordered as the values are, without NaN; None where 32 bits cannot hold them."""
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
    """Return the bits of floats, with the order of the negative ones reversed (IEEE 754)."""
    # Adding zero makes negative zeros positive.
    bits = (values.astype(np.float32) + np.float32(0)).view(np.uint32)
    negative = (bits >> np.uint32(31)).astype(np.bool_)
    return np.where(negative, ~bits, bits | np.uint32(2**31))

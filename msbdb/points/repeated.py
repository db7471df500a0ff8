"""Points that a survey holds more than once, as tiles with a margin or two exports of a strip do."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from msbdb.points.cloud import UNCLASSIFIED_CLASS, PointCloud
from msbdb.threads import in_threads, kernel

Mask = NDArray[np.bool_]
Floats = NDArray[np.float64]
Bits = NDArray[np.uint64]

QUANTA = 32768.0
"""Places are compared in steps of 0.03 mm: files with other offsets differ in the last digits. As it is a power of two,
whole millimetres, tenths or hundredths of them never lie on the border of two steps."""

SLOTS = 4
"""Least number of bits a point in the first look, and of places a suspect in the second: few share one by chance."""

LEAST_BITS = 10
"""Of a table's number of places, so that a few points need no case of their own."""

FACTORS = (0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9, 0xBF58476D1CE4E5B9)
"""Odd numbers of 64 bits that spread coordinates, and mix them (Knuth 1998; Steele et al. 2014)."""

UNNAMED = 255
"""Rank of a point without class: of two at one place the one with a class stays."""


def repeated(
    places: tuple[Floats, Floats, Floats],
    number: NDArray[np.uint8],
    classification: NDArray[np.uint8],
    others: Sequence[NDArray[np.unsignedinteger]] = (),
) -> NDArray[np.intp]:
    """Return the points that repeat another one: the same place, and the same number of the echo.

    Two pulses that stop at one place to the last digit are no more evidence than one, so that times play no part.

    Parameters
    ----------
    places : three (N,) ndarrays of float64
        x, y and z, metres, finite.
    number : (N,) ndarray of uint8
        Number of the echo in its pulse.
    classification : (N,) ndarray of uint8
        ASPRS classes. Of equal points one with a class stays, of several classes that with the least number.
    others : sequence of (N,) or (N, B) ndarrays of uint
        What decides then, of up to 16 bits: the least value stays. So the order of the points means nothing, but
        between points that are alike in all of it.

    Returns
    -------
    (K,) ndarray of intp
        Their indices, ascending; of each group of equal points all but one.

    Notes
    -----
    O(N), and less than six bytes a point where few points are repeated. First each point marks a bit of a table by its
    hash; each half of the points has tables of its own, on a core of its own. Then those that share a bit are compared
    exactly. Points that lie within a step of `QUANTA`, 0.03 mm, are at one place. Coordinates in feet may lie on the
    border of two steps: of files with other offsets one point in ten thousand may then stay twice.

    Examples
    --------
    >>> x, none = np.array([1.0, 2.0, 1.0, 1.0]), np.zeros(4)
    >>> repeated((x, none, none), np.uint8([1, 1, 1, 2]), np.uint8([1, 2, 6, 6]))
    array([0])
    """
    suspects = np.flatnonzero(_share_a_bit(places, number, _bits_of(len(number))))
    x, y, z = (values[suspects] for values in places)
    classes = classification[suspects]
    named = np.where(classes > UNCLASSIFIED_CLASS, classes, np.uint8(UNNAMED))
    ranks = np.column_stack([named, *(values[suspects] for values in others)]).astype(np.uint16)
    found = _repeats((x, y, z), number[suspects], ranks, _bits_of(len(suspects)))
    again: NDArray[np.intp] = suspects[found]
    return again


def without_repeated(cloud: PointCloud) -> PointCloud:
    """Return a cloud in which each place counts once; the same one where nothing is repeated."""
    none = np.zeros(len(cloud), dtype=np.uint8)
    number, classes = (none if values is None else values for values in (cloud.return_number, cloud.classification))
    known = (cloud.number_of_returns, cloud.intensity, cloud.colours)
    others = [values for values in known if values is not None]
    again = repeated((cloud.x, cloud.y, cloud.z), number, classes, others)
    if not len(again):
        return cloud
    keep = np.ones(len(cloud), dtype=np.bool_)
    keep[again] = False
    return cloud.take(keep)


def _bits_of(count: int) -> int:
    """Return the bits of a table in which so many points have places enough."""
    return max((SLOTS * count).bit_length(), LEAST_BITS)


@kernel
def _hash(x: float, y: float, z: float, number: np.uint8) -> np.uint64:
    """Mix the place and the number of an echo; high bits are mixed best."""
    mixed = np.uint64(np.int64(np.rint(x * QUANTA))) * np.uint64(FACTORS[0])
    mixed ^= np.uint64(np.int64(np.rint(y * QUANTA))) * np.uint64(FACTORS[1])
    mixed ^= np.uint64(np.int64(np.rint(z * QUANTA)) * 256 + number) * np.uint64(FACTORS[2])
    mixed ^= mixed >> np.uint64(29)
    mixed *= np.uint64(FACTORS[3])
    return mixed ^ (mixed >> np.uint64(32))


def _share_a_bit(places: tuple[Floats, Floats, Floats], number: NDArray[np.uint8], bits: int) -> Mask:
    """Return which points share a bit of a table with another one."""
    halves = [slice(0, number.size // 2), slice(number.size // 2, number.size)]
    (once, twice), (also, again) = in_threads(lambda half: _mark(_part(places, half), number[half], bits), halves)
    twice |= again | (once & also)
    return np.concatenate(in_threads(lambda half: _marked(_part(places, half), number[half], twice, bits), halves))


def _part(places: tuple[Floats, Floats, Floats], part: slice) -> tuple[Floats, Floats, Floats]:
    """Return the coordinates of some points."""
    x, y, z = places
    return x[part], y[part], z[part]


@kernel
def _mark(places: tuple[Floats, Floats, Floats], number: NDArray[np.uint8], bits: int) -> tuple[Bits, Bits]:
    """Return tables of so many bits: those that a point has, and those that several have."""
    x, y, z = places
    once, twice = np.zeros(1 << (bits - 6), dtype=np.uint64), np.zeros(1 << (bits - 6), dtype=np.uint64)
    away = np.uint64(64 - bits)
    for point in range(number.size):
        bit = _hash(x[point], y[point], z[point], number[point]) >> away
        word, mark = bit >> np.uint64(6), np.uint64(1) << (bit & np.uint64(63))
        if once[word] & mark:
            twice[word] |= mark
        else:
            once[word] |= mark
    return once, twice


@kernel
def _marked(places: tuple[Floats, Floats, Floats], number: NDArray[np.uint8], table: Bits, bits: int) -> Mask:
    """Return which points have a bit of a table of so many."""
    x, y, z = places
    found = np.zeros(number.size, dtype=np.bool_)
    away = np.uint64(64 - bits)
    for point in range(number.size):
        bit = _hash(x[point], y[point], z[point], number[point]) >> away
        found[point] = table[bit >> np.uint64(6)] & (np.uint64(1) << (bit & np.uint64(63))) != 0
    return found


@kernel
def _repeats(
    places: tuple[Floats, Floats, Floats], number: NDArray[np.uint8], ranks: NDArray[np.uint16], bits: int
) -> Mask:
    """Return which points are at the place of one that goes before them by its ranks."""
    x, y, z = places
    held = np.full(1 << bits, -1, dtype=np.int64)
    found = np.zeros(number.size, dtype=np.bool_)
    for point in range(number.size):
        slot = _hash(x[point], y[point], z[point], number[point]) >> np.uint64(64 - bits)
        while held[slot] >= 0:
            other = held[slot]
            if (
                number[other] == number[point]
                and np.rint(x[other] * QUANTA) == np.rint(x[point] * QUANTA)
                and np.rint(y[other] * QUANTA) == np.rint(y[point] * QUANTA)
                and np.rint(z[other] * QUANTA) == np.rint(z[point] * QUANTA)
            ):
                first = False
                for rank in range(ranks.shape[1]):
                    if ranks[point, rank] != ranks[other, rank]:
                        first = ranks[point, rank] < ranks[other, rank]
                        break
                found[other if first else point] = True
                if first:
                    held[slot] = point
                break
            slot = (slot + np.uint64(1)) & np.uint64((1 << bits) - 1)
        else:
            held[slot] = point
    return found

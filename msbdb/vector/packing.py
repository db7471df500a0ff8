"""Cells that hold points, numbered without the emptiness between islands that lie far apart."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msbdb.order import ranks

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Axis:
    """The cells of coordinates along one axis.

    Parameters
    ----------
    cell : (N,) ndarray of int64
        Packed number of each coordinate's cell, from 0.
    occupied, number : (M,) ndarray of int64
        The cells that hold a coordinate on the absolute lattice, ascending; and their packed numbers.
    """

    cell: Ints
    occupied: Ints
    number: Ints


def pack(values: Floats, side_m: float, gap: int) -> Axis:
    """Return the cells along one axis, numbered so that at most ``gap`` - 1 empty ones follow each other.

    Parameters
    ----------
    values : (N,) ndarray of float64, metres
        Coordinates; one at least.
    side_m : float
        Side of a cell, metres; corners lie at whole multiples of it.
    gap : int
        Largest step between two occupied cells that is left.
    """
    occupied, place = ranks(np.floor(values / side_m).astype(np.int64))
    number = np.cumsum(np.minimum(np.diff(occupied, prepend=occupied[:1]), gap))
    return Axis(number[place], occupied, number)

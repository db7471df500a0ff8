"""Squares of the absolute lattice, in which cells are counted: what is known around a place, alike in all windows."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate1d

from msbdb.grid import GridSpec

SQUARE_M = 25.0
"""Side of a square, metres; those of 3 by 3 squares count together, so that a cell knows what lies up to 50 m away."""


@dataclass(frozen=True, slots=True, eq=False)
class Squares:
    """The squares that a lattice touches.

    Parameters
    ----------
    rows : (H,) ndarray of int64
        For each row of cells that of its squares, from 0.
    cols : (W,) ndarray of int64
        The same for columns.
    """

    rows: NDArray[np.int64]
    cols: NDArray[np.int64]

    @classmethod
    def of(cls, spec: GridSpec) -> "Squares":
        """Return the squares of a lattice."""
        side = max(1, round(SQUARE_M / spec.cell_m))
        rows, cols = (
            (first + np.arange(length)) // side - first // side
            for first, length in zip((spec.frame.row, spec.frame.col), spec.shape, strict=True)
        )
        return cls(rows, cols)

    @property
    def shape(self) -> tuple[int, int]:
        """How many rows and columns of squares there are."""
        return int(self.rows[-1]) + 1, int(self.cols[-1]) + 1

    def on_cells(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the values of squares for each cell, (H, W)."""
        return values[self.rows[:, None], self.cols[None, :]]


def around(counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the counts of 3 by 3 squares, along the first two axes.

    Examples
    --------
    >>> around(np.array([[1, 0, 0, 2]])).tolist()
    [[1, 1, 2, 2]]
    """
    for axis in (0, 1):
        counts = correlate1d(counts, np.ones(3, dtype=np.int64), axis=axis, mode="constant")
    return counts

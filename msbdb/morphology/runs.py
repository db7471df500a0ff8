"""Images as runs: stretches of equal value along a row, and which of them touch.

The area filters work on runs instead of cells. A grid of storeys has far fewer runs than cells, and each scale of the
scale-space has fewer runs than the one before.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msbdb.errors import InputError
from msbdb.labels.numbering import require_connectivity, require_image
from msbdb.threads import kernel


class Layout(NamedTuple):
    """Where the maximal row runs of an array lie, in row-major order; they tile it without a gap.

    Parameters
    ----------
    starts : (n + 1,) ndarray of int32
        Flat index of each run's first cell, and the number of cells at the end: run i ends where run i + 1 starts.
    first : (2, n) ndarray of int32
        For each run the first run that touches it in the row above, and in the row below. The others follow it.
        Without meaning in the first and last row, respectively.
    width : int
        Columns of the array.
    reach : int
        How far beyond its ends a run touches the next row's runs: 0 for 4-connectivity, 1 for 8.
    """

    starts: NDArray[np.int32]
    first: NDArray[np.int32]
    width: int
    reach: int


@dataclass(frozen=True, slots=True, eq=False)
class Runs:
    """The maximal row runs of an array: their layout, and the value of each."""

    layout: Layout
    values: NDArray[Any]

    def paint(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return the array in which each run has the value given."""
        return np.repeat(values, np.diff(self.layout.starts)).reshape(-1, self.layout.width)


def find_runs(values: NDArray[Any], connectivity: int) -> Runs:
    """Cut an array into its runs. Time and memory are linear in the cells.

    Parameters
    ----------
    values : (H, W) ndarray
        Numbers or booleans without NaN.
    connectivity : int
        4 or 8.

    Raises
    ------
    InputError
        When the array has not two dimensions, no cells, too many, NaN or no numbers.
    ParameterError
        When the connectivity is neither 4 nor 8.

    Examples
    --------
    Four runs; the run of the two 3 in the second row touches both runs of the first.

    >>> runs = find_runs(np.array([[5, 5, 0, 0], [1, 3, 3, 1]]), 8)
    >>> runs.values, runs.layout.starts, runs.layout.first[0, 2:]
    (array([5, 0, 1, 3, 1]), array([0, 2, 4, 5, 7, 8], dtype=int32), array([0, 0, 1], dtype=int32))
    """
    require_image(values)
    require_connectivity(connectivity)
    changes = np.ones(values.shape, dtype=np.bool_)
    np.not_equal(values[:, 1:], values[:, :-1], out=changes[:, 1:])
    starts = np.empty(np.count_nonzero(changes) + 1, dtype=np.int32)
    starts[:-1] = np.flatnonzero(changes)
    starts[-1] = values.size
    reach = 1 if connectivity == 8 else 0
    width = values.shape[1]
    return Runs(Layout(starts, _first_touching(starts, width, reach), width, reach), values[changes])


def require_valid(values: NDArray[Any], valid: NDArray[np.bool_] | None) -> NDArray[np.bool_] | None:
    """Refuse what is no image in its valid cells, or no mask of it; return the mask, None when all are valid."""
    if valid is not None and (valid.shape != values.shape or valid.dtype != np.bool_):
        msg = (
            f"The mask of valid cells must be of booleans and of the image's shape {values.shape}; "
            f"got {valid.dtype} of {valid.shape}."
        )
        raise InputError(msg)
    if valid is None or valid.all():
        require_image(values)
        return None
    require_image(np.where(valid, values, values.dtype.type(0)))
    return valid


def widen(values: NDArray[Any]) -> NDArray[Any]:
    """Return the values as float64 or int64: kernels that compare values are compiled for these two only.

    Values that differ stay different; unsigned ones beyond the largest int64 wrap and lose their order.
    """
    return values.astype(np.float64 if values.dtype.kind == "f" else np.int64, order="C")


@kernel
def _first_touching(starts: NDArray[np.int32], width: int, reach: int) -> NDArray[np.int32]:
    """Find the first touching run above and below each run by two pointers that only move on."""
    count = starts.size - 1
    cells = starts[count]
    first = np.zeros((2, count), dtype=np.int32)
    # Runs come in row-major order, so the first touching run never moves back from one run to the next.
    above = below = 0
    for run in range(count):
        row_start = starts[run] // width * width
        left = max(starts[run] - reach, row_start)
        if row_start > 0:
            while starts[above + 1] <= left - width:
                above += 1
            first[0, run] = above
        if row_start + width < cells:
            while starts[below + 1] <= left + width:
                below += 1
            first[1, run] = below
    return first

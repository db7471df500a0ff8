"""Area opening, area closing and their sequence, the AOC operator (Vincent 1992; Vu et al. 2009, V1 to V5).

An area opening lowers each peak until its connected component holds at least s cells; an area closing raises each
pit in the same way. Values in the result are values of the input: nothing is computed, so nothing is rounded.

The filters work on runs, stretches of equal value along a row. A grid of storeys has far fewer runs than cells, and
each scale of the scale-space has fewer runs than the one before. Images with hardly a run of two cells, such as
heights, are filtered block by block (`msbdb.morphology.blockwise`).
"""

from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from msbdb.errors import InputError, ParameterError
from msbdb.labels.cellkernels import find_root
from msbdb.labels.numbering import MAX_CELLS, require_connectivity, require_image
from msbdb.morphology.blockwise import MOST_PX, filter_blockwise
from msbdb.order import order_of
from msbdb.threads import kernel

T = TypeVar("T", bound=np.generic)

NOT_ENTERED = -(2**31)
"""Mark of a run that the union-find has not met yet."""


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

    def with_values(self, values: NDArray[Any]) -> "Runs":
        """Return the maximal runs of the array in which each run has the value given."""
        starts, width, reach = self.layout.starts, self.layout.width, self.layout.reach
        differs = np.ones(values.size, dtype=np.bool_)
        differs[1:] = (values[1:] != values[:-1]) | (starts[1:-1] % width == 0)
        left = np.append(starts[:-1][differs], starts[-1])
        return Runs(Layout(left, _first_touching(left, width, reach), width, reach), values[differs])


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


def area_opening(values: NDArray[T], threshold_px: int, *, connectivity: int = 8) -> NDArray[T]:
    """Lower each cell to the highest level at which its connected component has at least s cells.

    Parameters
    ----------
    values : (H, W) ndarray
        Booleans, integers or floats without NaN. Not modified.
    threshold_px : int
        s, cells, from 1. Components of exactly s cells stay.
    connectivity : int
        4 or 8.

    Returns
    -------
    (H, W) ndarray
        Of the input's dtype.

    Raises
    ------
    InputError
        When the array is no image.
    ParameterError
        When s is below 1 or no whole number, or the connectivity neither 4 nor 8.

    Notes
    -----
    (γ_s f)(x) = sup{h ≤ f(x) : x in γ_s(T_h f)} with T_h f = {f ≥ h} [1]_ (Eq. 1, 2, 4, 5; V2, V4).

    Border: what lies outside of the array does not exist, so a component cut by the edge counts by what is seen of
    it. When s exceeds the array's cells, no component is large enough: the result is flat at the minimum.

    Nodata: none; mask before. Halo: none suffices, as a component may be of any extent.

    Complexity: runs of equal value are visited from the highest down and joined by union-find [2]_: nearly O(n) for n
    runs after they are sorted, which takes O(n log n). All other work is linear in the cells.

    References
    ----------
    .. [1] Vincent, L., 1992. Morphological area openings and closings for greyscale images. Shape in Picture, 197-208.
    .. [2] Meijster, A., Wilkinson, M.H.F., 2002. A comparison of algorithms for connected set openings and closings.
       IEEE Transactions on Pattern Analysis and Machine Intelligence 24 (4), 484-494. doi:10.1109/34.993556.

    Examples
    --------
    >>> area_opening(np.array([[0, 5, 0, 3, 3]]), 2)
    array([[0, 0, 0, 3, 3]])
    """
    return _filter(values, threshold_px, connectivity, from_top=True)


def area_closing(values: NDArray[T], threshold_px: int, *, connectivity: int = 8) -> NDArray[T]:
    """Raise each cell to the lowest level at which its component of cells no higher has at least s cells.

    Parameters, errors, complexity and rules are those of `area_opening`. This is its dual:
    φ_s(f) = -γ_s(-f) (Vu et al. 2009, Eq. 3; V3, V4). The connectivity is that of the pits, the complement.
    When s exceeds the array's cells, the result is flat at the maximum.

    Examples
    --------
    >>> area_closing(np.array([[4, 0, 4, 1, 1]]), 2)
    array([[4, 4, 4, 1, 1]])
    """
    return _filter(values, threshold_px, connectivity, from_top=False)


def area_open_close(values: NDArray[T], threshold_px: int, *, connectivity: int = 8) -> NDArray[T]:
    """Open, then close with the same s: the AOC operator (V5).

    Parameters, errors, complexity and rules are those of `area_opening`.

    Notes
    -----
    AOC_s(f) = φ_s(γ_s(f)). An 8-connected island above a background is filtered together with all that it
    encloses. It is independent of other islands when the background around it has at least s cells (V12).

    Examples
    --------
    >>> area_open_close(np.array([[0, 0, 5, 0, 0, 4, 4, 0, 4, 4]]), 2)
    array([[0, 0, 0, 0, 0, 4, 4, 4, 4, 4]])
    """
    require_threshold(threshold_px)
    if _is_in_blocks(values, threshold_px):
        return area_closing(
            area_opening(values, threshold_px, connectivity=connectivity), threshold_px, connectivity=connectivity
        )
    runs = find_runs(values, connectivity)
    opened = runs.with_values(_filtered(runs, threshold_px, from_top=True))
    return opened.paint(_filtered(opened, threshold_px, from_top=False))


def require_threshold(threshold_px: int) -> None:
    """Refuse an area threshold below one cell, or that is no whole number."""
    whole = isinstance(threshold_px, int | np.integer) and not isinstance(threshold_px, bool)
    if not whole or threshold_px < 1:
        msg = f"An area threshold must be a whole number of cells from 1; got {threshold_px!r}."
        raise ParameterError(msg)


def _filter(values: NDArray[T], threshold_px: int, connectivity: int, *, from_top: bool) -> NDArray[T]:
    """Open from the top or close from the bottom; both give each run the value of another run."""
    require_threshold(threshold_px)
    if _is_in_blocks(values, threshold_px):
        require_image(values)
        require_connectivity(connectivity)
        filtered: NDArray[T] = filter_blockwise(values, int(threshold_px), connectivity, from_top=from_top)
        return filtered
    runs = find_runs(values, connectivity)
    return runs.paint(_filtered(runs, threshold_px, from_top=from_top))


def _is_in_blocks(values: NDArray[Any], threshold_px: int) -> bool:
    """Return whether blocks are quicker: where runs have fewer than two cells on average, as with heights."""
    known = values.dtype.kind in "iuf" and values.dtype.itemsize <= 4
    if not known or values.ndim != 2 or threshold_px > MOST_PX or values.size > MAX_CELLS // 2:
        return False
    return bool(2 * np.count_nonzero(values[:, 1:] != values[:, :-1]) > values.size)


def _filtered(runs: Runs, threshold_px: int, *, from_top: bool) -> NDArray[Any]:
    """Return the value of each run after opening from the top or closing from the bottom."""
    order = order_of(runs.values, descending=from_top)
    # A threshold beyond the array acts like one of a cell more than it has, and keeps the areas within 32 bits.
    threshold = min(int(threshold_px), int(runs.layout.starts[-1]) + 1)
    filtered: NDArray[Any] = runs.values[_absorb(order, runs.layout, threshold)]
    return filtered


@kernel
def _absorb(order: NDArray[np.int32], layout: Layout, threshold: int) -> NDArray[np.int32]:
    """Return for each run the run whose value it takes.

    Runs enter in the order given. Each absorbs the components that it touches and that are still too small. These
    take its value, or the value of the run that absorbs it later. A component that has reached the threshold keeps
    its value; whatever touches it is large enough too.

    Invariant: ``node`` holds for the root of a component minus its area, up to the threshold; for any other run its
    parent; ``NOT_ENTERED`` before its turn. One array, because its cache misses take most of the time.
    """
    starts, first, width, reach = layout
    count = order.size
    cells = starts[count]
    node = np.full(count, NOT_ENTERED, dtype=np.int32)
    for run in order:
        start, end = starts[run], starts[run + 1]
        row_end = start // width * width + width
        reach_end = min(end + reach, row_end)
        area = end - start
        node[run] = -area
        for side in range(3):
            if side == 0:  # the neighbours in the run's own row
                other = run - 1 if start > row_end - width else run + 1
                stop = end + 1 if end < row_end else start
            elif side == 1:  # the row above
                other = first[0, run]
                stop = reach_end - width
            else:  # the row below
                other = first[1, run]
                stop = reach_end + width if row_end < cells else 0
            while other < count and starts[other] < stop:  # touching runs of a row follow each other
                if node[other] != NOT_ENTERED:
                    root = find_root(node, other)
                    if root != run:
                        if node[root] > -threshold:
                            area -= node[root]  # the root holds minus its area
                            node[root] = run
                        else:
                            area = threshold  # joined in area only: its cells keep their own value
                other += 1
        node[run] = -min(area, threshold)
    # A parent entered later than its children, so in reverse order it has its source before they ask for it.
    for position in range(count - 1, -1, -1):
        run = order[position]
        node[run] = run if node[run] < 0 else node[node[run]]
    return node

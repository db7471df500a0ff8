"""Area opening, area closing and their sequence, the AOC operator (Vincent 1992; Vu et al. 2009, V1 to V5).

An area opening lowers each peak until its connected component holds at least s cells; an area closing raises each
pit in the same way. Values in the result are values of the input: nothing is computed, so nothing is rounded.
"""

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from msbdb.errors import ParameterError
from msbdb.morphology.runs import Layout, find_runs
from msbdb.order import order_of
from msbdb.threads import kernel

T = TypeVar("T", bound=np.generic)

NOT_ENTERED = -(2**31)
"""Mark of a run that the union-find has not met yet."""


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
    opened = area_opening(values, threshold_px, connectivity=connectivity)
    return area_closing(opened, threshold_px, connectivity=connectivity)


def require_threshold(threshold_px: int) -> None:
    """Refuse an area threshold below one cell, or that is no whole number."""
    whole = isinstance(threshold_px, int | np.integer) and not isinstance(threshold_px, bool)
    if not whole or threshold_px < 1:
        msg = f"An area threshold must be a whole number of cells from 1; got {threshold_px!r}."
        raise ParameterError(msg)


def _filter(values: NDArray[T], threshold_px: int, connectivity: int, *, from_top: bool) -> NDArray[T]:
    """Open from the top or close from the bottom; both give each run the value of another run."""
    require_threshold(threshold_px)
    runs = find_runs(values, connectivity)
    order = order_of(runs.values, descending=from_top)
    # A threshold beyond the array acts like one of a cell more than it has, and keeps the areas within 32 bits.
    threshold = min(int(threshold_px), values.size + 1)
    source = _absorb(order, runs.layout, threshold)
    return runs.paint(runs.values[source])


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


@kernel
def find_root(node: NDArray[np.int32], run: int) -> int:
    """Return the root of a run's component, the one with a negative mark, and halve the way to it."""
    while node[run] >= 0:
        parent = node[run]
        if node[parent] >= 0:
            node[run] = node[parent]
        run = parent
    return run

"""Label images: connected regions of equal value, their numbers, their sizes, and the cells that two images share."""

from typing import Any, TypeGuard, TypeVar

import numpy as np
from numpy.typing import NDArray

from msbdb.errors import InputError, ParameterError

T = TypeVar("T", bound=np.generic)

Labels = NDArray[np.int32]
Box = tuple[slice, slice]

EIGHT = np.ones((3, 3), dtype=np.bool_)
"""A cell and its eight neighbours."""

LARGE = 1 << 16
"""Images of fewer cells are left to numpy, so that small work loads no kernels."""

MAX_CELLS = 2**31 - 2**16
"""Cells are counted in 32 bits, which halves the memory."""


def label_zones(values: NDArray[Any], *, connectivity: int = 8) -> tuple[Labels, int]:
    """Label the flat zones of an image: the connected cells of equal value (V10, V22, V25).

    Parameters
    ----------
    values : (H, W) ndarray
        Booleans, integers or floats without NaN. Not modified. Cells of value 0 are background and belong to no zone
        (V25). Floats are equal or not, without tolerance.
    connectivity : int
        4 or 8; the same as for the openings and closings, or zones of a finer scale may straddle those of a coarser
        one (V10).

    Returns
    -------
    labels : (H, W) ndarray of int32
        0 on the background, otherwise 1 to ``count`` in row-major order of the zones' first cells.
    count : int
        Number of zones.

    Raises
    ------
    InputError
        When the array is no image.
    ParameterError
        When the connectivity is neither 4 nor 8.

    Notes
    -----
    Border: a zone ends at the edge of the array. One pass joins the cells by union-find [1]_, a second one numbers the
    zones. Time and memory are linear in the cells. The reason for own code is measured in decision 0008.

    References
    ----------
    .. [1] Wu, K., Otoo, E., Suzuki, K., 2009. Optimizing two-pass connected-component labeling algorithms. Pattern
       Analysis and Applications 12 (2), 117-135. doi:10.1007/s10044-008-0109-y.

    Examples
    --------
    >>> label_zones(np.array([[2, 0, 5], [0, 2, 5]]))
    (array([[1, 0, 2],
           [0, 1, 2]], dtype=int32), 2)
    """
    # Compiled kernels take longer to load than a command that labels nothing.
    from msbdb.labels.cellkernels import label_cells

    require_image(values)
    require_connectivity(connectivity)
    labels, count = label_cells(as_compiled(values), connectivity == 8)
    return labels, int(count)


def as_compiled(values: NDArray[Any]) -> NDArray[Any]:
    """Return values that are equal where they were, of a dtype for which the kernels of flat zones are compiled."""
    if values.dtype.kind == "f":
        # Floats without NaN are equal just where their bits are, once negative zeros are positive.
        return (values.astype(np.float64, order="C") + 0.0).view(np.int64)
    if values.dtype in (np.bool_, np.uint8):
        return values.astype(np.uint8, order="C", copy=False)
    if values.dtype == np.uint16:  # slices
        return np.ascontiguousarray(values)
    narrow = values.dtype.itemsize < 4 or values.dtype == np.int32
    return values.astype(np.int32 if narrow else np.int64, order="C", copy=False)


def require_connectivity(connectivity: int) -> None:
    """Refuse a neighbourhood other than the two of the square lattice."""
    if connectivity not in (4, 8):
        msg = f"The connectivity must be 4 or 8; got {connectivity!r}."
        raise ParameterError(msg)


def require_image(values: NDArray[Any]) -> None:
    """Refuse what is no image: other than two dimensions, no cells or too many, NaN, or no real numbers."""
    if values.ndim != 2 or not 0 < values.size <= MAX_CELLS:
        msg = f"An image needs two dimensions and 1 to {MAX_CELLS} cells; got the shape {values.shape}."
        raise InputError(msg)
    if values.dtype.kind not in "biuf":
        msg = f"An image must hold booleans, integers or floats; got {values.dtype}."
        raise InputError(msg)
    if values.dtype.kind == "f" and np.isnan(values).any():
        msg = f"The image holds {np.isnan(values).sum()} NaN, which have no order. Fill them and keep a validity mask."
        raise InputError(msg)


def boxes(labels: Labels) -> dict[int, Box]:
    """Return the bounding box (rows, columns) of each label that has cells, in the labels' order."""
    # Loading it takes longer than an export, which needs only the labels' sizes.
    from scipy import ndimage

    return {number: box for number, box in enumerate(ndimage.find_objects(labels), start=1) if box is not None}


def widened(window: Box, margin: int) -> Box:
    """Return a window with so many cells more on each side, within the lattice.

    Examples
    --------
    >>> widened((slice(1, 3), slice(8, 9)), 2)
    (slice(0, 5, None), slice(6, 11, None))
    """
    rows, cols = (slice(max(side.start - margin, 0), side.stop + margin) for side in window)
    return rows, cols


def join_cells(heights: NDArray[np.floating], among: NDArray[np.bool_], step: float) -> tuple[Labels, int]:
    """Return the regions of cells that steps below a limit join across shared edges, each with its number.

    Parameters
    ----------
    heights : (H, W) ndarray of float32 or float64
        A step to or from NaN joins nothing.
    among : (H, W) ndarray of bool
        The cells that may be joined; each other cell is a region of its own.
    step : float
        The limit, in the unit and the precision of the heights.

    Returns
    -------
    regions : (H, W) ndarray of int32
        0 to ``count`` - 1, in row-major order of the regions' first cells.
    count : int
        Number of regions.

    Examples
    --------
    A step of 2 between the second and the third cell, and a cell that is left out:

    >>> join_cells(np.array([[1.0, 1.5, 3.5, 3.0, 3.0]]), np.array([[True, True, True, True, False]]), 1.0)
    (array([[0, 0, 1, 1, 2]], dtype=int32), 3)
    """
    from msbdb.labels.cellkernels import number_joined

    regions, count = number_joined(heights, among, heights.dtype.type(step))
    return regions, int(count)


def sizes(labels: NDArray[np.integer], count: int) -> NDArray[np.int64]:
    """Return the number of cells or points of each label from 1 to ``count``, int64.

    Examples
    --------
    >>> sizes(np.array([[0, 2, 2], [0, 1, 2]], dtype=np.int32), 3)
    array([1, 3, 0])
    """
    if _is_large(labels):
        from msbdb.labels.cellkernels import counted

        cells, complete = counted(labels.ravel(), count)
        if complete:
            return cells[1:]
    found: NDArray[np.int64] = np.bincount(labels.ravel(), minlength=count + 1)[1:]
    return found


def sums(labels: NDArray[np.integer], values: NDArray[Any], count: int) -> NDArray[np.float64]:
    """Return the sum of the values over the cells or points of each label from 1 to ``count``, added in their order.

    Examples
    --------
    >>> sums(np.array([[0, 2, 2], [0, 1, 2]]), np.array([[9, 1, 2], [9, 5, 3]]), 2)
    array([5., 6.])
    """
    if _is_large(labels) and values.dtype in (np.bool_, np.float64):
        from msbdb.labels.cellkernels import added

        total, complete = added(labels.ravel(), values.ravel(), count)
        if complete:
            return total[1:]
    inside = labels != 0
    return np.bincount(labels[inside], values[inside], count + 1)[1:].astype(np.float64)


def _is_large(labels: NDArray[np.integer]) -> TypeGuard[Labels]:
    """Return whether a kernel is worth its loading, and takes these labels."""
    return labels.size > LARGE and labels.dtype == np.int32


def look_up(table: NDArray[T], labels: NDArray[np.integer]) -> NDArray[T]:
    """Return ``table[labels]``, quicker for many labels.

    Parameters
    ----------
    table : (N + 1,) ndarray
        A value for each label from 0 on.
    labels : ndarray of int
        0 to N.

    Examples
    --------
    >>> look_up(np.array([0.0, 2.5]), np.array([[1, 0]], dtype=np.int32))
    array([[2.5, 0. ]])
    """
    if _is_large(labels):
        from msbdb.labels.cellkernels import looked_up

        values, complete = looked_up(table, labels.ravel())
        if complete:
            return values.reshape(labels.shape)
    found: NDArray[T] = table[labels]
    return found


def chosen_cells(labels: Labels, chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the cells or points of the chosen regions.

    Parameters
    ----------
    labels : ndarray of int32
        1 to N; 0 for none, which is never chosen.
    chosen : (N,) ndarray of bool
        One a region, in the labels' order.

    Examples
    --------
    >>> chosen_cells(np.array([0, 1, 2, 1]), np.array([True, False]))
    array([False,  True, False,  True])
    """
    return look_up(np.concatenate([[False], chosen]), labels)


def around(framed: NDArray[T], cells: NDArray[np.intp]) -> NDArray[T]:
    """Return the values of the 3 by 3 cells around some cells: quicker than a filter of all cells where these are few.

    Parameters
    ----------
    framed : (H + 2, W + 2) ndarray
        An image with a frame of one cell.
    cells : (K,) ndarray of int
        Flat indices into it; none is of the frame.

    Returns
    -------
    (K, 9) ndarray

    Examples
    --------
    >>> around(np.pad([[1, 2], [3, 4]], 1), np.array([5]))
    array([[0, 0, 0, 0, 1, 2, 0, 3, 4]])
    """
    steps = np.add.outer(np.arange(-1, 2) * framed.shape[1], np.arange(-1, 2)).ravel()
    values: NDArray[T] = framed.ravel()[cells[:, None] + steps]
    return values


def by_three(combine: np.ufunc, image: NDArray[T], *, beyond: T | None = None) -> NDArray[T]:
    """Combine the 3 by 3 cells around each cell, by an operator of two values in any order.

    Parameters
    ----------
    combine : ufunc
        For instance ``np.add`` for sums, ``np.logical_and`` for an erosion of a mask, ``np.logical_or`` for a dilation.
    image : (H, W) ndarray
        Not modified.
    beyond : scalar, optional
        The value beyond the lattice; by default the outermost cells go on.

    Examples
    --------
    >>> by_three(np.add, np.array([[1, 2], [3, 4]]), beyond=0)
    array([[10, 10],
           [10, 10]])
    """
    for axis in range(2):
        sides = [(1, 1) if axis == side else (0, 0) for side in range(2)]
        framed = np.pad(image, sides, mode="edge") if beyond is None else np.pad(image, sides, constant_values=beyond)
        count = image.shape[axis]
        one, two, three = (framed[n : n + count] if axis == 0 else framed[:, n : n + count] for n in range(3))
        image = combine(combine(one, two), three)
    return image


def small_zones(mask: NDArray[np.bool_], cells: float, *, connectivity: int) -> NDArray[np.bool_]:
    """Return the cells of the connected components that have fewer than so many cells.

    Parameters
    ----------
    mask : (H, W) ndarray of bool
        The image; a component ends at its border.
    cells : float
        Components of this size or larger are left out.
    connectivity : int
        4 or 8. Holes of an 8-connected region are 4-connected.

    Examples
    --------
    >>> small_zones(np.array([[True, False, True, True]]), 2, connectivity=4)
    array([[ True, False, False, False]])
    """
    labels, count = label_zones(mask, connectivity=connectivity)
    return chosen_cells(labels, sizes(labels, count) < cells)


def renumber(labels: Labels, keep: NDArray[np.bool_]) -> tuple[Labels, int]:
    """Give the regions to keep new numbers from 1 on in their order, and 0 to the others; return how many are kept.

    Parameters
    ----------
    labels : ndarray of int32
        1 to N; 0 for none.
    keep : (N,) ndarray of bool
        One a region, in the labels' order.

    Examples
    --------
    >>> renumber(np.array([3, 0, 1, 2]), np.array([True, False, True]))
    (array([2, 0, 1, 0], dtype=int32), 2)
    """
    rows = np.flatnonzero(keep)
    return reorder(labels, rows, len(keep)), len(rows)


def reorder(labels: Labels, rows: NDArray[np.integer], count: int) -> Labels:
    """Renumber regions by a new order of the rows of their table.

    Parameters
    ----------
    labels : ndarray of int32
        0 for none, otherwise row number + 1 in a table of ``count`` rows.
    rows : (N,) ndarray of int
        The old row number at each place of the new table. Regions of other rows get the label 0.
    count : int
        Number of rows of the old table.

    Returns
    -------
    ndarray of int32
        0 for none, otherwise row number + 1 in the new table.

    Examples
    --------
    >>> reorder(np.array([3, 0, 1, 2]), np.array([2, 0]), 3)
    array([1, 0, 2, 0], dtype=int32)
    """
    number = np.zeros(count + 1, dtype=np.int32)
    number[np.asarray(rows, dtype=np.intp) + 1] = np.arange(1, len(rows) + 1)
    return look_up(number, labels)


def shared_cells(
    one: Labels, other: NDArray[np.integer]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Count the cells that the regions of two images share.

    Parameters
    ----------
    one, other : ndarray of int
        Label images, or some of their cells, of one shape; 0 for none.

    Returns
    -------
    first, second : (P,) ndarray of int64
        The labels of each pair of regions that share cells, in order of the first, and of the second within it.
    cells : (P,) ndarray of int64
        Number of cells that they share.

    Examples
    --------
    >>> [part.tolist() for part in shared_cells(np.array([[1, 1, 2, 0]]), np.array([[5, 5, 4, 4]]))]
    [[1, 2], [5, 4], [2, 1]]
    """
    both = (one > 0) & (other > 0)
    width = int(other.max(initial=0)) + 1
    pairs, cells = np.unique(one[both].astype(np.int64) * width + other[both], return_counts=True)
    first, second = np.divmod(pairs, width)
    return first, second, cells

"""Area filters of images that have hardly a plateau, such as heights: first within blocks, then across their borders.

Cells in the order of their values lie far apart, so that a filter of a whole image waits for the memory at each step. A
block of cells fits in the processor's cache. What is decided there is decided for the image, but for components that
reach the block's border before they have s cells. Only these are joined across the blocks.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msbdb.errors import InputError
from msbdb.labels.cellkernels import find_root, neighbour_steps
from msbdb.order import order_of, sort_keys
from msbdb.threads import kernel

SIDE = 256
"""Rows and columns of a block: its arrays take about a megabyte."""

MOST_PX = SIDE**2 // 8
"""Largest s for which blocks are quicker than the image at once: larger components reach over their borders."""

PLACE = np.uint64(20)
"""Bits for a cell's place in its block and the ring around it."""

WAITS = -(2**31)
"""Mark of a cell that has not been entered yet."""

BEYOND = WAITS + 1
"""Mark of a cell of the ring around a block where the image goes on."""


def filter_blockwise(
    values: NDArray[Any], threshold_px: int, connectivity: int, *, from_top: bool, side: int = SIDE
) -> NDArray[Any]:
    """Open from the top or close from the bottom.

    Parameters
    ----------
    values : (H, W) ndarray
        Numbers of up to 32 bits without NaN, or whole numbers of a range below 2^32. Not modified.
    threshold_px : int
        s, cells, from 1. Up to `MOST_PX` this is quicker than `msbdb.morphology.area` without blocks.
    connectivity : int
        4 or 8.
    from_top : bool
        Whether to open; else to close.
    side : int
        Rows and columns of a block, up to 1,000; the result is the same with any.

    Returns
    -------
    (H, W) ndarray
        What `msbdb.morphology.area.area_opening` or `msbdb.morphology.area.area_closing` define.

    Raises
    ------
    InputError
        When 32 bits cannot hold the values in their order.

    Notes
    -----
    Cells enter from the highest down, and absorb the components that they touch, as in Meijster and Wilkinson (2002).
    A component that touches the ring around its block with fewer than s cells is open: its size is not known there.
    Within a block, components that are not open are lowered as far as is sure, to g with γ_s(f) ≤ g ≤ f. As γ_s is
    increasing and idempotent, γ_s(g) = γ_s(f). So it is enough to go on with the cells of open components in g, and
    with their neighbours, whose values are final.

    Border and nodata as for `msbdb.morphology.area.area_opening`. Memory: up to 25 bytes a cell.
    """
    keys = sort_keys(values)
    if keys is None:
        msg = f"Blocks need values that 32 bits can hold in order; got {values.dtype}."
        raise InputError(msg)
    rows, cols = values.shape
    count = -(-cols // side)
    source = np.empty(values.shape, dtype=np.int32)
    for top in range(0, rows, side):
        height = min(side, rows - top)
        numbers = np.full((height, count * side), 2**32, dtype=np.uint64)  # beyond the image: after all cells
        numbers[:, :cols] = ~keys[top : top + height] if from_top else keys[top : top + height]
        numbers = np.ascontiguousarray(numbers.reshape(height, count, side).swapaxes(0, 1)).reshape(count, -1)
        numbers <<= PLACE
        numbers |= _places(height, side)
        numbers.sort(axis=1)
        numbers &= (np.uint64(1) << PLACE) - np.uint64(1)
        steps = neighbour_steps(side + 2, connectivity)
        _filter_blocks(numbers.astype(np.int32), source, (top, top + height, side), threshold_px, steps)
    flat, before = source.ravel(), values.ravel()
    is_open = source < 0
    if is_open.any():
        np.invert(source, out=source, where=is_open)
        cells = _open_and_near(is_open, connectivity)
        cells = cells[order_of(before[flat[cells]], descending=from_top)]
        framed = cells + cells // np.int32(cols) * np.int32(2) + np.int32(cols + 3)
        node = np.full((2, (rows + 2) * (cols + 2)), WAITS, dtype=np.int32)
        _absorb_cells(framed, ~is_open.ravel()[cells], threshold_px, neighbour_steps(cols + 2, connectivity), node)
        taken = node[1, framed]
        flat[cells] = flat[taken - taken // np.int32(cols + 2) * np.int32(2) - np.int32(cols + 1)]
    return before[source]


def _places(rows: int, cols: int) -> NDArray[np.uint64]:
    """Return the place of each cell of a block in the block with its ring, row by row."""
    row, col = np.ogrid[1 : rows + 1, 1 : cols + 1]
    return (row * (cols + 2) + col).ravel().astype(np.uint64)


@kernel
def _filter_blocks(
    cells: NDArray[np.int32],
    source: NDArray[np.int32],
    strip: tuple[int, int, int],
    threshold: int,
    steps: NDArray[np.int32],
) -> None:
    """Filter a row of blocks as far as is sure there: write from which cell of the image each takes its value.

    Where the component is open the index is complemented. ``cells`` are the places of each block's cells in the order
    in which they enter, (B, n), then those beyond the image. The strip has the blocks' first row, the row behind them,
    and their side.
    """
    rows, cols = source.shape
    top, bottom, side = strip
    height, width = bottom - top, side + 2
    node = np.empty((2, width * width), dtype=np.int32)
    settled = np.zeros(height * side, dtype=np.bool_)
    for block in range(cells.shape[0]):
        left = block * side
        wide = min(side, cols - left)
        node[0] = WAITS
        if top > 0:
            node[0, : wide + 2] = BEYOND
        if bottom < rows:
            node[0, (height + 1) * width : (height + 1) * width + wide + 2] = BEYOND
        for row in range(height):
            if left > 0:
                node[0, (row + 1) * width] = BEYOND
            if left + wide < cols:
                node[0, (row + 1) * width + wide + 1] = BEYOND
        _absorb_cells(cells[block, : height * wide], settled, threshold, steps, node)
        for row in range(height):
            for col in range(wide):
                found = node[1, (row + 1) * width + col + 1]
                place = np.uint32(found if found >= 0 else ~found)
                above = place // np.uint32(width)
                taken = (top + above - 1) * cols + left + place - above * width - 1
                source[top + row, left + col] = taken if found >= 0 else ~taken


@kernel
def _absorb_cells(
    cells: NDArray[np.int32],
    settled: NDArray[np.bool_],
    threshold: int,
    steps: NDArray[np.int32],
    node: NDArray[np.int32],
) -> None:
    """Let cells enter in their order; write into ``node[1]`` from which cell each takes its value.

    A cell whose value is settled counts as a component that is large enough. Where the source is complemented, so
    negative, the component reaches beyond the block, and the value is only the lowest that is sure.

    ``node[0]`` has, for the root of a component, minus twice its area, up to the threshold, less one where it is open;
    for any other cell its parent. It comes with `WAITS` in the cells, and `WAITS` or `BEYOND` around them.
    """
    tree, source = node[0], node[1]
    enough = -2 * threshold
    for position in range(cells.size):
        cell = cells[position]
        area, is_open = (threshold if settled[position] else 1), 0
        tree[cell] = -2
        for step in steps:
            other = tree[cell + step]
            if other == WAITS:
                continue
            if other == BEYOND:
                is_open = 1
                continue
            root = cell + step
            if other >= 0:
                root = find_root(tree, root)
                other = tree[root]
            if root == cell:
                continue
            if other == enough:
                area = threshold
            else:
                area += -other >> 1
                is_open |= -other & 1
                source[root] = ~root if -other & 1 else cell
                tree[root] = cell
        source[cell] = cell
        tree[cell] = enough
        if area < threshold:
            tree[cell] = -2 * area - is_open
            if is_open:
                source[cell] = ~cell
    # A cell entered before what absorbed it, so in reverse order this has its own source already.
    for position in range(cells.size - 1, -1, -1):
        cell = cells[position]
        if source[cell] >= 0:
            source[cell] = source[source[cell]]


@kernel
def _open_and_near(is_open: NDArray[np.bool_], connectivity: int) -> NDArray[np.int32]:
    """Return the cells that are open or touch an open one, row by row."""
    rows, cols = is_open.shape
    near = np.zeros((rows, cols), dtype=np.bool_)
    for row in range(rows):
        for col in range(cols):
            if not is_open[row, col]:
                continue
            for r in range(max(row - 1, 0), min(row + 2, rows)):
                for c in range(max(col - 1, 0), min(col + 2, cols)):
                    if connectivity == 8 or r == row or c == col:
                        near[r, c] = True
    return np.flatnonzero(near).astype(np.int32)

"""Kernels over the cells of an image: connected cells of equal value by union-find, and values and sums by label.

Indexing and counting by numpy turn the labels into 64 bits first, which takes several times as long.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msbdb.threads import kernel

Labels = NDArray[np.int32]


@kernel
def looked_up(table: NDArray[Any], labels: NDArray[np.int32]) -> tuple[NDArray[Any], bool]:
    """Return (N,) the value in the table of each of (N,) labels, and whether it has all of them."""
    found = np.empty(labels.size, dtype=table.dtype)
    for place in range(labels.size):
        label = labels[place]
        if label < 0 or label >= table.size:
            return found, False
        found[place] = table[label]
    return found, True


@kernel
def counted(labels: NDArray[np.int32], count: int) -> tuple[NDArray[np.int64], bool]:
    """Return (count + 1,) how often each label from 0 on occurs among (N,) labels, and whether all are among these."""
    found = np.zeros(count + 1, dtype=np.int64)
    # Cells of one label follow each other: a counter that each of them raises would wait for itself.
    last, run = 0, 0
    for label in labels:
        if label != last:
            if label < 0 or label > count:
                return found, False
            found[last] += run
            last, run = label, 0
        run += 1
    found[last] += run
    return found, True


@kernel
def added(labels: NDArray[np.int32], values: NDArray[Any], count: int) -> tuple[NDArray[np.float64], bool]:
    """Return (count + 1,) the sums of (N,) values by label from 0 on, in their order in 64 bits; and as `counted`."""
    found = np.zeros(count + 1, dtype=np.float64)
    for place in range(labels.size):
        label = labels[place]
        if label != 0:
            if label < 0 or label > count:
                return found, False
            found[label] += values[place]
    return found, True


@kernel
def label_cells(values: NDArray[Any], eight: bool) -> tuple[Labels, int]:
    """Return the flat zones of an image and their number, as `msbdb.labels.label_zones` does.

    Invariant: a mark's parent is no larger than itself, so the root of a zone is the mark of its first cell. Cells that
    touch each other above the cell are joined already: each cell joins two marks at most.
    """
    rows, cols = values.shape
    labels = np.zeros((rows, cols), dtype=np.int32)
    parent = np.zeros(1024, dtype=np.int32)
    marks = 0
    for row in range(rows):
        for col in range(cols):
            value = values[row, col]
            if value == 0:
                continue
            left = col > 0 and values[row, col - 1] == value
            corner = row > 0 and col > 0 and values[row - 1, col - 1] == value
            if row > 0 and values[row - 1, col] == value:
                labels[row, col] = labels[row - 1, col]
                if left and not corner and not eight:
                    _join(parent, labels[row, col - 1], labels[row, col])
                continue
            right = eight and row > 0 and col + 1 < cols and values[row - 1, col + 1] == value
            if left:
                labels[row, col] = labels[row, col - 1]
            elif eight and corner:
                labels[row, col] = labels[row - 1, col - 1]
            elif right:
                labels[row, col] = labels[row - 1, col + 1]
                continue
            else:
                marks += 1
                if marks == parent.size:
                    parent = np.concatenate((parent, np.zeros_like(parent)))
                labels[row, col] = parent[marks] = marks
            if right:
                _join(parent, labels[row, col], labels[row - 1, col + 1])
    return labels, _number(labels, parent, marks)


@kernel
def label_listed(values: NDArray[Any], cells: NDArray[np.intp], width: int, eight: bool) -> tuple[Labels, int]:
    """Return the flat zones of listed cells and their number, as `msbdb.labels.CellList.zones` does.

    The rules are those of `label_cells`. ``cells`` are flat indices in rows of the given width.
    ``above`` follows them through the list, one row behind.
    """
    labels = np.zeros((1, values.size), dtype=np.int32)
    parent = np.zeros(1024, dtype=np.int32)
    marks, above = 0, 0
    for place in range(values.size):
        value, cell = values[place], cells[place]
        if value == 0:
            continue
        first, last = cell % width == 0, cell % width == width - 1
        # The first listed cell at or after the place above this one. It never passes this one, which is in the list.
        while cells[above] < cell - width:
            above += 1
        is_listed = cells[above] == cell - width
        after = above + 1 if is_listed else above
        left = not first and place > 0 and cells[place - 1] == cell - 1 and values[place - 1] == value
        corner = not first and above > 0 and cells[above - 1] == cell - width - 1 and values[above - 1] == value
        if is_listed and values[above] == value:
            labels[0, place] = labels[0, above]
            if left and not corner and not eight:
                _join(parent, labels[0, place - 1], labels[0, place])
            continue
        right = eight and not last and cells[after] == cell - width + 1 and values[after] == value
        if left:
            labels[0, place] = labels[0, place - 1]
        elif eight and corner:
            labels[0, place] = labels[0, above - 1]
        elif right:
            labels[0, place] = labels[0, after]
            continue
        else:
            marks += 1
            if marks == parent.size:
                parent = np.concatenate((parent, np.zeros_like(parent)))
            labels[0, place] = parent[marks] = marks
        if right:
            _join(parent, labels[0, place], labels[0, after])
    count = _number(labels, parent, marks)
    return labels[0], count


@kernel
def number_joined(heights: NDArray[Any], among: NDArray[np.bool_], step: np.floating) -> tuple[Labels, int]:
    """Return the regions of cells that smaller steps join, from 0 in the order of their first cells, and their number.

    Neighbours share an edge. Cells that are not among those given are regions of their own.
    """
    rows, cols = heights.shape
    parent = np.arange(rows * cols, dtype=np.int32)
    for row in range(rows):
        for col in range(cols):
            if among[row, col]:
                cell = row * cols + col
                if col > 0 and among[row, col - 1] and abs(heights[row, col - 1] - heights[row, col]) < step:
                    _join(parent, cell, cell - 1)
                if row > 0 and among[row - 1, col] and abs(heights[row - 1, col] - heights[row, col]) < step:
                    _join(parent, cell, cell - cols)
    # A parent comes before its cells, so that it has its number already.
    count = 0
    for cell in range(rows * cols):
        if parent[cell] == cell:
            parent[cell] = count
            count += 1
        else:
            parent[cell] = parent[parent[cell]]
    return parent.reshape(rows, cols), count


@kernel
def _join(parent: NDArray[np.int32], one: int, other: int) -> None:
    """Join the zones of two marks under the smaller root, and halve the ways to it."""
    while parent[one] != one:
        parent[one] = parent[parent[one]]
        one = parent[one]
    while parent[other] != other:
        parent[other] = parent[parent[other]]
        other = parent[other]
    parent[max(one, other)] = min(one, other)


@kernel
def _number(labels: Labels, parent: NDArray[np.int32], marks: int) -> int:
    """Replace marks by the zones' numbers, in the order of their first cells; return the number of zones."""
    count = 0
    for mark in range(1, marks + 1):
        if parent[mark] == mark:
            count += 1
            parent[mark] = count
        else:
            parent[mark] = parent[parent[mark]]
    for row in range(labels.shape[0]):
        for col in range(labels.shape[1]):
            labels[row, col] = parent[labels[row, col]]
    return count


def neighbour_steps(width: int, connectivity: int) -> NDArray[np.int32]:
    """Return what leads from a cell to its neighbours where rows have the width given, (4 or 8,)."""
    steps = [1, -1, width, -width, width + 1, width - 1, 1 - width, -1 - width]
    return np.array(steps[:connectivity], dtype=np.int32)


@kernel
def find_root(node: NDArray[np.int32], item: int) -> int:
    """Return the root of an item's component, the one with a negative mark, and halve the way to it.

    ``node`` has a negative mark for each root, and for any other item its parent.
    """
    while node[item] >= 0:
        parent = node[item]
        if node[parent] >= 0:
            node[item] = node[parent]
        item = parent
    return item


@kernel
def gathered(
    image: NDArray[Any],
    zones: Labels,
    islands: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]],
    found: NDArray[Any],
) -> None:
    """Fill in what `msbdb.labels.islands.Islands.gather` returns; of each island first cell, extent and place."""
    first, extent, place = islands
    for number in range(len(first)):
        for row in range(extent[number, 0]):
            for col in range(extent[number, 1]):
                own_row, own_col = first[number, 0] + row, first[number, 1] + col
                if zones[own_row, own_col] == number + 1:
                    found[place[number, 0] + row, place[number, 1] + col] = image[own_row, own_col]

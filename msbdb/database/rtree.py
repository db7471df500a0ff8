"""SQLite's R-trees, packed: the nodes of many boxes are made at once, as inserting them one by one takes far longer.

SQLite keeps an R-tree in three tables. ``_node`` has a blob of fixed length for each node: two bytes with the tree's
depth (in the root, node 1), two with the number of cells, and the cells; ``_rowid`` has the leaf of each row,
``_parent`` the father of each node. A cell is the number of a row or of a child, and xmin, xmax, ymin, ymax; all
numbers have their large bytes first. SQLite documents and checks this form: ``SELECT rtreecheck('name')``.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

ROOT = 1
HEAD_BYTES = 4
CELL = np.dtype([("number", ">i8"), ("box", ">f4", 4)])


@dataclass(frozen=True, slots=True)
class Packed:
    """The rows of an R-tree's three tables.

    ``nodes`` has (number, blob), ``leaves`` (row, its node), ``fathers`` (node, its father).
    """

    nodes: list[tuple[int, bytes]]
    leaves: list[tuple[int, int]]
    fathers: list[tuple[int, int]]


def pack(rows: NDArray[np.int64], boxes: NDArray[np.float64], node_bytes: int) -> Packed:
    """Pack boxes into an R-tree, by sorting and tiling (Leutenegger et al. 1997).

    Parameters
    ----------
    rows : (N,) ndarray of int64
        Numbers of the rows, each once.
    boxes : (N, 4) ndarray of float64
        xmin, xmax, ymin, ymax of each.
    node_bytes : int
        Length of a node's blob.

    Returns
    -------
    Packed
        The same for the same boxes in any order. Without boxes, the root is an empty leaf.

    Notes
    -----
    Nodes are as full as can be, and equally so: SQLite's lower bound of a third is kept. Boxes are rounded outwards
    to four bytes, as SQLite does.
    """
    first = np.argsort(rows, kind="stable")
    numbers, bounds = np.asarray(rows, dtype=np.int64)[first], _outwards(boxes[first])
    levels: list[tuple[NDArray[Any], NDArray[np.int64]]] = []  # from the leaves up: cells, and the node of each
    while True:
        order, node = _tile(bounds, _capacity(node_bytes))
        cells = np.zeros(len(numbers), dtype=CELL)
        cells["number"], cells["box"] = numbers[order], bounds[order]
        levels.append((cells, node))
        count = int(node.max(initial=0)) + 1
        if count == 1:
            break
        numbers, bounds = np.arange(count), _around(bounds[order], node)
    return _tables(levels, node_bytes)


def _outwards(boxes: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return boxes in float32 that hold those in float64."""
    near = boxes.astype(np.float32)
    below = np.where(near > boxes, np.nextafter(near, np.float32(-np.inf)), near)
    above = np.where(near < boxes, np.nextafter(near, np.float32(np.inf)), near)
    return np.where([True, False, True, False], below, above)


def _tile(bounds: NDArray[np.float32], capacity: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return an order of boxes, and the node of each in that order: columns from west to east, tiles from the south."""
    count = len(bounds)
    nodes = max(1, -(-count // capacity))
    columns = int(np.ceil(np.sqrt(nodes)))
    place = np.arange(count)
    x, y = bounds[:, :2].sum(axis=1), bounds[:, 2:].sum(axis=1)
    from_west = np.argsort(x, kind="stable")
    node = place * nodes // max(1, count)
    # A column holds whole nodes, so that no node spans two columns.
    column = node * columns // nodes
    order = from_west[np.lexsort((y[from_west], column))]
    return order, node


def _around(bounds: NDArray[np.float32], node: NDArray[np.int64]) -> NDArray[np.float32]:
    """Return the boxes around those of each node; nodes are in order."""
    starts = np.flatnonzero(np.diff(node, prepend=-1))
    least, most = np.minimum.reduceat(bounds, starts), np.maximum.reduceat(bounds, starts)
    return np.where([True, False, True, False], least, most)


def _tables(levels: list[tuple[NDArray[Any], NDArray[np.int64]]], node_bytes: int) -> Packed:
    """Return the tables of a tree given from the leaves up; its nodes are numbered from the root down."""
    nodes: list[tuple[int, bytes]] = []
    leaves: list[tuple[int, int]] = []
    fathers: list[tuple[int, int]] = []
    first = ROOT
    for above, (cells, node) in enumerate(reversed(levels)):
        is_leaf = above == len(levels) - 1
        if not is_leaf:
            cells["number"] += first + int(node.max()) + 1
        blobs = _blobs(cells, node, node_bytes)
        if first == ROOT:
            blobs[0, 1] = len(levels) - 1
        order = np.argsort(cells["number"])
        own = zip(cells["number"][order].tolist(), (first + node[order]).tolist(), strict=True)
        (leaves if is_leaf else fathers).extend(own)
        nodes += zip(range(first, first + len(blobs)), map(bytes, blobs), strict=True)
        first += len(blobs)
    return Packed(nodes, leaves, fathers)


def _blobs(cells: NDArray[Any], node: NDArray[np.int64], node_bytes: int) -> NDArray[np.uint8]:
    """Return the (nodes, node_bytes) blobs of a level's nodes, as of depth 0."""
    count = int(node.max(initial=0)) + 1
    sizes = np.bincount(node, minlength=count)
    place = np.arange(len(cells)) - (np.cumsum(sizes) - sizes)[node]
    table = np.zeros((count, _capacity(node_bytes)), dtype=CELL)
    table[node, place] = cells
    blobs = np.zeros((count, node_bytes), dtype=np.uint8)
    blobs[:, 2:HEAD_BYTES] = sizes.astype(">u2").view(np.uint8).reshape(count, 2)
    content = table.view(np.uint8).reshape(count, -1)
    blobs[:, HEAD_BYTES : HEAD_BYTES + content.shape[1]] = content
    return blobs


def _capacity(node_bytes: int) -> int:
    """Return the number of cells that a node has room for."""
    return (node_bytes - HEAD_BYTES) // CELL.itemsize

"""Kernels on cells and their neighbours: growth of seeds, boundaries, vegetation that reaches in, counts of classes."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msbdb.threads import kernel


@kernel
def grow(seeds: NDArray[np.int32], domain: NDArray[Any], connectivity: int) -> NDArray[np.int32]:
    """Spread values to the cells without one, by rings of neighbours, inside the cells of equal domain.

    Parameters
    ----------
    seeds : (H, W) ndarray of int32
        Values to spread; 0 for none. Not modified.
    domain : (H, W) ndarray of int
        A value spreads only between cells of one and the same domain above 0.
    connectivity : int
        4 or 8.

    Returns
    -------
    (H, W) ndarray of int32
        The seeds, and in each cell that a seed reaches the value of the nearest one. Distances count steps inside the
        domain; at equal distance the seed cell that comes first in row order wins.
    """
    rows, cols = seeds.shape
    grown = seeds.copy()
    flat = grown.ravel()
    area = domain.ravel()
    # A cell enters the queue once, when it gets its value, so the queue never exceeds the image. It starts with the
    # seeds in row order and stays in order of distance: the first value that reaches a cell is the nearest one.
    queue = np.empty(flat.size, dtype=np.int32)
    head = tail = 0
    for cell in range(flat.size):
        if flat[cell] != 0:
            queue[tail] = cell
            tail += 1
    while head < tail:
        cell = queue[head]
        head += 1
        row, col = cell // cols, cell % cols
        for r in range(max(row - 1, 0), min(row + 2, rows)):
            for c in range(max(col - 1, 0), min(col + 2, cols)):
                near = r * cols + c
                # With 4-connectivity a neighbour in another row and another column does not touch.
                if connectivity == 4 and r != row and c != col:
                    continue
                if flat[near] == 0 and area[near] != 0 and area[near] == area[cell]:
                    flat[near] = flat[cell]
                    queue[tail] = near
                    tail += 1
    return grown


@kernel
def mark_edges(labels: NDArray[np.int32], cells: NDArray[np.intp], edge: NDArray[np.bool_]) -> None:
    """Mark which cells of objects have a neighbour (of eight) outside of their object.

    Parameters
    ----------
    labels : (H, W) ndarray of int32
        Objects; 0 for none.
    cells : (K,) ndarray of int
        Flat indices of the cells to look at, those of all objects among them.
    edge : (H, W) ndarray of bool
        Changed in place, in these cells: whether a cell is on a boundary.

    Notes
    -----
    Border: what lies outside of the array does not exist.
    """
    # Each cell reads its neighbours and writes itself alone, so the order of the cells has no effect.
    rows, cols = labels.shape
    for cell in cells:
        row, col = cell // cols, cell % cols
        label = labels[row, col]
        edge[row, col] = False
        if label != 0:
            for r in range(max(row - 1, 0), min(row + 2, rows)):
                for c in range(max(col - 1, 0), min(col + 2, cols)):
                    if labels[r, c] != label:
                        edge[row, col] = True


@kernel
def reaching_in(
    labels: NDArray[np.int32],
    edge: NDArray[np.bool_],
    blobs: tuple[NDArray[np.int32], NDArray[np.int32]],
    count: int,
    reached: NDArray[np.bool_],
) -> None:
    """Mark the cells where blobs of mark 1 lie over an object (V37).

    The band of an object is the dilation of its boundary cells by 3 by 3 (A6). A blob has mark 1 for an object when
    it meets the object's band without lying in it wholly.

    Parameters
    ----------
    labels : (H, W) ndarray of int32
        Objects; 0 for none.
    edge : (H, W) ndarray of bool
        The objects' boundary cells.
    blobs : (N,) and (B + 1,) ndarray of int32
        Flat indices of the blobs' cells, blob by blob; and where each blob's cells start among them, and N.
    count : int
        The largest label.
    reached : (H, W) ndarray of bool
        Changed in place: the cells of objects under their blobs of mark 1 become true.
    """
    # `inside` counts the cells of a blob in each object's band. `last` holds the latest cell counted for an object, so
    # that a cell beside several boundary cells of one object counts once.
    rows, cols = labels.shape
    cells, starts = blobs
    inside = np.zeros(count + 1, dtype=np.int32)
    last = np.full(count + 1, -1, dtype=np.int32)
    for blob in range(starts.size - 1):
        blob_cells = cells[starts[blob] : starts[blob + 1]]
        for cell in blob_cells:
            row, col = cell // cols, cell % cols
            for r in range(max(row - 1, 0), min(row + 2, rows)):
                for c in range(max(col - 1, 0), min(col + 2, cols)):
                    label = labels[r, c]
                    if edge[r, c] and last[label] != cell:
                        last[label] = cell
                        inside[label] += 1
        # Mark 1: the blob meets the band (above 0) and does not lie in it wholly (below its own size).
        for cell in blob_cells:
            row, col = cell // cols, cell % cols
            label = labels[row, col]
            if label != 0 and 0 < inside[label] < blob_cells.size:
                reached[row, col] = True
        # Only the counts that this blob raised go back to 0, so the time is linear in the cells of the blobs.
        for cell in blob_cells:
            row, col = cell // cols, cell % cols
            for r in range(max(row - 1, 0), min(row + 2, rows)):
                for c in range(max(col - 1, 0), min(col + 2, cols)):
                    inside[labels[r, c]] = 0


@kernel
def tally(
    labels: NDArray[np.int32], position: NDArray[np.int64], index: NDArray[Any], counts: NDArray[np.int64]
) -> None:
    """Count the cells of each class in each object, into an array of counts.

    Parameters
    ----------
    labels : (H, W) or (C,) ndarray of int32
        Objects; 0 for none.
    position : (N + 1,) ndarray of int64
        Row of ``counts`` for each label; -1 for those that do not count.
    index : (H, W) or (C,) ndarray of int
        Class of each cell, from 0.
    counts : (M, K + 1) ndarray of int64
        Changed in place.
    """
    for label, kind in zip(labels.flat, index.flat):  # noqa: B905  (kernels know no strict)
        if position[label] >= 0:
            counts[position[label], kind] += 1

"""The flood that builds a component tree: from the lowest cell up, the highest waiting cell first (Salembier 1998).

The flood always proceeds at the highest cell that it can reach, so it leaves a component only when all of it is done.
Cells are compared by their rank, the place in the sorted order, so floats are as fast as small integers. The ranks
that wait are bits of a hierarchy of words, an eighth of a byte a cell.
"""

import numpy as np
from numpy.typing import NDArray

from msbdb.threads import kernel

NONE = -1
"""No rank, no cell."""

WORD = 6
"""Bits of the place within a word of 64 bits."""


@kernel
def flood(
    rank: NDArray[np.int32], cell_of: NDArray[np.int32], steps: NDArray[np.int32]
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return each cell's parent, and the cells in the order in which the flood left them: leaves before parents.

    Parameters
    ----------
    rank : (P,) ndarray of int32
        Place of each cell in the sorted order; negative where there is no cell. Every neighbour of a cell is within
        the array, so a frame of no cells surrounds the lattice. Overwritten: a visited cell's rank is complemented.
    cell_of : (n,) ndarray of int32
        The cell of each rank.
    steps : (4 or 8,) ndarray of int32
        What to add to a cell's index to reach its neighbours.

    Notes
    -----
    A cell's parent is the next lower one, by rank, of the components that hold the cell; a root is its own. While a
    cell waits on the stack of unfinished components, its parent is the one below it on the stack.
    """
    count = cell_of.size
    parent = np.empty(rank.size, dtype=np.int32)
    left = np.empty(count, dtype=np.int32)
    words, offsets = _queue(count)
    done = 0
    for cell in cell_of:
        if rank[cell] < 0:
            continue
        rank[cell] = ~rank[cell]  # the lowest cell of a connected area: its root
        parent[cell] = NONE
        # Invariant: from `cell` down to the root, each parent is a lower cell whose component is not finished.
        while cell != NONE:
            following = _look_around(cell, rank, steps, words, offsets)
            if following != NONE:
                parent[following] = cell
            else:
                following = below = parent[cell]
                if below == NONE:
                    parent[cell] = cell
                else:
                    # A waiting cell above the next cell of the stack belongs to a component between the two.
                    waiting = _highest(words, offsets)
                    if waiting > ~rank[below]:
                        _remove(words, offsets, waiting)
                        following = cell_of[waiting]
                        parent[following] = below
                        parent[cell] = following
                left[done] = cell
                done += 1
            cell = following
    return parent, left


@kernel
def _look_around(
    cell: int,
    rank: NDArray[np.int32],
    steps: NDArray[np.int32],
    words: NDArray[np.uint64],
    offsets: NDArray[np.int64],
) -> int:
    """Visit the neighbours: return the first that is higher, as the flood goes there; let the lower ones wait."""
    own = ~rank[cell]
    for step in steps:
        other = cell + step
        found = rank[other]
        if found >= 0:
            rank[other] = ~found
            if found > own:
                return int(other)
            _insert(words, offsets, found)
    return NONE


@kernel
def _queue(count: int) -> tuple[NDArray[np.uint64], NDArray[np.int64]]:
    """Return an empty set of ranks: levels of words, where a bit is set if its word of the level below has any."""
    offsets = np.zeros(8, dtype=np.int64)
    levels = 0
    size = count
    while levels == 0 or size > 1:
        size = (size + 63) >> WORD
        offsets[levels + 1] = offsets[levels] + size
        levels += 1
    return np.zeros(offsets[levels], dtype=np.uint64), offsets[: levels + 1]


@kernel
def _insert(words: NDArray[np.uint64], offsets: NDArray[np.int64], rank: int) -> None:
    """Put a rank into the set."""
    place = rank
    for level in range(offsets.size - 1):
        word = offsets[level] + (place >> WORD)
        before = words[word]
        words[word] = before | (np.uint64(1) << np.uint64(place & 63))
        if before != 0:
            return  # the bits above this word are set already
        place >>= WORD


@kernel
def _remove(words: NDArray[np.uint64], offsets: NDArray[np.int64], rank: int) -> None:
    """Take a rank out of the set."""
    place = rank
    for level in range(offsets.size - 1):
        word = offsets[level] + (place >> WORD)
        words[word] &= ~(np.uint64(1) << np.uint64(place & 63))
        if words[word] != 0:
            return  # the word is not empty, so the bits above it stay
        place >>= WORD


@kernel
def _highest(words: NDArray[np.uint64], offsets: NDArray[np.int64]) -> int:
    """Return the highest rank of the set, or none."""
    place = 0
    for level in range(offsets.size - 2, -1, -1):
        word = words[offsets[level] + place]
        if word == 0:
            return NONE
        place = (place << WORD) + _highest_bit(word)
    return place


@kernel
def _highest_bit(word: np.uint64) -> int:
    """Return the place of the highest bit that is set."""
    place = 0
    for step in (32, 16, 8, 4, 2, 1):
        upper = word >> np.uint64(step)
        if upper != 0:
            word = upper
            place += step
    return place

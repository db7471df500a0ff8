"""Outlines of many regions of points along the cells that hold them (S7, grid-based)."""

import numpy as np
from numpy.typing import NDArray

from msbdb.vector.alphashape import enclosed
from msbdb.vector.packing import pack
from msbdb.vector.polygons import Geometries

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Labels = NDArray[np.int32]

GAP_CELLS = 8
"""Wider empty bands are narrowed to it: more than the closing can bridge."""

MARGIN = 2
"""Empty cells beside the outermost ones, so that no window reaches round to the other end of a row."""

AROUND = tuple((down, right) for down in (-1, 0, 1) for right in (-1, 0, 1))
"""The window of the closing, 3 by 3 cells: it fills gaps of up to two cells."""

SIDES = (((0, -1), (0, 0), (1, 0)), ((0, 1), (1, 1), (0, 1)), ((-1, 0), (0, 1), (0, 0)), ((1, 0), (1, 0), (1, 1)))
"""For each side of a cell: the neighbour beyond it, and its two corners, as (row, column), row counted northwards."""


def cell_shapes(x: Floats, y: Floats, labels: Labels, count: int, side_m: float) -> Geometries:
    """Return the outline of each region along the cells that hold its points, closed over small gaps.

    Parameters
    ----------
    x, y : (N,) ndarray of float64, metres
        Points.
    labels : (N,) ndarray of int32
        1 to ``count``: the region of each point.
    count : int
        Number of regions.
    side_m : float
        Side of a cell, metres; cells lie on the absolute lattice.

    Returns
    -------
    (count,) ndarray of Polygon or MultiPolygon
        Disjoint. A cell belongs to the region with most of its points, of equal ones to the lower label; a region
        that nowhere has most points is None. Cells that the closing adds go to the lowest label that claims them.
    """
    east, north = pack(x, side_m, GAP_CELLS), pack(y, side_m, GAP_CELLS)
    width = int(east.number[-1]) + 1 + 2 * MARGIN
    cells, owner = _owned((north.cell + MARGIN) * width + east.cell + MARGIN, labels)
    cells, owner = _closed(cells, owner, width)
    row, col = np.divmod(cells, width)
    world_row, world_col = north.absolute(row - MARGIN), east.absolute(col - MARGIN)
    starts: list[Floats] = []
    ends: list[Floats] = []
    sides: list[Ints] = []
    for (down, right), start, end in SIDES:
        beyond = cells + down * width + right
        place = np.minimum(np.searchsorted(cells, beyond), len(cells) - 1)
        border = (cells[place] != beyond) | (owner[place] != owner)
        corners = (np.column_stack((world_col + at[1], world_row + at[0]))[border] for at in (start, end))
        for found, corner in zip((starts, ends), corners, strict=True):
            found.append(corner * side_m)
        sides.append(owner[border])
    return enclosed(np.concatenate(starts), np.concatenate(ends), np.concatenate(sides), count)


def _owned(key: Ints, labels: Labels) -> tuple[Ints, Ints]:
    """Return the cells in ascending order, and the label with most points in each, the lower of equal ones."""
    order = np.lexsort((labels, key))
    pair = np.flatnonzero((np.diff(key[order], prepend=-1) != 0) | (np.diff(labels[order], prepend=0) != 0))
    number = np.diff(np.append(pair, len(key)))
    cells, owner = key[order][pair], labels[order][pair].astype(np.int64)
    best = np.lexsort((owner, -number, cells))
    first = best[np.flatnonzero(np.diff(cells[best], prepend=-1))]
    return cells[first], owner[first]


def _closed(cells: Ints, owner: Ints, width: int) -> tuple[Ints, Ints]:
    """Close each region over free cells: those all of whose neighbours have a neighbour of the region, or are it."""
    span = int(cells.max()) + 2 * width + 2
    grown = np.unique(np.concatenate([owner * span + cells + down * width + right for down, right in AROUND]))
    inside = np.ones(len(grown), dtype=np.bool_)
    for down, right in AROUND:
        beyond = grown + down * width + right
        inside &= grown[np.minimum(np.searchsorted(grown, beyond), len(grown) - 1)] == beyond
    label, cell = np.divmod(grown[inside], span)
    place = np.minimum(np.searchsorted(cells, cell), len(cells) - 1)
    free = cells[place] != cell
    cell, first = np.unique(cell[free], return_index=True)  # ascending by label: the lowest comes first
    every, label = np.concatenate((cells, cell)), np.concatenate((owner, label[free][first]))
    order = np.argsort(every)
    return every[order], label[order]

"""Edge points of regions by the 8-directional neighbourhood (Cao & Wu, definitions 6 and 7)."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from msbdb.morphology.points import CellIndex, cell_place, index_cells, parts_of, strip
from msbdb.threads import in_threads, kernel

ALL_SECTORS = 255
"""A bit for each of the eight sectors."""

WIDER = 1 + 1e-6
"""Cells are this much wider than the reach, so that rounding puts no neighbour beyond the next cell."""


def find_edges(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    labels: NDArray[np.int32],
    *,
    radius_m: float,
    gap_m: float,
) -> NDArray[np.bool_]:
    """Return which points are edge points of their region (C8, C9).

    Parameters
    ----------
    x, y : (N,) ndarray of float64, metres
        Places of the points; heights do not count.
    labels : (N,) ndarray of int32
        Regions; 0 for none.
    radius_m : float
        R, radius of the eight sectors of 45 degrees around a point, the first of them north of east.
    gap_m : float
        E_s.

    Returns
    -------
    (N,) ndarray of bool
        True for a point of a region that has (1) a sector without any point of the same region, or (2) a sector
        whose nearest such point is farther than E_s. Points at the very same place lie in no sector.

    Notes
    -----
    A sector holds its first side, counter-clockwise, and not its second. Both conditions together ask for a point in
    each sector no farther than the smaller of R and E_s. O(n) at a bounded density.
    """
    reach = min(radius_m, gap_m)
    edge = np.zeros(len(x), dtype=np.bool_)
    inside = np.flatnonzero(labels > 0)
    x, y = x[inside], y[inside]
    index = index_cells(x, y, reach * WIDER)
    points = Members(index, x[index.order], y[index.order], labels[inside][index.order], reach**2)
    found = np.empty(inside.size, dtype=np.bool_)
    in_threads(lambda part: _open_sector(points, part, found), parts_of(index))
    edge[inside[index.order]] = found
    return edge


class Members(NamedTuple):
    """Points of regions in the order of their cells, and the square of their reach; for kernels."""

    cells: CellIndex
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    labels: NDArray[np.int32]
    reach_squared: float


@kernel
def _open_sector(points: Members, part: tuple[int, int], found: NDArray[np.bool_]) -> None:
    """Write which points of a range of cells have a sector without a point of their region within reach."""
    index, x, y, labels, reach_squared = points
    for cell in range(part[0], part[1]):
        row, col = cell_place(index, cell)
        # The point's own row first: there its sectors are filled soonest.
        near = (
            strip(index, row, col - 1, col + 1),
            strip(index, row + 1, col - 1, col + 1),
            strip(index, row - 1, col - 1, col + 1),
        )
        for point in range(index.starts[cell], index.starts[cell + 1]):
            seen = 0
            for first, stop in near:
                for other in range(first, stop):
                    east, north = x[other] - x[point], y[other] - y[point]
                    squared = east * east + north * north
                    if squared == 0 or squared > reach_squared or labels[other] != labels[point]:
                        continue
                    seen |= 1 << _sector(east, north)
                    if seen == ALL_SECTORS:
                        break
                if seen == ALL_SECTORS:
                    break
            found[point] = seen != ALL_SECTORS


@kernel
def _sector(east: float, north: float) -> int:
    """Return the sector of 45 degrees that holds a direction, counted from east over north."""
    sector = 0
    if north < 0 or (north == 0 and east < 0):  # turned by half a circle into the upper half
        east, north, sector = -east, -north, 4
    if east <= 0:  # turned back by a quarter into the first one
        east, north, sector = north, -east, sector + 2
    return sector + 1 if north >= east else sector

"""Small flat zones join the neighbour that they rise or fall to least, so that a scale has none below its s (V7)."""

import heapq
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msbdb.labels import CellList, chosen_cells, look_up, sizes
from msbdb.labels.numbering import require_image
from msbdb.threads import kernel

NONE = -1
"""The end of a list of pairs."""


def merge_small_zones(level: NDArray[Any], least_px: int, *, connectivity: int = 8) -> NDArray[Any]:
    """Merge each flat zone that is too small with the neighbouring zone of the nearest value.

    Parameters
    ----------
    level : (H, W) ndarray of int
        One scale; 0 is background, which neither grows nor shrinks. Not modified.
    least_px : int
        Zones with fewer cells are too small.
    connectivity : int
        4 or 8; that of the flat zones.

    Returns
    -------
    (H, W) ndarray
        Of the same dtype. A small zone without any neighbour, an island, stays.

    Notes
    -----
    Opening and closing remove small peaks and pits, but not the narrow zones between them, such as mixed cells along a
    high wall. The smallest zone is merged first; of equal ones that whose first cell comes first.
    It takes the value of the neighbour that differs least; of equal ones that with the longer common edge, then the
    one that comes first. Zones that touch with one value are one zone from then on.

    Zones only merge (V11), and islands do not influence each other (V12).
    Border: zones end at the array. Complexity: linear in the cells, and in the edges of the small zones.

    Examples
    --------
    The step of one cell rises to 3 by one storey, and by two to 5:

    >>> merge_small_zones(np.array([[0, 3, 3, 4, 6, 6]]), 2)
    array([[0, 3, 3, 3, 6, 6]])
    """
    require_image(level)
    cells = CellList.covering(level != 0)
    zone, count = cells.zones(cells.of(level), connectivity=connectivity)
    area = sizes(zone, count)
    small = area < least_px
    if not small.any():
        return level
    value = np.zeros(count + 1, dtype=np.int64)
    value[zone] = cells.of(level)
    pairs = _pairs(cells.image(zone), cells.numbers[chosen_cells(zone, small)], connectivity)
    merged = _merge(pairs, value, np.concatenate([[0], area]), least_px).astype(level.dtype)
    return cells.image(look_up(merged, zone))


@kernel
def _find(parent: NDArray[np.int32], zone: int) -> int:
    """Return the zone that stands for this one, and shorten the way to it."""
    while parent[zone] != zone:
        parent[zone] = parent[parent[zone]]
        zone = parent[zone]
    return zone


@kernel
def _pairs(labels: NDArray[np.int32], cells: NDArray[np.int64], connectivity: int) -> NDArray[np.int32]:
    """Return the zones of each pair of neighbours whose first cell is among those given; (N, 2)."""
    rows, cols = labels.shape
    pairs = np.empty((8 * cells.size, 2), dtype=np.int32)
    count = 0
    for cell in cells:
        row, col = cell // cols, cell % cols
        for r in range(max(row - 1, 0), min(row + 2, rows)):
            for c in range(max(col - 1, 0), min(col + 2, cols)):
                apart = connectivity == 4 and r != row and c != col
                if labels[r, c] and labels[r, c] != labels[row, col] and not apart:
                    pairs[count] = labels[row, col], labels[r, c]
                    count += 1
    return pairs[:count]


@kernel
def _best(zone: int, touched: NDArray[np.int32], edge: NDArray[np.int64], value: NDArray[np.int64]) -> int:
    """Return the neighbour of the nearest value; of equal ones that of the longer edge, then the first."""
    best = int(touched[0])
    for other in touched[1:]:
        nearer = abs(value[best] - value[zone]) - abs(value[other] - value[zone])
        longer = edge[other] - edge[best]
        if nearer > 0 or (nearer == 0 and (longer > 0 or (longer == 0 and other < best))):
            best = other
    return best


@kernel
def _merge(  # noqa: PLR0912  (one loop; its lists of neighbours cannot leave it)
    pairs: NDArray[np.int32], value: NDArray[np.int64], area: NDArray[np.int64], least_px: int
) -> NDArray[np.int64]:
    """Return the value of each zone after all merging; ``value`` and ``area`` are used up."""
    # Each small zone has a list of its pairs; lists of merged zones are hung together. Large zones need none, as a zone
    # is looked at only while it is small.
    following = np.full(len(pairs), NONE, dtype=np.int64)
    head = np.full(area.size, NONE, dtype=np.int64)
    tail = np.full(area.size, NONE, dtype=np.int64)
    for pair, zone in enumerate(pairs[:, 0]):
        if head[zone] == NONE:
            head[zone] = pair
        else:
            following[tail[zone]] = pair
        tail[zone] = pair
    parent = np.arange(area.size).astype(np.int32)
    edge = np.zeros(area.size, dtype=np.int64)
    touched = np.empty(area.size, dtype=np.int32)
    waiting = [(area[zone], zone) for zone in range(1, area.size) if area[zone] < least_px]
    heapq.heapify(waiting)
    while len(waiting) > 0:
        size, zone = heapq.heappop(waiting)
        if parent[zone] != zone or area[zone] != size:
            continue  # it was merged since it entered the queue
        near = 0
        pair = head[zone]
        while pair != NONE:
            other = _find(parent, pairs[pair, 1])
            if other != zone:
                if edge[other] == 0:
                    touched[near] = other
                    near += 1
                edge[other] += 1
            pair = following[pair]
        if near == 0:
            continue
        level = value[_best(zone, touched[:near], edge, value)]
        # All neighbours of the new value are one zone with it from now on.
        into = zone
        for other in touched[:near]:
            edge[other] = 0
            if value[other] != level:
                continue
            first, second = min(into, other), max(into, other)
            parent[second] = first
            area[first] += area[second]
            if head[first] == NONE:
                head[first], tail[first] = head[second], tail[second]
            elif head[second] != NONE:
                following[tail[first]] = head[second]
                tail[first] = tail[second]
            into = first
        value[into] = level
        if area[into] < least_px:
            heapq.heappush(waiting, (area[into], into))
    for zone in range(1, area.size):
        value[zone] = value[_find(parent, zone)]
    return value

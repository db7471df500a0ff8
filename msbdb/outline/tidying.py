"""Tidying of labels before they are outlined: corners joined, crumbs dropped, and holes closed that are no courts."""

import numpy as np
from numpy.typing import NDArray

from msbdb.labels import Labels, label_zones, sizes
from msbdb.threads import kernel

Ints = NDArray[np.int64]


def tidied(labels: Labels, least_px: float) -> Labels:
    """Return labels whose outlines have no rings below a least area, and no pieces that touch at a corner alone.

    Parameters
    ----------
    labels : (H, W) ndarray of int32
        0 where there is no object. Not modified.
    least_px : float
        Least size of a court, and of a second piece of a label, cells.

    Returns
    -------
    (H, W) ndarray of int32
        Every label is still there.

    Notes
    -----
    First, where two cells of a label touch at a corner and an empty cell lies beside both, that cell joins them. Then
    pieces below the least size go, but for the largest of each label. At last, empty zones below the least size that
    do not reach the border are filled: by the label along most of their edge, of equal ones the lower. Pieces and
    empty zones are 4-connected, as rings are. Invalid cells count as empty.

    Examples
    --------
    >>> labels = np.array([[1, 1, 1, 0], [1, 0, 1, 0], [1, 1, 1, 0], [0, 0, 0, 1]], dtype=np.int32)
    >>> tidied(labels, 2)
    array([[1, 1, 1, 0],
           [1, 1, 1, 0],
           [1, 1, 1, 1],
           [0, 0, 0, 1]], dtype=int32)
    """
    found = np.ascontiguousarray(labels, dtype=np.int32).copy()
    _join_corners(found)
    zones, count = label_zones(found, connectivity=4)
    cells = sizes(zones, count)
    owner = np.zeros(count + 1, dtype=np.int64)
    inside = np.flatnonzero(zones)
    owner[zones.ravel()[inside]] = found.ravel()[inside]
    order = np.lexsort((np.arange(count), -cells, owner[1:]))
    largest = np.zeros(count, dtype=np.bool_)
    largest[order[np.diff(owner[1:][order], prepend=0) > 0]] = True
    crumb = np.concatenate(([False], (cells < least_px) & ~largest))
    found.ravel()[inside[crumb[zones.ravel()[inside]]]] = 0
    return _without_small_holes(found, least_px)


@kernel
def _join_corners(labels: Labels) -> None:
    """Give an empty cell to a label whose cells touch at a corner only, until no such cell is left."""
    changed = True
    while changed:
        changed = False
        for row in range(labels.shape[0] - 1):
            for col in range(labels.shape[1] - 1):
                for side in range(2):
                    own = labels[row, col + side]
                    if own == 0 or labels[row + 1, col + 1 - side] != own:
                        continue
                    above, below = labels[row, col + 1 - side], labels[row + 1, col + side]
                    if own in (above, below):
                        continue
                    if above == 0:
                        labels[row, col + 1 - side] = own
                        changed = True
                    elif below == 0:
                        labels[row + 1, col + side] = own
                        changed = True


def _without_small_holes(labels: Labels, least_px: float) -> Labels:
    """Fill the small empty zones inside."""
    zones, count = label_zones(labels == 0, connectivity=4)
    small = np.concatenate(([False], sizes(zones, count) < least_px))
    for border in (zones[0], zones[-1], zones[:, 0], zones[:, -1]):
        small[border] = False
    if not small.any():
        return labels
    # A small zone does not reach the border, so each of its cells has four neighbours.
    cells = np.flatnonzero(small[zones])
    width = labels.shape[1]
    zone = np.tile(zones.ravel()[cells], 4).astype(np.int64)
    label = np.concatenate([labels.ravel()[cells + step] for step in (1, -1, width, -width)]).astype(np.int64)
    zone, label = zone[label > 0], label[label > 0]
    key, edges = np.unique(zone * (int(labels.max()) + 1) + label, return_counts=True)
    zone, label = np.divmod(key, int(labels.max()) + 1)
    order = np.lexsort((label, -edges, zone))
    first = order[np.diff(zone[order], prepend=0) > 0]
    winner = np.zeros(count + 1, dtype=np.int32)
    winner[zone[first]] = label[first]
    filled = labels.copy()
    filled.ravel()[cells] = winner[zones.ravel()[cells]]
    return filled

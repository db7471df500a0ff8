"""Regions that touch: their pairs, and a colouring in which no two of one colour touch."""

import numpy as np
from numpy.typing import NDArray

from msbdb.labels.numbering import Labels, look_up

WIDTH = 32
"""Bits of a label."""


def touching_pairs(labels: Labels) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return the pairs of regions that touch along a side or at a corner of cells.

    Parameters
    ----------
    labels : (H, W) ndarray of int32
        Regions; 0 for none.

    Returns
    -------
    smaller, larger : (P,) ndarray of int32
        The two labels of each pair, in order.

    Examples
    --------
    Regions 1 and 3 touch at a corner:

    >>> for labels in touching_pairs(np.array([[1, 2, 2], [0, 3, 0]], dtype=np.int32)):
    ...     labels.tolist()
    [1, 1, 2]
    [2, 3, 3]
    """
    rows, cols = labels.shape
    found = []
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        one = labels[: rows - down, max(-right, 0) : cols - max(right, 0)]
        other = labels[down:, max(right, 0) : cols + min(right, 0)]
        differ = (one != other) & (one > 0) & (other > 0)
        pair = one[differ].astype(np.int64), other[differ].astype(np.int64)
        found.append(np.minimum(*pair) << WIDTH | np.maximum(*pair))
    # A pair is one number: these are sorted far quicker than columns.
    pairs = np.unique(np.concatenate(found))
    return (pairs >> WIDTH).astype(np.int32), (pairs & (1 << WIDTH) - 1).astype(np.int32)


def colour_touching(labels: Labels) -> NDArray[np.uint8]:
    """Give each region a colour that no region has which touches it.

    Parameters
    ----------
    labels : (H, W) ndarray of int32
        Regions; 0 for none.

    Returns
    -------
    (H, W) ndarray of uint8
        0 for none, otherwise the colour from 1 on. Each region takes the first one that is free, in their order.

    Notes
    -----
    So work on many regions, each as if it stood alone, takes as many passes as there are colours: four suffice on a
    map, and the first free one seldom exceeds six.

    Examples
    --------
    >>> colour_touching(np.array([[7, 8, 9, 0, 5]], dtype=np.int32))
    array([[1, 2, 1, 0, 1]], dtype=uint8)
    """
    smaller, larger = touching_pairs(labels)
    colour = np.ones(int(labels.max(initial=0)) + 1, dtype=np.uint8)
    colour[0] = 0
    order = np.argsort(larger, kind="stable")
    regions, starts = np.unique(larger[order], return_index=True)
    # A region looks at those before it alone; those behind it look at this one.
    for region, before in zip(regions.tolist(), np.split(smaller[order], starts[1:]), strict=False):
        taken = set(colour[before].tolist())
        colour[region] = next(free for free in range(1, len(taken) + 2) if free not in taken)
    return look_up(colour, labels)

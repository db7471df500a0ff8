"""Links from each child to its father, and the duplicates that links reveal (V27 to V33)."""

import numpy as np
from numpy.typing import NDArray

from msbdb.parts.clusters import Clusters, Step

NONE = -1
"""The father of a root."""

SAME_STOREYS = "same storeys as its coarser cluster"
SAME_AREA = "nearly the area of its coarser cluster"


def link(clusters: Clusters) -> NDArray[np.int64]:
    """Find each living cluster's father: the living cluster that holds it on the nearest coarser scale (A3).

    Parameters
    ----------
    clusters : Clusters
        Nested: every cluster lies inside of one cluster of a coarser scale, or beside them all.

    Returns
    -------
    (N,) ndarray of int64
        Row number of the father; -1 for roots and for dropped clusters.

    Notes
    -----
    Flat zones only merge as s rises (V11), and the stages that reshape keep the clusters nested. Hence the label at
    one cell of the child, its first, is that of the father.

    Examples
    --------
    An upper part of two storeys (row 1) and both ends of the house beside it (rows 0 and 2) lie in the house (row 3):

    >>> from msbdb.parts.clusters import label_clusters
    >>> clusters = label_clusters([np.array([[1, 1, 2, 2, 1]]), np.array([[1, 1, 1, 1, 1]])], connectivity=8)
    >>> link(clusters).tolist()
    [3, 3, 3, -1]
    """
    rows = clusters.rows
    level, first, alive = rows["level"].to_numpy(), rows["first"].to_numpy(), clusters.alive
    living, place = np.concatenate([[False], alive]), clusters.cells.places(first)
    father = np.full(len(rows), NONE, dtype=np.int64)
    for coarser in range(1, len(clusters.labels)):
        child = np.flatnonzero(alive & (level < coarser) & (father == NONE))
        found = clusters.labels[coarser][place[child]]
        holds = living[found]
        father[child[holds]] = found[holds] - 1
    return father


def find_roots(father: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the row number of each cluster's root; a root's is its own.

    Complexity: linear in the clusters times the logarithm of the deepest tree's depth.
    """
    root = np.where(father == NONE, np.arange(len(father)), father)
    while (root != root[root]).any():
        root = root[root]
    return root


def drop_duplicates(clusters: Clusters, share: float, *, by_storeys: bool = True) -> Step:
    """Drop each finer cluster F that adds nothing to the next coarser one C that holds it.

    Parameters
    ----------
    clusters : Clusters
        Nested clusters.
    share : float
        F is a duplicate when area(F) >= share * area(C) (V28).
    by_storeys : bool
        Whether F is a duplicate also when its zone has as many storeys as C's (V27). Off after reshaping, when only
        the areas have changed.

    Returns
    -------
    Step
        Nothing is lost with a duplicate, as C covers it. The heights of C come from the nDSM and not from its zone,
        which the opening has lowered (A4).

    Notes
    -----
    The scan goes from fine to coarse. So F is compared with the next coarser cluster that exists when the scan begins,
    even if that one is a duplicate itself (V29). An F with the area of its C is always dropped, so a child is smaller
    than its father (V33).

    Examples
    --------
    Both ends have as many storeys as the house and go; the upper part with 2 of 5 cells stays:

    >>> from msbdb.parts.clusters import label_clusters
    >>> clusters = label_clusters([np.array([[1, 1, 2, 2, 1]]), np.array([[1, 1, 1, 1, 1]])], connectivity=8)
    >>> drop_duplicates(clusters, 0.85).clusters.alive.tolist()
    [False, True, False, True]
    """
    father = link(clusters)
    rows = clusters.rows
    finer = np.flatnonzero(father != NONE)
    coarser = father[finer]
    zone, area = rows["hzone"].to_numpy(), rows["area"].to_numpy()
    same_storeys = (zone[finer] == zone[coarser]) & by_storeys
    duplicate = same_storeys | (area[finer] >= share * area[coarser])
    reason = np.where(same_storeys, SAME_STOREYS, SAME_AREA)[duplicate]
    return Step(clusters.without(finer[duplicate]), rows.iloc[finer[duplicate]].assign(reason=reason))

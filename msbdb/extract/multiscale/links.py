"""Links between fathers and children over all scales (V32, V33)."""

import numpy as np
from numpy.typing import NDArray

from msbdb.extract.multiscale.clusters import Clusters

NONE = -1
"""The father of a root."""


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
    one cell of the child, its first, tells the father.
    """
    rows = clusters.rows
    level, first, alive = rows["level"].to_numpy(), rows["first"].to_numpy(), clusters.alive
    living = np.concatenate([[False], alive])
    father = np.full(len(rows), NONE, dtype=np.int64)
    for coarser in range(1, len(clusters.labels)):
        child = np.flatnonzero(alive & (level < coarser) & (father == NONE))
        found = clusters.labels[coarser].ravel()[first[child]]
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

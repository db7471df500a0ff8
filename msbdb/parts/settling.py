"""Clusters that were cut move to the scale whose s they still reach, so that none is below its own scale (V7)."""

import numpy as np
from numpy.typing import NDArray

from msbdb.labels import look_up
from msbdb.parts.clusters import Clusters, Step

COVERED = "covers the same scale as a cluster that was cut"


def settle(clusters: Clusters, thresholds: list[int]) -> Step:
    """Move each cluster that is smaller than the s of its scale to the coarsest scale whose s it reaches.

    Parameters
    ----------
    clusters : Clusters
        Nested clusters. Some were cut (V37, V44), or are the rest of a fake father (V46).
    thresholds : list of int
        s of the scales, cells, ascending.

    Returns
    -------
    Step
        Nested clusters. Where a cluster arrives on a scale, those that it holds there go as its duplicates: it covers
        them. A cluster smaller than the finest s stays on the finest scale.

    Notes
    -----
    Ids keep the scale on which the cluster was found (column ``made``).

    Examples
    --------
    A house of five cells stands on the scale of s = 8, and its upper part on that of s = 2. It moves to s = 4:

    >>> from msbdb.parts.clusters import label_clusters
    >>> house, part = np.array([[1, 1, 1, 1, 1]]), np.array([[2, 2, 0, 0, 0]])
    >>> clusters = label_clusters([part, 0 * house, house], connectivity=8)
    >>> settle(clusters, [2, 4, 8]).clusters.rows["level"].tolist()
    [0, 1]
    """
    rows = clusters.rows
    level, area = rows["level"].to_numpy(), rows["area"].to_numpy()
    reached = np.maximum(np.searchsorted(thresholds, area, side="right") - 1, 0)
    moved = np.flatnonzero(clusters.alive & (reached < level))
    if not moved.size:
        return Step(clusters, rows.iloc[:0].assign(reason=""))
    images = list(clusters.labels)
    covered: list[NDArray[np.intp]] = []
    target = np.where(clusters.alive, np.minimum(reached, level), level)
    for scale in np.unique(target[moved]).tolist():
        image = images[scale].copy()
        arriving = moved[target[moved] == scale]
        # From fine to coarse: a cluster that comes from a coarser scale holds those that come from finer ones.
        for origin in np.unique(level[arriving]).tolist():
            own = arriving[level[arriving] == origin]
            cells = look_up(clusters.flags(own), clusters.labels[origin])
            image[cells] = clusters.labels[origin][cells]
        here = np.flatnonzero(clusters.alive & (target == scale))
        shown = np.zeros(len(rows) + 1, dtype=np.bool_)
        shown[image] = True
        covered.append(here[~shown[here + 1]])
        images[scale] = image
    for origin in np.unique(level[moved]).tolist():
        gone = clusters.flags(moved[level[moved] == origin])
        images[origin] = np.where(look_up(gone, images[origin]), np.int32(0), images[origin])
    settled = Clusters(tuple(images), rows.assign(level=target))
    lost = np.sort(np.concatenate(covered))
    return Step(settled.without(lost), rows.iloc[lost].assign(reason=COVERED))

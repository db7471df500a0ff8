"""Elimination of duplicates: one thing that shows on several scales stays on the coarsest (V27-V31)."""

import numpy as np

from msbdb.extract.multiscale.clusters import Clusters, Step
from msbdb.extract.multiscale.links import NONE, link

SAME_STOREYS = "same storeys as its coarser cluster"
SAME_AREA = "nearly the area of its coarser cluster"


def drop_duplicates(clusters: Clusters, share: float, *, by_storeys: bool = True) -> Step:
    """Drop each finer cluster F that says nothing beside the next coarser one C that holds it.

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
        Nothing is lost with a duplicate: C stands for it. The heights of C come from the nDSM and not from its zone,
        which the opening has lowered (A4).

    Notes
    -----
    The scan goes from fine to coarse, so F is compared with the next coarser cluster that exists when it begins, even
    if that one turns out to be a duplicate itself (V29). An F of its C's very area is always dropped, hence a child
    is smaller than its father (V33).
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

"""Points that return to a region: what the change of curvature took from its edges (ours)."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from msbdb.threads import cores

NEAREST = 3
"""So many points of regions tell how high the roof is beside a point."""


def grow_regions(
    points: NDArray[np.float64],
    labels: NDArray[np.int32],
    free: NDArray[np.bool_],
    *,
    reach_m: float,
    step_m: float,
) -> NDArray[np.int32]:
    """Give regions back the points beside, below and on them.

    Parameters
    ----------
    points : (N, 3) ndarray of float64, metres
        From an origin nearby.
    labels : (N,) ndarray of int32
        Regions; 0 for none. Not modified.
    free : (N,) ndarray of bool
        Points without a region that may return to one.
    reach_m : float
        Largest distance in plan to a point of a region, which is excluded; 0 gives nothing back.
    step_m : float
        Points that lie higher than this above the highest of the three nearest points of regions do not return.

    Returns
    -------
    (N,) ndarray of int32
        A point that returns belongs to the region of the point nearest to it in plan.

    Notes
    -----
    The neighbourhood of an eave, a ridge with chimneys or a wall fills the space as a crown does, so Eq. 7 takes them
    where a roof is no wider than the neighbourhood. A crown over a roof is higher, a wall below it lower.
    """
    members, asking = np.flatnonzero(labels > 0), np.flatnonzero(free & (labels == 0))
    if reach_m <= 0 or not members.size or not asking.size:
        return labels
    tree = cKDTree(points[members, :2], balanced_tree=False, compact_nodes=False)
    distance, near = tree.query(
        points[asking, :2], k=np.arange(1, NEAREST + 1), distance_upper_bound=reach_m, workers=cores()
    )
    heights = np.append(points[members, 2], -np.inf)
    returns = np.isfinite(distance[:, 0]) & (points[asking, 2] <= heights[near].max(axis=1) + step_m)
    grown = labels.copy()
    grown[asking[returns]] = labels[members[near[returns, 0]]]
    return grown

"""Points that return to a region: what the change of curvature took from its edges, and its walls (ours)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from msbdb.threads import cores

NEAREST = 3
"""So many points of regions tell how high the roof is beside a point."""


@dataclass(frozen=True, slots=True)
class Reach:
    """How far from a region points return to it.

    Parameters
    ----------
    level_m : float
        Largest distance in plan to a point of a region; 0 gives nothing back.
    step_m : float
        Points within this of the roof's height are of its level.
    wall_factor : float
        Only echoes below that level return within so many times the distance, at least once.
    mask_m : float
        Lower above ground, points return as feet of walls alone.
    """

    level_m: float
    step_m: float
    wall_factor: float
    mask_m: float

    def of(
        self, above_roof_m: NDArray[np.float64], heights: NDArray[np.float64], several: NDArray[np.bool_]
    ) -> NDArray[np.float64]:
        """Return (N,) the distances within which points return, by their height above roof and ground; 0: never."""
        level, half = self.level_m, self.level_m / 2
        wall = np.where(several, level, self.wall_factor * level)
        reach = np.where(above_roof_m <= 2 * self.step_m, half, 0.0)
        reach[above_roof_m <= self.step_m] = level
        below = above_roof_m < -self.step_m
        reach[below] = wall[below]
        low = heights < self.mask_m
        reach[low] = np.where(below[low], half, 0.0)
        return reach


def grow_regions(
    points: NDArray[np.float64],
    labels: NDArray[np.int32],
    free: NDArray[np.bool_],
    *,
    heights: NDArray[np.float64],
    several: NDArray[np.bool_] | None,
    reach: Reach,
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
    heights : (N,) ndarray of float64, metres
        Above ground.
    several : (N,) ndarray of bool, optional
        Which points are of pulses with several echoes; None where nothing is known of echoes.
    reach : Reach
        How far they may lie from a region.

    Returns
    -------
    (N,) ndarray of int32
        A point that returns belongs to the region of the point nearest to it in plan.

    Notes
    -----
    The neighbourhood of an eave, a ridge with chimneys or a wall fills the space as a crown does, so Eq. 7 takes them
    where a roof is no wider than the neighbourhood. The height of the roof is that of the highest of the three
    nearest points of regions. A crown over a roof is higher. What is lower is a wall or a lower roof where the pulse
    ends there; where it goes on, half of it is leaves, and only what is near returns. Below the mask little is
    building, but points right below a roof's edge are the feet of its walls.
    """
    members, asking = np.flatnonzero(labels > 0), np.flatnonzero(free & (labels == 0))
    if reach.level_m <= 0 or not members.size or not asking.size:
        return labels
    tree = cKDTree(points[members, :2], balanced_tree=False, compact_nodes=False)
    distance, near = tree.query(
        points[asking, :2],
        k=np.arange(1, NEAREST + 1),
        distance_upper_bound=np.nextafter(max(1.0, reach.wall_factor) * reach.level_m, np.inf),
        workers=cores(),
    )
    roof = np.append(points[members, 2], -np.inf)[near].max(axis=1)
    split = np.zeros(len(asking), dtype=np.bool_) if several is None else several[asking]
    within = reach.of(points[asking, 2] - roof, heights[asking], split)
    returns = (within > 0) & (distance[:, 0] <= within)
    grown = labels.copy()
    grown[asking[returns]] = labels[members[near[returns, 0]]]
    return grown

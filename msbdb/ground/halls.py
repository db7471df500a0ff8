"""Halls that the progressive filter takes for terrain: wider than its windows, or cut by the border of the survey.

They are buildings after all, as walls bound them nearly all around.
"""

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from msbdb.labels import join_cells, neighbours
from msbdb.morphology.windows import erosion
from msbdb.params import GroundParams

Heights = NDArray[np.float32]
Mask = NDArray[np.bool_]

RAISED = (0.95, 0.5)
"""Ours: what joins the cells of a wide hall is below these shares of the steps that raised outliers make."""

COURT_M2 = 2000.0
"""Ours, in sample: ground beside things as high is a part of a hall from this area on; courts of gardens have 900."""

HALL_M = 4.0
"""Ours: least mean depth of the walls of a hall that the border cuts: retaining walls are lower."""

BARE = 0.25
"""Ours: higher things stand on a plateau along more than this share of its edge; a hall carries lanterns and plant."""

HOUSE_M2 = 500.0
"""Ours: what is larger and stands on a hall is a higher part of it; houses and crowns are smaller."""

CUT, SIDE = 0.55, 1 / 3
"""Ours: largest shares of the border in the edge of such a hall: two sides of a square and a little more; one side."""

STEPS = 4
"""Ours: a hall of up to so many levels is found, the highest level first, and so many treads of a hillside."""


def podiums(
    heights: Heights, ground: Mask, measured: Mask, *, wall_m: float, cell_m: float, params: GroundParams
) -> Mask:
    """Return the regions of ground that fall by walls nearly all around.

    A region is connected by steps that are no wall. Edges to higher roofs do not count; the border of the lattice
    counts as an edge without a wall. Nor do edges to what is as high and above ground, if it is larger than a house:
    of a hall wider than the windows, a part may be known already.

    Where points are few, low outliers that were raised make stairs of ``low_outlier_m`` beside walls. By them a hall
    runs into the ground. So regions as large as a window are connected by lower steps, too, and an edge then falls to
    the lowest of the nine cells beside it. Of a region of `COURT_M2` the edge to such known things counts as walls, as
    it is a part of them.

    Parameters
    ----------
    heights : (H, W) ndarray of float32
        Lowest heights, gap-free, metres.
    ground : (H, W) ndarray of bool
        The ground so far.
    measured : (H, W) ndarray of bool
        The other cells are a void.
    wall_m : float
        The step from which a pair of cells is rather a wall than none, metres.
    cell_m : float
        Side of a cell, metres.
    params : GroundParams
        ``podium_share``, ``low_outlier_m`` and ``window_m``.

    Returns
    -------
    (H, W) ndarray of bool
        Cells that are no ground.
    """
    decide = partial(_walled_around, heights, measured=measured, wall_m=wall_m, cell_m=cell_m, params=params)
    return _by_lower_steps(decide, ground, erosion(heights, 3, measured), wall_m, params)


def _walled_around(
    heights: Heights,
    ground: Mask,
    *,
    measured: Mask,
    beside: Heights | None,
    joined_m: float,
    least_m2: float,
    wall_m: float,
    cell_m: float,
    params: GroundParams,
) -> Mask:
    """Return the regions of ground, joined by lower steps, that fall by walls to the heights beside them."""
    lowest = heights if beside is None else beside
    regions, count = join_cells(heights, ground, joined_m)
    area_m2 = np.bincount(regions[ground], minlength=count) * cell_m**2
    large = area_m2 >= least_m2
    if not large.any():
        return np.zeros_like(ground)
    above = measured & ~ground
    others, number = join_cells(heights, above, wall_m)
    known = above & (np.bincount(others[above], minlength=number) * cell_m**2 >= HOUSE_M2)[others]
    around, falls, levels = (np.zeros(heights.shape, dtype=np.int32) for _ in range(3))
    for one, other in neighbours(heights.shape):
        for here, there in ((one, other), (other, one)):
            fall = heights[here] - heights[there]
            edge = (regions[here] != regions[there]) & (ground[there] | (fall > -wall_m) | ~measured[there])
            level = edge & known[there] & (fall < wall_m)
            edge &= ~level
            around[here] += edge
            falls[here] += edge & (heights[here] - lowest[there] >= wall_m) & measured[there]
            levels[here] += level
    for side in (np.s_[0], np.s_[-1], np.s_[:, 0], np.s_[:, -1]):
        around[side] += 1
    edges, walls, within = (
        np.bincount(regions.ravel(), weights=each.ravel(), minlength=count) for each in (around, falls, levels)
    )
    within *= area_m2 >= COURT_M2
    bounded = (walls + within > 0) & (walls + within >= params.podium_share * (edges + within))
    podium: Mask = ground & (large & bounded)[regions]
    return podium


def cut_halls(
    heights: Heights, ground: Mask, measured: Mask, *, wall_m: float, cell_m: float, params: GroundParams
) -> Mask:
    """Return the ground within halls that the border cuts.

    A region is connected by steps that are no wall, be it ground or not. It is a hall by the part of its edge that is
    seen: this falls by walls nearly all around, as that of a podium, and deeper than terraces do. The region is bare: a
    plateau carries houses and trees. The border is at most `CUT` of the edge, two sides of a corner; if it is more than
    `SIDE`, the region is the smaller part of the place, too. Large regions are connected by lower steps, too.

    The parameters and the returned mask are those of `podiums`.
    """
    decide = partial(_cut_regions, heights, measured=measured, wall_m=wall_m, cell_m=cell_m, params=params)
    return _by_lower_steps(decide, ground, erosion(heights, 3, measured), wall_m, params)


def _by_lower_steps(
    decide: Callable[..., Mask], ground: Mask, lowest: Heights, wall_m: float, params: GroundParams
) -> Mask:
    """Return what is decided to be a hall by regions that walls part, and then by large ones that lower steps part."""
    found = decide(ground, beside=None, joined_m=wall_m, least_m2=0.0)
    for share in RAISED:
        joined_m = min(wall_m, share * params.low_outlier_m)
        found |= decide(ground & ~found, beside=lowest, joined_m=joined_m, least_m2=params.window_m**2)
    return found


def _cut_regions(
    heights: Heights,
    ground: Mask,
    *,
    measured: Mask,
    beside: Heights | None,
    joined_m: float,
    least_m2: float,
    wall_m: float,
    cell_m: float,
    params: GroundParams,
) -> Mask:
    """Return the ground within halls that the border cuts, of regions that are joined by lower steps."""
    found = np.zeros_like(ground)
    regions, count = join_cells(heights, measured, joined_m)
    cells = np.bincount(regions.ravel(), minlength=count)
    possible = (np.bincount(regions[ground], minlength=count) > 0) & (cells * cell_m**2 >= least_m2)
    own, there, fall = edges_of(heights, regions, possible)
    deep = fall if beside is None else fall + (heights - beside).ravel()[there]
    seen = measured.ravel()[there]
    # What is next to a void goes on into it, as over the border.
    sides = [regions[side] for side in (np.s_[0], np.s_[-1], np.s_[:, 0], np.s_[:, -1])]
    cut = np.bincount(np.concatenate([*sides, own[~seen]]), minlength=count)
    possible &= cut > 0
    small = cells[regions.ravel()[there]] * cell_m**2 < HOUSE_M2
    # The lower part of a hall is known to be one once the higher part beside it is.
    for _ in range(STEPS):
        of_ground = (ground & ~found).ravel()[there]
        falls, outer = seen & (deep >= wall_m), seen & (of_ground | (fall > -wall_m))
        carries = seen & small & (fall <= -wall_m) & ~of_ground
        edges, walls, depth_m, carried = (
            np.bincount(own, weights=each, minlength=count) for each in (outer, outer & falls, falls * deep, carries)
        )
        share = cut / np.maximum(edges + cut, 1)
        halls = (
            possible
            & (walls >= np.maximum(params.podium_share * edges, 1))
            & (depth_m >= HALL_M * walls)
            & (carried <= BARE * edges)
            & (share <= CUT)
            & ((share <= SIDE) | (2 * cells <= np.count_nonzero(measured)))
        )
        before, found = found, ground & halls[regions]
        if (before == found).all():
            break
    return found


def edges_of(
    heights: Heights, regions: NDArray[np.int32], chosen: Mask
) -> tuple[NDArray[np.int32], NDArray[np.int32], Heights]:
    """Return the edges of chosen regions: the region, the cell on the other side, and how far that lies below.

    Parameters
    ----------
    heights : (H, W) ndarray of float32
        Metres.
    regions : (H, W) ndarray of int32
        The region of each cell, from 0.
    chosen : (N,) ndarray of bool
        By region.

    Returns
    -------
    own, beside : (K,) ndarray of int32
        The region, and the flat index of the cell beside it. Border: the lattice has no edge there.
    fall : (K,) ndarray of float32
        Metres; below 0 where the other side is higher.
    """
    node, edges = np.arange(heights.size, dtype=np.int32).reshape(heights.shape), []
    for one, other in neighbours(heights.shape):
        for here, there in ((one, other), (other, one)):
            at = chosen[regions[here]] & (regions[here] != regions[there])
            edges.append((regions[here][at], node[there][at], heights[here][at] - heights[there][at]))
    own, beside, fall = (np.concatenate(parts) for parts in zip(*edges, strict=True))
    return own, beside, fall

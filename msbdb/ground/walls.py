"""The ground by its walls, the default filter: a building is bounded by walls nearly all around, terrain is not.

The progressive filter is sure of some ground. What else is ground follows from the edges between the cells.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, uniform_filter

from msbdb.grid import Grid, GridSpec
from msbdb.ground.interpolation import NearestGround, interpolate_ground
from msbdb.ground.progressive import open_progressively
from msbdb.ground.regions import (
    HOUSE_M2,
    LEAST_M2,
    STEP_M,
    STEPS,
    beside_voids,
    edges_of,
    halls,
    reached_by_ways,
    sunk_roofs,
    with_narrow_bridges,
)
from msbdb.ground.trend import lower_trend
from msbdb.labels import Pairs, chosen_cells, join_cells, label_zones, minimum_cut, neighbours, sizes, sums
from msbdb.morphology.windows import dilation, opening
from msbdb.params import GroundParams

Heights = NDArray[np.float32]
Mask = NDArray[np.bool_]

SEEN = 0.4
"""Ours, in sample: least share of a plateau's edge beside ground; 0.3 loses more roofs, 0.5 takes knolls for roofs."""

FLANKS_M2, AT_ONCE, HALVED = 2000.0, 0.6, 0.3
"""Ours, in sample: least area of a knoll with steep flanks, and the largest share of its edge that falls by `STEP_M` at
once: knolls have up to 0.6, an arena 0.67. From 1,000 m² on, low halls among few echoes would go, too. What has more
than the last share of its edge at the border counts twice: half of a circle of cells has a third."""

WIDE_M, STAYS = 20.0, 0.3
"""Ours, in sample: half-width of an opening that removes houses, and the least share of a tread that it does not lower.
With 30 m, or with 0.5, fewer treads are found, and hardly fewer roofs are lost."""

FREE = 2 / 3
"""Ours: the largest share of a tread's edge beside ground, as the rest is beside higher treads and houses. Treads have
0.66 at most, a hall of 1.8 ha has 0.74."""

MOST_HOUSES = 0.5
"""A hollow lies in terrain if at most so much of its rim are houses; of a court it is nearly all."""

FEW = 100
"""Ours, in sample: so many echoes show walls as walls. Between fewer, shrubs beside a shed make up a slope to it."""

RISE_M = 0.5
"""Ours: a thing rises so much more than terrain may, as kerbs and beds do not."""

LEVEL_M, LEVEL_SHARE = 0.3, 0.25
"""Ours: a piece of a terrace has ground as high as itself beside more than this share of it."""

NEAR_M = 3.0
"""Ours: beside is within so many metres, the width of a path."""

WELL_M2 = 10.0
"""As ``vector.court_m2``: smaller courts are light wells, doubtful also where a cell of them is sure."""

WIDER = 3.0
"""Ours, in sample: blocks and windows so many times as wide follow no hall of up to 400 m; twice loses a few more."""

LOW_M = 1.0
"""Ours, in sample: low ground lies less than this above the lowest around; 0.7 to 1.2 m give nearly the same."""

HOLLOW_M = 180.0
"""Side of the square in which hollows are compared with what stands: as wide as the trend looks, nine blocks."""


def walled_ground(surface: Grid, params: GroundParams, points_m2: float = math.inf) -> Mask:
    """Detect ground cells by the walls between cells.

    1. An opening with a square of half-width ``clutter_m`` removes crowns, cars and masts.
    2. The trend of the terrain is subtracted (`lower_trend`), and the progressive filter runs on the rest. It is
       strict: what it keeps is ground. Closed hollows in terrain, deeper than ``wall_high_m``, that cover at most
       ``hollow_share`` as much as what stands around them are filled for it: pits, and false echoes from below.
    3. A minimum cut decides all other cells at once. With f the share of a wall, from 0 at a step of ``wall_low_m``
       to 1 at ``wall_high_m``, a pair of neighbours costs

       - 1 - f where only the higher one is above ground: a smooth transition from ground to roof;
       - 1 where only the lower one is above ground: ground looks down on a roof;
       - ``terrace_cost`` times f where both are ground: a retaining wall;
       - nothing where both are above ground.

       So a region is above ground if walls bound more than 1 / (1 + ``terrace_cost``) of its edge, 70 % by default, and
       all regions of a place are decided together: terraces one above the other, roofs beside higher roofs. Of a
       plateau larger than a house, under trees and houses that hide how it falls, the edge that is seen decides. Knolls
       whose edge falls in low steps are terrain, too, and so are treads of a hillside: an opening wider than a house
       does not lower them (`_plateaus`).
    4. A second cut, in which only low ground is sure, finds what else walls bound: halls too wide for the trend and the
       windows of the progressive filter. Their ground is a building after all if they fall by walls for
       ``podium_share`` of their edge. Of a hall that the border cuts the rest of the edge decides, if it is high and
       bare (`halls`).
    5. Of the ground, cells that rise above the opening are clutter, not ground. Nor are pieces of fewer than `FEW`
       echoes that rise above the terrain of what is sure, and are no part of a terrace: sheds among shrubs.
    6. What a way leads to from the ground is terrain after all: a terrace or a ramp, and all of a region if ways lead
       to ``reached_share`` of it. A way is three cells wide, and rises by less than ``even_step_m`` from cell to cell.
       Where the trend rises by more, it may follow the trend. It begins on even ground, so not on a slope
       where a level roof touches the terrain; nor is the rear of such a roof its beginning, which may count as ground.
       Narrower bridges are ground where they meet it at both ends (`with_narrow_bridges`).
    7. A court that higher cells bound all around costs nothing as ground, and nothing as a roof. Without a cell that is
       sure, or if it is small, it is a well in a roof, unless it lies on the terrain of the other ground. A larger one
       is a lower part of a roof if it lies far above that terrain (`sunk_roofs`).

    Parameters
    ----------
    surface : Grid
        Lowest heights, gap-free, metres; cells that are not valid are a void far from all points.
    params : GroundParams
        Section ``ground``.
    points_m2 : float
        First echoes a square metre; by default so many that every piece shows its walls.

    Returns
    -------
    (H, W) ndarray of bool
        Ground cells.

    Notes
    -----
    The filter is ours. Steps are those between cells of 1 m; between larger cells they must be larger in proportion.
    Border: the outermost cell is repeated. Nodata: a void is a border; it has no steps, and no cell of it is ground.
    Ties go to the ground.

    Examples
    --------
    A terrace of 3 m that a ramp reaches is ground; a roof of that height is not:

    >>> from pyproj import CRS
    >>> from msbdb.grid import lattice
    >>> heights = np.zeros((60, 120), dtype=np.float32)
    >>> heights[20:40, 80:100] = 3
    >>> heights[:, :50] = 3
    >>> heights[:24, 44:56] = np.linspace(3, 0, 12)
    >>> grid = Grid(heights, np.ones((60, 120), dtype=bool), lattice((0, 0, 119, 59), 1.0, CRS.from_epsg(2154)))
    >>> ground = walled_ground(grid, GroundParams())
    >>> bool(ground[30, 10]), bool(ground[30, 90])
    (True, False)
    """
    heights = np.asarray(surface.values, dtype=np.float32)
    cell_m = surface.spec.cell_m
    measured = surface.valid
    radius = max(1, round(params.clutter_m / cell_m))
    opened = np.where(measured, opening(heights, 2 * radius + 1, measured), heights)
    trend = lower_trend(surface, params)
    above_trend = _without_hollows(np.where(measured, opened - trend, 0), cell_m, params)
    sure = open_progressively(above_trend, cell_m, params.slope, params, measured)
    level, wall_m = Grid(opened, measured, surface.spec), wall_step_m(cell_m, params)
    decided = _decide(level, sure, params)
    decided &= ~halls(level, decided, _raised(level, decided, sure, wall_m, params), wall_m, params)
    # What the opening lowers by less is rough terrain: the slope, over the half-width of its square.
    clutter = heights - opened > params.height_m + params.slope * radius * cell_m
    ground = decided & ~clutter
    ground &= ~_blurred(level, ground, sure, params, points_m2)
    reached: Mask = ground | reached_by_ways(surface, trend, ground, wall_m, params)
    reached = with_narrow_bridges(surface, reached, wall_m, params)
    reached &= ~_wells(surface, reached, sure, params)
    return reached & ~sunk_roofs(surface, reached)


def _without_hollows(above_trend: Heights, cell_m: float, params: GroundParams) -> Heights:
    """Fill the hollows in terrain from their rims, for the progressive filter alone: pits and false echoes from below.

    The windows are as wide as halls, so that a pit would bring all terrain between it and the next low place into
    doubt. A hollow lies deep below the trend. It is closed, few as much beside what stands around it, and its rim is no
    wall of houses: the streets and courts of a dense town, whose trend lies near the roofs, are no hollows.
    """
    deep, high = above_trend < -params.wall_high_m, above_trend > params.wall_high_m
    if not deep.any():
        return above_trend
    width = round(HOLLOW_M / cell_m) | 1
    below, above = (uniform_filter(part.astype(np.float32), width, mode="constant") for part in (deep, high))
    labels, count = label_zones(deep)
    few = sums(labels, below - params.hollow_share * above, count) <= 0
    rim, houses = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
    for one, other in neighbours(deep.shape):
        for here, there in ((one, other), (other, one)):
            edge = deep[here] & ~deep[there]
            rim += sizes(labels[here][edge], count)
            houses += sizes(labels[here][edge & high[there]], count)
    border = np.concatenate([labels[side].ravel() for side in (np.s_[0], np.s_[-1], np.s_[:, 0], np.s_[:, -1])])
    hollows = chosen_cells(labels, few & (houses <= MOST_HOUSES * rim) & (sizes(border, count) == 0))
    rows, cols = distance_transform_edt(hollows, return_distances=False, return_indices=True)
    return np.asarray(above_trend[rows, cols])


def _decide(opened: Grid, sure: Mask, params: GroundParams) -> Mask:
    """Return the ground by the minimum cut, and plateaus; what is sure stays."""
    ground = opened.valid & ~_cut(opened, opened.valid & ~sure, np.zeros_like(sure), params)
    return ground | _plateaus(np.asarray(opened.values), ground, opened.valid, opened.spec.cell_m, params)


def _raised(opened: Grid, ground: Mask, sure: Mask, wall_m: float, params: GroundParams) -> Mask:
    """Return what a second cut takes off the ground around cells that are sure, but not low.

    The trend and the windows follow a roof that is wider than they are, so that its cells are sure. Here a trend over
    blocks of `WIDER` times the side is subtracted. Sure are only cells less than `LOW_M` above an opening of the rest
    with a square of `WIDER` times ``window_m``. Only what holds `LEAST_M2` of ground that is not low is cut again. Of
    it, cells without a step to any neighbour are decided together with these, which makes the cut quick. Where the
    trend follows a hall after all, cells on its roof seem low. Such a piece of ground is raised, too, if it is level
    with what is raised along more than `LEVEL_SHARE` of its edge.
    """
    heights, measured, cell_m = np.asarray(opened.values), opened.valid, opened.spec.cell_m
    trend = lower_trend(opened, replace(params, block_m=WIDER * params.block_m))
    rest = np.where(measured, heights - trend, 0)
    width = 2 * round(WIDER * params.window_m / cell_m) + 1
    low = sure & (rest - opening(rest, width, measured) <= LOW_M)
    pieces, count = label_zones(measured & ~low)
    free = chosen_cells(pieces, sizes(pieces[ground], count) * cell_m**2 >= LEAST_M2)
    if not free.any():
        return free
    stepped = np.zeros_like(free)
    for one, other in neighbours(heights.shape):
        step = np.abs(heights[one] - heights[other]) >= params.wall_low_m * max(cell_m, 1.0)
        stepped[one] |= step
        stepped[other] |= step
    raised = _cut(opened, free, free & ~stepped, params)
    pieces, count = join_cells(heights, measured & ~raised, wall_m)
    own, beside, fall = edges_of(heights, pieces, np.bincount(pieces[measured & ~raised], minlength=count) > 0)
    smooth = raised.ravel()[beside] & (np.abs(fall) < wall_m)
    level, edges = (np.bincount(own, weights=each, minlength=count) for each in (smooth, measured.ravel()[beside]))
    return raised | (measured & (level > LEVEL_SHARE * edges)[pieces])


def _cut(opened: Grid, free: Mask, even: Mask, params: GroundParams) -> Mask:
    """Return which of the free cells are above ground by the minimum cut; the other measured ones are ground.

    Neighbours that are even are decided as one.
    """
    heights, measured, cell_m = np.asarray(opened.values), opened.valid, opened.spec.cell_m
    node = np.full(heights.shape, -1, dtype=np.int32)
    above_ground = np.zeros_like(free)
    if not free.any():
        return above_ground
    together, pieces = label_zones(even, connectivity=4)
    alone = free & ~even
    count = pieces + int(np.count_nonzero(alone))
    node[even] = together[even] - 1
    node[alone] = np.arange(pieces, count, dtype=np.int32)
    costs = np.zeros(count)
    pairs = []
    for one, other in neighbours(heights.shape):
        for low, high in ((one, other), (other, one)):
            rise = heights[high] - heights[low]
            chosen = ((rise > 0) | ((rise == 0) & (low is one))) & measured[low] & measured[high]
            wall = _wall_share(rise, cell_m, params)
            terrace, smooth = params.terrace_cost * wall, 1 - wall
            below, above = node[low], node[high]
            both = chosen & (below >= 0) & (above >= 0) & (below != above)
            pairs.append((below[both], above[both], terrace[both], smooth[both]))
            # Beside sure ground a pair is a cost of the other cell alone.
            up = chosen & (below < 0) & (above >= 0)
            costs += np.bincount(above[up], weights=(smooth - terrace)[up], minlength=count)
            down = chosen & (below >= 0) & (above < 0)
            costs += np.bincount(below[down], weights=(1 - terrace)[down], minlength=count)
    first, second, terrace, smooth = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
    parts = Pairs(first, second, terrace, smooth, np.ones_like(terrace), np.zeros_like(terrace))
    above_ground[free] = minimum_cut(costs, parts)[node[free]]
    return above_ground


def _plateaus(heights: Heights, ground: Mask, measured: Mask, cell_m: float, params: GroundParams) -> Mask:
    """Return the cells of plateaus above ground that are terrain: wooded knolls and terraces.

    A plateau is connected by steps that are no wall, and larger than a house. Its edge is seen where it borders on
    ground. The rest borders on what is above ground. Voids and the border of the lattice are no edge. A plateau is
    terrain by one of three signs.

    - Walls are too small a share of the edge that is seen, and `SEEN` of the edge is. The cut also counts where the
      plateau is higher than trees on its slopes; here trees decide nothing. Of the rest of the edge no more may fall
      than rises: trees and houses stand on a plateau, but a roof is higher than its annexes.
    - It is a larger knoll, and its flanks are too steep for the first sign: `SEEN` of the edge is seen, and it falls in
      low steps, cell by cell. Halls fall by all of their height at once. Of a knoll that the border or a void cuts,
      half may lie beyond.
    - It is a tread of a hillside: higher treads lie beside it, so that an opening wider than a house does not lower
      `STAYS` of it. Only that part is terrain, as the rest is houses. Halls are none, as walls bound them all around.
      Nor is what is as wide as the opening by itself, or free on more sides than `FREE`: a hall with a higher part, and
      with trees and ramps beside its walls.
    """
    wall_m = wall_step_m(cell_m, params)
    width = 2 * round(WIDE_M / cell_m) + 1
    stays = np.where(measured, heights - opening(heights, width, measured), 0) <= wall_m
    found = np.zeros_like(ground)
    # Beside a tread that is terrain, more of the edge of the next one is seen.
    for _ in range(STEPS):
        around = ground | found
        above = measured & ~around
        regions, count = join_cells(heights, above, wall_m)
        cells, left = (np.bincount(regions[each], minlength=count) for each in (above, above & stays))
        large = cells * cell_m**2 >= HOUSE_M2
        own, beside, fall = edges_of(heights, regions, large)
        seen, hidden = around.ravel()[beside], above.ravel()[beside]
        wall = seen * _wall_share(fall, cell_m, params)
        high = seen & (fall >= STEP_M * max(cell_m, 1.0))
        at_border = np.bincount(regions[above & beside_voids(measured)], minlength=count)
        edges, of_ground, walls, falls, rises, high_steps = (
            np.bincount(own, weights=each, minlength=count)
            for each in (seen | hidden, seen, wall, hidden & (fall > 0), hidden & (fall < 0), high)
        )
        is_seen = of_ground >= SEEN * edges
        knolls = is_seen & (walls * (1 + params.terrace_cost) < of_ground) & (rises >= falls)
        whole = np.where(at_border > HALVED * (edges + at_border), 2, 1) * cells
        knolls |= is_seen & (high_steps < AT_ONCE * of_ground) & (whole * cell_m**2 >= FLANKS_M2)
        treads = (left >= STAYS * cells) & (2 * cells * cell_m <= WIDE_M * edges)
        treads &= (of_ground <= FREE * edges) & (walls < params.podium_share * of_ground)
        more = above & ((large & knolls)[regions] | (stays & (large & treads)[regions]))
        if not more.any():
            break
        found |= more
    return found


def _blurred(opened: Grid, ground: Mask, sure: Mask, params: GroundParams, points_m2: float) -> Mask:
    """Return the small pieces of ground that rise like things whose walls few echoes do not show.

    None of their cells is sure. They rise above the terrain of the sure ground, and then above that of all other
    ground: terraces that are large enough hold their small pieces. A piece beside ground as high as itself stays, too.
    """
    heights, spec = np.asarray(opened.values), opened.spec
    found, known = np.zeros_like(ground), ground & sure
    most_m2 = min(FEW / points_m2, params.hill_m2)
    if most_m2 < spec.cell_area_m2 or known.all() or not known.any():
        return found
    raised = ground & ~sure & (_rise(heights, known, spec, params) > RISE_M)
    pieces, count = label_zones(raised)
    few = sizes(pieces, count) * spec.cell_area_m2 < most_m2
    small = chosen_cells(pieces, few)
    if not small.any():
        return found
    others = ground & ~small
    beside = dilation(heights, 2 * max(1, round(NEAR_M / spec.cell_m)) + 1, others)
    level = sizes(pieces[small & (beside >= heights - LEVEL_M)], count)
    rise = sums(pieces, _rise(heights, others, spec, params) - RISE_M, count)
    return chosen_cells(pieces, few & (level <= LEVEL_SHARE * sizes(pieces, count)) & (rise > 0))


def _wells(surface: Grid, ground: Mask, sure: Mask, params: GroundParams) -> Mask:
    """Return the regions of ground, small or without a sure cell, that lie above the terrain of the other ground.

    Beside the border of the lattice the trend follows the roofs of a block, so that a well in it seems sure ground.
    """
    regions, count = label_zones(ground)
    small = sizes(regions, count) * surface.spec.cell_area_m2 <= WELL_M2
    doubtful = small | (sizes(regions[sure], count) == 0)
    others = ground & ~chosen_cells(regions, doubtful)
    if not doubtful.any() or not others.any():
        return np.zeros_like(ground)
    # Against a cell that is sure it takes a rise that terrain and kerbs do not make.
    rise = _rise(np.asarray(surface.values), others, surface.spec, params) - RISE_M * sure
    return chosen_cells(regions, doubtful & (sums(regions, rise, count) > 0))


def _rise(heights: Heights, ground: Mask, spec: GridSpec, params: GroundParams) -> Heights:
    """Return how far heights lie above what the terrain of some ground may reach there, metres.

    It may rise from that ground as towards an object in the progressive filter, by ``height_m`` and ``slope``.
    """
    nearest = NearestGround.of(ground)
    terrain = np.asarray(interpolate_ground(heights, ground, spec, sources=nearest).values)
    most_m = params.height_m + params.slope * spec.cell_m * nearest.distance
    return np.asarray(heights - terrain - most_m)


def _wall_share(rise: Heights, cell_m: float, params: GroundParams) -> NDArray[Any]:
    """Return the share of a wall that steps between neighbours are, from 0 to 1."""
    above_low = rise / max(cell_m, 1.0) - params.wall_low_m
    return np.asarray(np.clip(above_low / (params.wall_high_m - params.wall_low_m), 0, 1))


def wall_step_m(cell_m: float, params: GroundParams) -> float:
    """Return the step from which a pair of cells is rather a wall than none, metres."""
    return (params.wall_low_m + params.wall_high_m) / 2 * max(cell_m, 1.0)

"""Heights of buildings: the ground around each, eaves and ridge of its roofs, storeys, and how well it was seen.

A building's roofs are its surfaces between walls. Each has its eaves, the level of its rim, and its ridge. All levels
are taken above sea where the terrain is known, because a roof is level where the ground beneath is not.
"""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, maximum_filter1d
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from msbdb.detect.scene import Elevations
from msbdb.grid import Grid
from msbdb.kept import PER_METRE
from msbdb.labels import Labels, boxes, label_zones, neighbours, quantiles, sizes, sums, widened
from msbdb.params import HeightParams, SurfaceParams
from msbdb.parts.clusters import storeys
from msbdb.surface.gaps import nearest_cells
from msbdb.threads import together

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

AROUND = 5
"""What is a wall depends on cells up to so far away."""

TWO_CELLS = 1.5
"""A wall over two cells is higher than a wall over one by this factor: it crosses a cell, and noise adds up."""

STRIP = 1.6
"""Links between cells, for each cell of a surface, below which it is a strip: a band of two cells has 1.5."""

STEEP_CELLS = 1.5
"""The points of neighbouring cells are up to so many cells apart, and a steep roof rises so far between them."""


@dataclass(frozen=True, slots=True, eq=False)
class Roofs:
    """The roofs of buildings: connected surfaces without a wall inside.

    Parameters
    ----------
    labels : (H, W) ndarray of int32
        0 for none, otherwise the roof's number, 1 to R.
    building : (R,) ndarray of int32
        The building of each roof, from 0.
    area_m2 : (R,) ndarray of float64
        Area of its cells.
    eaves, ridge : (R,) ndarray of float64
        Levels of its rim and of its top, metres.
    """

    labels: Labels
    building: NDArray[np.int32]
    area_m2: Floats
    eaves: Floats
    ridge: Floats


def measure_heights(
    labels: Labels,
    count: int,
    ndsm: Grid,
    elevations: Elevations,
    *,
    params: HeightParams,
    surface: SurfaceParams,
) -> pd.DataFrame:
    """Return the heights of buildings, their storeys, and how well they were seen.

    Parameters
    ----------
    labels : (H, W) ndarray of int32
        Which building covers a cell: 0 for none, otherwise row number + 1.
    count : int
        Number of buildings.
    ndsm : Grid
        Heights above ground on the labels' lattice, metres.
    elevations : Elevations
        The terrain above sea and the echoes of each cell, each only where it is known.
    params : HeightParams
        What counts as wall, rim, ridge, and ground beside a building.
    surface : SurfaceParams
        Mask and height of a storey.

    Returns
    -------
    DataFrame
        A row a building. ``z_ground``, ``z_ground_min`` and ``z_ground_max``: median, and nearly the lowest and the
        highest, of the terrain around the building. ``z_eaves`` and ``z_ridge``: levels above sea. ``eaves`` and
        ``ridge``: the same above ``z_ground``. ``storeys``, ``storeys_min``, ``storeys_max`` and ``storeys_top``, whole
        numbers, and ``floor_area_m2``. ``coverage``, ``nodata_share`` and ``density``. Metres, shares, and echoes a
        square metre; NaN where unknown.

    Notes
    -----
    - Ground: cells near the building and outside of all buildings where the surface itself is at the terrain. Where
      none is near, farther ones count, and then the terrain beneath the building.
    - Pieces without weight, such as dormers and cells beside a step, count for the nearest roof of weight in their
      building.
    - Eaves: the mean level of the roofs of weight over the middle half of the building's area, lowest roofs first. That
      is the level of one roof where it has three quarters; of two roofs that are nearly equal none is taken by chance.
    - Ridge: the highest of the roofs of weight.
    - Storeys: by V18 of the eaves of that roof of weight up to which half of the area lies, as storeys between those of
      two roofs exist in none. Their range follows from low and tall storeys and from the slope of the ground.
      ``storeys_top`` are those of the highest eaves of the roofs of weight, as of a tower on a podium. The floor area
      counts the area of each roof of weight by the storeys of its own eaves.
    - Without a terrain all levels are above ground, and those above sea are NaN.

    Border and nodata: what lies beyond the lattice has no height. A cell without a height is in no roof.
    """
    terrain = np.zeros(labels.shape) if elevations.terrain_cm is None else elevations.terrain_cm / PER_METRE
    level = Grid(terrain + np.asarray(ndsm.values, dtype=np.float64), ndsm.valid, ndsm.spec)
    found, (ground, nodata) = together(
        partial(roofs_of, labels, level, params), partial(_around, labels, count, ndsm, terrain, params)
    )
    area_m2 = sizes(labels, count).astype(np.float64) * ndsm.spec.cell_area_m2
    heavy = _of_weight(found, area_m2, params)
    shares = _with_pieces(found, heavy)
    eaves, main, top, ridge = _levels(found, heavy, shares, count)
    z_ground, low, high = (np.round(one, 2) for one in ground)
    own = storeys(main - z_ground, surface)
    of_roofs = storeys(found.eaves - z_ground[found.building], surface)
    known = np.nan if elevations.terrain_cm is None else 0.0
    fewest = np.clip(np.ceil((main - high - params.roof_build_m) / params.tall_storey_m), 1, own)
    most = np.maximum(np.floor((main - low) / params.low_storey_m), own)
    return pd.DataFrame(
        {
            "z_ground": z_ground + known,
            "z_ground_min": low + known,
            "z_ground_max": high + known,
            "z_eaves": np.round(eaves, 2) + known,
            "z_ridge": np.round(ridge, 2) + known,
            "eaves": np.round(eaves - z_ground, 2),
            "ridge": np.round(ridge - z_ground, 2),
            "storeys": own,
            "storeys_min": fewest.astype(np.int64),
            "storeys_max": most.astype(np.int64),
            "storeys_top": storeys(top - z_ground, surface),
            "floor_area_m2": sums(found.building + 1, shares * of_roofs, count) * ndsm.spec.cell_area_m2,
            "nodata_share": nodata,
            **_seen(labels, count, elevations, ndsm.spec.cell_area_m2),
        }
    )


def roofs_of(labels: Labels, level: Grid, params: HeightParams) -> Roofs:
    """Return the roofs of buildings: cells of one building are of one roof where no wall lies between them.

    Parameters
    ----------
    labels : (H, W) ndarray of int32
        Which building covers a cell: 0 for none, otherwise row number + 1.
    level : Grid
        Levels of the surface, metres.
    params : HeightParams
        ``wall_m`` and ``wall_slope``: what is a wall. ``eaves_share`` of the rim and ``ridge_share`` of the roof lie
        below its eaves and its ridge.

    Notes
    -----
    A wall is a step of more than ``wall_m``. It must also be steeper than ``wall_slope``, or exceed the steps beside it
    in its line that go the same way by ``wall_m``: steep roofs of large cells have large steps, too, one after the
    other. A cell on the wall has a level between both sides, so a line of two steps between level cells is a wall, too.
    A gap of a cell in a line of walls joins no roofs.

    A steep roof breaks into pieces, as its points lie anywhere in their cells. What is in no roof of ``least_roof_m2``
    is joined again over the steps that such a roof has. The ridge of a strip of cells beside a wall is its eaves.

    A roof's rim are its cells at the outline of its building, and those beside a wall that goes down. So a house has
    the same eaves alone and in a row. The level at the edge of such a cell is half a step of the roof lower than at its
    centre. A roof without a rim, as between higher roofs of its building, takes all its cells.

    Examples
    --------
    A tower of 20 m stands on a podium of 6 m:

    >>> from pyproj import CRS
    >>> from msbdb.grid import lattice
    >>> spec = lattice((0, 0.1, 5.9, 0.9), 1.0, CRS.from_epsg(2154))
    >>> heights = np.array([[0.0, 6.0, 6.0, 6.0, 20.0, 20.0]])
    >>> level = Grid(heights, np.ones((1, 6), dtype=bool), spec)
    >>> roofs = roofs_of(np.int32(heights > 0), level, HeightParams())
    >>> roofs.area_m2.tolist(), roofs.eaves.tolist()
    ([3.0, 2.0], [6.0, 20.0])
    """
    heights = np.asarray(level.values, dtype=np.float64)
    inside = (labels > 0) & level.valid
    cell_m = level.spec.cell_m
    found, edge, _ = _surfaces(heights, labels, inside, params, cell_m)
    least_px = params.least_roof_m2 / level.spec.cell_area_m2
    pieces = inside & (np.bincount(found.ravel())[found] < least_px)
    groups, _ = label_zones(np.where(pieces, labels, 0))
    pieces &= np.bincount(groups.ravel())[groups] >= least_px
    steep = replace(params, wall_m=max(params.wall_m, STEEP_CELLS * params.wall_slope * cell_m))
    again, rims, strip = _surfaces(heights, np.where(pieces, labels, 0), pieces, steep, cell_m)
    joined = pieces & (np.bincount(again.ravel())[again] >= least_px)
    found[joined] = again[joined] + found.max()
    edge[joined] = rims[joined]
    used = np.bincount(found[inside], minlength=1) > 0
    found[inside] = np.cumsum(used, dtype=np.int32)[found[inside]]
    number = int(np.count_nonzero(used))
    building = np.zeros(number, dtype=np.int32)
    building[found[inside] - 1] = labels[inside] - 1
    rim = np.isfinite(edge)
    [eaves] = quantiles(found[rim], edge[rim], number, params.eaves_share)
    low, ridge = quantiles(found, heights, number, params.eaves_share, params.ridge_share)
    eaves = np.where(np.isnan(eaves), low, eaves)
    flat = np.unique(found[joined & strip[again]]) - 1
    ridge[flat] = eaves[flat]
    area_m2 = sizes(found, number).astype(np.float64) * level.spec.cell_area_m2
    return Roofs(found, building, area_m2, eaves, ridge)


def _surfaces(
    heights: Floats, labels: Labels, inside: Mask, params: HeightParams, cell_m: float
) -> tuple[Labels, Floats, Mask]:
    """Return the connected surfaces without a wall inside, 0 for none, the levels at a rim, and which are strips."""
    across, down, edge = _walls(heights, labels, inside, params, cell_m)
    count = int(np.count_nonzero(inside))
    node = np.zeros(labels.shape, dtype=np.int32)
    node[inside] = np.arange(count, dtype=np.int32)
    ways = zip(neighbours(labels.shape), (across, down), strict=True)
    pairs = [(node[one][joined], node[other][joined]) for (one, other), joined in ways]
    first, second = (np.concatenate(ends) for ends in zip(*pairs, strict=True))
    graph = coo_matrix((np.ones(first.size, dtype=np.int8), (first, second)), shape=(count, count))
    found = np.zeros(labels.shape, dtype=np.int32)
    found[inside] = connected_components(graph, directed=False)[1] + 1
    # A cell of a wide surface has two links, one to the right and one down; of a line of cells it has one.
    links = np.bincount(found[inside][first], minlength=found.max() + 1)
    return found, edge, links < STRIP * np.bincount(found.ravel())


def _walls(
    heights: Floats, labels: Labels, inside: Mask, params: HeightParams, cell_m: float
) -> tuple[Mask, Mask, Floats]:
    """Return which cells are of one roof with the next one of their row and of their column, and the levels at a rim.

    Each island of buildings is looked at in its own window, as most of a lattice has none. Returns (H, W - 1),
    (H - 1, W) and (H, W).
    """
    across, down = np.zeros_like(inside), np.zeros_like(inside)
    edge = np.full(labels.shape, np.inf)
    islands, _ = label_zones(labels > 0)
    for number, window in boxes(islands).items():
        near = widened(window, AROUND)
        own = islands[near] == number
        level, label, known = heights[near], labels[near], inside[near]
        joined, rim = _along_rows(level, label, known, params, cell_m)
        joined_down, rim_down = _along_rows(level.T, label.T, known.T, params, cell_m)
        across[near][:, :-1][own[:, :-1]] = joined[own[:, :-1]]
        down[near][:-1][own[:-1]] = joined_down.T[own[:-1]]
        edge[near][own] = np.minimum(rim, rim_down.T)[own]
    return across[:, :-1], down[:-1], edge


def _along_rows(
    heights: Floats, labels: Labels, inside: Mask, params: HeightParams, cell_m: float
) -> tuple[Mask, Floats]:
    """Return which cells are of one roof with the next one of their row, and the level at the edges of cells at a rim.

    ``inside`` are the cells of buildings that have a height. Returns (H, W - 1) and (H, W); infinity for no rim.
    """
    same = inside[:, :-1] & inside[:, 1:] & (labels[:, :-1] == labels[:, 1:])
    step = np.where(same, np.diff(heights, axis=1), 0.0)
    way, size = np.sign(step), np.abs(step)
    around = np.pad(step, ((0, 0), (1, 1)))
    # Of the steps beside, those that go the other way count as none.
    beside = np.maximum(np.maximum(around[:, :-2] * way, around[:, 2:] * way), 0)
    steady = (size <= params.wall_slope * cell_m) & (size - beside <= params.wall_m)
    joined = same & ((size <= params.wall_m) | steady)
    halves = _over_two_cells(step, same, params.wall_m)
    joined &= ~_in_wall(halves) & ~(halves & _in_wall(halves, 2))
    # A gap in a wall, as where a verge crosses the level of the annex beside it, joins no roofs.
    joined &= ~_in_wall(same & ~joined)
    edge = np.full(heights.shape, np.inf)
    for here, there, inner in ((np.s_[:, :-1], np.s_[:, 1:], 1), (np.s_[:, 1:], np.s_[:, :-1], -1)):
        ends = inside[here] & ~joined
        # What lies beside is not this building, or lower by a wall: a gutter between two houses is the eaves of both.
        ends &= (labels[there] != labels[here]) | (inside[there] & (heights[here] - heights[there] > params.wall_m))
        # The step from the neighbour on the other side, where it is of the same roof.
        rise = np.zeros(heights.shape)
        behind = np.s_[:, 1:] if inner == 1 else np.s_[:, :-1]
        rise[behind] = np.where(joined, np.maximum(-inner * step, 0), 0)
        edge[here] = np.where(ends, np.minimum(edge[here], heights[here] - rise[here] / 2), edge[here])
    return joined, edge


def _over_two_cells(step: Floats, same: Mask, wall_m: float) -> Mask:
    """Return the steps, (H, W - 1), that are halves of a wall: two the same way between level cells of a building."""
    size = np.pad(np.where(same, np.abs(step), np.inf), ((0, 0), (1, 1)), constant_values=np.inf)
    one, other = step[:, :-1], step[:, 1:]
    beyond = np.maximum(size[:, :-3], size[:, 3:])
    wall = same[:, :-1] & same[:, 1:] & (one * other > 0) & (np.abs(one + other) - 2 * beyond > TWO_CELLS * wall_m)
    halves: Mask = np.pad(wall, ((0, 0), (0, 1))) | np.pad(wall, ((0, 0), (1, 0)))
    return halves


def _in_wall(wall: Mask, least: int = 3) -> Mask:
    """Return the places of a line of walls, with its gaps of one or two: walls in three of the four rows around."""
    wide = maximum_filter1d(wall, 3, axis=1, mode="constant")
    rows = np.zeros(wall.shape, dtype=np.int8)
    for offset, walls in ((1, wall), (2, wide)):
        rows[offset:] += walls[:-offset]
        rows[:-offset] += walls[offset:]
    lined: Mask = rows >= least
    return lined


def _of_weight(roofs: Roofs, area_m2: Floats, params: HeightParams) -> Mask:
    """Return which roofs count in the heights of their buildings, of (N,) areas; the largest one always does."""
    least = np.minimum(params.roof_m2, np.maximum(params.roof_share * area_m2, params.least_roof_m2))
    largest = np.zeros(area_m2.size)
    np.maximum.at(largest, roofs.building, roofs.area_m2)
    heavy: Mask = roofs.area_m2 >= np.minimum(least, largest)[roofs.building]
    return heavy


def _with_pieces(roofs: Roofs, heavy: Mask) -> NDArray[np.int64]:
    """Return the cells for which each roof counts: its own, and the pieces without weight that are nearest to it.

    Where two roofs are nearly equal, the pieces decide which of them is the larger one. Returns (R,), zero for pieces.
    """
    building = np.append(0, roofs.building + 1)[roofs.labels]
    weighty = np.append(False, heavy)[roofs.labels]
    several = np.bincount(roofs.building[heavy], minlength=1) > 1
    only = np.zeros(several.size + 1, dtype=np.int32)
    only[roofs.building[heavy] + 1] = np.flatnonzero(heavy) + 1
    counted = only[building]
    for number, window in boxes(building).items():
        if several[number - 1]:
            own = building[window] == number
            rows, cols = distance_transform_edt(~(own & weighty[window]), return_distances=False, return_indices=True)
            counted[window][own] = roofs.labels[window][rows, cols][own]
    return sizes(counted, heavy.size).astype(np.int64)


def _levels(roofs: Roofs, heavy: Mask, shares: NDArray[np.int64], count: int) -> tuple[Floats, Floats, Floats, Floats]:
    """Return eaves, those of the main roof, the highest ones, and the ridge of each building by its roofs of weight.

    NaN without any. Shares are whole cells, so the sums are exact in any order.
    """
    order = np.flatnonzero(heavy)[np.lexsort((roofs.eaves[heavy], roofs.building[heavy]))]
    building, cells, level = roofs.building[order], shares[order], roofs.eaves[order]
    total = np.zeros(count, dtype=np.int64)
    np.add.at(total, building, cells)
    reached, own = np.cumsum(cells) - (np.cumsum(total) - total)[building], total[building]
    middle = np.clip(4 * reached, own, 3 * own) - np.clip(4 * (reached - cells), own, 3 * own)
    eaves, main, top, ridge = (np.full(count, np.nan) for _ in range(4))
    known = total > 0
    eaves[known] = sums(building + 1, middle * level, count)[known] / (2 * total[known])
    # Of equal halves the lower one counts.
    half = np.flatnonzero(2 * reached >= own)[::-1]
    main[building[half]] = level[half]
    top[building] = level
    highest = np.full(count, -np.inf)
    np.maximum.at(highest, building, np.maximum(roofs.ridge[order], level))
    ridge[building] = highest[building]
    # By rounding, the mean of equal levels may lie above them, and eaves above their ridge.
    return np.minimum(eaves, ridge), main, top, ridge


def _around(
    labels: Labels, count: int, ndsm: Grid, terrain: Floats, params: HeightParams
) -> tuple[tuple[Floats, Floats, Floats], Floats]:
    """Return median, low and high level of the ground around each building, and the share of no data there."""
    if not count:
        none = np.zeros(0)
        return (none, none, none), none
    near_m = max(params.ring_m, 2 * ndsm.spec.cell_m)
    far_m = max(near_m, params.far_ring_m)
    reach, far = (int(np.ceil(one / ndsm.spec.cell_m)) for one in (near_m, far_m))
    # What lies beyond the lattice has no height, like any other cell without data.
    wide, level, height, valid = (np.pad(one, reach) for one in (labels, terrain, np.asarray(ndsm.values), ndsm.valid))
    is_built = wide > 0
    # Only cells in a square around a building look for the nearest one, as most of a survey lies farther away.
    rows = maximum_filter1d(is_built.view(np.uint8), 2 * far + 1, axis=0)
    cells = np.flatnonzero(maximum_filter1d(rows, 2 * far + 1, axis=1))
    nearest = nearest_cells(is_built, cells, far + 1)
    cells, nearest = cells[nearest >= 0], nearest[nearest >= 0]
    (row, col), (its_row, its_col) = (np.divmod(one, wide.shape[1]) for one in (cells, nearest))
    distance_m = np.sqrt((row - its_row) ** 2 + (col - its_col) ** 2) * ndsm.spec.cell_m
    owner, built = wide.ravel()[nearest], is_built.ravel()[cells]
    level, height, valid = (values.ravel()[cells] for values in (level, height, valid))
    near = distance_m <= near_m
    nodata = sizes(owner[near & ~valid], count) / sizes(owner[near], count)
    bare = ~built & valid & (np.abs(height) <= params.bare_m)
    shares = (0.5, params.ground_tail, 1 - params.ground_tail)
    levels = np.full((3, count), np.nan)
    for chosen, least in (
        (bare & near, params.ground_cells),
        (bare & (distance_m <= far_m), params.ground_cells),
        (built, 1),
    ):
        missing = np.isnan(levels[0]) & (sizes(owner[chosen], count) >= least)
        chosen &= np.append(False, missing)[owner]
        levels[:, missing] = np.stack(quantiles(owner[chosen], level[chosen], count, *shares))[:, missing]
    return (levels[0], levels[1], levels[2]), nodata


def _seen(labels: Labels, count: int, elevations: Elevations, cell_area_m2: float) -> dict[str, Floats]:
    """Return the share of each building's cells that hold a measured height, and its echoes a square metre."""
    unknown = np.full(count, np.nan)
    if elevations.echoes is None:
        return {"coverage": unknown, "density": unknown}
    cells = sizes(labels, count)
    echoes = sums(labels[labels > 0], elevations.echoes[labels > 0].astype(np.float64), count)
    coverage = sizes(labels[elevations.echoes > 0], count) / cells
    return {"coverage": coverage, "density": echoes / (cells * cell_area_m2) if elevations.of_points else unknown}

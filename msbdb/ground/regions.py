"""What regions are as a whole: halls among the ground are buildings; terraces, ramps and bridges above it are terrain.

Walls bound a hall nearly all around, also where the progressive filter is sure of its roof: one wider than its windows,
or cut by the border of the survey. A lower part of a roof lies far above the terrain around. Terrain is reached by a
way, and a bridge meets the ground at both ends.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msbdb.grid import Grid
from msbdb.ground.interpolation import interpolate_ground
from msbdb.labels import chosen_cells, join_cells, label_zones, neighbours, sizes, sums
from msbdb.morphology.windows import dilation, erosion
from msbdb.params import GroundParams

Heights = NDArray[np.float32]
Mask = NDArray[np.bool_]
Numbers = NDArray[Any]

HALL_M = 4.0
"""Ours: least mean depth of the walls of a hall that the border cuts, and least rise of a lower part of a roof above
the terrain around the building: retaining walls are lower."""

STEP_M = 2.0
"""Ours: a roof falls by as much at once, the height of the mask; steep flanks of knolls fall in lower steps."""

BARE = 0.25
"""Ours: higher things stand on a plateau along more than this share of its edge; a hall carries lanterns and plant."""

HOUSE_M2 = 500.0
"""Ours: what is larger and stands on a hall is a higher part of it; houses and crowns are smaller."""

CUT, SIDE = 0.55, 1 / 3
"""Ours: largest shares of the border in the edge of such a hall: two sides of a square and a little more; one side."""

STEPS = 4
"""Ours: so many treads of a hillside are found, one after the other."""

LEAST_M2 = 50.0
"""No way is sought to smaller regions: clutter, and the cells of walls. Nor does one begin on less even ground."""

BEGINNING, BEGINNING_M2 = 0.3, 150.0
"""Ours, in sample: share or area of a way that is ground already; of a roof whose rear meets a bank 0.2, or 100 m²."""

WAY_PX = 3
"""Width of a way, cells."""

DECK_M = 7.0
"""Ours: mean width up to which a bridge may be too narrow for a way of three cells of 1 m, at any angle."""

SLENDER = 5.0
"""Ours: a bridge is at least so many times as long as it is wide."""

END = 0.15
"""Ours: what counts as an end of a bridge, a share of its length."""

MEETS = 2
"""Ours: an end of a bridge meets the ground with a step below so many even ones, as few points show it roughly."""

MET = 0.5
"""Ours, in sample: share of its mean width along which a bridge meets the ground at an end. A bush at the end of a roof
is narrower."""

HIDDEN = 1 / 3
"""Ours: other things above ground are beside a bridge along at most this share of its edge; of annexes 0.4 and 0.55."""


def halls(surface: Grid, ground: Mask, raised: Mask, wall_m: float, params: GroundParams) -> Mask:
    """Return the ground within halls: wider than the windows of the progressive filter, or cut by the border.

    A region of what is raised is a hall if it falls by walls nearly all around. Half of these fall by `STEP_M` at once,
    as those of knolls with steep flanks do not. A hall is bare, as a plateau carries houses and trees. What looks up at
    walls nearly all around is a yard.

    If the border cuts the region, the part of its edge that is seen decides. This falls deeper than terraces do, on
    average. The border is at most `CUT` of the edge, two sides of a corner; if it is more than `SIDE`, the region is
    the smaller part of the place, too.

    Parameters
    ----------
    surface : Grid
        Lowest heights without clutter, gap-free, metres; cells that are not valid are a void.
    ground : (H, W) ndarray of bool
        The ground so far.
    raised : (H, W) ndarray of bool
        Cells that are above ground by their edges, also where the progressive filter is sure of them.
    wall_m : float
        The step from which a pair of cells is a wall, metres.
    params : GroundParams
        ``podium_share``, for nearly all.

    Returns
    -------
    (H, W) ndarray of bool
        Cells that are no ground.
    """
    heights, measured, cell_m2 = np.asarray(surface.values), surface.valid, surface.spec.cell_area_m2
    doubtful, known = ground & raised, raised & ~ground
    regions, count = label_zones(raised)
    possible = sizes(regions[doubtful], count) * cell_m2 >= LEAST_M2
    if not possible.any():
        return np.zeros_like(ground)
    chosen = np.concatenate([[False], possible])
    own, there, fall = edges_of(heights, regions, chosen)
    seen = measured.ravel()[there]
    falls = seen & (fall >= wall_m)
    edges, walls = sizes(own[seen], count), sizes(own[falls], count)
    depth_m = np.bincount(own[falls], weights=fall[falls], minlength=count + 1)[1:]
    at_once = sizes(own[falls & (fall >= STEP_M * max(surface.spec.cell_m, 1.0))], count)
    # What is next to a void goes on into it, as over the border.
    outside = own[~seen], regions[0], regions[-1], regions[:, 0], regions[:, -1]
    cut = sizes(np.concatenate(outside), count)
    share = cut / np.maximum(edges + cut, 1)
    things, number = join_cells(heights, known, wall_m)
    small = np.bincount(things[known], minlength=number) * cell_m2 < HOUSE_M2
    own, there, fall = edges_of(heights, np.where(doubtful, regions, 0), chosen)
    higher = known.ravel()[there] & (fall <= -wall_m)
    of_doubtful = sizes(own[measured.ravel()[there]], count)
    looks_up, carries = sizes(own[higher], count), sizes(own[higher & small[things.ravel()[there]]], count)
    walled = (walls >= np.maximum(params.podium_share * edges, 1)) & (2 * at_once >= walls)
    bare, yard = carries <= BARE * edges, looks_up >= params.podium_share * of_doubtful
    high = (cut == 0) | (depth_m >= HALL_M * walls)
    is_seen = (share <= SIDE) | ((share <= CUT) & (2 * sizes(regions, count) <= np.count_nonzero(measured)))
    return doubtful & chosen_cells(regions, possible & walled & bare & ~yard & high & is_seen)


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


def beside_voids(measured: Mask) -> Mask:
    """Return the cells beside the border of the lattice, or beside a void.

    Parameters
    ----------
    measured : (H, W) ndarray of bool
        Where no void is.

    Returns
    -------
    (H, W) ndarray of bool
    """
    outside = ~np.pad(measured, 1)
    beside: Mask = outside[:-2, 1:-1] | outside[2:, 1:-1] | outside[1:-1, :-2] | outside[1:-1, 2:]
    return beside


def sunk_roofs(surface: Grid, ground: Mask) -> Mask:
    """Return the regions of ground that other parts of a roof surround, far above the terrain around the building.

    The street enters no such region, so that it is a court or a lower part of a roof. A court lies on the terrain of
    the other ground, or not `HALL_M` above it.

    Parameters
    ----------
    surface : Grid
        Lowest heights, gap-free, metres; cells that are not valid are a void.
    ground : (H, W) ndarray of bool
        The ground so far.

    Returns
    -------
    (H, W) ndarray of bool
        Cells that are no ground. Border and nodata: a region that the border or a void cuts is none of these, nor is
        the largest one.
    """
    regions, count = label_zones(ground)
    cells = sizes(regions, count)
    closed = (sizes(regions[ground & beside_voids(surface.valid)], count) == 0) & (cells < cells.max(initial=0))
    others = ground & ~chosen_cells(regions, closed)
    if not closed.any() or not others.any():
        return np.zeros_like(ground)
    heights = np.asarray(surface.values, dtype=np.float32)
    terrain = np.asarray(interpolate_ground(heights, others, surface.spec).values)
    rise = heights - terrain - HALL_M
    return chosen_cells(regions, closed & (sums(regions, rise, count) > 0))


def reached_by_ways(surface: Grid, trend: Heights, ground: Mask, wall_m: float, params: GroundParams) -> Mask:
    """Return the cells above ground that a way from the ground leads to, and the regions that are mostly ways.

    A way is even. Where the trend is too steep for that, a way may follow the trend. No way is partly even and partly
    follows the trend, because a level roof may touch the slope.

    Parameters
    ----------
    surface : Grid
        Lowest heights, gap-free, metres; cells that are not valid are a void.
    trend : (H, W) ndarray of float32
        The trend of the terrain, metres.
    ground : (H, W) ndarray of bool
        The ground so far.
    wall_m : float
        The step from which two cells belong to different regions, metres.
    params : GroundParams
        ``even_step_m`` and ``reached_share``.

    Returns
    -------
    (H, W) ndarray of bool
        Cells that are ground, too. Border: the outermost cell is repeated. Nodata: no way crosses a void.
    """
    heights, measured, cell_m = np.asarray(surface.values, dtype=np.float32), surface.valid, surface.spec.cell_m
    most_m = (WAY_PX - 1) * _even_m(cell_m, params)

    def rise(of: Heights) -> Heights:
        return dilation(of, WAY_PX, measured) - erosion(of, WAY_PX, measured)

    on_ways = np.zeros_like(ground)
    for even in (rise(heights) < most_m, (rise(heights - trend) < most_m) & (rise(trend) >= most_m)):
        ways, count = label_zones(measured & even)
        of_ground = sizes(ways[ground], count)
        begun = (of_ground * cell_m**2 >= LEAST_M2) & (of_ground >= BEGINNING * sizes(ways, count))
        on_ways |= chosen_cells(ways, begun | (of_ground * cell_m**2 >= BEGINNING_M2))
    reached = dilation((on_ways & ~ground).astype(np.float32), WAY_PX, None) > 0
    regions, count = join_cells(heights, measured & ~ground, wall_m)
    cells, of_them = (np.bincount(regions.ravel(), weights=each, minlength=count) for each in (None, reached.ravel()))
    mostly, large = of_them >= params.reached_share * cells, cells * cell_m**2 >= LEAST_M2
    terrain: Mask = measured & ~ground & large[regions] & (reached | mostly[regions])
    return terrain


def with_narrow_bridges(surface: Grid, ground: Mask, wall_m: float, params: GroundParams) -> Mask:
    """Return the ground with the decks of bridges that are too narrow for a way of three cells.

    A bridge is a slender region above ground whose sides are mostly free. At both of its ends ground of `BEGINNING_M2`
    is as high as itself along `MET` of its width, and hardly anywhere else. The border of the survey may cut one of the
    ends. A house whose rear lies on a slope touches it along a side or at one end. Cells in which echoes came from
    below the deck are closed, so that they do not divide it. They are no ground then: the deck covers them.

    Parameters
    ----------
    surface : Grid
        Lowest heights, gap-free, metres; cells that are not valid are a void.
    ground : (H, W) ndarray of bool
        The ground so far.
    wall_m : float
        The step from which two cells belong to different regions, metres.
    params : GroundParams
        ``even_step_m``.

    Returns
    -------
    (H, W) ndarray of bool
        The ground. Border and nodata: what the border or a void cuts at both ends stays above ground.

    Examples
    --------
    A deck of 40 m by 3 m spans a cutting of 4 m, from one bank to the other; a wall beside it ends in the cutting:

    >>> from pyproj import CRS
    >>> from msbdb.grid import lattice
    >>> heights = np.full((60, 30), 4.0, dtype=np.float32)
    >>> heights[10:50] = 0
    >>> ground = np.ones((60, 30), dtype=bool)
    >>> for cols, rows in ((slice(5, 8), slice(10, 50)), (slice(20, 23), slice(10, 45))):
    ...     heights[rows, cols], ground[rows, cols] = 4, False
    >>> grid = Grid(heights, np.ones((60, 30), dtype=bool), lattice((0, 0, 29, 59), 1.0, CRS.from_epsg(2154)))
    >>> found = with_narrow_bridges(grid, ground, 1.0, GroundParams()) & ~ground
    >>> int(found[:, 5:8].sum()), int(found[:, 20:23].sum())
    (120, 0)
    """
    cell_m, measured = surface.spec.cell_m, surface.valid
    lowest = np.asarray(surface.values, dtype=np.float32)
    heights = erosion(dilation(lowest, WAY_PX, measured), WAY_PX, measured)
    closed = measured & (~ground | (heights - lowest > wall_m))
    regions, count = join_cells(heights, closed, wall_m)
    cells = np.bincount(regions[closed], minlength=count)
    row, col = np.nonzero(closed & (cells * cell_m**2 >= LEAST_M2)[regions])
    if not len(row):
        return ground
    axis = _Axis.of(regions[row, col], row, col, count)
    width = cells / axis.length
    slender = (cells > 0) & (width * cell_m <= DECK_M) & (axis.length >= SLENDER * width)
    if not slender.any():
        return ground
    chosen = np.where(slender[regions], regions, -1)
    spanning = _spanning(chosen, (axis,), heights, surface, ground, wall_m=wall_m, params=params)
    decks, seen_below = (slender & spanning)[regions] & measured, heights - lowest > wall_m
    with_decks: Mask = (ground | decks) & ~(decks & seen_below)
    return with_decks


def bridges(surface: Grid, terrain: Heights, ground: Mask, wall_m: float, params: GroundParams) -> Mask:
    """Return the decks of bridges above a ground that is known.

    They are narrow bridges (`with_narrow_bridges`), and wider ones: what ways lead to from both ends. A roof or a stand
    of seats that meets the ground along one side is no bridge.

    Parameters
    ----------
    surface : Grid
        Lowest heights, gap-free, metres; cells that are not valid are a void.
    terrain : (H, W) ndarray of float32
        The known ground, also below decks, metres.
    ground : (H, W) ndarray of bool
        Where the surface is the ground.
    wall_m : float
        The step from which two cells belong to different regions, metres.
    params : GroundParams
        ``even_step_m`` and ``reached_share``.

    Returns
    -------
    (H, W) ndarray of bool
        Border and nodata: as those of `with_narrow_bridges`.
    """
    decks: Mask = with_narrow_bridges(surface, ground, wall_m, params) & ~ground
    zones, count = label_zones(reached_by_ways(surface, terrain, ground, wall_m, params) & ~decks)
    if not count:
        return decks
    row, col = np.nonzero(zones)
    axes = tuple(_Axis.of(zones[row, col], row, col, count + 1, turned) for turned in (0.0, np.pi / 2))
    heights, chosen = np.asarray(surface.values), np.where(zones > 0, zones, -1)
    spanning = _spanning(chosen, axes, heights, surface, ground, wall_m=wall_m, params=params)
    return decks | chosen_cells(zones, spanning[1:])


def _spanning(
    regions: NDArray[Any],
    axes: tuple["_Axis", ...],
    heights: Heights,
    surface: Grid,
    ground: Mask,
    *,
    wall_m: float,
    params: GroundParams,
) -> NDArray[np.bool_]:
    """Return which regions meet the ground at both ends of one of their axes, or at one where the other is cut.

    ``regions`` are numbered from 0, with -1 elsewhere; ``heights`` are those of their decks. Ground of `BEGINNING_M2`
    counts, along `MET` of the width. Other things above ground may be beside a region along `HIDDEN` of its edge.
    """
    lowest, measured = np.asarray(surface.values, dtype=np.float32), surface.valid
    pieces, number = join_cells(lowest, measured & ground, wall_m)
    large = np.bincount(pieces.ravel(), minlength=number) * surface.spec.cell_area_m2 >= BEGINNING_M2
    banks, most_m = ground & large[pieces], MEETS * _even_m(surface.spec.cell_m, params)
    count = len(axes[0].row)
    touches, edges, hidden = np.zeros_like(ground), np.zeros(count), np.zeros(count)
    for one, other in neighbours(heights.shape):
        for here, there in ((one, other), (other, one)):
            at = (regions[here] >= 0) & (regions[here] != regions[there])
            edges += np.bincount(regions[here][at], minlength=count)
            hidden += np.bincount(regions[here][at & ~ground[there]], minlength=count)
            touches[here] |= at & banks[there] & (np.abs(heights[here] - lowest[there]) < most_m)
    cut, spanning = beside_voids(measured) & (regions >= 0), np.zeros(count, dtype=np.bool_)
    for axis in axes:
        head, tail, sides = axis.count(touches, regions)
        head_cut, tail_cut, _ = axis.count(cut, regions)
        least = MET * np.bincount(regions[regions >= 0], minlength=count) / axis.length
        at_head, at_tail = head >= least, tail >= least
        met = (at_head & (at_tail | (tail_cut > 0))) | (at_tail & (head_cut > 0))
        spanning |= met & (2 * sides <= head + tail)
    return spanning & (hidden <= HIDDEN * edges)


@dataclass(frozen=True)
class _Axis:
    """The axes of regions: the directions along which their cells scatter most."""

    row: Numbers
    col: Numbers
    angle: Numbers
    first: Numbers
    length: Numbers

    @classmethod
    def of(cls, own: NDArray[np.int32], row: Numbers, col: Numbers, count: int, turned: float = 0.0) -> "_Axis":
        """Measure ``count`` regions by the places of their cells; one without any has a length of 1.

        The axes may be ``turned`` by an angle.
        """
        cells = np.maximum(np.bincount(own, minlength=count), 1)
        rows, cols = (np.bincount(own, weights=place, minlength=count) / cells for place in (row, col))
        across, along = row - rows[own], col - cols[own]
        squares = (across * across - along * along, 2 * across * along)
        less, twice = (np.bincount(own, weights=part, minlength=count) for part in squares)
        angle = np.arctan2(twice, less) / 2 + turned
        place = across * np.cos(angle[own]) + along * np.sin(angle[own])
        first, last = np.zeros(count), np.zeros(count)
        np.minimum.at(first, own, place)
        np.maximum.at(last, own, place)
        return cls(rows, cols, angle, first, last - first + 1)

    def count(self, chosen: Mask, regions: NDArray[np.int32]) -> tuple[Numbers, Numbers, Numbers]:
        """Return how many of the chosen cells lie at one end of each region, at the other, and between them."""
        row, col = np.nonzero(chosen)
        own = regions[row, col]
        across, along = row - self.row[own], col - self.col[own]
        place = across * np.cos(self.angle[own]) + along * np.sin(self.angle[own])
        share = (place - self.first[own]) / self.length[own]
        head, tail = (np.bincount(own[at], minlength=len(self.row)) for at in (share < END, share > 1 - END))
        return head, tail, np.bincount(own, minlength=len(self.row)) - head - tail


def _even_m(cell_m: float, params: GroundParams) -> float:
    """Return the step up to which neighbours are even, metres; between cells above 1 m it is larger in proportion."""
    return params.even_step_m * max(cell_m, 1.0)

"""Plants that the detectors took for roofs: rough and green objects, hedges, domes, scrub, what leans on a house."""

from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median, uniform_filter

from msbdb.fuse.domes import COARSE_M, single_crowns
from msbdb.fuse.probability import HOUSE_M2, building_probability
from msbdb.fuse.roofplanes import measure_edges
from msbdb.grid import Grid
from msbdb.labels import Labels, by_three, chosen_cells, label_zones, sizes, sums
from msbdb.morphology.windows import dilation
from msbdb.params import FuseParams
from msbdb.surface.texture import NO_PLANE_M, grid_samples, scatter
from msbdb.threads import in_threads

Mask = NDArray[np.bool_]
Field = NDArray[np.float32]

MOST = 0.5
"""An object is smooth where this share of its cells is."""

SOME = 0.1
"""A large object with a smaller smooth share may still be a group of crowns: roofs that were lost have 0.2 to 0.5.
A small one with a smaller even share and little support is a crown on cells above `FINE_M`."""

HARDLY = 0.2
"""Ours, in sample: an object with a smaller smooth share is rough throughout, unless most of it is nearly smooth."""

FINE_M = 0.75
"""Ours, in sample: on larger cells, those of fewer than 2 points/m², narrow roofs are as rough as crowns."""

GROUP_M2, KNOWN = 100.0, 0.85
"""Ours, in sample: there an object of this area is no narrow roof, but may be a group or a row of crowns, if planes
were fitted to this share of it. Blocks with noise in plan have fewer."""

CLEARLY = 0.77
"""Ours, in sample: a roof that is rough throughout beside the even ground, or hardly even, has more mean support than
this. Crowns have 0.75 at most, three of four detectors."""

LOW_M = 6.0
"""Ours, in sample: half of a low object lies below this height above ground, as of houses of two storeys at most."""

NEARLY_ALL = 0.875
"""Ours, in sample: nearly all detectors take an object of this mean support: half a vote of four is lacking."""

LEAST_INNER = 12
"""Ours, in sample: with fewer inner cells than these the roughness of a low object is chance."""

STOREY_M = 4.0
"""Ours: half of what has one storey lies below this height above ground."""

SCRUB, SCRUB_GROUP, SCRUB_BESIDE = 0.4, 0.6, 0.3
"""Ours, in sample: scrub has a smaller even share of its inner cells: an object, one of `GROUP_M2`, and a part."""

LARGEST_CELL_M = 1.5
"""Ours, in sample: on larger cells low houses are as rough as crowns."""

BARE_M = 0.5
"""Ours: cells up to this height show how rough even surfaces of the survey are."""

AROUND_M = 30.0
"""Ours: the side of the square whose bare cells count, wider than most houses."""

LEAST_M = 0.001
"""The least roughness that counts, a millimetre."""

NOISE = 3.0
"""Ours, in sample: a cell that is rougher than so many times the bare cells around it is no even surface."""

NEARLY = ((0.5, 2.0), (0.75, 4.0))
"""Ours, in sample: an object is nearly smooth where one of these shares of it is within so many times the limit."""

AVERAGED = 0.85
"""Ours, in sample: it is noise where means of 3 by 3 cells scatter by less than this share of the roughness."""

WINDOW_PX = 5
"""Ours: side of the window in which means of cells scatter, cells."""

DENIED = 0.6
"""Ours, in sample: what leans on a house and has more support than this mean share stays; half of the votes are 0.5."""

BESIDE = 0.45
"""Ours, in sample: what has a larger share of its edge at buildings stands among them, as annexes in courts do."""

LEANING_M2 = 400.0
"""Ours, in sample: a larger piece is no crown, nor a row of them. On cells above 1 m most larger ones are wings."""

CELL_POWER = 1.5
"""Ours, in sample: above 1 m the limit of smoothness grows by this power of the cell, as windows span several roofs."""

STEPPED = 0.4
"""Ours, in sample: what is flush with the house along a larger share of the edge at it may be a part of its roof."""

EVEN, BARE = 1.5, 2.0
"""Ours, in sample: a cell of a crown is even up to so many times the limit of smoothness, or up to so many times the
roughness of the bare cells around it that have bare neighbours alone."""


def smooth_limit(params: FuseParams, cell_m: float) -> float:
    """Return the roughness up to which a cell is smooth, metres.

    Parameters
    ----------
    params : FuseParams
        ``smooth_m``: the limit on cells of up to 1 m; on larger cells it grows.
    cell_m : float
        Side of a cell, metres.

    Returns
    -------
    float

    Examples
    --------
    >>> [round(smooth_limit(FuseParams(smooth_m=0.06), cell_m), 2) for cell_m in (0.5, 1.0, 2.0)]
    [0.06, 0.06, 0.17]
    """
    return float(params.smooth_m * max(1.0, cell_m) ** CELL_POWER)


def without_crowns(
    decided: Mask, share: Field, roughness_m: Field, params: FuseParams, *, clear: float, cell_m: float
) -> Mask:
    """Drop the objects that hardly enough detectors support for their area, and that are mostly rough.

    Detectors of one kind share their errors: two that look at the surface take the same dense crown for a roof. A roof
    that two others miss, by its size or its echoes, is still smooth, or larger than crowns are.

    Parameters
    ----------
    decided : (H, W) ndarray of bool
        Cells of buildings; objects are 8-connected.
    share : (H, W) ndarray of float32
        Share of the detectors that take a cell for building.
    roughness_m : (H, W) ndarray of float32, metres
        Residual of the best plane in the small window.
    params : FuseParams
        ``smooth_m``: cells of at most this roughness are smooth (`smooth_limit`); and the odds of a building by support
        and area (`msbdb.fuse.probability.building_probability`).
    clear : float
        Objects of 50 m² with this mean share stay, and larger ones with a smaller share of the same odds, if a tenth of
        them is smooth.
    cell_m : float
        Side of a cell, metres.

    Returns
    -------
    (H, W) ndarray of bool

    Examples
    --------
    Of two objects with two votes of four, the rough one goes:

    >>> decided = np.array([[True, True, False, True, True]])
    >>> rough = np.float32([[0.02, 0.03, 1, 0.2, 0.1]])
    >>> without_crowns(decided, decided / 2, rough, FuseParams(), clear=0.625, cell_m=1.0).astype(int)
    array([[1, 1, 0, 0, 0]])
    """
    labels, count = label_zones(decided)
    area = sizes(labels, count)
    support = sums(labels, share, count) / area
    smooth = _share_of_known(labels, count, roughness_m <= smooth_limit(params, cell_m), roughness_m, unknown=MOST)
    # Smaller objects than a house need no more support than it: their smoothness decides.
    area_m2 = np.where(smooth >= SOME, np.maximum(area * cell_m**2, HOUSE_M2), HOUSE_M2)
    enough = building_probability(np.array([clear]), np.array([HOUSE_M2]), params)
    doubtful = building_probability(support, area_m2, params) < enough
    return decided & ~chosen_cells(labels, doubtful & (smooth < MOST))


def without_rough(decided: Mask, share: Field, roughness_m: Field, heights: Grid, params: FuseParams) -> Mask:
    """Drop the objects that are rough nearly throughout, whatever supports them: hedges, crowns and groups of crowns.

    Rough is what exceeds both the noise of a scanner and that of the bare cells around it. So a noisy survey, or two
    strips that do not fit, make no roof rough. An object stays where half of it is within twice that limit, as roofs of
    many small planes are. Nor does an object go that is even but for noise: where strips do not fit in plan, echoes of
    steep roofs scatter, and those of level ground do not. Such noise is much the same all over a roof, and
    three quarters of it are within four times the limit; more of a crown is rougher. Means of 3 by 3 cells have a third
    of such noise, and all of a crown's relief. On cells larger than `FINE_M` only objects of `GROUP_M2` and more are
    dropped so, where planes are known for `KNOWN` of them. Their inner cells alone are judged: windows at an edge lie
    half on the ground. There an object of a mean support of up to `CLEARLY` goes, too, if it is rough compared with the
    bare cells that have bare neighbours alone. On cells larger than `COARSE_M` none of this is done.

    Low objects have a second, stricter limit, on cells of up to `LARGEST_CELL_M`. Blocks of old towns are rough and
    high, and houses of one or two storeys have simple roofs. So the inner cells of a low object that not nearly all
    detectors take are compared with the bare cells with bare neighbours alone, and its means are not asked.

    On cells of up to `COARSE_M` single crowns are dropped by their shape, too (`msbdb.fuse.domes`): little of them is
    even, and they are domes. Rough roofs of old towns are saddles, or have steps. A hipped roof falls off to all sides,
    but more of it is even.

    On cells larger than `FINE_M`, and up to `LARGEST_CELL_M`, an object of a mean support of up to `CLEARLY` goes if
    less than `SOME` of it is even. Small roofs that one detector refuses have more. Of an object of `GROUP_M2` and more
    less than `HARDLY` must be even, and on cells larger than `COARSE_M` it stays, as blocks are as rough there.

    What has one storey has a simple roof, so that scrub and crops go though detectors support them, on cells of up to
    `COARSE_M`. Such an object goes if less than `SCRUB` of its inner cells is even, or less than `SCRUB_GROUP` from
    `GROUP_M2` on if not nearly all detectors take it. What is higher in it and even stays, a house among plants. The
    part of an object that is lower than `STOREY_M` goes, too, if less than `SCRUB_BESIDE` is even, from the area of a
    house on, and from `GROUP_M2` on whatever supports it.

    Parameters
    ----------
    decided : (H, W) ndarray of bool
        Cells of buildings; objects are 8-connected.
    share : (H, W) ndarray of float32
        Share of the detectors that take a cell for building.
    roughness_m : (H, W) ndarray of float32, metres
        Residual of the best plane in the small window; `msbdb.surface.texture.NO_PLANE_M` where it is not known.
    heights : Grid
        Heights above ground, metres.
    params : FuseParams
        ``smooth_m``.

    Returns
    -------
    (H, W) ndarray of bool

    Notes
    -----
    The roughness of bare cells is their geometric mean in a square of `AROUND_M`; without any, the noise of a scanner
    alone counts. For single crowns, low objects and those of little support on coarse cells, the bare cells with bare
    neighbours alone count, as others are rough by the crowns beside them. Otherwise all bare cells count: without those
    beside raised cells, blocks with noise in plan were lost. Border: the square ends at the lattice, and an object that
    it cuts is judged by what is left of it. Nodata: invalid cells are no buildings.

    Examples
    --------
    Two objects on even ground, one of them a hedge:

    >>> from pyproj import CRS
    >>> from msbdb.grid import lattice
    >>> spec = lattice((0, 0.1, 2.4, 0.4), 0.5, CRS.from_epsg(2154))
    >>> heights = Grid(np.float32([[4, 4, 0, 4, 4]]), np.ones((1, 5), dtype=bool), spec)
    >>> rough, decided = np.float32([[0.02, 0.03, 0.02, 0.3, 0.2]]), np.asarray(heights.values) > 2
    >>> without_rough(decided, np.float32(decided), rough, heights, FuseParams()).astype(int)
    array([[1, 1, 0, 0, 0]])
    """
    cell_m = heights.spec.cell_m
    labels, count = label_zones(decided)
    if cell_m > LARGEST_CELL_M or not count:
        return decided
    bare = heights.valid & (np.asarray(heights.values) < BARE_M)
    around_m = partial(_mean_roughness, roughness_m=roughness_m, side=2 * round(AROUND_M / cell_m / 2) + 1)
    # Bare cells beside raised ones show noise in plan, but beside crowns they are rough by the crowns.
    noise_m, even_m = in_threads(around_m, (bare, by_three(np.logical_and, bare)))
    inner = by_three(np.logical_and, decided, beyond=np.False_)
    throughout = partial(_rough_throughout, labels, count, roughness_m=roughness_m, params=params)
    cells = sizes(labels, count)
    low = _low(labels, count, inner, heights, LOW_M) & (sums(labels, share, count) < NEARLY_ALL * cells)
    low &= throughout(inner, even_m)
    even = roughness_m <= np.maximum(EVEN * params.smooth_m, BARE * even_m)
    even_share = _share_of_known(labels, count, even, roughness_m, unknown=1.0)
    grouped = cells * heights.spec.cell_area_m2 >= GROUP_M2
    doubted = sums(labels, share, count) <= CLEARLY * cells
    crowns, rough = low, np.zeros(count, dtype=np.bool_)
    if cell_m <= COARSE_M:
        crowns = crowns | single_crowns(labels, even_share, heights)
    if cell_m <= FINE_M:
        rough = throughout(decided, noise_m)
    else:
        most = HARDLY if cell_m <= COARSE_M else 0.0
        crowns = crowns | doubted & (even_share < np.where(grouped, most, SOME))
    if FINE_M < cell_m <= COARSE_M:
        known = sizes(labels[decided & (roughness_m < NO_PLANE_M)], count) >= KNOWN * cells
        rough = grouped & known & (throughout(inner, noise_m) | doubted & throughout(inner, even_m))
    rough = chosen_cells(labels, rough)
    left = decided & ~chosen_cells(labels, crowns) & ~(rough & ~_only_noisy(rough, roughness_m, heights))
    return left & ~_scrub(left, share, even, roughness_m, heights) if cell_m <= COARSE_M else left


def _rough_throughout(
    labels: Labels, count: int, cells: Mask, bare_m: NDArray[np.float64], *, roughness_m: Field, params: FuseParams
) -> Mask:
    """Return the objects of which hardly a cell is as even as the bare ones around, and too few are nearly so."""
    own, own_m = labels[cells], roughness_m[cells]
    limit_m = np.maximum(params.smooth_m, NOISE * bare_m[cells])
    rough = np.ones(count, dtype=np.bool_)
    for share, times in ((HARDLY, 1.0), *NEARLY):
        rough &= _share_of_known(own, count, own_m <= times * limit_m, own_m, unknown=1.0) < share
    return rough


def _low(labels: Labels, count: int, inner: Mask, heights: Grid, limit_m: float) -> Mask:
    """Return the objects of which half lies below a height above ground, and that have `LEAST_INNER` inner cells."""
    inside = labels > 0
    middle_m = np.asarray(median(np.asarray(heights.values)[inside], labels[inside], np.arange(1, count + 1)))
    low: Mask = (middle_m < limit_m) & (sizes(labels[inner], count) >= LEAST_INNER)
    return low


def _scrub(decided: Mask, share: Field, even: Mask, roughness_m: Field, heights: Grid) -> Mask:
    """Return the cells of plants lower than a storey: objects, but for the houses among them, and parts of others."""
    even_of = partial(_share_of_known, smooth=even, roughness_m=roughness_m)
    high = np.asarray(heights.values) >= STOREY_M
    labels, count = label_zones(decided)
    if not count:
        return decided
    cells = sizes(labels, count)
    grouped = (cells * heights.spec.cell_area_m2 >= GROUP_M2) & (sums(labels, share, count) < NEARLY_ALL * cells)
    core = by_three(np.logical_and, decided, beyond=np.False_)
    scrub = even_of(labels * core, count, unknown=1.0) < np.where(grouped, SCRUB_GROUP, SCRUB)
    plants = chosen_cells(labels, scrub & _low(labels, count, core, heights, STOREY_M))
    houses, count = label_zones(_opened(plants & high), connectivity=4)
    plants &= ~chosen_cells(houses, even_of(houses, count, unknown=0.0) >= MOST)
    beside = _opened(decided & ~plants & ~high)
    parts, count = label_zones(beside, connectivity=4)
    cells, core = sizes(parts, count), by_three(np.logical_and, beside, beyond=np.False_)
    doubted = sums(parts, share, count) <= CLEARLY * cells
    large = cells * heights.spec.cell_area_m2 >= np.where(doubted, HOUSE_M2, GROUP_M2)
    return plants | chosen_cells(parts, large & (even_of(parts * core, count, unknown=1.0) < SCRUB_BESIDE))


def _mean_roughness(cells: Mask, *, roughness_m: Field, side: int) -> NDArray[np.float64]:
    """Return the geometric mean of the known roughness of some cells in a square around each cell; 0 without any."""
    cells = cells & (roughness_m < NO_PLANE_M)
    logs = np.zeros(cells.shape)
    logs[cells] = np.log(np.maximum(roughness_m[cells], LEAST_M).astype(np.float64))
    weight, log = (uniform_filter(part, size=side, mode="constant") for part in (cells.astype(np.float64), logs))
    # Less than one cell in the square leaves what rounding has left.
    mean: NDArray[np.float64] = np.where(weight * side**2 > 0.5, np.exp(log / np.maximum(weight, 1 / side**2)), 0.0)
    return mean


def _only_noisy(rough: Mask, roughness_m: Field, heights: Grid) -> Mask:
    """Return the objects whose heights are even once they are averaged."""
    labels, count = label_zones(rough)
    if not count:
        return rough
    inside = rough.astype(np.float32)
    total = uniform_filter(inside * np.asarray(heights.values, dtype=np.float32), 3, mode="constant")
    mean = np.divide(total, uniform_filter(inside, 3, mode="constant"), out=np.zeros_like(total), where=rough)
    spec = heights.spec
    scattered = scatter(grid_samples(Grid(mean, rough, spec)), WINDOW_PX * spec.cell_m)
    known = np.where((scattered < NO_PLANE_M) & (roughness_m < NO_PLANE_M), labels, 0)
    numbers = np.arange(1, count + 1)
    averaged, of_cells = (median(part[rough], known[rough], numbers) for part in (scattered, roughness_m))
    return chosen_cells(labels, averaged < AVERAGED * of_cells)


def _share_of_known(
    labels: Labels, count: int, smooth: Mask, roughness_m: Field, *, unknown: float
) -> NDArray[np.float64]:
    """Return the smooth share of each object's cells of known roughness; ``unknown`` at least if most are unknown."""
    known = roughness_m < NO_PLANE_M
    cells = sizes(labels[known], count)
    share = sizes(labels[known & smooth], count) / np.maximum(cells, 1)
    every = sizes(labels, count)
    enough = (every > 0) & (cells >= MOST * every)
    found: NDArray[np.float64] = np.where(enough, share, np.maximum(share, unknown))
    return found


def without_green(
    decided: Mask, multiscale: Mask, green: Mask, roughness_m: Field, params: FuseParams, *, cell_m: float
) -> Mask:
    """Drop the objects that are mostly green and rough, and that the multi-scale detector does not take at all.

    It alone looks at colours. The others look at shape, and take the same dense row of trees for a roof.

    Parameters
    ----------
    decided : (H, W) ndarray of bool
        Cells of buildings; objects are 8-connected.
    multiscale : (H, W) ndarray of bool
        Cells that the multi-scale detector takes; less than a tenth of a dropped object.
    green : (H, W) ndarray of bool
        Cells of the colour of vegetation; at least half of a dropped object.
    roughness_m : (H, W) ndarray of float32, metres
        Residual of the best plane in the small window.
    params : FuseParams
        ``smooth_m``: as for `without_crowns`; less than half of a dropped object's known cells is smooth. ``piece_m2``:
        a smooth part of another colour, of at least this area, stays. It is a house that the trees touch.
    cell_m : float
        Side of a cell, metres.

    Returns
    -------
    (H, W) ndarray of bool

    Examples
    --------
    Of two green objects, the smooth one is a planted roof:

    >>> decided = np.array([[True, True, False, True, True]])
    >>> rough = np.float32([[0.02, 0.03, 1, 0.2, 0.3]])
    >>> without_green(decided, ~decided, decided, rough, FuseParams(), cell_m=1.0).astype(int)
    array([[1, 1, 0, 0, 0]])
    """
    labels, count = label_zones(decided)
    area = sizes(labels, count)
    smooth = roughness_m <= smooth_limit(params, cell_m)
    denied = (
        (sizes(labels[multiscale], count) < SOME * area)
        & (sizes(labels[green], count) >= MOST * area)
        & (_share_of_known(labels, count, smooth, roughness_m, unknown=MOST) < MOST)
    )
    trees = chosen_cells(labels, denied)
    parts, count = label_zones(_opened(trees & ~green))
    area = sizes(parts, count)
    houses = (area * cell_m**2 >= params.piece_m2) & (sizes(parts[smooth], count) >= MOST * area)
    return decided & ~trees | chosen_cells(parts, houses)


def without_leaning_crowns(
    decided: Mask, share: Field, roughness_m: Field, heights: Grid, params: FuseParams, *, limit_m: float
) -> Mask:
    """Drop the pieces of objects that are crowns beside a house: their own evidence is poor.

    A piece is what is left of an object without the house, the cells that all detectors take, and without the cells
    beside these. It goes if all of this holds. Hardly more than half of the detectors take it. It is hardly smooth. It
    is seldom flush with the house, and free on most of its edge. It is not larger than crowns are. An annex fails one
    of these. A dome goes, too, whatever supports it and however long its edge at the house is (`without_rough`).

    Parameters
    ----------
    decided : (H, W) ndarray of bool
        Cells of buildings; objects are 8-connected, pieces 4-connected.
    share : (H, W) ndarray of float32
        Share of the detectors that take a cell for building.
    roughness_m : (H, W) ndarray of float32, metres
        Residual of the best plane in the small window; `msbdb.surface.texture.NO_PLANE_M` where it is not known.
    heights : Grid
        Heights above ground, metres.
    params : FuseParams
        ``flush_m``; pieces smaller than ``piece_m2`` stay, as do those larger than `LEANING_M2`.
    limit_m : float
        Cells up to this roughness are smooth, metres.

    Returns
    -------
    (H, W) ndarray of bool

    Notes
    -----
    Border: pairs end at the lattice. Nodata: invalid cells are no buildings. Linear in the cells.

    Examples
    --------
    Beside a house that all take, a rough piece that half of them take, 2 m lower:

    >>> from pyproj import CRS
    >>> from msbdb.grid import lattice
    >>> spec = lattice((0, 0.1, 11, 4.9), 1.0, CRS.from_epsg(2154))
    >>> high = np.zeros((5, 12), dtype=np.float32)
    >>> high[1:4, 1:6], high[1:4, 6:11] = 6, 4
    >>> heights = Grid(high, np.ones((5, 12), dtype=bool), spec)
    >>> left = without_leaning_crowns(
    ...     high > 0, np.where(high == 6, 1, high / 8), (6 - high) / 2, heights, FuseParams(), limit_m=0.06
    ... )
    >>> left[1].astype(int)
    array([0, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0])
    """
    house = _opened(decided & (share >= 1))
    values = np.asarray(heights.values)
    # A piece often reaches the cells beside the house, so that these get the height of the house.
    around = dilation(values, 3, house)
    near = np.isfinite(around)
    objects, count = label_zones(decided)
    with_house = chosen_cells(objects, sizes(objects[house], count) > 0)
    labels, count = label_zones(with_house & ~near, connectivity=4)
    area = sizes(labels, count)
    area_m2 = area * heights.spec.cell_area_m2
    smooth = _share_of_known(labels, count, roughness_m <= limit_m, roughness_m, unknown=1.0)
    edge, beside, flush = measure_edges(labels, count, decided, np.where(near, around, values), params)
    crowns = (
        (area_m2 >= params.piece_m2)
        & (area_m2 <= LEANING_M2)
        & (sums(labels, share, count) <= DENIED * area)
        & (smooth < HARDLY)
        & (beside <= BESIDE * edge)
        & (flush <= STEPPED * beside)
    )
    if heights.spec.cell_m <= COARSE_M:
        even = _share_of_known(labels, count, roughness_m <= EVEN * limit_m, roughness_m, unknown=1.0)
        crowns |= (area_m2 >= params.piece_m2) & single_crowns(labels, even, heights)
    return decided & ~chosen_cells(labels, crowns)


def _opened(mask: Mask) -> Mask:
    """Return the opening of a mask by 3 by 3 cells; beyond the lattice nothing is in the mask."""
    none = np.False_
    return by_three(np.logical_or, by_three(np.logical_and, mask, beyond=none), beyond=none)

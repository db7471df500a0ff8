"""Which cells are building: the detectors' votes, and a minimum cut whose edges follow the steps of height."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from msbdb.detect.scene import Evidence, Regions
from msbdb.fuse.crowns import smooth_limit, without_crowns, without_green, without_leaning_crowns, without_rough
from msbdb.fuse.roofplanes import with_flush_planes
from msbdb.grid import Grid
from msbdb.labels import Labels, Pairs, around, by_three, label_zones, minimum_cut, neighbours, small_zones
from msbdb.params import FuseParams

Mask = NDArray[np.bool_]

RASTER_VOTES = {"multiscale": 2, "flatregions": 0}
"""Ours: votes on rasters of heights, others have one. Flat regions look at the surface as ``multiscale`` does there."""


def fuse_cells(
    heights: Grid,
    regions: Mapping[str, Regions],
    params: FuseParams,
    *,
    mask_m: float,
    of_points: bool = True,
    coloured: bool = False,
    evidence: Evidence | None = None,
    green: Mask | None = None,
) -> Mask:
    """Decide for each cell whether it is building, from the regions of all detectors that were run.

    Each detector has one vote, and half of the votes are enough; of rasters of heights see `count_votes`. A cell
    costs the votes that its kind lacks. A pair of neighbours of different kinds costs λ exp(-d/τ), with d their
    difference in height: edges of buildings are cheap along steps. The cheapest division of all cells is taken
    (`msbdb.labels.minimum_cut`). Holes and pieces smaller than ``piece_m2`` are filled and dropped, and bumps and
    notches of a cell at the edges go. Cells below the mask stay where they are the edge of one building; those that
    would join two buildings do not. A second look drops hedges, rough objects that hardly enough detectors support or
    that are green, single crowns, and crowns that lean on a house (`msbdb.fuse.crowns`). It adds smooth regions that
    lie flush with a building (`msbdb.fuse.roofplanes`).

    Parameters
    ----------
    heights : Grid
        Heights above ground, metres.
    regions : mapping of str to Regions
        By detector, at least one; labels on the lattice of the heights.
    params : FuseParams
        ``edge_cost`` λ, ``edge_height_m`` τ, ``piece_m2``; ``smooth_m``, ``flush_m`` and ``flush_share``.
    mask_m : float
        Height of the mask (V17), metres.
    of_points, coloured : bool
        Whether the source has points, and not only heights; and whether there is imagery.
    evidence : Evidence, optional
        The cells' roughness, for the second look; without it no second look is taken.
    green : (H, W) ndarray of bool, optional
        Cells of the colour of vegetation, where there is imagery.

    Returns
    -------
    (H, W) ndarray of bool

    Notes
    -----
    Equal votes are ours: weights that were fitted on all places but one are no better on the one left out.
    Border: pairs end at the lattice. Nodata: invalid cells are no building, and have no pairs. Ties go to no building.

    Examples
    --------
    Of four detectors two see the left house, and one sees the right:

    >>> from pyproj import CRS
    >>> from msbdb.grid import lattice
    >>> spec = lattice((0, 0.1, 6, 0.9), 1.0, CRS.from_epsg(2154))
    >>> left, right = np.array([[0, 1, 1, 0, 0, 0, 0]], np.int32), np.array([[0, 0, 0, 0, 1, 1, 0]], np.int32)
    >>> heights = Grid(5 * np.float32(left + right), np.ones((1, 7), dtype=bool), spec)
    >>> seen = {"a": left, "b": left, "c": right, "d": 0 * left}
    >>> votes = {name: Regions(name, labels, None, None, {}) for name, labels in seen.items()}
    >>> fuse_cells(heights, votes, FuseParams(piece_m2=0), mask_m=2.0).astype(int)
    array([[0, 1, 1, 0, 0, 0, 0]])
    """
    votes, every, enough = count_votes(regions, of_points=of_points, coloured=coloured)
    votes[~heights.valid] = 0
    needed = enough - 0.5
    decided = _tidy(_cut(votes, needed, heights, params), heights, params, mask_m)
    if evidence is None:
        return decided
    roughness_m = evidence.roughness_mm.astype(np.float32) / np.float32(1000)
    limit_m = smooth_limit(params, heights.spec.cell_m)
    share, clear = np.asarray(votes / every, dtype=np.float32), (needed + 1) / every
    decided = without_crowns(decided, share, roughness_m, params, clear=clear, cell_m=heights.spec.cell_m)
    decided = without_rough(decided, share, roughness_m, heights, params)
    if green is not None and "multiscale" in regions:
        multiscale = regions["multiscale"].labels > 0
        decided = without_green(decided, multiscale, green, roughness_m, params, cell_m=heights.spec.cell_m)
    decided = without_leaning_crowns(decided, share, roughness_m, heights, params, limit_m=limit_m)
    smooth = (votes > 0) & (roughness_m <= limit_m) & (np.asarray(heights.values) >= mask_m)
    return _tidy(with_flush_planes(decided, smooth, heights, params), heights, params, mask_m)


def count_votes(
    regions: Mapping[str, Regions], *, of_points: bool, coloured: bool
) -> tuple[NDArray[np.int8], int, int]:
    """Return the votes of each cell, all votes that there are, and how many are enough.

    Each detector has one vote, and half of the votes are enough. Without points no detector sees echoes, and they err
    together on crowns: then more than half are needed, and the votes are `RASTER_VOTES`. Of all four, a cell is
    building where ``multiscale`` takes it and ``area3d`` or ``adaptive`` does so, too. Where there is imagery,
    ``multiscale`` alone sees it, and decides by itself.

    Parameters
    ----------
    regions : mapping of str to Regions
        By detector, at least one.
    of_points, coloured : bool
        Whether the source has points, and not only heights; and whether there is imagery.

    Returns
    -------
    votes : (H, W) ndarray of int8
    every, enough : int
    """
    worth = {name: 1 if of_points else RASTER_VOTES.get(name, 1) for name in regions}
    if coloured and not of_points and "multiscale" in worth:
        worth["multiscale"] += 1
    votes = np.zeros(next(iter(regions.values())).labels.shape, dtype=np.int8)
    for name, found in regions.items():
        votes += np.int8(worth[name]) * (found.labels > 0)
    every = sum(worth.values())
    return votes, every, (every + 1) // 2 if of_points else every // 2 + 1


def _tidy(decided: Mask, heights: Grid, params: FuseParams, mask_m: float) -> Mask:
    """Fill small holes, straighten edges, keep buildings apart, and drop small pieces."""
    least = params.piece_m2 / heights.spec.cell_area_m2
    decided = decided | (small_zones(~decided, least, connectivity=4) & heights.valid)
    decided = _straight(decided) & heights.valid
    decided = _apart(decided, decided & (np.asarray(heights.values) >= mask_m))
    return decided & ~small_zones(decided, least, connectivity=4)


def is_fused(regions: Mapping[str, Regions], params: FuseParams) -> bool:
    """Return whether the detectors decide together.

    There are three at least, as two have no majority; the multi-scale one, which makes the parts, is among them.
    """
    return params.votes and len(regions) > 2 and "multiscale" in regions


def _straight(decided: Mask) -> Mask:
    """Let most of the 3 by 3 cells around each cell decide, as one echo a cell does not; corners stay as they are.

    A corner has four of its nine cells. So what an opening by 3 by 3 cells keeps stays, and what a closing leaves empty
    stays empty: bumps and notches of a cell go.
    """
    most = by_three(np.add, decided.astype(np.int8)) > 4
    opened = by_three(np.logical_or, by_three(np.logical_and, decided))
    closed = by_three(np.logical_and, by_three(np.logical_or, decided))
    straight: Mask = (most | opened) & closed
    return straight


def _apart(decided: Mask, high: Mask) -> Mask:
    """Keep of the cells below the mask those beside one building, unless they touch those of another."""
    owner = np.pad(label_zones(high)[0], 1)
    rim = np.flatnonzero(np.pad(decided & ~high, 1))
    highest, lowest = _extremes(owner, rim)
    rim, own = rim[highest == lowest], highest[highest == lowest]
    owner.ravel()[rim] = own
    highest, lowest = _extremes(owner, rim)
    kept = np.pad(high, 1)
    kept.ravel()[rim[highest == lowest]] = True
    return kept[1:-1, 1:-1]


def _extremes(framed: Labels, cells: NDArray[np.intp]) -> tuple[Labels, Labels]:
    """Return the largest label in the 3 by 3 cells around some cells, and the smallest one above 0."""
    labels = around(framed, cells)
    return labels.max(axis=1), np.where(labels > 0, labels, np.iinfo(np.int32).max).min(axis=1)


def _cut(votes: NDArray[np.int8], needed: float, heights: Grid, params: FuseParams) -> Mask:
    """Return the cells of the cheapest division; those without a vote are no building."""
    seen = votes > 0
    count = int(np.count_nonzero(seen))
    decided = np.zeros(votes.shape, dtype=np.bool_)
    if not count:
        return decided
    node = np.full(votes.shape, -1, dtype=np.int32)
    node[seen] = np.arange(count, dtype=np.int32)
    costs = needed - votes[seen].astype(np.float64)
    values = np.asarray(heights.values, dtype=np.float64)
    pairs = []
    for one, other in neighbours(votes.shape):
        voted = np.nonzero(seen[one] | seen[other])
        step = values[one][voted] - values[other][voted]
        first, second = node[one][voted], node[other][voted]
        edge = params.edge_cost * np.exp(-np.abs(step) / params.edge_height_m)
        edge[~(heights.valid[one][voted] & heights.valid[other][voted])] = 0
        both = (first >= 0) & (second >= 0)
        pairs.append((first[both], second[both], edge[both]))
        # A neighbour without a vote is no building, so that the pair is a cost of the other cell alone.
        for here, there in ((first, second), (second, first)):
            rim = there < 0
            costs += np.bincount(here[rim], weights=edge[rim], minlength=count)
    first, second, edges = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
    none = np.zeros_like(edges)
    decided[seen] = minimum_cut(costs, Pairs(first, second, none, edges, edges, none))
    return decided

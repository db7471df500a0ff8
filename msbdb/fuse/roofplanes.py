"""Planes of roofs: what is flush with a building belongs to it, as planes do not end inside of a roof."""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from msbdb.grid import Grid
from msbdb.labels import Labels, chosen_cells, neighbours, sizes
from msbdb.params import FuseParams

Mask = NDArray[np.bool_]


def with_flush_planes(decided: Mask, candidates: Mask, heights: Grid, params: FuseParams) -> Mask:
    """Add the smooth regions that lie flush with a building along enough of their edge: they are part of its roof.

    A roof of glass, of panels or under plants may be lost to most detectors in the midst of a kept one. A lower annex,
    a lorry or a crown beside the eaves has a step towards it.

    Parameters
    ----------
    decided : (H, W) ndarray of bool
        Cells of buildings.
    candidates : (H, W) ndarray of bool
        Smooth cells above the mask that at least one detector takes; those of ``decided`` do not count.
    heights : Grid
        Heights above ground, metres.
    params : FuseParams
        ``flush_m``: neighbours are flush where their heights differ by no more; regions are 4-connected flush
        candidates. ``flush_share``: a region's least share of pairs towards other cells that are flush with a building.

    Returns
    -------
    (H, W) ndarray of bool

    Notes
    -----
    Border: pairs end at the lattice. Nodata: invalid cells are no candidates, and their pairs are not flush.
    Linear in the cells.

    Examples
    --------
    Of the cells between two roofs, those in their plane join them:

    >>> from pyproj import CRS
    >>> from msbdb.grid import lattice
    >>> spec = lattice((0, 0.1, 6, 0.9), 1.0, CRS.from_epsg(2154))
    >>> heights = Grid(np.float32([[9, 9, 9.1, 9, 4, 4, 9]]), np.ones((1, 7), dtype=bool), spec)
    >>> decided = np.array([[True, True, False, False, False, False, True]])
    >>> with_flush_planes(decided, ~decided, heights, FuseParams()).astype(int)
    array([[1, 1, 1, 1, 0, 0, 1]])
    """
    candidates = candidates & ~decided & heights.valid
    values = np.asarray(heights.values)
    flush = [np.abs(values[one] - values[other]) <= params.flush_m for one, other in neighbours(decided.shape)]
    labels, count = _flush_regions(candidates, flush)
    edge, _, joined = measure_edges(labels, count, decided, values, params)
    return decided | chosen_cells(labels, joined >= np.maximum(params.flush_share * edge, 1))


def measure_edges(
    labels: Labels, count: int, decided: Mask, values: NDArray[np.floating], params: FuseParams
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Count the pairs of neighbours on the edge of each region.

    Parameters
    ----------
    labels : (H, W) ndarray of int32
        Regions 1 to ``count``; 0 for none.
    count : int
        Number of regions.
    decided : (H, W) ndarray of bool
        Cells of buildings.
    values : (H, W) ndarray of float, metres
        Heights.
    params : FuseParams
        ``flush_m``.

    Returns
    -------
    edge, beside, flush : (count,) ndarray of int64
        Pairs of a cell of the region and one of four neighbours outside of it; those with a building; and of these
        those whose heights differ by ``flush_m`` at most. Border: pairs end at the lattice.
    """
    edge, beside, flush = (np.zeros(count, dtype=np.int64) for _ in range(3))
    cells = np.flatnonzero(labels)
    own, value, width = labels.ravel()[cells], values.ravel()[cells], labels.shape[1]
    col = cells % width
    steps = ((-width, cells >= width), (width, cells < labels.size - width), (-1, col > 0), (1, col < width - 1))
    for step, inside in steps:
        place = np.flatnonzero(inside)
        there = cells[place] + step
        rim = labels.ravel()[there] != own[place]
        place, there = place[rim], there[rim]
        edge += sizes(own[place], count)
        built = decided.ravel()[there]
        place, there = place[built], there[built]
        beside += sizes(own[place], count)
        level = np.abs(value[place] - values.ravel()[there]) <= params.flush_m
        flush += sizes(own[place[level]], count)
    return edge, beside, flush


def _flush_regions(candidates: Mask, flush: list[Mask]) -> tuple[Labels, int]:
    """Label the candidates that paths of flush neighbours connect."""
    total = int(np.count_nonzero(candidates))
    node = np.zeros(candidates.shape, dtype=np.int32)
    node[candidates] = np.arange(total, dtype=np.int32)
    first, second = [], []
    for (one, other), level in zip(neighbours(candidates.shape), flush, strict=True):
        both = candidates[one] & candidates[other] & level
        first.append(node[one][both])
        second.append(node[other][both])
    pairs = np.concatenate(first), np.concatenate(second)
    graph = coo_matrix((np.ones(len(pairs[0]), dtype=np.bool_), pairs), shape=(total, total))
    count, component = connected_components(graph, directed=False)
    labels = np.zeros(candidates.shape, dtype=np.int32)
    labels[candidates] = component + 1
    return labels, int(count)

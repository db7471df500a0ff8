"""Fake fathers: roots that only join neighbouring buildings, with children dispersed in them (V46)."""

import logging
from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import ndimage

from msbdb.labels import EIGHT, boxes, label_zones, look_up, measure, offsets, sizes
from msbdb.params import ScaleParams
from msbdb.parts.adjacency import grow
from msbdb.parts.clusters import Clusters, Step
from msbdb.parts.links import NONE, link
from msbdb.parts.reshaping import as_rows, joined

logger = logging.getLogger(__name__)

FAKE = "fake father"
GAP = "gap between the children of a fake father"


def drop_fake_fathers(
    clusters: Clusters, scale: ScaleParams, *, cell_m: float, smallest_px: int, supported: bool = False
) -> Step:
    """Drop roots whose children are dispersed in them; the children become roots; repeat until none is left.

    Parameters
    ----------
    clusters : Clusters
        Nested clusters.
    scale : ScaleParams
        A root is fake when it has at least ``fake_father_min_children`` direct children, they cover at least
        ``fake_father_coverage`` of it, and they are dispersed. They are when StdDis / sqrt(area / pi) exceeds
        ``fake_father_ratio``, or StdDis exceeds ``fake_father_m`` (where this is above 0).
    cell_m : float
        Side of a cell, metres.
    smallest_px : int
        s of the finest scale, cells.
    supported : bool
        Whether several detectors take all cells of the clusters for building.

    Returns
    -------
    Step
        The children do not change. The cells that only the father held fall into connected areas. Areas of at least
        ``smallest_px`` that are mostly wider than two cells become roots on the father's scale, with ids of their own:
        houses of the row that were dropped as duplicates of it. The others are gaps and go to the ledger. Where the
        cells are supported there are no gaps, but edges of roofs: areas of that size are roots whatever their width,
        and the cells of smaller ones go to the nearest child or root.

    Notes
    -----
    The paper states neither the threshold nor the action (A7). StdDis of children spread evenly over a disc is 0.24
    of its radius, whatever the size; hence the ratio. StdDis alone does not separate a row of houses from a large roof
    with a few small parts far apart; the share that the children cover does.
    """
    before, father = clusters, link(clusters)
    fake: list[int] = []
    while (found := _find_fakes(clusters, father, scale, cell_m)).size:
        fake.extend(found.tolist())
        clusters = clusters.without(found)
        father = np.where(np.isin(father, found), NONE, father)
    logger.debug("%d fake fathers", len(fake))
    rows = np.sort(np.array(fake, dtype=np.int64))
    remainders = _keep_remainders(
        clusters, rows, link(before), smallest_px=smallest_px, connectivity=scale.connectivity, supported=supported
    )
    dropped = pd.concat([before.rows.iloc[rows].assign(reason=FAKE), remainders.dropped])
    return replace(remainders, dropped=dropped)


def _find_fakes(clusters: Clusters, father: NDArray[np.int64], scale: ScaleParams, cell_m: float) -> NDArray[np.intp]:
    """Return the living roots that are fake by the rule."""
    spread = spread_of_children(clusters, father, cell_m)
    radius = np.sqrt(clusters.rows["area"].to_numpy() / np.pi) * cell_m
    stddis = spread["stddis"].fillna(0).to_numpy()
    dispersed = stddis > scale.fake_father_ratio * radius
    if scale.fake_father_m > 0:
        dispersed |= stddis > scale.fake_father_m
    root = clusters.alive & (father == NONE)
    many = spread["children"].to_numpy() >= scale.fake_father_min_children
    covered = spread["covered"].to_numpy() >= scale.fake_father_coverage
    return np.flatnonzero(root & many & covered & dispersed)


def spread_of_children(clusters: Clusters, father: NDArray[np.int64], cell_m: float) -> pd.DataFrame:
    """Measure how the direct children of every cluster lie in it.

    Parameters
    ----------
    clusters : Clusters
        Clusters with their centroids.
    father : (N,) ndarray of int64
        Row number of each cluster's father, -1 for none.
    cell_m : float
        Side of a cell, metres.

    Returns
    -------
    DataFrame
        One row a cluster: ``children``, their number; ``stddis``, the population standard deviation of the distances
        from their centroids to the father's, metres (V46), NaN without children; ``covered``, their area over the
        father's.

    Notes
    -----
    StdDis = √(1/n Σ (d_j - mean d)²) over the distances d_j of the n children.

    Examples
    --------
    Three houses of 1, 3 and 1 cells in a row of 7: d = 3, 0 and 3 m, and StdDis = √((1 + 4 + 1) / 3) = 1.41 m:

    >>> from msbdb.parts.clusters import label_clusters
    >>> houses = np.array([[2, 1, 2, 2, 2, 1, 2]])
    >>> clusters = label_clusters([np.where(houses > 1, houses, 0), np.ones_like(houses)], connectivity=8)
    >>> spread_of_children(clusters, link(clusters), cell_m=1.0).round(2).loc[3].tolist()
    [3.0, 1.41, 0.71]
    """
    rows = clusters.rows
    count = len(rows)
    area = rows["area"].to_numpy().astype(np.float64)
    width = clusters.cells.shape[1]
    row, col = np.divmod(rows["first"].to_numpy(), width)
    down, right = offsets(rows, width)
    child = np.flatnonzero(father != NONE)
    of = father[child]
    along_rows = (row[child] - row[of]) + (down[child] - down[of])
    along_cols = (col[child] - col[of]) + (right[child] - right[of])
    distance = np.hypot(along_rows, along_cols) * cell_m
    children = np.bincount(of, minlength=count)
    divisor = np.where(children > 0, children, np.nan)
    mean = np.bincount(of, distance, count) / divisor
    variance = np.bincount(of, (distance - mean[of]) ** 2, count) / divisor
    covered = np.bincount(of, area[child], count) / area
    return pd.DataFrame({"children": children, "stddis": np.sqrt(variance), "covered": covered})


def _keep_remainders(
    clusters: Clusters,
    fake: NDArray[np.int64],
    father: NDArray[np.int64],
    *,
    smallest_px: int,
    connectivity: int,
    supported: bool,
) -> Step:
    """Make roots of what fake fathers hold beside their children, where it is large, or large and wide."""
    steps = []
    # From coarse to fine, as a child that is fake as well must still have all its cells when its father is cut.
    for level in np.unique(clusters.rows["level"].to_numpy()[fake])[::-1].tolist():
        here = fake[clusters.rows["level"].to_numpy()[fake] == level]
        labels = clusters.labels[level]
        zones = np.zeros(clusters.cells.shape, dtype=np.int32)
        seeds = np.zeros_like(zones)
        kept: list[NDArray[np.bool_]] = []
        count = 0
        for window, remainder, held in _remainders(clusters, level, here, father):
            pieces, found = label_zones(remainder)
            zones[window] += np.where(pieces > 0, pieces + count, 0).astype(np.int32)
            seeds[window] += held
            kept.append((_large if supported else _wide)(pieces, found, smallest_px))
            count += found
        keep = np.concatenate([np.zeros(0, dtype=np.bool_), *kept])
        table = measure(zones, count)
        source = labels[clusters.cells.places(table["first"].to_numpy())].astype(np.int64) - 1
        rows = as_rows(clusters, source, table).assign(alive=True)
        target = np.zeros(count + 1, dtype=np.int32)
        target[1:][keep] = len(clusters.rows) + 1 + np.arange(keep.sum())
        zone = clusters.cells.of(zones)
        own = look_up(target, zone)
        more = pd.concat([clusters.rows, rows[keep]], ignore_index=True)
        clusters = clusters.relabelled({level: np.where(own > 0, own, labels)}, more)
        given = np.zeros(count, dtype=np.bool_)
        if supported:
            seed = np.where(own > 0, own, clusters.cells.of(seeds))
            domain = np.where(look_up(clusters.flags(here), labels), labels, np.int32(0))
            image, of = clusters.cells.image, clusters.cells.of
            grown = of(grow(image(seed), image(domain), connectivity))
            grown[(zone == 0) | (seed > 0)] = 0
            clusters = _with_cells(clusters, grown)
            given = ~keep & (sizes(zone[grown > 0], count) == sizes(zone, count))
        steps.append(Step(clusters, rows[~keep & ~given].assign(reason=GAP), count - int(given.sum())))
    return joined(clusters, steps)


def _with_cells(clusters: Clusters, gained: NDArray[np.int32]) -> Clusters:
    """Return the clusters with further cells; no other living cluster of their scale has any of these.

    The label that gains each cell is (K,) in the clusters' cells, 0 for none.
    """
    place = np.flatnonzero(gained > 0)
    cells, row = clusters.cells.numbers[place], gained[place] - 1
    level = clusters.rows["level"].to_numpy()[row]
    after = {}
    for scale in np.unique(level).tolist():
        after[scale] = clusters.labels[scale].copy()
        after[scale][place[level == scale]] = row[level == scale] + 1
    count = len(clusters.rows)
    at_row, at_col = np.divmod(cells, clusters.cells.shape[1])
    first = clusters.rows["first"].to_numpy().copy()
    np.minimum.at(first, row, cells)
    more = {"area": np.ones(cells.size), "row_sum": at_row, "col_sum": at_col}
    # The sums are whole numbers below 2**53, hence exact in the float64 of bincount.
    grown = {
        name: clusters.rows[name].to_numpy() + np.bincount(row, values, count).astype(np.int64)
        for name, values in more.items()
    }
    return clusters.relabelled(after, clusters.rows.assign(first=first, **grown))


def _remainders(
    clusters: Clusters, level: int, fake: NDArray[np.int64], father: NDArray[np.int64]
) -> Iterator[tuple[tuple[slice, slice], NDArray[np.bool_], NDArray[np.int32]]]:
    """Yield for each fake father of a scale its window, the cells there of no child, and the children's labels."""
    images = cache(clusters.image)
    windows = boxes(images(level))
    levels = clusters.rows["level"].to_numpy()
    for row in fake.tolist():
        window = windows[row + 1]
        remainder = images(level)[window] == row + 1
        held = np.zeros(remainder.shape, dtype=np.int32)
        children = np.flatnonzero(father == row)
        for finer in np.unique(levels[children]).tolist():
            own = children[levels[children] == finer]
            labels = images(finer)[window]
            inside = np.isin(labels, own + 1)
            held[inside] = labels[inside]
        yield window, remainder & (held == 0), held


def _wide(pieces: NDArray[np.int32], count: int, smallest_px: int) -> NDArray[np.bool_]:
    """Return which pieces are large, with at least half of their cells in squares of 3 by 3 cells within them."""
    area = sizes(pieces, count)
    inside = ndimage.binary_opening(pieces > 0, EIGHT)
    core = sizes(pieces[inside], count)
    wide: NDArray[np.bool_] = _large(pieces, count, smallest_px) & (2 * core >= area)
    return wide


def _large(pieces: NDArray[np.int32], count: int, smallest_px: int) -> NDArray[np.bool_]:
    """Return which pieces are as large as a part may be."""
    return sizes(pieces, count) >= smallest_px

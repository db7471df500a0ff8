"""Reshaping: clusters lose vegetation that reaches into them, are cut, and get the scale that they reach (V37-V39)."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import sparse

from msbdb.labels import Labels, label_zones, look_up, renumber, sizes
from msbdb.parts.adjacency import mark_edges, reaching_in
from msbdb.parts.clusters import Clusters, Step
from msbdb.parts.links import NONE, link

FRAGMENT = "piece smaller than the finest scale"
MEASURED = ["first", "area", "row_sum", "col_sum"]
VEGETATION = "vegetation"

COVERED = "covers the same scale as a cluster that was cut"


def cut_vegetation(
    clusters: Clusters,
    vegetation: NDArray[np.bool_],
    *,
    smallest_px: int,
    connectivity: int,
    kept: Sequence[int] | NDArray[np.integer] = (),
) -> Step:
    """Take the vegetation that reaches in from outside away from every cluster.

    Parameters
    ----------
    clusters : Clusters
        Nested clusters.
    vegetation : (H, W) ndarray of bool
        Cells of vegetation classes. A blob is a connected component of them (V39).
    smallest_px : int
        s of the finest scale, cells: smaller pieces are dropped (V38).
    connectivity : int
        4 or 8, as for the scale-space.
    kept : sequence of int
        Row numbers of clusters, such as roots, that keep all of their cells. Nothing beside them may hold them.

    Returns
    -------
    Step
        Nested clusters again.

    Notes
    -----
    The band of a cluster is the dilation of its boundary cells by 3 by 3 (A6): three cells wide, on both sides of the
    outline. A blob that lies in the band wholly gets mark 0: a fringe of mixed cells, and the roof stays. A blob that
    meets the band and leaves it gets mark 1: a tree that reaches in, whose cells are taken from the cluster. A blob in
    the middle of a roof meets no band and stays (a green roof).

    Scales go from coarse to fine. The cells cut from a father are cut from all clusters in it as well, so that children
    stay inside of their fathers.
    """
    blobs = _blobs(vegetation, connectivity, over=clusters.cells.numbers[clusters.in_cells(clusters.alive)])
    if not blobs[0].size:
        return joined(clusters, [])
    gone, edge = (np.zeros(vegetation.shape, dtype=np.bool_) for _ in range(2))
    objects, at = np.zeros(vegetation.shape, dtype=np.int32), clusters.cells.numbers
    steps = []
    for level in reversed(range(len(clusters.labels))):
        living = clusters.flags(np.setdiff1d(clusters.at(level), kept))
        own = np.where(look_up(living, clusters.labels[level]), clusters.labels[level], np.int32(0))
        objects.ravel()[at] = own
        mark_edges(objects, at, edge)
        count = len(clusters.rows)
        reaching_in(objects, edge, blobs, count, gone)
        lost = clusters.cells.of(gone)
        touched = np.flatnonzero(sizes(own[lost], count) > 0)
        if touched.size:
            own[lost | ~look_up(clusters.flags(touched), own)] = 0
            step = cut(
                clusters, level, own, touched, smallest_px=smallest_px, connectivity=connectivity, reason=VEGETATION
            )
            steps.append(step)
            clusters = step.clusters
    return joined(clusters, steps)


def _blobs(
    vegetation: NDArray[np.bool_], connectivity: int, *, over: NDArray[np.intp]
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """List the cells of the blobs that lie over some cells, blob by blob, and where each blob's cells start."""
    if not vegetation.ravel()[over].any():
        return np.zeros(0, dtype=np.int32), np.zeros(1, dtype=np.int32)
    labels, count = label_zones(vegetation, connectivity=connectivity)
    labels, count = renumber(labels, sizes(labels.ravel()[over], count) > 0)
    cells = np.flatnonzero(labels != 0).astype(np.int32)
    member = labels.ravel()[cells] - 1
    # Turning a sparse matrix from rows to columns is a counting sort.
    table = sparse.csr_array((cells, member, np.arange(cells.size + 1)), shape=(cells.size, count)).tocsc()
    return table.data.astype(np.int32), table.indptr.astype(np.int32)


def cut(
    clusters: Clusters,
    level: int,
    zones: NDArray[np.integer],
    touched: NDArray[np.integer],
    *,
    smallest_px: int,
    connectivity: int,
    reason: str,
) -> Step:
    """Cut clusters of one scale into pieces.

    Parameters
    ----------
    clusters : Clusters
        The clusters before.
    level : int
        The scale, 0 = finest.
    zones : (K,) ndarray of int, in the clusters' cells
        0 outside of the touched clusters and where they lose cells. Elsewhere every connected flat zone is a piece.
        A zone lies in one cluster.
    touched : (M,) ndarray of int
        Row numbers of the clusters to cut, all of this scale.
    smallest_px : int
        Smaller pieces are dropped, unless they are a whole cluster.
    connectivity : int
        4 or 8.
    reason : str
        Why a cluster without a piece that is large enough is dropped.

    Returns
    -------
    Step
        The largest piece of a cluster keeps its row and id; of equal ones the first in row order. The others get rows
        of their own. A cluster without a piece that is large enough is dropped with all of its cells.
    """
    labels, count = clusters.cells.zones(zones, connectivity=connectivity)
    pieces = clusters.cells.measure(labels, count)
    before = clusters.labels[level]
    source = before[clusters.cells.places(pieces["first"].to_numpy())].astype(np.int64) - 1
    heir = _heirs(source, pieces)
    area = pieces["area"].to_numpy()
    large = (area >= smallest_px) | (area == clusters.rows["area"].to_numpy()[source])

    rows = clusters.rows.copy()
    rows.loc[source[heir & large], MEASURED] = pieces.loc[heir & large, MEASURED].to_numpy()
    lost = np.setdiff1d(touched, source[heir & large])
    rows.loc[lost, "alive"] = False
    new = as_rows(clusters, source[~heir & large], pieces[~heir & large])
    small = as_rows(clusters, source[~heir & ~large], pieces[~heir & ~large])
    dropped = pd.concat([clusters.rows.loc[lost].assign(reason=reason), small.assign(reason=FRAGMENT)])

    target = np.zeros(count + 1, dtype=np.int32)
    target[1:][heir & large] = source[heir & large] + 1
    target[1:][~heir & large] = len(rows) + 1 + np.arange(len(new))
    own = np.where(look_up(clusters.flags(touched), before), look_up(target, labels), before)
    after = clusters.relabelled({level: own}, pd.concat([rows, new], ignore_index=True))
    return Step(after, dropped, int((~heir).sum()))


def _heirs(source: NDArray[np.integer], pieces: pd.DataFrame) -> NDArray[np.bool_]:
    """Return which pieces are the largest of their source; of equal ones the first in row order."""
    order = np.lexsort((pieces["first"], -pieces["area"], source))
    ranked = source[order]
    heir = np.zeros(len(pieces), dtype=np.bool_)
    heir[order[np.flatnonzero(np.diff(ranked, prepend=-1))]] = True
    return heir


def as_rows(clusters: Clusters, source: NDArray[np.integer], pieces: pd.DataFrame) -> pd.DataFrame:
    """Return rows for measured pieces that are cut off the source rows."""
    rows = clusters.rows.iloc[source].reset_index(drop=True)
    rows[MEASURED] = pieces[MEASURED].to_numpy()
    return rows.assign(origin=rows["first"], piece=rows["piece"] + 1)


def joined(clusters: Clusters, steps: list[Step]) -> Step:
    """Return the steps over several scales as one, with the clusters that are left after all of them."""
    none = clusters.rows.iloc[:0].assign(reason="")
    dropped = [step.dropped for step in steps if len(step.dropped)]
    return Step(clusters, pd.concat(dropped) if dropped else none, sum(step.pieces for step in steps))


def settle(clusters: Clusters, thresholds: list[int]) -> Step:
    """Move each cluster that is smaller than the s of its scale to the coarsest scale whose s it reaches.

    Parameters
    ----------
    clusters : Clusters
        Nested clusters. Some were cut (V37, V44), or are the rest of a fake father (V46).
    thresholds : list of int
        s of the scales, cells, ascending.

    Returns
    -------
    Step
        Nested clusters. Where a cluster arrives on a scale, those that it holds there go as its duplicates: it covers
        them. A root smaller than the finest s stays on the finest scale; what else is smaller goes, as the cells of
        its father hold it: the rest of a cluster beside a court that its scale had closed.

    Notes
    -----
    Ids keep the scale on which the cluster was found (column ``made``).

    Examples
    --------
    A house of five cells stands on the scale of s = 8, and its upper part on that of s = 2. It moves to s = 4:

    >>> from msbdb.parts.clusters import label_clusters
    >>> house, part = np.array([[1, 1, 1, 1, 1]]), np.array([[2, 2, 0, 0, 0]])
    >>> clusters = label_clusters([part, 0 * house, house], connectivity=8)
    >>> settle(clusters, [2, 4, 8]).clusters.rows["level"].tolist()
    [0, 1]
    """
    rows = clusters.rows
    level, area = rows["level"].to_numpy(), rows["area"].to_numpy()
    reached = np.maximum(np.searchsorted(thresholds, area, side="right") - 1, 0)
    moved = np.flatnonzero(clusters.alive & (reached < level))
    if not moved.size:
        return _without_crumbs(Step(clusters, rows.iloc[:0].assign(reason="")), thresholds[0])
    own = clusters.labels
    after: dict[int, Labels] = {}
    covered: list[NDArray[np.intp]] = []
    target = np.where(clusters.alive, np.minimum(reached, level), level)
    for scale in np.unique(target[moved]).tolist():
        line = own[scale].copy()
        arriving = moved[target[moved] == scale]
        # From fine to coarse: a cluster that comes from a coarser scale holds those that come from finer ones.
        for origin in np.unique(level[arriving]).tolist():
            coming = look_up(clusters.flags(arriving[level[arriving] == origin]), own[origin])
            line[coming] = own[origin][coming]
        here = np.flatnonzero(clusters.alive & (target == scale))
        covered.append(here[sizes(line, len(rows))[here] == 0])
        after[scale] = line
    for origin in np.unique(level[moved]).tolist():
        gone, line = clusters.flags(moved[level[moved] == origin]), after.get(origin, own[origin])
        after[origin] = np.where(look_up(gone, line), np.int32(0), line)
    settled = clusters.relabelled(after, rows.assign(level=target))
    lost = np.sort(np.concatenate(covered))
    return _without_crumbs(Step(settled.without(lost), rows.iloc[lost].assign(reason=COVERED)), thresholds[0])


def _without_crumbs(step: Step, smallest_px: int) -> Step:
    """Drop the clusters that are smaller than the finest s and have a father."""
    rows = step.clusters.rows
    small = step.clusters.alive & (rows["area"].to_numpy() < smallest_px)
    if not small.any():
        return step
    crumbs = np.flatnonzero(small & (link(step.clusters) != NONE))
    dropped = pd.concat([step.dropped, rows.iloc[crumbs].assign(reason=FRAGMENT)])
    return Step(step.clusters.without(crumbs), dropped, step.pieces)

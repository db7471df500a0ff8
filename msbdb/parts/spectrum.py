"""Spectral classes of clusters: splitting by two dominant ones, removal without any, and SPE (V40 to V45)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msbdb.labels import Labels, chosen_cells, look_up, sizes
from msbdb.landcover import ClassMap
from msbdb.parts.adjacency import grow, tally
from msbdb.parts.clusters import Clusters, Step
from msbdb.parts.reshaping import cut, joined

TOO_FEW = "too few cells of building classes"
SPLIT = "split with its father into pieces smaller than the finest scale"


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """Building classes inside the clusters of one scale.

    Parameters
    ----------
    rows : (M,) ndarray of int
        Row numbers of the living clusters of the scale.
    counts : (M, K + 1) ndarray of int64
        Cells of each building class; other classes (vegetation, shadow, ...) count as 0 (V40).
    share : (M,) ndarray of float64
        Cells of all building classes over all cells.
    """

    rows: NDArray[np.intp]
    counts: NDArray[np.int64]
    share: NDArray[np.float64]

    def dominant(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
        """Return the most frequent and the second building class, and the second's share of all building cells."""
        order = np.argsort(-self.counts, axis=1, kind="stable")[:, :2]
        total = np.maximum(self.counts.sum(axis=1), 1)
        second = np.take_along_axis(self.counts, order[:, 1:], axis=1)[:, 0]
        return order[:, 0], order[:, 1], second / total


def measure_spectrum(clusters: Clusters, level: int, classes: ClassMap) -> Spectrum:
    """Count the building classes' cells in the living clusters of one scale. Linear in the cells."""
    rows, counts = _count_classes(clusters, level, classes)
    building = np.zeros(counts.shape[1], dtype=np.bool_)
    building[[index for index, label in classes.labels.items() if label == "building"]] = True
    counts = np.where(building, counts, 0)
    area = clusters.rows["area"].to_numpy()[rows]
    return Spectrum(rows, counts, counts.sum(axis=1) / np.maximum(area, 1))


def spectral_modes(clusters: Clusters, level: int, colours: ClassMap) -> tuple[NDArray[np.intp], NDArray[np.int64]]:
    """Return the living clusters of a scale and their SPE: the most frequent building class inside (V42).

    Without one, as on a roof garden, it is the most frequent class of all; of equal ones the lowest; 0 where no
    cell has a class.
    """
    rows, counts = _count_classes(clusters, level, colours)
    counts[:, 0] = 0
    building = [index for index, label in colours.labels.items() if label == "building"]
    own = np.zeros_like(counts)
    own[:, building] = counts[:, building]
    counts = np.where(own.any(axis=1, keepdims=True), own, counts)
    return rows, np.where(counts.any(axis=1), counts.argmax(axis=1), 0)


def _count_classes(clusters: Clusters, level: int, classes: ClassMap) -> tuple[NDArray[np.intp], NDArray[np.int64]]:
    """Return the living clusters of a scale, and in columns by class how many cells of each they have."""
    rows = clusters.at(level)
    position = np.full(len(clusters.rows) + 1, -1, dtype=np.int64)
    position[rows + 1] = np.arange(len(rows))
    counts = np.zeros((len(rows), max(classes.labels, default=1) + 1), dtype=np.int64)
    tally(clusters.labels[level], position, clusters.cells.of(classes.index), counts)
    return rows, counts


def drop_unlike(
    clusters: Clusters, classes: ClassMap, min_share: float, *, kept: Sequence[int] | NDArray[np.integer] = ()
) -> Step:
    """Drop the clusters that hold too little of the building classes (V41, V43).

    Parameters
    ----------
    clusters : Clusters
        Clusters of all scales.
    classes : ClassMap
        Classes on the same lattice.
    min_share : float
        Share of building cells below which a cluster is dropped; one without any is dropped at 0, too.
    kept : sequence of int
        Row numbers of clusters that stay whatever their share.

    Notes
    -----
    Each cluster is judged by itself. Children of a dropped father are linked to its father, or become roots (V45).
    """
    judged = np.setdiff1d(np.flatnonzero(clusters.alive), kept)
    levels = np.unique(clusters.rows["level"].to_numpy()[judged]).tolist()
    found = [measure_spectrum(clusters, level, classes) for level in levels]
    low = np.concatenate([judged[:0], *(s.rows[(s.share < min_share) | (s.share == 0)] for s in found)])
    low = np.intersect1d(low, judged)
    return Step(clusters.without(low), clusters.rows.iloc[low].assign(reason=TOO_FEW))


def split_by_classes(
    clusters: Clusters,
    classes: ClassMap,
    *,
    split_share: float,
    min_share: float,
    smallest_px: int,
    connectivity: int,
) -> Step:
    """Split the clusters in which two building classes are dominant (V44, A5).

    Parameters
    ----------
    clusters : Clusters
        Nested clusters.
    classes : ClassMap
        Classes on the same lattice.
    split_share : float
        A cluster is split when its second building class has at least this share of its building cells, so that the
        first one has at most 1 - share; 0 never splits.
    min_share : float
        Clusters with a smaller share of building cells are not split, as `drop_unlike` drops them.
    smallest_px : int
        s of the finest scale, cells: smaller areas of a class do not found a piece.
    connectivity : int
        4 or 8, as for the scale-space.

    Returns
    -------
    Step
        Nested clusters again.

    Notes
    -----
    Pieces grow from the connected components of the two classes that are large enough; the remaining cells go to the
    nearest, and components of one class that meet become one piece. Without a large component of both classes there
    is no split.

    Scales go from coarse to fine: a line that splits a father splits all clusters in it as well. So each piece of a
    child lies in one piece of the father, to which it is linked (V45), and no child lies in two buildings.
    """
    if split_share <= 0:
        return joined(clusters, [])
    line = np.zeros(clusters.cells.numbers.size, dtype=np.int32)
    steps = []
    options = {"smallest_px": smallest_px, "connectivity": connectivity}
    for level in reversed(range(len(clusters.labels))):
        step = _follow(clusters, level, line, **options)
        spectrum = measure_spectrum(step.clusters, level, classes)
        first, second, share = spectrum.dominant()
        wanted = (share >= split_share) & (spectrum.share >= min_share)
        seeds = _seeds(step.clusters, level, classes, (spectrum.rows, first, second), wanted, **options)
        steps.append(step)
        clusters = step.clusters
        if seeds.any():
            step = _split(clusters, level, seeds, line, **options)
            steps.append(step)
            clusters = step.clusters
    return joined(clusters, steps)


def _seeds(
    clusters: Clusters,
    level: int,
    classes: ClassMap,
    dominant: tuple[NDArray[np.intp], NDArray[np.int64], NDArray[np.int64]],
    wanted: NDArray[np.bool_],
    *,
    smallest_px: int,
    connectivity: int,
) -> Labels:
    """Return (K,) the large components of the two dominant classes: 2 * row + 1 and 2 * row + 2; 0 elsewhere."""
    rows, first, second = (part[wanted] for part in dominant)
    label, kind = clusters.labels[level], clusters.cells.of(classes.index)
    seed = np.zeros(label.size, dtype=np.int32)
    if not rows.size:
        return seed
    for number, chosen in ((1, first), (2, second)):
        class_of = np.full(len(clusters.rows) + 1, -1, dtype=np.int16)
        class_of[rows + 1] = chosen
        here = kind == look_up(class_of, label)
        seed[here] = 2 * (label[here] - 1) + number
    component, count = clusters.cells.zones(seed, connectivity=connectivity)
    seed[chosen_cells(component, sizes(component, count) < smallest_px)] = 0
    has = np.zeros(2 * len(clusters.rows) + 1, dtype=np.bool_)
    has[seed] = True
    both = np.concatenate([[False], np.repeat(has[1::2] & has[2::2], 2)])
    return np.where(look_up(both, seed), seed, np.int32(0))


def _split(clusters: Clusters, level: int, seeds: Labels, line: Labels, *, smallest_px: int, connectivity: int) -> Step:
    """Split clusters by their seeds, and draw the pieces' labels into the line."""
    own, image = clusters.labels[level], clusters.cells.image
    touched = np.unique((seeds[seeds > 0] - 1) // 2)
    split = look_up(clusters.flags(touched), own)
    grown = grow(image(seeds), image(np.where(split, own, np.int32(0))), connectivity)
    zones = clusters.cells.of(grown)
    step = cut(clusters, level, zones, touched, smallest_px=smallest_px, connectivity=connectivity, reason=SPLIT)
    line[split] = step.clusters.labels[level][split]
    return step


def _follow(clusters: Clusters, level: int, line: Labels, *, smallest_px: int, connectivity: int) -> Step:
    """Split the clusters of a scale where their coarser ones have been split."""
    rows = clusters.at(level)
    touched = rows[line[clusters.cells.places(clusters.rows["first"].to_numpy()[rows])] > 0]
    if not touched.size:
        return joined(clusters, [])
    own = clusters.labels[level]
    # One value for each pair of a cluster and a piece of its father.
    zones = np.where(look_up(clusters.flags(touched), own), own.astype(np.int64) * (int(line.max()) + 1) + line, 0)
    return cut(clusters, level, zones, touched, smallest_px=smallest_px, connectivity=connectivity, reason=SPLIT)

"""Agreement by object (V55, S9, S10), and how far matched objects differ in outline, height and shape (V57 to V59).

Objects are counted on both sides, also where they were merged or split.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from msbdb.evaluate.agreement import Averages, Rates, averages, rates, ratio
from msbdb.grid import GridSpec
from msbdb.labels import Labels, shared_cells, sizes, sums
from msbdb.outline.polygons import Geometries

Ints = NDArray[np.int64]

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Overlaps:
    """Where the objects of both sides meet.

    Attributes
    ----------
    extracted, reference : (P,) ndarray of int64
        The objects of each pair with common cells.
    common_m2 : (P,) ndarray of float64
        Their common area.
    extracted_m2, reference_m2 : (N,) and (M,) ndarray of float64
        The scored area of every object.
    """

    extracted: Ints
    reference: Ints
    common_m2: Floats
    extracted_m2: Floats
    reference_m2: Floats

    def together(self, share: float) -> NDArray[np.bool_]:
        """Return the pairs that have at least this share of the smaller object in common."""
        smaller = np.minimum(self.extracted_m2[self.extracted], self.reference_m2[self.reference])
        return np.asarray(self.common_m2 >= share * smaller)


@dataclass(frozen=True, slots=True)
class ObjectScore:
    """Objects as each side counts them, and their rates.

    Attributes
    ----------
    found, missed : int
        Reference objects that are covered by extracted ones to the chosen share, and the others.
    true, false : int
        Extracted objects that are covered by reference ones to the chosen share, and the others.
    fused : int
        Extracted objects that are several in reality: they hold the chosen share of each of two reference objects.
    split : int
        Reference objects that were extracted as several: they hold the chosen share of each of two extracted ones.
    fusion, fission : float
        ``fused`` a counted extracted object, ``split`` a counted reference object.
    rates : Rates
        Of the four counts.
    """

    found: int
    missed: int
    true: int
    false: int
    fused: int
    split: int
    fusion: float
    fission: float
    rates: Rates


def overlaps(extracted: Labels, reference: Labels, counts: tuple[int, int], cell_area_m2: float) -> Overlaps:
    """Count the common cells of all objects.

    Parameters
    ----------
    extracted, reference : (H, W) ndarray of int32
        Index + 1 of the object in each cell, 0 for none, and 0 on both sides in cells that are not scored.
    counts : tuple of int
        Number of extracted and of reference objects.
    cell_area_m2 : float
        Area of a cell, m2.
    """
    one, other, cells = shared_cells(extracted, reference)
    extracted_cells, reference_cells = sizes(extracted, counts[0]), sizes(reference, counts[1])
    return Overlaps(
        extracted=one - 1,
        reference=other - 1,
        common_m2=cells.astype(np.float64) * cell_area_m2,
        extracted_m2=extracted_cells.astype(np.float64) * cell_area_m2,
        reference_m2=reference_cells.astype(np.float64) * cell_area_m2,
    )


def score_objects(
    found: Overlaps,
    counted: tuple[NDArray[np.bool_], NDArray[np.bool_]],
    covered_m2: tuple[Floats, Floats],
    share: float,
) -> ObjectScore:
    """Count the objects that the other side covers, each side on its own.

    An object is covered when at least the share of its scored area is building on the other side, in one object or in
    several. So a merged row of houses counts as found; only the fusion rate shows the merge.

    Parameters
    ----------
    found : Overlaps
        The common areas of all objects.
    counted : tuple of ndarray of bool
        Which extracted, and which reference objects count; the others still cover.
    covered_m2 : tuple of ndarray of float64
        Scored area of each extracted and of each reference object that is building on the other side.
    share : float
        The least share of an object's area, above 0 and up to 1.
    """
    counted_e, counted_r = counted
    true = covered_m2[0][counted_e] >= share * found.extracted_m2[counted_e]
    seen = covered_m2[1][counted_r] >= share * found.reference_m2[counted_r]
    pair = counted_e[found.extracted] & counted_r[found.reference]
    holds_reference = pair & (found.common_m2 >= share * found.reference_m2[found.reference])
    holds_extracted = pair & (found.common_m2 >= share * found.extracted_m2[found.extracted])
    fused = int(np.count_nonzero(np.bincount(found.extracted[holds_reference]) >= 2))
    split = int(np.count_nonzero(np.bincount(found.reference[holds_extracted]) >= 2))
    numbers = {
        "found": int(seen.sum()),
        "missed": int((~seen).sum()),
        "true": int(true.sum()),
        "false": int((~true).sum()),
    }
    return ObjectScore(
        **numbers,
        fused=fused,
        split=split,
        fusion=ratio(fused, len(true)),
        fission=ratio(split, len(seen)),
        rates=rates(**numbers),
    )


def groups(found: Overlaps, share: float) -> tuple[Ints, Ints, int]:
    """Gather the objects that depict the same buildings, m to n.

    Two objects belong together when they have at least the share of the smaller one in common; a group holds all
    that are linked so, directly or through others.

    Returns
    -------
    extracted, reference : (N,) and (M,) ndarray of int64
        Group of each object; -1 for those that have no partner.
    count : int
        Number of groups.
    """
    n, m = len(found.extracted_m2), len(found.reference_m2)
    linked = found.together(share)
    one, other = found.extracted[linked], found.reference[linked]
    graph = coo_array((np.ones(len(one), dtype=np.int8), (one, n + other)), shape=(n + m, n + m))
    _, component = connected_components(graph, directed=False)
    matched = np.unique(component[one])
    of_component = np.full(n + m + 1, -1, dtype=np.int64)
    of_component[matched] = np.arange(len(matched))
    return of_component[component[:n]], of_component[component[n:]], len(matched)


@dataclass(frozen=True, slots=True)
class BoundaryScore:
    """Distances between the outlines of matched buildings.

    Attributes
    ----------
    samples : int
        Samples on both outlines that lie in scored cells.
    left_out : float
        Share of them that is farther than the cap from the other outline.
    rms_m : Averages
        RMS of the distances of the others: of all samples (micro), and the mean of the buildings' (macro).
    """

    samples: int
    left_out: float
    rms_m: Averages


def score_boundary(
    extracted: Geometries,
    reference: Geometries,
    scored: NDArray[np.bool_],
    spec: GridSpec,
    *,
    step_m: float,
    cap_m: float,
) -> BoundaryScore:
    """Measure the distance of samples on each outline to the nearest point of the other outline.

    Parameters
    ----------
    extracted, reference : (G,) ndarray of polygonal geometries
        Outlines of the matched buildings, with their holes.
    scored : (H, W) ndarray of bool
        Samples in other cells are left out, because the outline there may be the edge of the data.
    spec : GridSpec
        The lattice of ``scored``.
    step_m : float
        Largest distance between two samples; they are spread evenly on each ring.
    cap_m : float
        Samples farther than this from the other outline do not enter the RMS: they belong to a part that is missing or
        added, which the areas show.
    """
    lines_e, lines_r = shapely.boundary(extracted), shapely.boundary(reference)
    distance, group = (
        np.concatenate(both)
        for both in zip(
            _distances(lines_e, lines_r, scored, spec, step_m),
            _distances(lines_r, lines_e, scored, spec, step_m),
            strict=True,
        )
    )
    near = distance <= cap_m
    used = sizes(group[near] + 1, len(extracted))
    squares = sums(group[near] + 1, distance[near] ** 2, len(extracted))
    if not near.any():
        return BoundaryScore(len(distance), ratio(len(distance), len(distance)), Averages(math.nan, math.nan))
    micro = math.sqrt(float(squares.sum()) / int(used.sum()))
    macro = float(np.mean(np.sqrt(squares[used > 0] / used[used > 0])))
    return BoundaryScore(len(distance), 1 - float(near.mean()), Averages(micro, macro))


def united(outlines: Geometries, group: Ints, count: int) -> Geometries:
    """Return the union of the outlines of each group; those of group -1 are left out."""
    order = np.argsort(group, kind="stable")
    first = np.searchsorted(group[order], np.arange(count + 1))
    members = (outlines[order[start:stop]] for start, stop in pairwise(first))
    unions = np.empty(count, dtype=np.object_)
    unions[:] = [part[0] if len(part) == 1 else shapely.union_all(part) for part in members]
    return unions


def _distances(
    lines: Geometries, others: Geometries, scored: NDArray[np.bool_], spec: GridSpec, step_m: float
) -> tuple[NDArray[np.float64], Ints]:
    """Return the distance of each scored sample on the lines to the other line of its group, and the group."""
    rings, group = shapely.get_parts(lines, return_index=True)
    length = shapely.length(rings)
    number = np.maximum(np.ceil(length / step_m), 1).astype(np.int64)
    ring = np.repeat(np.arange(len(rings)), number)
    along = np.arange(len(ring)) - np.repeat(np.cumsum(number) - number, number)
    points = shapely.line_interpolate_point(rings[ring], (along + 0.5) * (length / number)[ring])
    counted = spec.sample(scored, shapely.get_x(points), shapely.get_y(points), outside=False)
    kept = group[ring[counted]].astype(np.int64)
    return np.asarray(shapely.distance(points[counted], others[kept]), dtype=np.float64), kept


@dataclass(frozen=True, slots=True)
class HeightScore:
    """Heights of the matched reference objects that state one: how many, RMSE and mean of extracted - reference."""

    objects: int
    rmse_m: float
    bias_m: float


def score_heights(
    found: Overlaps, extracted_m: NDArray[np.float64], reference_m: NDArray[np.float64], share: float
) -> HeightScore:
    """Compare the heights above ground.

    Parameters
    ----------
    found : Overlaps
        The common areas of all objects.
    extracted_m, reference_m : (N,) and (M,) ndarray of float64
        Heights above ground, metres; NaN where unknown.
    share : float
        Objects belong together when they have at least this share of the smaller one in common.

    Notes
    -----
    A reference object is compared with the mean of the extracted heights that belong to it, weighted by the common
    area.
    """
    use = found.together(share) & np.isfinite(extracted_m[found.extracted]) & np.isfinite(reference_m[found.reference])
    one, other, common = found.extracted[use], found.reference[use], found.common_m2[use]
    weight = sums(other + 1, common, len(reference_m))
    total = sums(other + 1, common * extracted_m[one], len(reference_m))
    compared = weight > 0
    error = total[compared] / weight[compared] - reference_m[compared]
    if not len(error):
        return HeightScore(0, math.nan, math.nan)
    return HeightScore(len(error), float(np.sqrt(np.mean(error**2))), float(np.mean(error)))


@dataclass(frozen=True, slots=True)
class ShapeScore:
    """Areas of the matched buildings, reference A and extracted B; NaN without any.

    Attributes
    ----------
    buildings : int
        Number of matched groups; a group is one building.
    reference_m2, difference_m2, reference_only_m2, extracted_only_m2 : float
        Means over the buildings of A, of |A - B|, of A without B (called under-segmentation by V59) and of B
        without A (over-segmentation), m2.
    relative_difference : Averages
        |A - B| over A.
    dissimilarity : Averages
        Total relative shape dissimilarity: the areas in just one of both, over A.
    completeness, correctness : Averages
        Area in both over A, and over B: the paper's pixel completeness and correctness.
    """

    buildings: int
    reference_m2: float
    difference_m2: float
    reference_only_m2: float
    extracted_only_m2: float
    relative_difference: Averages
    dissimilarity: Averages
    completeness: Averages
    correctness: Averages


def score_shape(found: Overlaps, group_e: Ints, group_r: Ints, count: int) -> ShapeScore:
    """Compare the areas of the matched groups.

    Parameters
    ----------
    found : Overlaps
        The common areas of all objects.
    group_e, group_r : (N,) and (M,) ndarray of int64
        Group of each extracted and of each reference object, -1 for none.
    count : int
        Number of groups.
    """
    same = (group_e[found.extracted] == group_r[found.reference]) & (group_e[found.extracted] >= 0)
    both = sums(group_e[found.extracted[same]] + 1, found.common_m2[same], count)
    a = sums(group_r + 1, found.reference_m2, count)
    b = sums(group_e + 1, found.extracted_m2, count)
    difference, a_only, b_only = np.abs(a - b), a - both, b - both
    return ShapeScore(
        buildings=count,
        reference_m2=_mean(a),
        difference_m2=_mean(difference),
        reference_only_m2=_mean(a_only),
        extracted_only_m2=_mean(b_only),
        relative_difference=averages(difference, a),
        dissimilarity=averages(a_only + b_only, a),
        completeness=averages(both, a),
        correctness=averages(both, b),
    )


def _mean(values: NDArray[np.float64]) -> float:
    """Return the mean, or NaN for none."""
    return float(values.mean()) if len(values) else math.nan

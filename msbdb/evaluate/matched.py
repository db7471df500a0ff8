"""Differences between matched buildings: distances of their outlines, heights, and shape (V57 to V59)."""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import NDArray

from msbdb.evaluate.agreement import Averages, averages, ratio
from msbdb.evaluate.byobject import Overlaps
from msbdb.grid import GridSpec
from msbdb.labels import sizes, sums
from msbdb.outline.polygons import Geometries

Ints = NDArray[np.int64]


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

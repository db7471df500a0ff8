"""Differences in shape between matched buildings (V57 to V59)."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msbdb.evaluate.metrics import Averages, averages
from msbdb.evaluate.objects import Overlaps
from msbdb.labels import sums

Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class ShapeScore:
    """Areas of the matched buildings, reference A and extracted B; NaN without any.

    Attributes
    ----------
    buildings : int
        Number of matched groups; a group stands for one building.
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

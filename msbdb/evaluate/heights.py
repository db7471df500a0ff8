"""Differences in height between matched buildings."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msbdb.evaluate.objects import Overlaps
from msbdb.labels import sums


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

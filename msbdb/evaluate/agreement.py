"""Completeness, correctness and quality by their usual definitions, and the agreement by area.

Vu et al. 2009 (V55), Mongus et al. 2013 (M25), the adaptive filter's slides (S9) and Cao & Wu (C21) mean the same three
numbers. In print, Cao & Wu swap two of the names (A16).
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Rates:
    """Shares of what was found and of what is true; NaN where the divisor is 0.

    Attributes
    ----------
    completeness : float
        Share of the reference that was found, TP / (TP + FN).
    correctness : float
        Share of what was extracted that is true, TP / (TP + FP).
    quality : float
        See `quality`.
    omission, commission : float
        1 - completeness and 1 - correctness (A20).
    """

    completeness: float
    correctness: float
    quality: float
    omission: float
    commission: float


@dataclass(frozen=True, slots=True)
class Averages:
    """A relative measure over many buildings, in both readings (A21).

    Attributes
    ----------
    micro : float
        The ratio of the sums: large buildings weigh more.
    macro : float
        The mean of the ratios: every building weighs the same.
    """

    micro: float
    macro: float


def rates(*, found: float, missed: float, true: float, false: float) -> Rates:
    """Return the rates of counts or areas that were taken on both sides (V55).

    Parameters
    ----------
    found, missed : float
        Reference: true positives as the reference counts them, and false negatives.
    true, false : float
        Extracted: true positives as the extraction counts them, and false positives. Areas have ``true == found``.
    """
    completeness = ratio(found, found + missed)
    correctness = ratio(true, true + false)
    return Rates(completeness, correctness, quality(completeness, correctness), 1 - completeness, 1 - correctness)


def quality(completeness: float, correctness: float) -> float:
    """Return Cm Cr / (Cm - Cm Cr + Cr) (S9), the same as (1/Cm + 1/Cr - 1)^-1 (M25).

    With the same true positives on both sides it is TP / (TP + FP + FN), the intersection over the union. It is 0
    when either rate is 0, and NaN when one is not defined and the other not 0.
    """
    if 0 in (completeness, correctness):
        return 0.0
    product = completeness * correctness
    return product / (completeness - product + correctness)


def ratio(part: float, whole: float) -> float:
    """Return part / whole, or NaN where the whole is 0."""
    return part / whole if whole else math.nan


def averages(parts: NDArray[np.float64], wholes: NDArray[np.float64]) -> Averages:
    """Return the ratio of the sums and the mean of the ratios of (N,) parts and positive wholes; NaN for none."""
    if not len(parts):
        return Averages(math.nan, math.nan)
    return Averages(ratio(float(parts.sum()), float(wholes.sum())), float(np.mean(parts / wholes)))


def plain(value: Any) -> Any:  # noqa: ANN401 (nested values of any plain type)
    """Return the value with None in the place of NaN, at every depth."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    return None if isinstance(value, float) and math.isnan(value) else value


def flat(values: dict[str, Any], prefix: str = "") -> list[tuple[str, float | None]]:
    """Return the leaves of nested values with their names joined by dots; those of 'rates' go by their own names."""
    leaves: list[tuple[str, float | None]] = []
    for name, value in values.items():
        if isinstance(value, dict):
            leaves += flat(value, prefix if name == "rates" else f"{prefix}{name}.")
        else:
            leaves.append((prefix + name, value))
    return leaves


@dataclass(frozen=True, slots=True)
class AreaScore:
    """Areas in m2, and their rates; the quality is the intersection over the union of the cells."""

    scored_m2: float
    reference_m2: float
    extracted_m2: float
    both_m2: float
    reference_only_m2: float
    extracted_only_m2: float
    rates: Rates


def score_area(extracted: Mask, reference: Mask, scored: Mask, cell_area_m2: float) -> AreaScore:
    """Compare the cells of buildings (V57, S11, M25, C21).

    Parameters
    ----------
    extracted, reference : (H, W) ndarray of bool
        Cells that are building.
    scored : (H, W) ndarray of bool
        The other cells are left out.
    cell_area_m2 : float
        Area of a cell, m2.
    """
    both = int(np.count_nonzero(extracted & reference & scored)) * cell_area_m2
    extracted_m2 = int(np.count_nonzero(extracted & scored)) * cell_area_m2
    reference_m2 = int(np.count_nonzero(reference & scored)) * cell_area_m2
    return AreaScore(
        scored_m2=int(np.count_nonzero(scored)) * cell_area_m2,
        reference_m2=reference_m2,
        extracted_m2=extracted_m2,
        both_m2=both,
        reference_only_m2=reference_m2 - both,
        extracted_only_m2=extracted_m2 - both,
        rates=rates(found=both, missed=reference_m2 - both, true=both, false=extracted_m2 - both),
    )

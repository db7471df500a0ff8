"""Completeness, correctness and quality by their usual definitions; the agreement by area, and by point (C20, C21).

Vu et al. 2009 (V55), Mongus et al. 2013 (M25), the adaptive filter's slides (S9) and Cao & Wu (C21) mean the same three
numbers. In print, Cao & Wu swap two of the names (A16).
"""

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from msbdb.errors import CRSError, InputError, NodataError
from msbdb.evaluate.reference import horizontal
from msbdb.points.cloud import PointCloud

Mask = NDArray[np.bool_]

WITHIN_M = 0.01
"""Two points are the same within this distance: more than a coordinate's rounding, less than a scanner's spacing."""


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


@dataclass(frozen=True, slots=True)
class PrintedRates:
    """The two columns as the paper prints them (C21): its names are swapped (A16).

    Attributes
    ----------
    correctness : float
        TP / (TP + FN), the usual completeness.
    completeness : float
        TP / (TP + FP), the usual correctness.
    """

    correctness: float
    completeness: float


@dataclass(frozen=True, slots=True)
class PointScores:
    """Points on which two classifications agree and differ, and their rates.

    Attributes
    ----------
    tp, fp, fn, tn : int
        Points that are building on both sides, for the prediction alone, for the truth alone, and on neither side.
    rates : Rates
        By the usual definitions.
    cao_wu_columns : PrintedRates
        The same numbers under the paper's names, for comparison with its tables.
    """

    tp: int
    fp: int
    fn: int
    tn: int
    rates: Rates
    cao_wu_columns: PrintedRates

    @classmethod
    def of(cls, *, tp: int, fp: int, fn: int, tn: int) -> "PointScores":
        """Return counts with their rates."""
        usual = rates(found=tp, missed=fn, true=tp, false=fp)
        printed = PrintedRates(correctness=usual.completeness, completeness=usual.correctness)
        return cls(tp, fp, fn, tn, usual, printed)


def percent(share: float) -> str:
    """Return a share in per cent for people; one that is not all of it is never rounded up to 100.

    Examples
    --------
    >>> percent(0.832), percent(0.9996), percent(1.0), percent(float("nan"))
    ('83 %', '99.9 %', '100 %', 'unknown')
    """
    if math.isnan(share):
        return "unknown"
    whole = round(100 * share)
    if whole in (0, 100) and share not in (0.0, 1.0):
        return f"{min(max(100 * share, 0.1), 99.9):.1f} %"
    return f"{whole} %"


@dataclass(frozen=True, slots=True)
class PointEvaluation:
    """A comparison by point.

    Attributes
    ----------
    matched : str
        How each point of the reference was matched: ``order``, ``coordinates`` or ``footprints``.
    points : PointScores
        The counts and rates.
    """

    matched: str
    points: PointScores

    def as_dict(self) -> dict[str, Any]:
        """Return the measures as nested plain values for JSON; None where a measure is not defined."""
        values: dict[str, Any] = plain(asdict(self))
        return values

    @property
    def sentences(self) -> tuple[str, str, str]:
        """How good it is, for people: all points, those of the reference, and those found."""
        found, rates = self.points, self.points.rates
        every = found.tp + found.fp + found.fn + found.tn
        wrong = found.fp + found.fn
        return (
            f"Points: {percent(rates.quality)} quality. {percent(1 - wrong / every if every else math.nan)} of "
            f"{every:,} points have the right class.",
            f"Of {found.tp + found.fn:,} building points {percent(rates.completeness)} are found.",
            f"Of {found.tp + found.fp:,} points found {percent(rates.correctness)} are buildings.",
        )

    def rows(self) -> list[tuple[str, str, float | None]]:
        """Return (section, measure, value) of every measure, in order, for tables."""
        return [("points", name, value) for name, value in flat(self.as_dict()["points"])]


def score_points(predicted: Mask, truth: Mask) -> PointScores:
    """Compare two classifications of the same points (C21).

    Parameters
    ----------
    predicted, truth : (N,) ndarray of bool
        Which points are building.

    Raises
    ------
    InputError
        When the lengths differ.
    """
    if predicted.shape != truth.shape:
        msg = f"The prediction has {predicted.size} points, the truth {truth.size}; they must be the same points."
        raise InputError(msg)
    tp = int(np.count_nonzero(predicted & truth))
    fp, fn = int(np.count_nonzero(predicted)) - tp, int(np.count_nonzero(truth)) - tp
    return PointScores.of(tp=tp, fp=fp, fn=fn, tn=predicted.size - tp - fp - fn)


def match_points(predicted: PointCloud, reference: PointCloud) -> tuple[NDArray[np.int64], str]:
    """Find each point of a reference in a prediction.

    Parameters
    ----------
    predicted, reference : PointCloud
        The same points in one CRS, in any order.

    Returns
    -------
    index : (N,) ndarray of int64
        For each point of the reference, its place in the prediction.
    matched : {'order', 'coordinates'}
        In order, where the coordinates agree so within ``WITHIN_M``; otherwise the nearest point that close.

    Raises
    ------
    CRSError
        When the CRS differ.
    InputError
        When a point on either side has no partner.

    Notes
    -----
    Where several points of the prediction share a place, any of them may be
    matched. Cost: linear in order, N log N by coordinates.
    """
    if horizontal(predicted.crs) != horizontal(reference.crs):
        msg = f"The points are in '{predicted.crs.name}', the reference in '{reference.crs.name}'; reproject one."
        raise CRSError(msg)
    if not len(reference):
        msg = "The reference holds no points. Give a file of the evaluated place."
        raise NodataError(msg)
    if len(predicted) == len(reference) and _agree(predicted, reference):
        return np.arange(len(reference), dtype=np.int64), "order"
    ours, theirs = (np.column_stack((cloud.x, cloud.y, cloud.z)) for cloud in (predicted, reference))
    index, lost = _nearest(ours, theirs)
    _, added = _nearest(theirs, ours)
    if lost or added:
        msg = (
            f"{lost} of {len(theirs)} points of the reference have no point within {100 * WITHIN_M:g} cm among those "
            f"to evaluate, and {added} of {len(ours)} the other way round. Compare files of the same points."
        )
        raise InputError(msg)
    return index, "coordinates"


def _agree(one: PointCloud, other: PointCloud) -> bool:
    """Return whether points of the same number are the same, one by one."""
    apart = sum((getattr(one, axis) - getattr(other, axis)) ** 2 for axis in "xyz")
    return bool((apart <= WITHIN_M**2).all())


def _nearest(among: NDArray[np.float64], points: NDArray[np.float64]) -> tuple[NDArray[np.int64], int]:
    """Return the index of the nearest of some points to each of others, and how many have none."""
    # The tree excludes the largest distance itself.
    distance, index = cKDTree(among).query(points, distance_upper_bound=np.nextafter(WITHIN_M, 1.0), workers=-1)
    return index.astype(np.int64), int(np.count_nonzero(~np.isfinite(distance)))

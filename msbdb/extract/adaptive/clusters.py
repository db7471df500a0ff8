"""Stepwise clustering: the tree of single linkage cut at shorter and shorter distances, by harder thresholds (S6)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msbdb.extract.adaptive.points import OffGround
from msbdb.extract.adaptive.vegetation import Structure
from msbdb.labels import Labels
from msbdb.morphology.points import linked
from msbdb.order import order_of_points
from msbdb.params import AdaptiveParams

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

UPPER = 0.9
"""Share of a cluster's points below the height that is compared with the threshold."""


@dataclass(frozen=True, slots=True)
class Step:
    """One step: the distance of the cut, metres, and the least that a cluster must have."""

    distance_m: float
    points: float
    area_m2: float
    height_m: float
    width_m: float
    level: float
    level_per_split: float


def ladder(params: AdaptiveParams, spacing_m: float) -> list[Step]:
    """Return the steps; each value goes evenly from the first one given to the last."""
    shares = np.linspace(0, 1, params.steps) if params.steps > 1 else np.ones(1)

    def at(values: tuple[float, ...], share: float) -> float:
        return float(values[0] + share * (values[-1] - values[0]))

    return [
        Step(
            max(at(params.link_factors, share) * spacing_m, params.link_least_m),
            at(params.points, share),
            at(params.area_m2, share),
            at(params.height_m, share),
            at(params.width_m, share),
            at(params.level_shares, share),
            at(params.level_per_split, share),
        )
        for share in shares.tolist()
    ]


def cluster(points: OffGround, chosen: Mask, distance_m: float) -> tuple[Labels, int]:
    """Cut the tree of single linkage: clusters are the connected components of points nearer than the distance.

    Returns labels 1 to count in the order of the clusters' first points, 0 for points that are not chosen.
    """
    inside = np.flatnonzero(chosen)
    labels = np.zeros(len(points), dtype=np.int32)
    if not inside.size:
        return labels, 0
    labels[inside], count = linked(points.x[inside], points.y[inside], points.z[inside], distance_m)
    return labels, count


def judge(points: OffGround, found: Structure, labels: Labels, count: int, step: Step) -> NDArray[np.object_]:
    """Return for each cluster the first threshold that it fails, in words; empty where it passes all."""
    inside = np.flatnonzero(labels)
    member = labels[inside] - 1
    size = np.bincount(member, minlength=count)
    area = np.bincount(member, points.area_m2[inside], count)
    height = upper_heights(points.heights[inside], member, size)
    width = widths(points.x[inside], points.y[inside], member, size)
    level = np.bincount(member, found.level[inside], count) / np.maximum(size, 1)
    split = np.bincount(member, found.split[inside], count) / np.maximum(size, 1)
    fails = (
        (size < step.points, f"fewer than {step.points:g} points"),
        (area < step.area_m2, f"less than {step.area_m2:g} m2"),
        (height < step.height_m, f"lower than {step.height_m:g} m"),
        (width < step.width_m, f"narrower than {step.width_m:g} m"),
        (level < step.level, f"level to less than {step.level:g}"),
        (level < step.level_per_split * split, f"less than {step.level_per_split:g} times as level as split"),
    )
    reasons = np.full(count, "", dtype=object)
    for broken, words in reversed(fails):
        reasons[broken] = words
    return reasons


def upper_heights(heights: Floats, member: NDArray[np.int32], size: NDArray[np.int64]) -> Floats:
    """Return the height that `UPPER` of each cluster's points do not exceed, metres."""
    order = order_of_points(heights, heights, group=member)
    first = np.cumsum(size) - size
    place = first + np.maximum(np.ceil(UPPER * size).astype(np.int64) - 1, 0)
    return np.asarray(heights[order][place])


def widths(x: Floats, y: Floats, member: NDArray[np.int32], size: NDArray[np.int64]) -> Floats:
    """Return the shorter side of the rectangle with the same second moments as each cluster's points, metres."""
    count, number = len(size), np.maximum(size, 1)
    dx = x - (np.bincount(member, x, count) / number)[member]
    dy = y - (np.bincount(member, y, count) / number)[member]
    xx, yy, xy = (np.bincount(member, product, count) / number for product in (dx * dx, dy * dy, dx * dy))
    least = (xx + yy) / 2 - np.hypot((xx - yy) / 2, xy)
    return np.asarray(np.sqrt(12 * np.maximum(least, 0)))

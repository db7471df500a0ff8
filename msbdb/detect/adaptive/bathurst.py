"""The adaptive detector: off-ground points without vegetation, clustered step by step (slides, S6).

The clusters are those of single linkage, cut at shorter and shorter distances. At each step clusters that fail harder
thresholds are dropped.
"""

import logging
from dataclasses import dataclass

import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from msbdb.detect.adaptive.offground import (
    GREEN,
    SCATTERED,
    OffGround,
    SurfaceEvidence,
    classify_vegetation,
    off_ground,
    structure,
)
from msbdb.detect.pointregions import (
    Candidates,
    PlacedPoints,
    PointLedger,
    describe_candidates,
    detect_on_points,
    in_order_of_ids,
    strings_of_points,
)
from msbdb.detect.scene import Regions, Scene
from msbdb.grid import GridSpec
from msbdb.labels import Labels, renumber
from msbdb.order import order_of_points
from msbdb.params import AdaptiveParams, Params
from msbdb.points.aside import let_go
from msbdb.points.cloud import PointCloud
from msbdb.points.linkage import linked
from msbdb.points.nearest import nearest_in_plan

logger = logging.getLogger(__name__)

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

UPPER = 0.9
"""Share of a cluster's points below the height that is compared with the threshold."""

METHOD = "adaptive"
RULE = "clustering"
VEGETATION = "vegetation"
KINDS = {GREEN: "NDVI of vegetation", SCATTERED: "scattered surface or split echoes, as of crowns"}

NEAREST = 4
"""A point returns to one of so many nearest points of regions, the nearest of like height."""


@dataclass(frozen=True, slots=True)
class ClusterStep:
    """One step: the distance of the cut, metres, and the least that a cluster must have."""

    distance_m: float
    points: float
    area_m2: float
    height_m: float
    width_m: float
    level: float
    level_per_split: float


def detect_adaptive(scene: Scene, params: Params) -> Regions:
    """Detect candidate regions among the points of a scene (S6): the detector ``adaptive``.

    Parameters
    ----------
    scene : Scene
        With points and a surface.
    params : Params
        Sections ``adaptive``, ``surface``, ``ground`` and ``vector``.

    Returns
    -------
    Regions
        The table has the columns of ``tables.CANDIDATE_REGION`` and outlines.
    """
    return detect_on_points(extract_adaptive, scene, params)


def extract_adaptive(
    cloud: PointCloud,
    heights: NDArray[np.float64],
    *,
    spec: GridSpec,
    survey: str,
    params: Params,
    ndvi: NDArray[np.float32] | None = None,
    noise_m: NDArray[np.float32] | None = None,
    recorded: NDArray[np.float32] | None = None,
) -> Candidates:
    """Detect the clusters of off-ground points that may be buildings.

    Parameters
    ----------
    cloud : PointCloud
        All echoes, N points.
    heights : (N,) ndarray of float64, metres
        Above ground, by any ground filter; that of the slides is ``ground_filter = adaptive`` (S3 to S5).
    spec : GridSpec
        The survey's lattice, from which regions take their ids; points may lie outside of it.
    survey : str
        Name of the survey; part of the ids.
    params : Params
        Sections ``adaptive`` and, of ``surface``, the mask.
    ndvi : (N,) ndarray of float32, optional
        NDVI of each point, NaN where it has none.
    noise_m : (N,) ndarray of float32, optional
        What noise adds to the residuals of planes at each point, metres.
    recorded : (N,) ndarray of float32, optional
        How far later echoes were recorded around each point, from 0 to 1.

    Returns
    -------
    Candidates
        Possibly without regions.

    Raises
    ------
    InputError
        When an array does not fit the points, or a coordinate or height is not finite.

    Notes
    -----
    1. Points at or above the mask are off-ground.
    2. Vegetation is removed point by point: by NDVI where there is one (S6), and by surface and echoes. The second
       is ours, since NDVI alone is not reliable, and most surveys have no colours.
    3. The other points are clustered by Euclidean distance, step by step at shorter distances. Each step drops the
       clusters that fail its thresholds on number of points, area, height and surface (S6). The slides give no
       values; ours follow from the spacing.
    4. Off-ground points at the edge of a region become its points again: eaves split pulses as crowns do.

    The result does not depend on the order of the points. Border: what lies outside of the cloud does not exist.
    O(N) in time at a given density, but for sorting.
    """
    own = params.adaptive
    given = [heights]
    del heights  # so that nobody else holds them
    points = off_ground(cloud, given.pop(), ndvi, noise_m, recorded=recorded, spec=spec, mask_m=params.surface.mask_m)
    del ndvi, noise_m, recorded
    let_go()
    placed = points.placed(spec, survey)
    ledger = PointLedger(METHOD, placed, params.fuse.piece_m2)
    found = structure(points, own)
    steps = ladder(own, points.spacing_m, points.step_m)
    labels, count = _without_vegetation(points, found, own, steps[0], ledger)
    for number, step in enumerate(steps, start=1):
        labels, count = _tightened(points, found, (labels, count), (number, step), ledger)
    del found
    let_go()
    labels = regain(points, labels, reach_m=own.regain_factor * points.spacing_m, step_m=own.regain_step_m)
    let_go()
    regions = describe(points, labels, count, placed)
    logger.info(
        "adaptive found %d regions among %d points above ground; they are %.2f m apart",
        count,
        len(points),
        points.spacing_m,
    )
    return in_order_of_ids(labels, regions, points.index, len(cloud), ledger)


def _without_vegetation(
    points: OffGround, found: SurfaceEvidence, params: AdaptiveParams, step: ClusterStep, ledger: PointLedger
) -> tuple[Labels, int]:
    """Cluster what is no vegetation, and record the clusters of what is."""
    kind = classify_vegetation(points, found, params)
    dropped = 0
    for number, reason in KINDS.items():
        lost, lost_count = cluster(points, kind == number, step.distance_m)
        dropped += ledger.reject(VEGETATION, np.full(lost_count, reason, dtype=object), lost, number)
    labels, count = cluster(points, kind == 0, step.distance_m)
    ledger.count(VEGETATION, count + dropped, count, dropped)
    return labels, count


def _tightened(
    points: OffGround,
    found: SurfaceEvidence,
    clusters: tuple[Labels, int],
    step: tuple[int, ClusterStep],
    ledger: PointLedger,
) -> tuple[Labels, int]:
    """Cut the clusters, which are labels and their number, at the step's distance, and drop those that fail."""
    (labels, count), (number, values) = clusters, step
    stage = f"step {number}"
    pieces = labels, count
    if number > 1:
        pieces = cluster(points, labels > 0, values.distance_m)
    reasons = judge(points, found, *pieces, values)
    lost = reasons != ""
    rejected, _ = renumber(pieces[0], lost)
    dropped = ledger.reject(stage, reasons[lost], rejected, len(KINDS) + number)
    kept, left = renumber(pieces[0], ~lost)
    ledger.count(stage, count, left, dropped, pieces=pieces[1] - count)
    return kept, left


def ladder(params: AdaptiveParams, spacing_m: float, step_m: float = 0.0) -> list[ClusterStep]:
    """Return the steps; each value goes evenly from the first one given to the last. No link is below ``step_m``.

    Examples
    --------
    >>> steps = ladder(AdaptiveParams(steps=3, link_factors=(3.0, 2.0), points=(10.0, 30.0)), spacing_m=1.0)
    >>> [(step.distance_m, step.points) for step in steps]
    [(3.0, 10.0), (2.5, 20.0), (2.0, 30.0)]
    """
    shares = np.linspace(0, 1, params.steps) if params.steps > 1 else np.ones(1)

    def at(values: tuple[float, ...], share: float) -> float:
        return float(values[0] + share * (values[-1] - values[0]))

    return [
        ClusterStep(
            max(at(params.link_factors, share) * spacing_m, params.link_least_m, step_m),
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
    return linked(points.x, points.y, points.z, distance_m, chosen)


def judge(
    points: OffGround, found: SurfaceEvidence, labels: Labels, count: int, step: ClusterStep
) -> NDArray[np.object_]:
    """Return for each cluster the first threshold that it fails, in words; empty where it passes all."""
    inside = np.flatnonzero(labels != 0)
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
    """Return the shorter side of the rectangle with the same second moments as each cluster's points, metres.

    Examples
    --------
    A wall of 101 by 3 points at 0.1 m, whose points reach half a spacing beyond their places:

    >>> y, x = np.mgrid[0:3, 0:101].reshape(2, -1) / 10
    >>> widths(x, y, np.zeros(303, dtype=np.int32), np.array([303])).round(2)
    array([0.28])
    """
    count, number = len(size), np.maximum(size, 1)
    dx = x - (np.bincount(member, x, count) / number)[member]
    dy = y - (np.bincount(member, y, count) / number)[member]
    xx, yy, xy = (np.bincount(member, product, count) / number for product in (dx * dx, dy * dy, dx * dy))
    least = (xx + yy) / 2 - np.hypot((xx - yy) / 2, xy)
    return np.asarray(np.sqrt(12 * np.maximum(least, 0)))


def regain(points: OffGround, labels: Labels, *, reach_m: float, step_m: float) -> Labels:
    """Return labels in which points at the edges belong to the region near them in plan and of like elevation."""
    inside, outside = np.flatnonzero(labels != 0), np.flatnonzero(labels == 0)
    if not inside.size or not outside.size or reach_m == 0:
        return labels
    tree = cKDTree(np.column_stack((points.x[inside], points.y[inside])))
    result = labels.copy()
    for asking, _, nearest in nearest_in_plan(tree, (points.x, points.y), outside, NEAREST, reach_m):
        there = nearest < inside.size
        source = inside[np.where(there, nearest, 0)]
        fits = there & (np.abs(points.z[source] - points.z[asking, None]) <= step_m)
        some = fits.any(axis=1)
        chosen = source[np.arange(asking.size), np.argmax(fits, axis=1)]
        result[asking[some]] = labels[chosen[some]]
    return result


def describe(points: OffGround, labels: Labels, count: int, placed: PlacedPoints) -> pd.DataFrame:
    """Return the rows of labelled regions (``tables.CANDIDATE_REGION``, without geometry), in the labels' order.

    The detector has no edge points: the perimeter is 0, and compactness, linearity and directions are not known.
    """
    mbr = bounding_rectangles(points, labels, count)
    unknown = ("height_scale_m", "compactness", "linearity", "direction_1", "direction_2")
    shape: dict[str, NDArray[np.generic] | str | float] = {
        "rule": RULE,
        "perimeter": 0,
        "mbr_m2": mbr,
        "rectangularity": placed.areas(labels, count) / mbr,
        **dict.fromkeys(unknown, np.nan),
    }
    return describe_candidates(placed, labels, points.heights, points.ndvi, shape, method=METHOD)


def bounding_rectangles(points: OffGround, labels: Labels, count: int) -> Floats:
    """Return the areas of the minimum bounding rectangles, m2.

    Rectangles reach half a spacing beyond the points, as the areas do, so that points in a row have one.
    """
    if not count:
        return np.zeros(0)
    inside = np.flatnonzero(labels != 0)
    lines = strings_of_points(points.x[inside], points.y[inside], labels[inside] - 1)
    hulls = shapely.buffer(shapely.convex_hull(lines), points.spacing_m / 2, join_style="mitre", cap_style="square")
    return np.asarray(shapely.area(shapely.minimum_rotated_rectangle(hulls)))

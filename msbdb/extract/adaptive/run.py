"""The extraction of buildings from off-ground points, from end to end (slides on adaptive filtering, S6 to S8)."""

import logging

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from msbdb.extract.adaptive.clusters import Step, cluster, judge, ladder
from msbdb.extract.adaptive.points import OffGround, off_ground
from msbdb.extract.adaptive.regions import METHOD, describe
from msbdb.extract.adaptive.vegetation import GREEN, SCATTERED, Structure, structure, tell_vegetation
from msbdb.extract.candidates import Candidates
from msbdb.extract.placed import PointBooks
from msbdb.grid import GridSpec
from msbdb.labels import Labels, renumber, reorder
from msbdb.params import AdaptiveParams, Params
from msbdb.pointcloud import PointCloud
from msbdb.threads import cores

logger = logging.getLogger(__name__)

VEGETATION = "vegetation"
KINDS = {GREEN: "NDVI of vegetation", SCATTERED: "scattered surface or split echoes, as of crowns"}

NEAREST = 4
"""So many of the nearest points of regions are asked for one of like height when points are regained."""


def extract_adaptive(
    cloud: PointCloud,
    heights: NDArray[np.float64],
    *,
    spec: GridSpec,
    survey: str,
    params: Params,
    ndvi: NDArray[np.float32] | None = None,
) -> Candidates:
    """Extract the clusters of off-ground points that may be buildings.

    Parameters
    ----------
    cloud : PointCloud
        All echoes, N points.
    heights : (N,) ndarray of float64, metres
        Above ground, by any ground filter; that of the slides is ``ground_filter = adaptive`` (S3 to S5).
    spec : GridSpec
        The survey's lattice, on which the ids stand; points may lie outside of it.
    survey : str
        Name of the survey; part of the ids.
    params : Params
        Sections ``adaptive`` and, of ``surface``, the mask.
    ndvi : (N,) ndarray of float32, optional
        NDVI of each point, NaN where it has none.

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
    2. Vegetation is taken out point by point: by NDVI where there is one, and by surface and echoes (S6; the second
       is ours, since NDVI alone is not reliable, and most surveys have no colours).
    3. What is left is clustered by Euclidean distance, step by step at shorter distances, and clusters that fail
       harder thresholds on number of points, area, height and surface are dropped (S6). The slides give no values;
       ours follow from the spacing.
    4. Off-ground points at the edge of a region become its points again: eaves split pulses as crowns do.

    The result does not depend on the order of the points. Border: what lies outside of the cloud does not exist.
    O(N) in time at a given density, but for sorting.
    """
    own = params.adaptive
    points = off_ground(cloud, heights, ndvi, spec=spec, mask_m=params.surface.mask_m)
    placed = points.placed(spec, survey)
    books = PointBooks(METHOD, placed)
    found = structure(points, own)
    steps = ladder(own, points.spacing_m)
    labels, count = _without_vegetation(points, found, own, steps[0], books)
    for number, step in enumerate(steps, start=1):
        labels, count = _tightened(points, found, (labels, count), (number, step), books)
    labels = regain(points, labels, reach_m=own.regain_factor * points.spacing_m, step_m=own.regain_step_m)
    regions = describe(points, labels, count, placed)
    order = np.argsort(regions["candidate_id"].to_numpy(), kind="stable")
    full = np.zeros(len(cloud), dtype=np.int32)
    full[points.index] = reorder(labels, order, count)
    logger.info("Adaptive: %d regions of %d off-ground points, spacing %.2f m", count, len(points), points.spacing_m)
    return Candidates(METHOD, full, regions.iloc[order].reset_index(drop=True), books.rejections(), books.counts)


def regain(points: OffGround, labels: Labels, *, reach_m: float, step_m: float) -> Labels:
    """Give points at the edges back to regions: those near to one in plan, and of like elevation."""
    inside, outside = np.flatnonzero(labels), np.flatnonzero(labels == 0)
    if not inside.size or not outside.size or reach_m == 0:
        return labels
    place = np.column_stack((points.x, points.y))
    _, nearest = cKDTree(place[inside]).query(place[outside], k=NEAREST, distance_upper_bound=reach_m, workers=cores())
    there = nearest < inside.size
    source = inside[np.where(there, nearest, 0)]
    fits = there & (np.abs(points.z[source] - points.z[outside, None]) <= step_m)
    some = fits.any(axis=1)
    chosen = source[np.arange(outside.size), np.argmax(fits, axis=1)]
    result = labels.copy()
    result[outside[some]] = labels[chosen[some]]
    return result


def _without_vegetation(
    points: OffGround, found: Structure, params: AdaptiveParams, step: Step, books: PointBooks
) -> tuple[Labels, int]:
    """Cluster what is no vegetation, and book the clusters of what is."""
    kind = tell_vegetation(points, found, params)
    dropped = 0
    for number, reason in KINDS.items():
        lost, lost_count = cluster(points, kind == number, step.distance_m)
        dropped += books.reject(VEGETATION, np.full(lost_count, reason, dtype=object), lost, number)
    labels, count = cluster(points, kind == 0, step.distance_m)
    books.count(VEGETATION, count + dropped, count, dropped)
    return labels, count


def _tightened(
    points: OffGround, found: Structure, clusters: tuple[Labels, int], step: tuple[int, Step], books: PointBooks
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
    dropped = books.reject(stage, reasons[lost], rejected, len(KINDS) + number)
    kept, left = renumber(pieces[0], ~lost)
    books.count(stage, count, left, dropped, pieces=pieces[1] - count)
    return kept, left

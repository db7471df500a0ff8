"""Building regions at each height scale h_j, and their union over all heights (Cao & Wu, sections 2.2 and 3.2).

The height scales are local minima of the histogram of heights above ground.
"""

import logging
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from msbdb.detect.area3d.curvature import Reach, grow_regions
from msbdb.detect.area3d.regionshape import Shapes, judge, measure_shapes, reasons_against
from msbdb.detect.pointregions import PlacedPoints, PointLedger
from msbdb.grid import GridSpec
from msbdb.labels import Labels, chosen_cells, region_means, renumber, sizes, sums
from msbdb.params import Area3dParams
from msbdb.points.aside import let_go
from msbdb.points.graph import PointGraph, components, connect

logger = logging.getLogger(__name__)

Mask = NDArray[np.bool_]

KIND = "\0area3d"
"""Follows the survey's name in the ids' keys, so that no region has the id of a part at the same place."""

STAGES = ("fusion", "opening", "curvature", "crowns", "rules")
"""The stages that reject regions, in order."""

BINS = 100
"""Bars of the histogram (C14)."""

BESIDE = 3
"""Bars to the left and to the right that a local minimum is compared with (C14)."""

WITHIN = "within a region accepted at a lower height"
SMALL = "smaller than T_a"
LOOSE = "loose points, fewer than three connected"
LEAVES = "change of curvature or echoes of a crown"
REST = "smaller than T_a beside its crowns"
CROWN = "a crown by its curvature and echoes"
GREEN = "a crown by its NDVI"

LEAST_POINTS = 3
"""Fewer points span no area; those that lie near each other in plan share a row of the ledger."""


def height_scales(heights: NDArray[np.float64], params: Area3dParams, *, mask_m: float) -> tuple[float, ...]:
    """Choose the heights h_j at which regions are detected (C14).

    Parameters
    ----------
    heights : (N,) ndarray of float64, metres
        Heights above ground of all points, finite.
    params : Area3dParams
        ``heights_m`` decides where it is set; otherwise ``most_heights``, ``mask_first`` and the histogram's tail.
    mask_m : float
        What is lower is no building: no scale of the histogram lies below.

    Returns
    -------
    tuple of float
        Ascending, at least one, metres. The single-scale mode is the first of them alone.

    Notes
    -----
    The scales are `histogram_minima` above the mask. If there are more than ``most_heights``, the lowest stay, as in
    the paper, where SS uses the first. Where there is no local minimum above the mask, the mask is the only scale.
    """
    if params.heights_m:
        return tuple(sorted(set(params.heights_m)))[: params.most_heights]
    first = [mask_m] if params.mask_first else []
    found = [h for h in histogram_minima(heights, params.histogram_tail_percent) if h > mask_m]
    return tuple([*first, *found][: params.most_heights]) or (mask_m,)


def histogram_minima(heights: NDArray[np.float64], tail_percent: float = 0.0) -> list[float]:
    """Return the centres of the histogram's local minima, ascending, metres.

    Parameters
    ----------
    heights : (N,) ndarray of float64, metres
        Not modified.
    tail_percent : float
        Share of the heights left out at either end, per cent.

    Notes
    -----
    A bar of the histogram is a local minimum when none of the three bars on either side is lower (C14). Bars without
    three others on both sides are none. Adjoining local minima are equal bars, a plateau. A plateau counts once, by its
    middle, unless no bar beside it is higher.

    Examples
    --------
    Each height h from 0 to 9.9 m occurs |h - 4 m| / 0.1 m + 1 times, so the minimum is at 4 m:

    >>> bars = np.arange(100)
    >>> heights = np.repeat(bars / 10, 1 + np.abs(bars - 40))
    >>> [round(h, 1) for h in histogram_minima(heights)]
    [4.0]
    """
    low, high = np.percentile(heights, (tail_percent, 100 - tail_percent), method="closest_observation")
    if not high > low:
        return []
    counts, bounds = np.histogram(heights, BINS, (low, high))
    windows = np.lib.stride_tricks.sliding_window_view(counts, 2 * BESIDE + 1)
    middle = windows[:, BESIDE]
    lowest = np.pad(middle == windows.min(axis=1), BESIDE + 1)
    below = np.pad(middle < windows.max(axis=1), BESIDE + 1)
    begins = np.flatnonzero(lowest[1:] & ~lowest[:-1])
    ends = np.flatnonzero(lowest[:-1] & ~lowest[1:])
    return [
        float((bounds[begin] + bounds[end]) / 2)
        for begin, end in zip(begins, ends, strict=True)
        if below[begin + 1 : end + 1].any()
    ]


@dataclass(frozen=True, slots=True, eq=False)
class NormalisedCloud:
    """The points in canonical order, as the steps take them.

    Parameters
    ----------
    points : (N, 3) ndarray of float64, metres
        From an origin at a whole kilometre nearby.
    heights : (N,) ndarray of float64, metres
        Above ground.
    area_m2 : (N,) ndarray of float64
        Area of each point.
    several : (N,) ndarray of bool, optional
        Which points are of pulses with several echoes; None without echo numbers.
    echo_trust : (N,) or (1,) ndarray of float32
        The trust in single echoes as a sign of a roof, from 0 to 1; 0 where the source has no echoes.
    ndvi : (N,) ndarray of float64, optional
        NaN where a point has none.
    place : (N,) ndarray of int64
        Row-major number of the point's cell on the lattice.
    origin : (2,) ndarray of float64
        Easting and northing of the points' origin.
    """

    points: NDArray[np.float64]
    heights: NDArray[np.float64]
    area_m2: NDArray[np.float64]
    several: NDArray[np.bool_] | None
    echo_trust: NDArray[np.float32]
    ndvi: NDArray[np.float64] | None
    place: NDArray[np.int64]
    origin: NDArray[np.float64]

    def placed(self, spec: GridSpec, survey: str) -> PlacedPoints:
        """Return the points on a survey's lattice."""
        x, y = self.points[:, 0], self.points[:, 1]
        return PlacedPoints(x, y, self.origin, self.area_m2, self.place, spec, survey + KIND)


@dataclass(frozen=True, slots=True, eq=False)
class OnSets:
    """The input that all height scales of one area scale share.

    Parameters
    ----------
    cloud : NormalisedCloud
        The points in canonical order.
    graph : PointGraph
        Which points are connected (C2).
    levels : (N,) ndarray of uint16
        At how many height scales, from the lowest one, each point is on after opening and closing by area (C6, C7).
    spacing_m : float
        Mean point spacing.
    link_m : float
        T_c, below which points are connected.
    curvature : (N,) ndarray of float64
        Change of curvature (C16), measured on the lowest on-set; 0 elsewhere.
    smooth : (N,) ndarray of bool
        Which points are no crown by their neighbourhood (C16; the echoes are ours).
    params : Area3dParams
        The section of this detector.
    mask_m : float
        Lower points are no building, but for the feet of its walls.
    """

    cloud: NormalisedCloud
    graph: PointGraph
    levels: NDArray[np.uint16]
    spacing_m: float
    link_m: float
    curvature: NDArray[np.float64]
    smooth: Mask
    params: Area3dParams
    mask_m: float

    @property
    def grow_m(self) -> float:
        """Distance in plan within which points return to a region, metres; 0 for none."""
        return max(self.params.grow_m, self.params.grow_spacings * self.spacing_m)

    @property
    def max_crown(self) -> float:
        """Threshold on curvature times echoes: the wider apart the points, the more roofs have a ridge among K."""
        thin_m = self.params.thin_m
        return self.params.max_crown * (max(1.0, self.spacing_m / thin_m) if thin_m > 0 else 1.0)

    def areas(self, labels: Labels, count: int) -> NDArray[np.float64]:
        """Return (count,) the areas of labelled regions, m2 (A17)."""
        return sums(labels, self.cloud.area_m2, count)

    def shapes(self, labels: Labels, count: int) -> Shapes:
        """Measure labelled regions."""
        x, y = self.cloud.points[:, 0], self.cloud.points[:, 1]
        return measure_shapes(
            x, y, labels, count, area_m2=self.cloud.area_m2, spacing_m=self.spacing_m, params=self.params
        )


@dataclass(frozen=True, slots=True, eq=False)
class Accepted:
    """The union of the accepted regions over all area and height scales (C7, C19).

    Parameters
    ----------
    labels : (N,) ndarray of int32
        1 to M; 0 for none.
    rule : (M,) ndarray of int8
        The rule that accepted each region.
    height_m : (M,) ndarray of float64
        The lowest height scale at which it was accepted.
    """

    labels: Labels
    rule: NDArray[np.int8]
    height_m: NDArray[np.float64]


def fuse_over_scales(scenes: tuple[OnSets, ...], scales: tuple[float, ...], ledger: PointLedger) -> Accepted:
    """Judge the regions at each area and height scale, and take the union of the accepted ones (C7, C19).

    Parameters
    ----------
    scenes : tuple of OnSets
        One for each area scale Ta_k, ascending.
    scales : tuple of float
        Height scales h_j, metres, ascending.
    ledger : PointLedger
        Gets what is lost.

    Notes
    -----
    Within one area scale, regions of a higher h_j lie within those of a lower one. So each place is taken by the lowest
    height that accepts it, and higher ones look only at the points left. Larger area scales follow in the same way;
    their union with the smaller ones is ours.
    """
    labels = np.zeros(len(scenes[0].cloud.heights), dtype=np.int32)
    recorded = np.zeros(len(labels), dtype=np.bool_)
    rules, heights = [np.zeros(0, dtype=np.int8)], [np.zeros(0)]
    for number, (scene, (rank, height_m)) in enumerate(product(scenes, enumerate(scales, 1)), 1):
        found, rule = _Level(scene, ledger, number, rank, height_m, labels > 0, recorded).regions()
        before = sum(len(values) for values in rules)
        labels += np.where(found > 0, found + np.int32(before), np.int32(0))
        rules.append(rule)
        heights.append(np.full(len(rule), height_m))
        logger.debug("area3d: %d regions at %.2f m", len(rule), height_m)
    return Accepted(labels, np.concatenate(rules), np.concatenate(heights))


@dataclass(frozen=True, slots=True, eq=False)
class _Level:
    """One height scale of an area scale: its steps, in their order, and what they write into the ledger.

    ``number`` counts from 1 over all scales of areas and heights, ``rank`` over the heights of one area scale.
    ``taken`` are the points of regions that lower scales accepted, ``recorded`` the points of regions that the opening
    removed. Each scale adds its own points to the latter, because the ledger has a region once, at its lowest height.
    """

    scene: OnSets
    ledger: PointLedger
    number: int
    rank: int
    height_m: float
    taken: Mask
    recorded: Mask

    def regions(self) -> tuple[Labels, NDArray[np.int8]]:
        """Return the regions accepted at this height, and the rule that accepted each."""
        scene = self.scene
        left = self.without_absorbed()
        on = (scene.levels >= self.rank) & ~self.taken
        opened = self.without_small(on, *left)
        del left
        labels, count = self.without_crowns(*self.without_leaves(on, opened))
        let_go()
        labels = self.grown(labels)
        let_go()
        shapes = scene.shapes(labels, count)
        rule = judge(shapes, scene.params)
        labels, _ = self.drop("rules", labels, reasons_against(shapes, rule, scene.params))
        return labels, rule[rule > 0]

    def grown(self, labels: Labels) -> Labels:
        """Return the regions with the points beside, below and on them that belong to them (ours)."""
        scene, own = self.scene, self.scene.params
        return grow_regions(
            scene.cloud.points,
            labels,
            (scene.cloud.heights >= min(own.foot_m, scene.mask_m)) & ~self.taken,
            heights=scene.cloud.heights,
            several=scene.cloud.several,
            reach=Reach(scene.grow_m, own.grow_step_m, own.wall_factor, scene.mask_m),
        )

    def without_absorbed(self) -> tuple[Labels, int]:
        """Record the components within accepted regions; return the components of the on-set that are left (C19)."""
        stage, graph, on = "fusion", self.scene.graph, self.scene.cloud.heights >= self.height_m
        others, left = components(on & ~self.taken, graph)
        if not self.taken.any():
            self.ledger.count(stage, left, left, 0)
            return others, left
        _, entered = components(on, graph)
        labels, absorbed = components(on & self.taken, graph)
        self.record(stage, labels, np.ones(absorbed, dtype=np.bool_), WITHIN)
        self.ledger.count(stage, entered, left, absorbed, pieces=left + absorbed - entered)
        return others, left

    def without_small(self, on: Mask, labels: Labels, count: int) -> int:
        """Record the components that the opening removed; return how many are left after AOC (C4 to C6)."""
        stage, graph = "opening", self.scene.graph
        _, opened = components(on, graph)
        lost = sums(labels, on, count) == 0
        lost &= sums(labels, self.recorded, count) == 0
        spans = sizes(labels, count) >= LEAST_POINTS
        dropped = self.record(stage, labels, lost & spans, SMALL)
        dropped += self.record_loose(stage, chosen_cells(labels, lost & ~spans))
        self.recorded[chosen_cells(labels, lost)] = True
        self.ledger.count(stage, count, opened, dropped, pieces=opened + dropped - count)
        return opened

    def without_leaves(self, on: Mask, entered: int) -> tuple[Labels, int]:
        """Remove the points of crowns, and components smaller than T_a without them (C16); return the regions left."""
        stage, scene, smooth = "curvature", self.scene, self.scene.smooth
        labels, count = components(on & smooth, scene.graph)
        large = scene.areas(labels, count) >= scene.params.smallest_m2
        dropped = self.record(stage, labels, ~large, REST)
        if self.number == 1:  # crowns at higher scales lie within those of the lowest
            leaves, number = components(on & ~smooth, scene.graph)
            dropped += self.record(stage, leaves, np.ones(number, dtype=np.bool_), LEAVES)
        labels, kept = renumber(labels, large)
        self.ledger.count(stage, entered, kept, dropped, pieces=kept + dropped - entered)
        return labels, kept

    def without_crowns(self, labels: Labels, count: int) -> tuple[Labels, int]:
        """Drop the regions that are crowns as a whole (ours): by curvature and echoes together, and by NDVI.

        The less single echoes are trusted, the more the curvature alone decides.
        """
        cloud, own = self.scene.cloud, self.scene.params
        curvature = region_means(self.scene.curvature, labels, count)
        trust = cloud.echo_trust if len(cloud.echo_trust) == 1 else region_means(cloud.echo_trust, labels, count)
        crown = curvature * (1 - trust) > own.max_crown_curvature
        if cloud.several is not None:
            crown |= curvature * region_means(cloud.several, labels, count) > self.scene.max_crown
        reasons = np.where(crown, CROWN, "").astype(object)
        if cloud.ndvi is not None:
            reasons[~crown & (region_means(cloud.ndvi, labels, count) > own.max_ndvi)] = GREEN
        return self.drop("crowns", labels, reasons)

    def drop(self, stage: str, labels: Labels, reasons: NDArray[np.object_]) -> tuple[Labels, int]:
        """Write the regions that have a reason into the ledger, and number the others anew."""
        lost = reasons != ""
        rejected, dropped = renumber(labels, lost)
        self.reject(stage, reasons[lost], rejected)
        kept, left = renumber(labels, ~lost)
        self.ledger.count(stage, len(reasons), left, dropped)
        return kept, left

    def record(self, stage: str, labels: Labels, chosen: Mask, reason: str) -> int:
        """Write the chosen regions into the ledger with one reason; return how many."""
        rejected, dropped = renumber(labels, chosen)
        return self.reject(stage, np.full(dropped, reason, dtype=object), rejected)

    def record_loose(self, stage: str, loose: Mask) -> int:
        """Write loose points into the ledger, a row for those that are no farther than T_c apart in plan."""
        index = np.flatnonzero(loose)
        x, y = (np.ascontiguousarray(self.scene.cloud.points[index, axis]) for axis in range(2))
        near = connect(x, y, np.zeros(len(index)), self.scene.link_m)
        found, count = components(np.ones(len(index), dtype=np.bool_), near)
        labels = np.zeros(len(loose), dtype=np.int32)
        labels[index] = found
        return self.record(stage, labels, np.ones(count, dtype=np.bool_), LOOSE)

    def reject(self, stage: str, reasons: NDArray[np.object_], labels: Labels) -> int:
        """Write labelled regions into the ledger; return how many."""
        number = len(STAGES) * self.number + STAGES.index(stage) + 1
        return self.ledger.reject(stage, reasons, labels, number, scale=self.number)

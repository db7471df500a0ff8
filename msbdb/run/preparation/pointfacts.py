"""What holds for all points of a survey: their spacing and echoes, from the whole of it or from several blocks."""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from msbdb.errors import give_notice
from msbdb.params import Params
from msbdb.points.cloud import GROUND_CLASS, PointCloud
from msbdb.points.laterechoes import numbered_by_place, under_distance
from msbdb.points.lonepoints import LONE_GAP_Z_M, levels_of
from msbdb.points.lots import kept_of, thinned
from msbdb.points.spacing import SPARSE_SHARE, measure_spacings
from msbdb.surface.gridding import density
from msbdb.surveyplan import PointFacts
from msbdb.threads import together

THINNED = (
    "Where first echoes are denser than surface.most_density, a share of the points was left out, by lot. "
    "The values of the detectors were not judged on denser ones."
)
"""Without numbers, so that the tiles of a build agree in it."""

UNEVEN = (
    "A part of the ground has far fewer points than the rest. The cells, and the distances by which points are linked, "
    "follow from the spacing of that part. A build of the denser part by itself has smaller cells."
)
"""As `THINNED`."""

DENSER = 2.0
"""Ours, in sample: places that are denser by more than this keep a share of their points; 2, 3 and 100 do alike."""

Heights = NDArray[np.float64]


def with_facts(cloud: PointCloud, most_density: float) -> PointCloud:
    """Return a cloud that knows what holds for all its points.

    Echoes without numbers are numbered by their place; then what is denser than ``most_density`` is thinned.
    """
    if cloud.facts is None:
        cloud, under_m = with_later_echoes(cloud)
        cloud, facts = sparse_enough(cloud, under_m, most_density)
        return replace(cloud, facts=facts)
    if cloud.facts.under_m:
        cloud = numbered_by_place(cloud, cloud.facts.under_m)
    return thinned(cloud, most_density)


def sparse_enough(cloud: PointCloud, under_m: float, most_density: float) -> tuple[PointCloud, PointFacts]:
    """Return a cloud that is nowhere denser than asked, and what holds for all its points."""
    kept = kept_of(cloud, most_density)
    all_kept = bool(kept.all())

    def measure() -> tuple[float, float, float, float]:
        first = cloud.first_echo if all_kept else cloud.first_echo & kept
        return measure_spacings(cloud.x[first], cloud.y[first])

    fewer, spacings = together(lambda: cloud if all_kept else cloud.take(kept), measure)
    facts = _facts_of(fewer, spacings, under_m)
    if fewer is not cloud:
        facts = replace(facts, all_density=density(cloud, facts.link_m))
    return fewer, facts


def with_later_echoes(cloud: PointCloud) -> tuple[PointCloud, float]:
    """Return a whole survey whose later echoes are known, and the distance within which they lie under others."""
    under_m = under_distance(cloud)
    return (numbered_by_place(cloud, under_m) if under_m else cloud), under_m


def _facts_of(cloud: PointCloud, spacings: tuple[float, float, float, float], under_m: float) -> PointFacts:
    """Return what holds for all points of a cloud; the spacings and ``under_m`` were found before.

    Raises
    ------
    NodataError
        When there is no first echo.
    """
    spacing_m, typical_m, link_m, sparse_m = spacings
    points_m2 = density(cloud, link_m)
    return PointFacts(
        points=len(cloud),
        density=points_m2,
        all_density=points_m2,
        spacing_m=spacing_m,
        typical_m=typical_m,
        sparse_m=sparse_m,
        link_m=link_m,
        numbered=cloud.return_number is not None,
        echoes=cloud.has_echoes,
        crown_split=None,
        under_m=under_m,
        ground_share=float(np.count_nonzero(cloud.in_class(GROUND_CLASS))) / max(len(cloud), 1),
        colours=cloud.colour_names,
        intensity=cloud.intensity is not None,
        levels_m=levels_of(cloud.z),
    )


def joined_facts(facts: Sequence[PointFacts]) -> PointFacts:
    """Return what holds for the points of several blocks together.

    The density is that of their covered ground. Of the typical spacings and of the links the median counts, and of the
    sparser parts the same quantile as within a block, by covered ground.
    """
    if len(facts) == 1:
        return facts[0]
    points = sum(each.points for each in facts)
    # A block covers as many square metres as its points fill at its spacing, but for later echoes.
    covered = np.array([each.points * each.spacing_m**2 for each in facts])

    def quantile(share: float, values: list[float]) -> float:
        order = np.argsort(values, kind="stable")
        return values[int(order[np.searchsorted(np.cumsum(covered[order]), covered.sum() * share)])]

    names = [name for name in ("red", "green", "blue", "nir") if any(name in each.colours for each in facts)]
    return PointFacts(
        points=points,
        density=points / sum(each.points / each.density for each in facts),
        all_density=sum(each.points / each.density * each.all_density for each in facts)
        / sum(each.points / each.density for each in facts),
        spacing_m=math.sqrt(float(covered.sum()) / points),
        typical_m=quantile(0.5, [each.typical_m for each in facts]),
        sparse_m=quantile(SPARSE_SHARE, [each.sparse_m for each in facts]),
        link_m=quantile(0.5, [each.link_m for each in facts]),
        numbered=any(each.numbered for each in facts),
        echoes=any(each.echoes for each in facts),
        crown_split=None,
        under_m=max(each.under_m for each in facts),
        ground_share=sum(each.ground_share * each.points for each in facts) / points,
        colours=tuple(names),
        intensity=any(each.intensity for each in facts),
        levels_m=_joined_levels([each.levels_m for each in facts]),
    )


def _joined_levels(levels: Sequence[tuple[tuple[float, float], ...]]) -> tuple[tuple[float, float], ...]:
    """Return the groups of elevations of several blocks, those joined that no wide gap separates."""
    found: list[tuple[float, float]] = []
    for low, high in sorted(chain.from_iterable(levels)):
        if found and low <= found[-1][1] + LONE_GAP_Z_M:
            found[-1] = (found[-1][0], max(found[-1][1], high))
        else:
            found.append((low, high))
    return tuple(found)


def sparse_with_facts(cloud: PointCloud | None, params: Params) -> PointCloud | None:
    """Return a cloud that knows what holds for all its points, and give notice if some were left out; None for None."""
    if cloud is None:
        return None
    found = with_facts(cloud, params.surface.most_density)
    if len(found) < len(cloud):
        give_notice(THINNED)
    return found


def evenly_dense(cloud: PointCloud, above: Heights | None) -> tuple[PointCloud, Heights | None]:
    """Return the points that `area3d` and `adaptive` are shown, and their heights.

    Parameters
    ----------
    cloud : PointCloud
        N points that know what holds for all of the survey's.
    above : (N,) ndarray of float64, metres
        Heights above ground; None where they are not known.

    Notes
    -----
    Both detectors link points by distances that follow from one spacing. By the mean one the roofs of far sparser parts
    come apart. By theirs, dense parts have many points too many within reach. So these keep a share of their points, by
    lot, and a notice is given. An even survey stays as it is.
    """
    facts = cloud.facts
    if facts is None or facts.even_m == facts.spacing_m:
        return cloud, above
    give_notice(UNEVEN)
    kept = kept_of(cloud, DENSER / facts.even_m**2)
    facts = replace(facts, spacing_m=facts.even_m, typical_m=max(facts.typical_m, facts.even_m))
    return replace(cloud.take(kept), facts=facts), None if above is None else above[kept]

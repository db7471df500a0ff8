"""Buildings that the border of surveys side by side cuts: which pieces are one, and the ground of each."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import geopandas as gpd
import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from msbdb.change.differences import Offset, earlier_heights
from msbdb.change.surveywindows import Ground, read_around
from msbdb.fuse.houses.touching import divide
from msbdb.grid import lattice
from msbdb.labels import Labels
from msbdb.outline.polygons import rasterise
from msbdb.params import ChangeParams, TouchingParams

Shapes = NDArray[np.object_]

_AREAS = ("Polygon", "MultiPolygon")

REACH_CELLS = 2.0
"""Pieces of one building may end this far apart: a fitted wall lies up to a cell inside of the border, on each side."""

NEAR_M = 25.0
"""Roofs are compared this far from the border: a house, or the end of a hall."""

OVERLAP_M2 = 1e-4
"""Smaller overlaps of two outlines are rounding of their coordinates."""

LOOSE_M2 = 1.0
"""Smaller loose pieces of an outline go: they are what is left of a cell at a border."""

NO_OFFSET = Offset(0.0, 0.0, 0.0, 0, float("nan"))


@dataclass(frozen=True, slots=True, eq=False)
class Surveyed:
    """What a survey knows of its ground.

    Parameters
    ----------
    area : Polygon
        The box of its lattice.
    ground : Ground
        Its heights, above sea where its terrain is known.
    density : float
        First echoes a square metre; 0 for a raster.
    """

    area: shapely.Polygon
    ground: Ground
    density: float


@dataclass(frozen=True, slots=True)
class Link:
    """Two pieces, by row, that are one building; ``contact_m`` is the length of the border that cuts it."""

    one: int
    other: int
    contact_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Whole:
    """A building of one piece or more, or a piece without the ground that is a neighbour's.

    Parameters
    ----------
    members : tuple of int
        The rows of its pieces.
    neighbours : tuple of int
        The rows of the pieces that took ground from it.
    shape : Polygon or MultiPolygon
        Its outline.
    """

    members: tuple[int, ...]
    neighbours: tuple[int, ...]
    shape: shapely.Geometry

    @property
    def is_changed(self) -> bool:
        """Whether it is more, or less, than a single piece."""
        return len(self.members) > 1 or bool(self.neighbours)


def find_links(
    pieces: gpd.GeoDataFrame,
    loose: NDArray[np.bool_],
    surveys: Mapping[int, Surveyed],
    *,
    params: ChangeParams,
    touching: TouchingParams,
) -> list[Link]:
    """Find the pieces of different surveys that are one building, cut by the border of a survey.

    Parameters
    ----------
    pieces : GeoDataFrame
        Outlines with ``survey_id``.
    loose : (N,) ndarray of bool
        The pieces that may be joined; of two one at least is.
    surveys : mapping of int to Surveyed
        The surveys by their key.
    params : ChangeParams
        ``link_share``, ``thickness_m`` and ``rise_m``.
    touching : TouchingParams
        The reasons that divide touching houses.

    Returns
    -------
    list of Link
        The longest contact first; two outlines of the same ground come before all others.

    Notes
    -----
    Two pieces are one building when

    - they share ``link_share`` of the smaller one: both surveys saw this ground; or
    - they meet along a border of their surveys over twice ``thickness_m``, the ground between them is as high as a
      building, and no reason divides them there.

    The reasons are those that divide touching houses within a survey (`msbdb.fuse.houses.touching.divide`), looked for
    on the heights of both surveys together. The ground beneath a building is interpolated in each survey apart, and two
    flights may count their levels from different zeros. So a reason counts where heights above ground and levels above
    sea both show it, if both are known.
    """
    shapes = pieces.geometry.to_numpy()
    owners = pieces["survey_id"].to_numpy()
    widest = max((one.ground.spec.cell_m for one in surveys.values()), default=0.0)
    pairs = shapely.STRtree(shapes).query(shapes, predicate="dwithin", distance=REACH_CELLS * widest)
    found = []
    corners = shapely.bounds(shapes)
    # Neighbours follow each other, because windows that lie near each other are read faster.
    for one, other in sorted(zip(*pairs.tolist(), strict=True), key=lambda pair: (*corners[pair[0]], *pair)):
        if one >= other or owners[one] == owners[other] or not (loose[one] or loose[other]):
            continue
        a, b = shapes[one], shapes[other]
        both = [surveys[int(owners[row])] for row in (one, other)]
        shared = float(shapely.intersection(a, b).area)
        if shared >= params.link_share * min(a.area, b.area):
            found.append(Link(one, other, float("inf")))
            continue
        zone = _between(a, b, both)
        lengths = [shapely.length(shapely.intersection(side.area.boundary, zone)) for side in both]
        # The reach lengthens the contact at both of its ends.
        contact = float(max(lengths)) - 2 * _reach_m(both)
        if contact >= 2 * params.thickness_m and _is_one(a, b, both, params, touching):
            found.append(Link(one, other, contact))
    return sorted(found, key=lambda link: (-link.contact_m, link.one, link.other))


def _reach_m(surveys: Sequence[Surveyed]) -> float:
    """Return how far apart pieces of one building may end, metres."""
    return REACH_CELLS * max(side.ground.spec.cell_m for side in surveys)


def _between(a: shapely.Geometry, b: shapely.Geometry, surveys: Sequence[Surveyed]) -> shapely.Geometry:
    """Return the ground within reach of two pieces."""
    reach_m = _reach_m(surveys)
    return shapely.intersection(a.buffer(reach_m), b.buffer(reach_m))


def _is_one(
    a: shapely.Geometry,
    b: shapely.Geometry,
    surveys: Sequence[Surveyed],
    params: ChangeParams,
    touching: TouchingParams,
) -> bool:
    """Return whether the roofs of two pieces go on into each other in most places where they meet."""
    zone = _between(a, b, surveys)
    west, south, east, north = zone.bounds
    around = (west - NEAR_M, south - NEAR_M, east + NEAR_M, north + NEAR_M)
    cell_m = max(side.ground.spec.cell_m for side in surveys)
    spec = lattice(around, cell_m, surveys[0].ground.spec.crs)
    seen = [part for part in (read_around(side.ground, spec.bounds) for side in surveys) if part is not None]
    heights = earlier_heights([part.above_ground for part in seen], spec, NO_OFFSET)
    painted = rasterise([a, b], spec)
    gap = (rasterise([zone], spec) > 0) & (painted == 0) & (np.asarray(heights.values) >= params.rise_m)
    nearest = distance_transform_edt(painted == 0, return_distances=False, return_indices=True)
    sides = np.where(gap, painted[tuple(nearest)], painted) * heights.valid
    densities = [side.density for side in surveys]
    spacing_m = 1 / np.sqrt(min(densities)) if min(densities) > 0 else cell_m
    grids = [heights]
    levels = [part.above_sea for part in seen if part.above_sea is not None]
    if len(levels) == len(seen):
        grids.append(earlier_heights(levels, spec, NO_OFFSET))
    for grid in grids:
        built = (sides > 0) & grid.valid
        if _goes_on(sides, divide(grid, built, touching, spacing_m=float(spacing_m)).houses):
            return True
    return False


def _goes_on(sides: Labels, houses: Labels) -> bool:
    """Return whether most neighbouring cells of both sides are of one house; without such cells they do not meet."""
    same = apart = 0
    for axis in (0, 1):
        one, other = (np.moveaxis(labels, axis, 0) for labels in (sides, houses))
        meet = (one[1:] != one[:-1]) & (other[1:] > 0) & (other[:-1] > 0)
        equal = int(np.count_nonzero(meet & (other[1:] == other[:-1])))
        same, apart = same + equal, apart + int(np.count_nonzero(meet)) - equal
    return same > 0 and same >= apart


def whole_buildings(
    pieces: gpd.GeoDataFrame, loose: NDArray[np.bool_], links: Sequence[Link], *, reach_m: float
) -> list[Whole]:
    """Join the pieces that are one building, and give ground that several cover to the largest.

    Parameters
    ----------
    pieces : GeoDataFrame
        Outlines with ``survey_id`` and ``version_id``.
    loose : (N,) ndarray of bool
        The pieces that may change; the ground of others stays theirs where two of them overlap.
    links : sequence of Link
        From `find_links`.
    reach_m : float
        Gaps up to twice as wide between the pieces of a building are closed.

    Returns
    -------
    list of Whole
        Those of several pieces, or with less ground than before, in order of their first pieces.

    Notes
    -----
    Houses that touch in one survey were divided there for a reason. They are not joined through a piece of another
    survey: the longer contact goes first. The result does not depend on the order of the pieces.
    """
    shapes = pieces.geometry.to_numpy()
    groups = _grouped(pieces, links)
    others = shapely.STRtree(shapes)
    joined = []
    for group in groups:
        shape = shapes[group[0]]
        if len(group) > 1:
            near = others.query(shapely.union_all(shapes[list(group)]), predicate="dwithin", distance=reach_m)
            beside = [shapes[row] for row in sorted(near.tolist()) if row not in group]
            shape = _united(shapes[list(group)], beside, reach_m)
        joined.append((group, shape))
    return list(_without_overlaps(pieces, loose, joined))


def _grouped(pieces: gpd.GeoDataFrame, links: Sequence[Link]) -> list[tuple[int, ...]]:
    """Return the rows of each building, in order of their first rows."""
    shapes, owners = pieces.geometry.to_numpy(), pieces["survey_id"].to_numpy()
    involved = sorted({row for link in links for row in (link.one, link.other)})
    near = shapely.STRtree(shapes[involved]).query(shapes[involved], predicate="dwithin", distance=0.01)
    divided = {
        (involved[one], involved[other])
        for one, other in zip(*near.tolist(), strict=True)
        if one != other and owners[involved[one]] == owners[involved[other]]
    }
    groups = {row: {row} for row in range(len(pieces))}
    for link in links:
        one, other = groups[link.one], groups[link.other]
        if one is other or any((a, b) in divided for a in one for b in other):
            continue
        one |= other
        for row in other:
            groups[row] = one
    return sorted({tuple(sorted(group)) for group in groups.values()})


def _united(shapes: Shapes, beside: Sequence[shapely.Geometry], reach_m: float) -> shapely.Geometry:
    """Return pieces as one outline, with the gaps between them closed as far as no other building is there."""
    union = shapely.union_all(shapes)
    zones = [
        shapely.intersection(one.buffer(2 * reach_m), other.buffer(2 * reach_m))
        for place, one in enumerate(shapes)
        for other in shapes[:place]
    ]
    closed = union.buffer(reach_m, join_style="mitre").buffer(-reach_m, join_style="mitre")
    gaps = shapely.intersection(shapely.difference(closed, union), shapely.union_all(zones))
    if len(beside):
        gaps = shapely.difference(gaps, shapely.union_all(np.array(beside, dtype=object)))
    return _polygons(shapely.union(union, gaps)) or union


def _without_overlaps(
    pieces: gpd.GeoDataFrame, loose: NDArray[np.bool_], joined: Sequence[tuple[tuple[int, ...], shapely.Geometry]]
) -> Iterator[Whole]:
    """Yield the buildings that are changed; ground of two is the larger one's, of equal ones that of the lower key."""
    owners, keys = pieces["survey_id"].to_numpy(), pieces["version_id"].to_numpy()
    shapes = np.array([shape for _, shape in joined], dtype=object)
    free = [bool(loose[list(group)].any()) for group, _ in joined]
    rank = sorted(range(len(joined)), key=lambda at: (-joined[at][1].area, min(keys[list(joined[at][0])])))
    place = {at: number for number, at in enumerate(rank)}
    near: dict[int, list[int]] = {}
    for at, other in zip(*shapely.STRtree(shapes).query(shapes, predicate="intersects").tolist(), strict=True):
        if place[other] < place[at] and (free[at] or free[other]):
            near.setdefault(at, []).append(other)
    found = {}
    for at in rank:
        group, shape = joined[at]
        takers: list[int] = []
        for other in sorted(near.get(at, ()), key=place.__getitem__):
            rows = joined[other][0]
            if len({*owners[list(group)], *owners[list(rows)]}) == 1:
                continue
            if shapely.intersection(shape, shapes[other]).area > OVERLAP_M2:
                left = _polygons(shapely.difference(shape, shapes[other]))
                if left is not None:
                    shape = left
                    takers += rows
        shapes[at] = shape
        found[at] = Whole(group, tuple(sorted(takers)), shape)
    yield from (found[at] for at in range(len(joined)) if found[at].is_changed)


def _polygons(shape: shapely.Geometry) -> shapely.Geometry | None:
    """Return the polygons of a geometry, valid and in normal form; None where none is left."""
    parts = [part for part in shapely.get_parts(shapely.make_valid(shape)) if part.geom_type in _AREAS]
    parts = [each for part in parts for each in shapely.get_parts(part) if each.area > OVERLAP_M2]
    if not parts:
        return None
    parts = [part for part in parts if part.area >= LOOSE_M2] or parts
    whole: shapely.Geometry = shapely.normalize(shapely.union_all(np.array(parts, dtype=object)))
    return whole

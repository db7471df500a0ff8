"""What an outline is worth: agreement with a reference, and how it is drawn."""

import math
from dataclasses import dataclass

import geopandas as gpd
import numpy as np
import shapely
from numpy.typing import NDArray

from cases.labelled import Reference
from msbdb.grid import GridSpec
from msbdb.outline.polygons import Geometries, polygonise, rasterise

Floats = NDArray[np.float64]

NEAR = math.radians(5)
"""An edge follows a direction up to this angle."""

CAP_M = 3.0
"""Samples farther from the reference belong to parts that are missing or added, not to the outline."""

STEP_M = 0.5
CRUMB_M2 = 1.0
SAME_SHARE = 0.5
"""A building is compared with the reference's objects that share so much of the smaller of both."""


@dataclass(frozen=True)
class Shape:
    """How the outlines of one case are drawn, and how far they are from the reference."""

    quality: float
    """Area: TP / (TP + FP + FN), per cent."""
    rms_m: float
    """Of samples on both outlines of matched buildings, up to 3 m."""
    polis_m: float
    """Mean of the corners' distances to the other outline, both ways, of matched buildings; the median."""
    hausdorff_m: float
    """Of matched buildings, the median."""
    per_m: float
    """Vertices a metre."""
    along: float
    """Share of the length along the direction of each building and its right angle, per cent."""
    along_three: float
    """The same with the three best directions of each building."""
    overlap_m2: float
    gap_m2: float
    """Area between outlines that was building, and that none of them covers."""
    crumbs: int
    """Rings below 1 m²."""
    pieces: int
    """Buildings of several pieces."""


def measure_shape(
    outlines: Geometries,
    traced: Geometries,
    reference: Reference,
    truth: Geometries,
    spec: GridSpec,
    *,
    islands: bool = False,
) -> Shape:
    """Measure the outlines of a case.

    Parameters
    ----------
    outlines : (N,) ndarray of MultiPolygon
        The buildings.
    traced : (N,) ndarray of MultiPolygon
        The same along their cells.
    reference : Reference
        The cells that are building, and those that are scored.
    truth : (M,) ndarray of Polygon
        The outlines of the reference (`objects_of`).
    spec : GridSpec
        The lattice of the cells.
    islands : bool
        The reference does not divide touching houses: matched buildings are those that touch, together.
    """
    rings = shapely.get_rings(shapely.get_parts(outlines))
    length = float(shapely.length(outlines).sum())
    one, three = along_directions(outlines, spec)
    union = shapely.union_all(outlines)
    mine, theirs = matched(shapely.get_parts(union) if islands else shapely.make_valid(outlines), truth)
    cells = shapely.union_all(traced)
    # A hole that was mostly building is a gap between outlines.
    gaps = [hole.area for hole in holes_of(union) if shapely.intersection(hole, cells).area > hole.area / 2]
    return Shape(
        quality=area_quality(outlines, reference),
        rms_m=rms(mine, theirs, reference),
        polis_m=float(np.median(polis(mine, theirs))) if len(mine) else math.nan,
        hausdorff_m=float(np.median(shapely.hausdorff_distance(mine, theirs))) if len(mine) else math.nan,
        per_m=(shapely.get_num_coordinates(rings).sum() - len(rings)) / length,
        along=100 * one,
        along_three=100 * three,
        overlap_m2=max(float(shapely.area(outlines).sum() - union.area), 0.0),
        gap_m2=float(sum(gaps)),
        crumbs=int(np.count_nonzero(shapely.area(shapely.polygons(rings)) < CRUMB_M2)),
        pieces=int(np.count_nonzero(shapely.get_num_geometries(outlines) > 1)),
    )


def area_quality(outlines: Geometries, reference: Reference) -> float:
    """Compare the cells whose centres lie in outlines with the reference, per cent."""
    return reference.quality(rasterise(outlines, reference.spec) > 0, reference.spec)


def moved_inward(outlines: Geometries, distance_m: float) -> Geometries:
    """Return the union of outlines with its edge moved inward, or outward where the distance is below zero.

    Borders between touching houses are no edges of the union, so no gaps open there.

    Parameters
    ----------
    outlines : (N,) ndarray of MultiPolygon
        Buildings that do not overlap.
    distance_m : float
        Metres.

    Returns
    -------
    (1,) ndarray of Polygon or MultiPolygon
    """
    union = shapely.union_all(outlines)
    return np.array([shapely.buffer(union, -distance_m, join_style="mitre")], dtype=np.object_)


def holes_of(geometry: shapely.Geometry) -> list[shapely.Polygon]:
    """Return the holes of a geometry."""
    return [shapely.Polygon(hole) for part in shapely.get_parts(geometry) for hole in part.interiors]


def objects_of(reference: Reference, footprints: gpd.GeoDataFrame | None) -> Geometries:
    """Return the outlines of the reference: the polygons of the cadastre, or its connected cells."""
    if footprints is not None:
        return np.asarray(shapely.get_parts(footprints.to_crs(reference.spec.crs).geometry.to_numpy()))
    cells = polygonise(reference.built.astype(np.int32), reference.spec, 1)
    return np.asarray(shapely.get_parts(cells))


def matched(outlines: Geometries, truth: Geometries) -> tuple[Geometries, Geometries]:
    """Return the buildings that have objects of the reference, and for each the union of those."""
    one, other = shapely.STRtree(truth).query(outlines, predicate="intersects")
    common = shapely.area(shapely.intersection(outlines[one], truth[other]))
    linked = common >= SAME_SHARE * np.minimum(shapely.area(outlines[one]), shapely.area(truth[other]))
    one, other = one[linked], other[linked]
    kept = np.unique(one)
    unions = [shapely.union_all(truth[other[one == building]]) for building in kept]
    return outlines[kept], np.array(unions, dtype=np.object_)


def rms(outlines: Geometries, truth: Geometries, reference: Reference) -> float:
    """Return the RMS distance of samples on both outlines of each pair to the other one, up to `CAP_M`."""
    distances = []
    for one, other in zip(outlines, truth, strict=True):
        for line, across in ((one, other), (other, one)):
            along = shapely.get_coordinates(shapely.segmentize(shapely.boundary(line), STEP_M))
            scored = reference.spec.sample(reference.scored, along[:, 0], along[:, 1], outside=False)
            distances.append(distance_to(along[scored], across))
    near = np.concatenate(distances)
    near = near[near <= CAP_M]
    return float(np.sqrt(np.mean(near**2))) if len(near) else math.nan


def distance_to(places: Floats, shape: shapely.Geometry) -> Floats:
    """Return the distance of each place to the boundary of a shape."""
    ends, ring = shapely.get_coordinates(shapely.get_rings(shapely.get_parts(shape)), return_index=True)
    inner = ring[1:] == ring[:-1]
    edges = shapely.linestrings(np.stack((ends[:-1][inner], ends[1:][inner]), axis=1))
    if not len(places):
        return np.empty(0)
    found = shapely.STRtree(edges).query_nearest(shapely.points(places), all_matches=False, return_distance=True)
    return np.asarray(found[1], dtype=np.float64)


def polis(outlines: Geometries, truth: Geometries) -> Floats:
    """Return the PoLiS distance of each pair: the mean distance of corners to the other outline, of both ways."""
    distances = []
    for one, other in zip(outlines, truth, strict=True):
        there = distance_to(corners(one), other).mean()
        back = distance_to(corners(other), one).mean()
        distances.append((there + back) / 2)
    return np.array(distances)


def corners(geometry: shapely.Geometry) -> Floats:
    """Return the vertices of a geometry, each once a ring."""
    return np.concatenate(
        [shapely.get_coordinates(ring)[:-1] for ring in shapely.get_rings(shapely.get_parts(geometry))]
    )


def at_border(ring: Floats, spec: GridSpec | None) -> NDArray[np.bool_]:
    """Return which edges of a ring lie within a cell of one side of a lattice."""
    if spec is None:
        return np.zeros(len(ring) - 1, dtype=np.bool_)
    west, south, east, north = spec.bounds
    near = np.abs(ring[:, [0, 0, 1, 1]] - (west, east, south, north)) <= spec.cell_m
    return np.asarray((near[:-1] & near[1:]).any(axis=1))


def along_directions(outlines: Geometries, spec: GridSpec | None = None) -> tuple[float, float]:
    """Return the share of the length along the best direction of each outline, and along its three best ones.

    A direction stands for its right angle too. It is that of one of the edges: the one that most of the length
    follows, up to 5°. The next one is that which most of the rest follows. Edges within a cell of the border of a
    lattice are left out: they are cuts and no walls.
    """
    total, one, three = 0.0, 0.0, 0.0
    for outline in outlines:
        rings = [shapely.get_coordinates(ring) for ring in shapely.get_rings(shapely.get_parts(outline))]
        edges = np.concatenate([np.diff(ring, axis=0)[~at_border(ring, spec)] for ring in rings])
        length, angle = np.hypot(*edges.T), np.mod(np.arctan2(edges[:, 1], edges[:, 0]), math.pi / 2)
        total += length.sum()
        for place in range(3):
            if not len(length):
                break
            off = np.abs(np.mod(angle[:, None] - angle[None, :] + math.pi / 4, math.pi / 2) - math.pi / 4)
            near = off <= NEAR
            best = int(np.argmax(near @ length))
            held = float(length[near[best]].sum())
            one += held if place == 0 else 0.0
            three += held
            length, angle = length[~near[best]], angle[~near[best]]
    return one / total, three / total

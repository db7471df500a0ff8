"""The area3d detector: building regions among the points, by 3-D area morphology at several heights (Cao & Wu, 2.2)."""

import logging
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from msbdb.detect.area3d.curvature import measure_structure
from msbdb.detect.area3d.heightscales import NormalisedCloud, OnSets, fuse_over_scales, height_scales
from msbdb.detect.pointregions import (
    Candidates,
    PointLedger,
    describe_candidates,
    detect_on_points,
    in_order_of_ids,
    places,
)
from msbdb.detect.scene import Regions, Scene
from msbdb.errors import InputError, NodataError
from msbdb.grid import GridSpec
from msbdb.labels import chosen_cells, sums
from msbdb.order import order_in_groups
from msbdb.params import Area3dParams, Params
from msbdb.points.aside import let_go, set_aside
from msbdb.points.cellindex import index_cells
from msbdb.points.cloud import PointCloud
from msbdb.points.graph import PointGraph, components, connect
from msbdb.points.pointarea import build_point_scale_space, open_close_linked, open_close_on_sets
from msbdb.points.spacing import measure_density

logger = logging.getLogger(__name__)

METHOD = "area3d"

ORIGIN_M = 1000.0
"""Coordinates are counted from a multiple of this, so that their squares keep their digits."""

BLOCK_M = 16.0
"""Side of the blocks by which points are sorted: what a few thousand points take fits into the processor's cache."""


def detect_area3d(scene: Scene, params: Params) -> Regions:
    """Detect candidate regions among the points of a scene (C19): the detector ``area3d``.

    Parameters
    ----------
    scene : Scene
        With points and a surface.
    params : Params
        Sections ``area3d``, ``surface``, ``ground`` and ``vector``.

    Returns
    -------
    Regions
        The table has the columns of ``tables.CANDIDATE_REGION`` and outlines.
    """
    return detect_on_points(extract_area3d, scene, params)


def extract_area3d(
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
    """Detect the regions of points that may be buildings.

    Parameters
    ----------
    cloud : PointCloud
        All echoes, outliers gone. Classes are not looked at.
    heights : (N,) ndarray of float64, metres
        Heights above ground of the points, finite: the third coordinate of the normalised cloud.
    spec : GridSpec
        The survey's lattice, from which regions take their ids.
    survey : str
        Name of the survey; part of the ids.
    params : Params
        Sections ``area3d`` and, of ``surface``, the mask.
    ndvi : (N,) ndarray of float32, optional
        NDVI of the points, NaN where unknown.
    noise_m : (N,) ndarray of float32, optional
        What noise adds to the heights of each point, metres.
    recorded : (N,) ndarray of float32, optional
        How far later echoes were recorded around each point, from 0 to 1.

    Returns
    -------
    Candidates
        Possibly without regions.

    Raises
    ------
    InputError
        When heights or NDVI are not one a point, or a height or a coordinate is not finite.
    NodataError
        When there is no point.

    Notes
    -----
    At each height scale h_j (C14) the on-set is opened and closed by area, and its connected components (C1 to C7)
    lose their crowns (C16). Components that are still as large as T_a are judged by their shape (C8 to C12, C17, C18).

    The fusion over heights is the union (C19). AOC filters one function, so components at a higher h_j lie within those
    at a lower one. A region is accepted at the lowest height that accepts it, and absorbs the regions within it higher
    up. Higher scales thus add regions that are joined to something else lower down.

    The change of curvature is measured once, among the points of the lowest on-set, so that the components without
    crowns are nested too.

    The result does not depend on the points' order. Complexity: O(N log N) and O(N) a height scale. Border: a
    building cut by the border is judged by its part inside. Halo: none suffices, as components are of any extent.
    """
    _require(cloud, heights, ndvi)
    given = [heights]
    del heights  # so that nobody else holds them
    scenes, scales, order = _prepare(cloud, given.pop(), ndvi, spec, params, noise_m=noise_m, recorded=recorded)
    del ndvi, noise_m, recorded
    scene = scenes[0]
    placed = scene.cloud.placed(spec, survey)
    ledger = PointLedger(METHOD, placed, params.fuse.piece_m2)
    accepted = fuse_over_scales(scenes, scales, ledger)
    shape = {
        "rule": np.array(["", "rule 1", "rule 2"], dtype=object)[accepted.rule],
        "height_scale_m": accepted.height_m,
        **scene.shapes(accepted.labels, len(accepted.rule)).columns(),
    }
    regions = describe_candidates(placed, accepted.labels, scene.cloud.heights, scene.cloud.ndvi, shape, method=METHOD)
    from_m = ", ".join(f"{each:.1f}" for each in scales)
    logger.info("area3d found %d regions from the heights %s m on", len(regions), from_m)
    return in_order_of_ids(accepted.labels, regions, order, len(cloud), ledger)


def _require(cloud: PointCloud, heights: NDArray[np.float64], ndvi: NDArray[np.float32] | None) -> None:
    """Refuse clouds without points, arrays of another length, NaN and infinity."""
    if len(cloud) == 0:
        msg = (
            "The cloud has no points, so no building can be detected; check the extent and the classes that were read."
        )
        raise NodataError(msg)
    for name, values in (("heights", heights), ("ndvi", ndvi)):
        if values is not None and values.shape != (len(cloud),):
            msg = f"The {name} must be one a point, of {len(cloud)}; got the shape {values.shape}."
            raise InputError(msg)
    for name, values in (("height above ground", heights), ("x", cloud.x), ("y", cloud.y), ("z", cloud.z)):
        strange = len(cloud) - int(np.count_nonzero(np.isfinite(values)))
        if strange:
            msg = f"The {name} is NaN or infinite at {strange} of {len(cloud)} points. Drop or interpolate them first."
            raise InputError(msg)


def _canonical_order(
    cloud: PointCloud, heights: NDArray[np.float64], ndvi: NDArray[np.float32] | None
) -> NDArray[np.int32]:
    """Return the index that sorts the points by place, and points at one place by all their other values.

    Blocks come first: points near each other in plan lie near each other in memory, for the graph and neighbours.
    """
    blocks = index_cells(cloud.x, cloud.y, BLOCK_M)
    echoes = [values for values in (ndvi, cloud.number_of_returns, cloud.return_number) if values is not None]
    return order_in_groups((blocks.order, blocks.starts), cloud.x, cloud.y, [cloud.z, heights, *echoes])


def _prepare(
    cloud: PointCloud,
    heights: NDArray[np.float64],
    ndvi: NDArray[np.float32] | None,
    spec: GridSpec,
    params: Params,
    *,
    noise_m: NDArray[np.float32] | None,
    recorded: NDArray[np.float32] | None,
) -> tuple[tuple[OnSets, ...], tuple[float, ...], NDArray[np.int32]]:
    """Return the input of all height scales for each area, the heights, and the places of its points in the cloud.

    The density and the lowest height's filter take all points. For one area scale, no later step looks at points that
    are off then and lower than the feet of walls: so they are left out, and only the others are connected.
    """
    own, mask_m = params.area3d, params.surface.mask_m
    order = _canonical_order(cloud, heights, ndvi)
    let_go()
    origin = np.array([np.floor(each.min() / ORIGIN_M) * ORIGIN_M for each in (cloud.x, cloud.y, cloud.z)])
    columns = [set_aside(values - low) for values, low in zip((cloud.x, cloud.y, cloud.z), origin, strict=True)]
    density = measure_density(columns[0], columns[1], cloud.first_echo, cloud.facts)
    spacing_m, link_m = density.spacing_m, max(own.link_spacings * density.spacing_m, density.step_m)
    areas = tuple(sorted(set(own.areas_m2))) or (own.smallest_m2,)
    scales = height_scales(heights, own, mask_m=mask_m)
    heights, area_m2 = set_aside(heights[order]), set_aside(density.area_m2[order])
    del density
    for axis in range(3):
        columns[axis] = set_aside(columns[axis][order])
        let_go()
    lowest = None
    if len(areas) == 1:
        on, rim = open_close_linked(heights >= scales[0], columns, link_m, areas[0], weights=area_m2)
        some = on | (heights >= min(own.foot_m, mask_m, scales[0]))
        columns, lowest = [values[some] for values in columns], (on[some], rim[some])
        order, heights, area_m2 = order[some], set_aside(heights[some]), set_aside(area_m2[some])
    points = set_aside(np.stack(columns)).T
    del columns
    several = cloud.number_of_returns[order] > 1 if cloud.has_echoes and cloud.number_of_returns is not None else None
    green = None if ndvi is None else ndvi[order].astype(np.float64)
    place = set_aside(places(spec, cloud.x[order], cloud.y[order]))
    order = set_aside(order)
    let_go()
    x, y, z = points.T
    graph = connect(x, y, z, link_m, once=lowest is not None).aside()
    let_go()
    filtered = _open_close(heights, graph, area_m2, areas, scales, lowest=lowest)
    levels = [np.searchsorted(scales, each, side="right").astype(np.uint16) for each in filtered]
    del filtered
    noise = None if noise_m is None else noise_m[order]
    curvature, smooth = _structure(points, several, noise, np.logical_or.reduce(levels) > 0, own)
    let_go()
    trust = cloud.echo_trust(heights)
    if recorded is not None:
        trust = trust * recorded[order]
    known = NormalisedCloud(points, heights, area_m2, several, trust, green, place, origin[:2])
    scenes = tuple(
        OnSets(known, graph, on, spacing_m, link_m, curvature, smooth, replace(own, smallest_m2=area), mask_m)
        for on, area in zip(levels, areas, strict=True)
    )
    return scenes, scales, order


def _open_close(
    heights: NDArray[np.float64],
    graph: PointGraph,
    area_m2: NDArray[np.float64],
    areas: tuple[float, ...],
    scales: tuple[float, ...],
    *,
    lowest: tuple[NDArray[np.bool_], NDArray[np.bool_]] | None,
) -> NDArray[np.float64]:
    """Return, for each area scale, the highest height scale at which each point is on after AOC (C6, C7).

    Parameters
    ----------
    heights : (N,) ndarray of float64, metres
        Heights above ground.
    graph : PointGraph
        The connected points; for several area scales from both ends.
    area_m2 : (N,) ndarray of float64
        Area of each point.
    areas : tuple of float
        Ta_k, m2, ascending; SP_k is fed by SP_{k-1} (Eq. 3).
    scales : tuple of float
        h_j, metres, ascending.
    lowest : two (N,) ndarrays of bool, or None
        For one area scale, what is on at the lowest height, and its rim.

    Returns
    -------
    (K, N) ndarray of float64
        Metres; minus infinity without one.

    Notes
    -----
    On-sets of a higher h_j lie within those of a lower one. Islands of less than T_a, for which no height decides
    between on and off, are never on. For one area the on-sets are filtered one by one, which is faster than a sweep
    over all heights (`open_close_on_sets`) and gives the same.
    """
    if len(areas) == 1:
        return open_close_on_sets(heights, graph, areas[0], scales, weights=area_m2, lowest=lowest)[None]
    islands, count = components(np.ones(len(heights), dtype=np.bool_), graph)
    size = sums(islands, area_m2, count)
    space = build_point_scale_space(heights, graph, areas, weights=area_m2)
    filtered = np.full((len(areas), len(heights)), -np.inf)
    for number, area in enumerate(areas):
        large = chosen_cells(islands, size >= area)
        for height_m in scales:
            filtered[number, space.on_set(number, height_m) & large] = height_m
    return filtered


def _structure(
    points: NDArray[np.float64],
    several: NDArray[np.bool_] | None,
    noise_m: NDArray[np.float32] | None,
    on: NDArray[np.bool_],
    own: Area3dParams,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the change of curvature of the points of the on-set, 0 for all others, and which points are no crown."""
    echoes, noise = None if several is None else several[on], None if noise_m is None else noise_m[on]
    found = measure_structure(points[on], echoes, noise, neighbours=own.neighbours, thin_m=own.thin_m)
    curvature, smooth = np.zeros(len(on)), np.full(len(on), own.max_curvature >= 0 and own.max_echo_share >= 0)
    curvature[on] = found.curvature
    smooth[on] = (found.curvature <= own.max_curvature) & (found.echo_share <= own.max_echo_share)
    return set_aside(curvature), smooth

"""Classification of points: a copy of a LAS or LAZ file, whose class 6 is what the detectors found."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from msbdb.detect.scene import Regions, Scene
from msbdb.errors import InputError
from msbdb.fuse.cells import is_fused
from msbdb.grid import GridSpec
from msbdb.io.files import require_input
from msbdb.io.las import read_points_indexed
from msbdb.io.lasheader import read_las_header
from msbdb.io.laswrite import check_output, write_classes
from msbdb.labels import Labels, chosen_cells, sizes, sums
from msbdb.params import Params, choose_detectors
from msbdb.points.cloud import BUILDING_CLASS, GROUND_CLASS, UNCLASSIFIED_CLASS, PointCloud
from msbdb.points.nearest import nearest_of
from msbdb.points.repeated import without_repeated
from msbdb.run.compose import detect, fuse_and_decompose
from msbdb.run.inputs import Inputs
from msbdb.run.preparation.pointfacts import sparse_with_facts
from msbdb.run.preparation.prepare import Label, prepare
from msbdb.run.reports import ClassifyReport, Notices, Progress, Stages, collect_notices
from msbdb.surface import heights_above

Mask = NDArray[np.bool_]

INSIDE = 0.5
"""Ours: a region of points is of a building where at least this share of its points is inside."""

EDGES = "area3d"
"""Ours: the detector by whose regions a building has points beyond its cells, which end at the edge of the roof: walls,
eaves and low roofs. Regions of ``adaptive`` have points of trees there."""


def classify_points(
    inputs: Inputs,
    out: Path,
    *,
    extract: str | Sequence[str],
    params: Params,
    ground: bool,
    keep: bool,
    overwrite: bool,
    progress: Progress | None,
) -> ClassifyReport:
    """Detect the buildings among the points of a file, and write it with them in class 6; see `msbdb.api.classify`."""
    source, *others = inputs.points
    if others:
        msg = f"One file is classified at a time; got {len(inputs.points)}, from {source} on. Give them one by one."
        raise InputError(msg)
    notices, stages = Notices(), Stages(progress)
    require_input(source)
    check_output(source, out, overwrite=overwrite)
    with collect_notices(notices):
        methods = choose_detectors(extract)
        inputs.require_files()
        inputs.require_one_place()
        with stages.stage("read"):
            cloud, index = read_points_indexed(source, crs=inputs.crs, z_unit=inputs.z_unit, progress=progress)
        distinct = sparse_with_facts(without_repeated(cloud), params)
        scene, params, _ = prepare(inputs, distinct, params, stages, Label(inputs.default_survey()))
        del distinct
        heights = heights_above(cloud, scene.require_surface().dtm)
        found = detect(scene, methods, params, stages)
        regions = {name: replace(one, of_points=_of_all(one.of_points, scene, cloud)) for name, one in found.items()}
        taken = np.zeros(len(cloud), dtype=np.bool_)
        if is_fused(regions, params.fuse):
            # The buildings of a build: what the detectors decide together, and not what any of them takes.
            built = fuse_and_decompose(scene, regions, params, stages).roofs
            inside = scene.heights.spec.sample(built, cloud.x, cloud.y, outside=False)
            taken = inside & (heights >= params.surface.mask_m)
            edges = regions.get(EDGES)
            if edges is not None and edges.of_points is not None:
                taken |= mostly_inside(edges.of_points, inside)
        else:
            for one in regions.values():
                taken |= _points_of(one, scene, cloud, heights, params)
        on_ground = on_terrain(heights, taken, params.ground.height_m) if ground else np.zeros_like(taken)
        stale = np.zeros_like(taken) if keep else _stale(cloud, taken, on_ground, ground=ground)
        with stages.stage("write"):
            new = {BUILDING_CLASS: taken, GROUND_CLASS: on_ground, UNCLASSIFIED_CLASS: stale}
            classes, where = _as_in_file(read_las_header(source).points, index, new)
            written = write_classes(source, out, classes, where=where, overwrite=overwrite, progress=progress)
    return ClassifyReport(
        points=written.points,
        read=len(cloud),
        building_points=int(np.count_nonzero(taken)),
        ground_points=int(np.count_nonzero(on_ground)),
        changed=written.changed,
        demoted=int(np.count_nonzero(stale & cloud.in_class(BUILDING_CLASS))),
        regions={name: len(one.table) for name, one in regions.items()},
        notices=(*notices.kept, *notices.passing),
        timings=stages.rounded(),
    )


def _of_all(of_points: Labels | None, scene: Scene, cloud: PointCloud) -> Labels | None:
    """Return the labels of all points: one that was left out has that of the nearest one that was not.

    Points are left out that are there more than once, or by lot where there are very many.
    """
    seen = scene.require_cloud()
    if of_points is None or len(seen) == len(cloud):
        return of_points
    return of_points[nearest_of((seen.x, seen.y, seen.z), (cloud.x, cloud.y, cloud.z))]


def _points_of(regions: Regions, scene: Scene, cloud: PointCloud, heights: NDArray[np.float64], params: Params) -> Mask:
    """Return the points of a detector's regions: its own, or those in its cells that are high enough above ground."""
    if regions.of_points is not None:
        return regions.of_points > 0
    return points_in(regions.labels > 0, scene.heights.spec, cloud, heights, params.surface.mask_m)


def points_in(cells: Mask, spec: GridSpec, cloud: PointCloud, heights: NDArray[np.float64], least_m: float) -> Mask:
    """Return the points in the chosen cells of a lattice that are high enough above ground.

    Parameters
    ----------
    cells : (H, W) ndarray of bool
        Chosen cells; a point outside of the lattice is in none.
    spec : GridSpec
        The lattice, in the points' CRS.
    cloud : PointCloud
        N points.
    heights : (N,) ndarray of float64, metres
        Their heights above ground; NaN where unknown, which is not enough.
    least_m : float
        Least height above ground, metres: walls and roofs count, the ground beside and below does not.

    Returns
    -------
    (N,) ndarray of bool
    """
    return spec.sample(cells, cloud.x, cloud.y, outside=False) & (heights >= least_m)


def mostly_inside(of_points: Labels, inside: Mask) -> Mask:
    """Return the points of the regions that lie in buildings with at least `INSIDE` of their points.

    Parameters
    ----------
    of_points : (N,) ndarray of int32
        The region of each point, from 1; 0 for none.
    inside : (N,) ndarray of bool
        Points in the cells of buildings.

    Returns
    -------
    (N,) ndarray of bool

    Examples
    --------
    >>> mostly_inside(np.array([1, 1, 2, 2, 2, 0]), np.array([True, False, True, False, False, True])).tolist()
    [True, True, False, False, False, False]
    """
    count = int(of_points.max(initial=0))
    return chosen_cells(of_points, sums(of_points, inside, count) >= INSIDE * sizes(of_points, count))


def on_terrain(heights: NDArray[np.float64], taken: Mask, tolerance_m: float) -> Mask:
    """Return the points of the ground: those near the terrain that are no building.

    Parameters
    ----------
    heights : (N,) ndarray of float64, metres
        Heights above the terrain; NaN where unknown, which is not the ground.
    taken : (N,) ndarray of bool
        Points of buildings.
    tolerance_m : float
        Largest height above or below the terrain, metres. The terrain goes through the lowest points, and the others
        scatter around it by their noise, the slope and the grass.

    Returns
    -------
    (N,) ndarray of bool
    """
    return (np.abs(heights) <= tolerance_m) & ~taken


def _stale(cloud: PointCloud, taken: Mask, on_ground: Mask, *, ground: bool) -> Mask:
    """Return the points that the source calls buildings, or ground where that is asked for, and that were not found."""
    before = cloud.in_class(BUILDING_CLASS) | (cloud.in_class(GROUND_CLASS) if ground else False)
    return before & ~taken & ~on_ground


def _as_in_file(points: int, index: NDArray[np.int64], found: Mapping[int, Mask]) -> tuple[NDArray[np.uint8], Mask]:
    """Return the classes of all points of a file by the points found of each, and which of them are to be written."""
    classes, where = np.zeros(points, dtype=np.uint8), np.zeros(points, dtype=np.bool_)
    for number, chosen in found.items():
        classes[index[chosen]] = number
        where[index[chosen]] = True
    return classes, where

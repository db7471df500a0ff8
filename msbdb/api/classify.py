"""Buildings written back into the points: a LAS or LAZ file whose class 6 is what an extractor found."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msbdb.api.build import check_extractors
from msbdb.bands import Bands
from msbdb.detect.candidatelayer import point_candidates, point_ndvi
from msbdb.detect.flatregions.flatlayer import find_flat_regions
from msbdb.grid import GridSpec
from msbdb.io.las import read_points_indexed
from msbdb.io.lasheader import read_las_header
from msbdb.io.laswrite import check_output, write_classes
from msbdb.params import Params
from msbdb.params import profile as named_profile
from msbdb.parts.tree import choose_scales, extract_parts
from msbdb.points.cloud import BUILDING_CLASS, UNCLASSIFIED_CLASS, PointCloud
from msbdb.run.prepare import Inputs, build_surface, collect_notices, read_ortho
from msbdb.run.stages import Progress, Stages
from msbdb.spectral.colours import spectral_bands
from msbdb.spectral.coverclasses import classify_cover
from msbdb.surface import Surface, cover_from_surface, heights_above

Mask = NDArray[np.bool_]

"""ASPRS classes: looked at but of no kind, and building."""


@dataclass(frozen=True, slots=True)
class ClassifyReport:
    """What a classification did.

    Attributes
    ----------
    points, read : int
        Points of the file, and those that were looked at: noise, withheld and lone points are not, and keep their
        class.
    building_points : int
        Points that were found to be buildings.
    changed : int
        Points whose class is another than before.
    demoted : int
        Points that were buildings before, and are unclassified now.
    regions : dict
        Buildings, flat regions or candidate regions that each extractor found.
    notices : tuple of str
        Sentences for people.
    timings : dict
        Seconds a stage.
    """

    points: int
    read: int
    building_points: int
    changed: int
    demoted: int
    regions: dict[str, int]
    notices: tuple[str, ...]
    timings: dict[str, float]

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return asdict(self)


@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    """What every extractor starts from; ``heights`` are the points' heights above ground, (N,) float64, metres."""

    cloud: PointCloud
    surface: Surface
    bands: Bands | None
    heights: NDArray[np.float64]
    params: Params
    survey: str


def classify(
    source: Path,
    out: Path,
    *,
    extract: Sequence[str] = ("area3d",),
    crs: str | None = None,
    ortho: Sequence[Path] = (),
    ortho_crs: str | None = None,
    z_unit: str = "auto",
    params: Params | None = None,
    profile: str = "default",
    keep: bool = False,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> ClassifyReport:
    """Find the buildings among the points of a file, and write it with them in class 6.

    Parameters
    ----------
    source : path
        LAS, LAZ or COPC.
    out : path
        LAS or LAZ, by its ending; everything but the classes is as in the source.
    extract : sequence of str
        The extractors; with several, a point that any of them takes is a building. For ``area3d`` and ``adaptive``
        the points of their candidate regions are taken, for ``multiscale`` and ``flatregions`` those in the cells of
        a part or flat region that are as high above ground as the mask, ``surface.mask_m``.
    crs, ortho_crs : str, optional
        CRS of points and orthophotos that state none.
    ortho : sequence of path
        Orthophotos of any bands, each on its own grid and CRS. Without them the points' colours serve.
    z_unit : str
        Unit of the heights: ``auto``, ``m``, ``ft`` or ``us-ft``.
    params : Params, optional
        Parameters; the profile's by default.
    profile : str
        Name of the profile that the parameters come from.
    keep : bool
        Leave points in class 6 that are so in the source, found or not; otherwise they become unclassified (1).
    overwrite : bool
        Replace ``out`` if it exists.
    progress : callable, optional
        Called with stage, steps done and steps in all.

    Returns
    -------
    ClassifyReport

    Raises
    ------
    MsbdbError
        One of its kinds, when the file cannot be used or written. Nothing is written then.
    """
    source, out = Path(source), Path(out)
    params = params or named_profile(profile)
    methods = check_extractors(extract)
    check_output(source, out, overwrite=overwrite)
    inputs = Inputs((source,), tuple(Path(path) for path in ortho), crs=crs, ortho_crs=ortho_crs, z_unit=z_unit)
    stages = Stages(progress)
    notices: list[str] = []
    regions: dict[str, int] = {}
    with collect_notices(notices):
        with stages.stage("read"):
            cloud, index, told = read_points_indexed(source, crs=crs, z_unit=z_unit, progress=progress)
        notices += told
        scene = _prepare(inputs, cloud, params, stages)
        taken = np.zeros(len(cloud), dtype=np.bool_)
        for method in methods:
            with stages.stage(method):
                found, regions[method] = _find(method, scene)
            taken |= found
    stale = np.zeros_like(taken) if keep else _stale(cloud, taken)
    with stages.stage("write"):
        classes, where = _as_in_file(read_las_header(source).points, index, taken, stale)
        written = write_classes(source, out, classes, where=where, overwrite=overwrite, progress=progress)
    return ClassifyReport(
        points=written.points,
        read=len(cloud),
        building_points=int(np.count_nonzero(taken)),
        changed=written.changed,
        demoted=int(np.count_nonzero(stale)),
        regions=regions,
        notices=(*notices, *written.notices),
        timings={name: round(seconds, 3) for name, seconds in stages.timings.items()},
    )


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


def _prepare(inputs: Inputs, cloud: PointCloud, params: Params, stages: Stages) -> _Scene:
    """Make the surface, the heights of the points, and the bands."""
    with stages.stage("surface"):
        surface = build_surface(cloud, params)
        heights = heights_above(cloud, surface.dtm)
    spec = surface.ndsm.spec
    with stages.stage("bands"):
        ortho = read_ortho(inputs, spec)
        bands = spectral_bands(ortho, cloud, spec, max_gap_m=params.surface.max_gap_m)
    return _Scene(cloud, surface, bands, heights, params, inputs.default_survey())


def _find(method: str, scene: _Scene) -> tuple[Mask, int]:
    """Return the points that an extractor takes for buildings, and the number of its regions."""
    if method == "multiscale":
        return _find_parts(scene)
    if method == "flatregions":
        return _find_flat(scene)
    return _find_candidates(method, scene)


def _find_parts(scene: _Scene) -> tuple[Mask, int]:
    """Return the points in the parts of the multi-scale extraction, and the number of buildings."""
    surface, cloud, params = scene.surface, scene.cloud, scene.params
    found = cover_from_surface(surface, cloud, params)
    params = choose_scales(surface.ndsm, found.cover, params)
    cover = classify_cover(found.cover, scene.bands, surface.ndsm, found.roughness_m, params, echoes=cloud.has_echoes)
    forest = extract_parts(surface.ndsm, cover.classes, survey=scene.survey, params=params)
    cells = np.logical_or.reduce([labels > 0 for labels in forest.labels])
    buildings = int((forest.parts["supid"] == 0).sum())
    return points_in(cells, surface.ndsm.spec, cloud, scene.heights, params.surface.mask_m), buildings


def _find_flat(scene: _Scene) -> tuple[Mask, int]:
    """Return the points in the flat regions, and the number of regions."""
    spec, mask_m = scene.surface.ndsm.spec, scene.params.surface.mask_m
    flat = find_flat_regions(scene.surface, scene.cloud, scene.params, survey=scene.survey, figure=None)
    return points_in(flat.labels > 0, spec, scene.cloud, scene.heights, mask_m), len(flat.regions)


def _find_candidates(method: str, scene: _Scene) -> tuple[Mask, int]:
    """Return the points of the candidate regions of an extractor on points, and the number of regions."""
    ndvi = point_ndvi(scene.bands, scene.cloud)
    found = point_candidates(method, scene.cloud, scene.surface, ndvi=ndvi, params=scene.params, survey=scene.survey)
    return found.labels > 0, len(found.regions)


def _stale(cloud: PointCloud, taken: Mask) -> Mask:
    """Return the points that the source calls buildings, and that were not found to be."""
    return cloud.in_class(BUILDING_CLASS) & ~taken


def _as_in_file(points: int, index: NDArray[np.int64], taken: Mask, stale: Mask) -> tuple[NDArray[np.uint8], Mask]:
    """Return the classes of all points of a file, and which of them are to be written."""
    classes, where = np.full(points, UNCLASSIFIED_CLASS, dtype=np.uint8), np.zeros(points, dtype=np.bool_)
    classes[index[taken]] = BUILDING_CLASS
    where[index[taken | stale]] = True
    return classes, where

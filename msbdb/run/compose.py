"""The composition: one survey from its files to the run that the database keeps.

Prepare, detect, fuse, decompose into parts, describe; `msbdb.run.store` writes the result. A re-labelling starts from a
kept run, detects parts under the new labels, and shares all later steps.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from msbdb.database import pack_rasters
from msbdb.detect.detectors import DETECTORS
from msbdb.detect.flatregions.initialisation import denoise
from msbdb.detect.flatregions.mongus2013 import lowest_surface
from msbdb.detect.scene import Regions, Scene
from msbdb.fuse.cells import fuse_cells, is_fused
from msbdb.fuse.houses.touching import Division, divide
from msbdb.grid import Bounds, Grid
from msbdb.kept import KeptRun, Packed, Rasters
from msbdb.params import Params, as_dict, with_values
from msbdb.parts.forest import Forest
from msbdb.parts.tree import extract_parts
from msbdb.points.aside import let_go
from msbdb.run.describe import Description, count_cells, describe, describe_choices, describe_rasters
from msbdb.run.inputs import Inputs
from msbdb.run.preparation.drafts import read_cloud
from msbdb.run.preparation.planning import is_large, make_plan
from msbdb.run.preparation.pointfacts import sparse_with_facts
from msbdb.run.preparation.prepare import Label, Window, note_missing_sources, prepare
from msbdb.run.reports import Notices, Stages, collect_notices
from msbdb.surveyplan import Plan
from msbdb.tables import Counts, Run
from msbdb.threads import in_threads, memory_reused, together
from msbdb.version import __version__


@dataclass(frozen=True, slots=True)
class Job:
    """What one run is to do.

    Parameters
    ----------
    inputs : Inputs
        The files.
    params : Params
        All parameters.
    profile : str
        Name of the profile that the parameters began from.
    label : Label
        The survey's name and date, and an operator's labels of its classes so far.
    methods : tuple of str
        The detectors to run, sorted.
    denoising_figure : path, optional
        PNG of the surface before and after the denoising for the flat regions.
    plan : Plan, optional
        The plan of a survey that this one is a part of, or a later one of.
    """

    inputs: Inputs
    params: Params
    profile: str
    label: Label
    methods: tuple[str, ...]
    denoising_figure: Path | None = None
    plan: Plan | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Detected:
    """A survey, or a window of it, after the steps from reading to the detectors.

    Parameters
    ----------
    scene : Scene
        Without its sources.
    params : Params
        With the values of the plan.
    plan : Plan
        That given, or that of the survey.
    regions : mapping of str to Regions
        Of each detector that was run.
    choices : dict
        What the run decided itself, as `msbdb.run.describe.describe_choices` returns it.
    points : int
        Points in the own ground of the window; of rasters, cells with a value.
    reach : tuple of float or None
        West, south, east and north of these points, or of all of these cells, metres; None without any.
    """

    scene: Scene
    params: Params
    plan: Plan
    regions: Mapping[str, Regions]
    choices: dict[str, object]
    points: int = 0
    reach: Bounds | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Decomposed:
    """A scene whose cells are decided, divided into houses, and decomposed into parts, but not described.

    Parameters
    ----------
    scene : Scene
        What the steps share.
    params : Params
        Of the run.
    regions : mapping of str to Regions
        Of each detector that was run.
    built : (H, W) ndarray of bool or None
        The cells that the detectors take together; None where they do not decide together.
    division : Division or None
        The houses in these cells.
    forest : Forest
        The tree of parts.
    rasters : Rasters, optional
        What the run keeps of the cells, where it is known already.
    packed : mapping of str to (ndarray, dict)
        These rasters as the database keeps them, where they are packed already.
    """

    scene: Scene
    params: Params
    regions: Mapping[str, Regions]
    built: NDArray[np.bool_] | None
    division: Division | None
    forest: Forest
    rasters: Rasters | None = None
    packed: Packed = field(default_factory=dict)

    @property
    def roofs(self) -> NDArray[np.bool_]:
        """The (H, W) cells of buildings: those to which the raster of reasons will give *building*."""
        roofs: NDArray[np.bool_] = self.forest.root_labels > 0
        return roofs

    @property
    def houses(self) -> NDArray[np.int32]:
        """The number of the building of each of the (H, W) cells; 0 for none."""
        return self.forest.root_labels if self.division is None else np.where(self.roofs, self.division.houses, 0)

    def described(self, stages: Stages) -> Description:
        """Return what the database keeps of it: outlines, heights, evidence and rasters."""
        with stages.stage("outlines"):
            found = describe(
                self.scene,
                self.regions,
                self.forest,
                self.params,
                built=self.built,
                division=self.division,
                rasters=self.rasters,
            )
        return replace(found, packed=self.packed)


def run_survey(job: Job, stages: Stages, notices: Notices) -> KeptRun:
    """Take one survey through all steps, up to the run that the database keeps.

    Parameters
    ----------
    job : Job
        What to do.
    stages : Stages
        For timings and progress.
    notices : Notices
        Receives the notices that arise; those that it has already are kept, too.
    """
    planned = job.plan
    if planned is None and is_large(job.inputs, job.params):
        with collect_notices(Notices()), memory_reused():
            planned = make_plan(job.inputs, job.params, stages)
    with collect_notices(notices), memory_reused():
        found = find_regions(job, planned, stages)
        made = fuse_and_decompose(found.scene, found.regions, found.params, stages, packs=True).described(stages)
    run = record_run(job, counts_of(found, made, job), stages.timings, notices)
    return KeptRun(found.scene.survey, run, made.frames, made.rasters, found.plan, made.packed)


def find_regions(job: Job, planned: Plan | None, stages: Stages, window: Window | None = None) -> Detected:
    """Take a survey, or a window of it, through the steps from reading to the detectors.

    Points, surface and bands are released as soon as no later step needs them, to keep the peak of memory low. In a
    window the detectors run one by one, as tiles beside it use the cores.

    Parameters
    ----------
    job : Job
        What to do.
    planned : Plan or None
        The plan; None where the survey makes its own.
    stages : Stages
        For timings and progress.
    window : Window, optional
        The part that is built; the classes count the cells of its own ground alone.

    Raises
    ------
    NodataError
        When there are no points or heights.
    MsbdbError
        When the files cannot be used.
    """
    facts, area = (None if planned is None else planned.points), (None if window is None else window.area)
    with stages.stage("read"):
        cloud = read_cloud(job.inputs, stages.progress, facts, area)
        points, reach = (0, None) if window is None or cloud is None else window.held_points(cloud)
        cloud = sparse_with_facts(cloud, job.params)  # here, so that the points that are left out are freed
    scene, params, plan = prepare(job.inputs, cloud, job.params, stages, job.label, plan=planned, window=window)
    del cloud
    if window is not None:
        if scene.cloud is None:
            points, reach = window.held_cells(scene.heights)
        scene = scene.with_points_aside()
    note_missing_sources(scene)
    choices = describe_choices(scene, params)
    regions = detect(scene, job.methods, params, stages, frugal=window is not None)
    if job.denoising_figure is not None and "flatregions" in job.methods:
        _draw_denoising(scene, params, job.denoising_figure)
    return Detected(scene.without_sources(), params, plan, regions, choices, points, reach)


def counts_of(found: Detected, made: Description, job: Job) -> Counts:
    """Return what a run counts, states and chooses: its regions by stage, its cells, and how they were classified."""
    cover = found.scene.cover
    return Counts(
        regions=made.counts,
        cells=count_cells(found.scene.heights, cover),
        cover={"colours_decide": int(cover.colours_decide), "green_decides": int(cover.green_decides)},
        stated=job.inputs.stated(),
        chosen=found.choices,
    )


def record_run(job: Job, counts: Counts, timings: dict[str, float], notices: Notices) -> Run:
    """Return the record of a run."""
    values: dict[str, object] = dict(as_dict(job.params))
    return Run(job.methods, job.profile, __version__, values, counts, timings, tuple(notices.kept))


def relabelled(
    kept: KeptRun, scene: Scene, regions: Mapping[str, Regions], labels: Mapping[int, str], stages: Stages
) -> KeptRun:
    """Return a kept run with other labels of its classes, and all that follows from them.

    Parameters
    ----------
    kept : KeptRun
        The run as it is in the database.
    scene, regions : Scene, mapping of str to Regions
        What `msbdb.run.store` reads back from it; the regions of ``multiscale`` are detected again.
    labels : mapping of int to str
        The operator's labels by class.
    stages : Stages
        For timings and progress.

    Raises
    ------
    InputError
        For a class or a label that does not exist.
    """
    scene = replace(scene, cover=scene.cover.relabelled(labels))
    params = with_values(Params(), kept.run.parameters)  # type: ignore[arg-type]  # plain nested values
    # The run's own scales: where the parameters give none, other labels would lead to other scales.
    params = with_values(params, {"scale": {"scales_m2": kept.frames["scale"]["threshold_m2"].tolist()[::-1]}})
    if "multiscale" in kept.run.methods:
        regions = {**regions, **detect(scene, ["multiscale"], params, stages)}
    found = fuse_and_decompose(scene, regions, params, stages, packs=True).described(stages)
    counts = replace(kept.run.counts, regions=found.counts, cells=count_cells(scene.heights, scene.cover))
    run = replace(kept.run, counts=counts, timings={**kept.run.timings, **stages.timings})
    return KeptRun(kept.survey, run, found.frames, found.rasters, kept.plan, found.packed)


def detect(
    scene: Scene, methods: Sequence[str], params: Params, stages: Stages, *, frugal: bool = False
) -> dict[str, Regions]:
    """Run the detectors on a scene, a stage each; none knows of the others.

    They run side by side on the cores. To be ``frugal`` with memory they run one by one, and keep no labels of points.
    """

    def find(method: str) -> Regions:
        with stages.stage(method):
            found = DETECTORS[method](scene, params)
            let_go()
        return replace(found, of_points=None) if frugal else found

    with stages.side_by_side():
        found = [find(method) for method in methods] if frugal else in_threads(find, methods)
    return dict(zip(methods, found, strict=True))


def fuse_and_decompose(
    scene: Scene, regions: Mapping[str, Regions], params: Params, stages: Stages, *, packs: bool = False
) -> Decomposed:
    """Decide which cells are building, divide them into houses, and these into parts.

    Where the detectors do not decide together, nothing is divided, and the multi-scale one alone makes the parts. Where
    a run will be written as a whole, it ``packs`` the rasters beside the first steps, which use one core.
    """
    if not scene.elevations.of_points:
        params = replace(params, fuse=params.fuse.of_rasters(scene.heights.spec.cell_m))
    rasters = describe_rasters(scene, regions) if packs else None

    def decide_cells() -> tuple[NDArray[np.bool_] | None, Division | None]:
        built = fuse(scene, regions, params, stages)
        return built, divide_houses(scene, built, params, stages)

    by_name = {} if rasters is None else rasters.by_name()
    (built, division), packed = together(decide_cells, partial(pack_rasters, by_name))
    with stages.stage("parts"):
        forest = decompose(scene, regions, built, division, params)
    return Decomposed(scene, params, regions, built, division, forest, rasters, packed)


def fuse(scene: Scene, regions: Mapping[str, Regions], params: Params, stages: Stages) -> NDArray[np.bool_] | None:
    """Return the cells that the detectors take together; None where they do not decide together."""
    with stages.stage("fusion"):
        if not is_fused(regions, params.fuse):
            return None
        green = scene.cover.colours.labelled("vegetation")
        return fuse_cells(
            scene.heights,
            regions,
            params.fuse,
            mask_m=params.surface.mask_m,
            of_points=scene.elevations.of_points,
            coloured=scene.cover.spectral is not None,
            evidence=scene.evidence,
            green=green,
        )


def divide_houses(scene: Scene, built: NDArray[np.bool_] | None, params: Params, stages: Stages) -> Division | None:
    """Divide the cells that the detectors take together into houses; None where they do not decide together."""
    if built is None:
        return None
    with stages.stage("houses"):
        heights, density = scene.heights, scene.survey.density
        cover = scene.cover.with_buildings(built, heights, params.surface.mask_m)
        spacing_m = 1 / math.sqrt(density) if density > 0 else heights.spec.cell_m
        labelled = built & cover.classes.labelled("building")
        return divide(
            heights,
            labelled,
            params.touching,
            spacing_m=spacing_m,
            parcels=scene.parcels,
            intensity=scene.intensity,
        )


def decompose(
    scene: Scene,
    regions: Mapping[str, Regions],
    built: NDArray[np.bool_] | None,
    division: Division | None,
    params: Params,
) -> Forest:
    """Return the tree of parts.

    Parameters
    ----------
    scene : Scene
        Heights and land cover.
    regions : mapping of str to Regions
        Of each detector that was run.
    built : (H, W) ndarray of bool or None
        The cells that the detectors support together. None leaves the tree to the multi-scale detector alone; it is
        empty where that was not run.
    division : Division or None
        The houses in these cells; None where there are no such cells.
    params : Params
        As `msbdb.parts.tree.extract_parts` takes them.
    """
    found = regions.get("multiscale")
    heights, cover = scene.heights, scene.cover
    houses = None if division is None else division.houses
    if built is not None:
        cover = cover.with_buildings(built, heights, params.surface.mask_m)
    elif found is not None and found.forest is not None:
        return found.forest
    else:
        heights = Grid(heights.values, np.zeros_like(heights.valid), heights.spec)
    return extract_parts(
        heights,
        cover.classes,
        survey=scene.survey.name,
        params=params,
        houses=houses,
        colours=cover.colours,
        crowns=scene.crowns(params),
    )


def _draw_denoising(scene: Scene, params: Params, figure: Path) -> None:
    """Draw the lowest points before and after the denoising for the flat regions."""
    from msbdb.view.regionmap import draw_denoising  # matplotlib takes half a second to load

    lowest = lowest_surface(scene, params)
    draw_denoising(lowest, denoise(lowest, params.flatregions).grid, figure, title=scene.survey.name)

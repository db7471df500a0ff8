"""The composition: one survey from its files to the run that the database keeps.

Prepare, detect, decompose into parts, fuse, describe. A re-labelling shares the steps after detection, `settle`.
"""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from msbdb.detect.flatregions.initialisation import denoise
from msbdb.detect.flatregions.mongus2013 import lowest_surface
from msbdb.detect.registry import DETECTORS
from msbdb.detect.scene import Regions, Scene
from msbdb.errors import MsbdbWarning, ParameterError
from msbdb.fuse.footprints import fuse
from msbdb.grid import Grid
from msbdb.kept import KeptRun, Rasters
from msbdb.params import Params, as_dict
from msbdb.parts.forest import Forest
from msbdb.parts.tree import extract_parts
from msbdb.run.describe import make_frames, outline_parts
from msbdb.run.prepare import Inputs, Label, prepare, read_cloud
from msbdb.run.stages import Notices, Stages, collect_notices
from msbdb.spectral.coverclasses import Cover
from msbdb.tables import Counts, Run
from msbdb.version import __version__
from msbdb.view.regionmap import draw_denoising

NO_IMAGERY = "There is no imagery: roofs and vegetation are told by height texture and echoes alone."
NO_POINTS = "There are no points: {names}, which {take} the points themselves, {were} left out."
NO_ECHOES = "No pulse has a second echo, or the source does not tell: height texture alone tells roofs from vegetation."


@dataclass(frozen=True, slots=True)
class Job:
    """What one run is to do.

    Parameters
    ----------
    inputs : Inputs
        The files.
    params : Params
        Every value that decides something.
    profile : str
        Name of the profile that the parameters began from.
    label : Label
        The survey's name and date, and an operator's labels of its classes so far.
    methods : tuple of str
        The detectors to run, sorted.
    denoising_figure : path, optional
        PNG of the surface before and after the denoising for the flat regions.
    """

    inputs: Inputs
    params: Params
    profile: str
    label: Label
    methods: tuple[str, ...]
    denoising_figure: Path | None = None


def choose_detectors(names: Sequence[str], inputs: Inputs) -> tuple[str, ...]:
    """Return the detectors to run, in order of their names.

    Those that take the points themselves are left out, with a notice, where the source is a raster.

    Raises
    ------
    ParameterError
        When one does not exist, none is named, or none of them can be run.
    """
    unknown = sorted(set(names) - set(DETECTORS))
    if unknown or not names:
        msg = f"The extractors are {', '.join(DETECTORS)}; got {', '.join(unknown) or 'none'}."
        raise ParameterError(msg)
    chosen = tuple(sorted(set(names)))
    if inputs.points:
        return chosen
    without = [name for name in chosen if DETECTORS[name].takes_points]
    left = tuple(name for name in chosen if name not in without)
    if not without:
        return left
    several = len(without) > 1
    told = NO_POINTS.format(
        names=" and ".join(without), take="take" if several else "takes", were="were" if several else "was"
    )
    if not left:
        msg = f"{told} Give LAS or LAZ files by --points, or ask for multiscale or flatregions."
        raise ParameterError(msg)
    warnings.warn(told, MsbdbWarning, stacklevel=2)
    return left


def run_survey(job: Job, stages: Stages, notices: Notices) -> KeptRun:
    """Take one survey through all stages, up to what the database keeps.

    Points, surface and bands are released as soon as no later stage needs them, for the peak of memory.

    Parameters
    ----------
    job : Job
        What to do.
    stages : Stages
        For timings and progress.
    notices : Notices
        Receives the notices that arise; those before it are kept, too.
    """
    evidence = {"multiscale", "flatregions"} <= set(job.methods)
    with collect_notices(notices):
        with stages.stage("read"):
            cloud = read_cloud(job.inputs, stages.progress)
        scene, params = prepare(job.inputs, cloud, job.params, stages, job.label, evidence=evidence)
        del cloud
        _note_sources(scene)
        ground_filter = scene.require_surface().ground_filter
        regions = detect(scene, job.methods, params, stages)
        if job.denoising_figure is not None and "flatregions" in job.methods:
            lowest = lowest_surface(scene, job.params)
            denoised = denoise(lowest, job.params.flatregions).grid
            draw_denoising(lowest, denoised, job.denoising_figure, title=job.label.name)
        scene = scene.without_sources()
        settled = settle(scene, regions, params, stages)
    counts = Counts(
        regions=settled.counts,
        cells=count_cells(scene.heights, scene.cover),
        cover={"colours_decide": int(scene.cover.colours_decide), "green_decides": int(scene.cover.green_decides)},
        stated=job.inputs.stated(),
        chosen=_chosen(ground_filter, params, scene.cover),
    )
    values: dict[str, object] = dict(as_dict(job.params))
    run = Run(job.methods, job.profile, __version__, values, counts, stages.timings, tuple(notices.kept))
    return KeptRun(scene.survey, run, settled.frames, settled.rasters)


def detect(scene: Scene, methods: Sequence[str], params: Params, stages: Stages) -> dict[str, Regions]:
    """Run the detectors on a scene, a stage each; none knows of the others."""
    found = {}
    for method in methods:
        with stages.stage(method):
            found[method] = DETECTORS[method].detect(scene, params)
    return found


@dataclass(frozen=True, slots=True, eq=False)
class Settled:
    """What follows from the regions of the detectors.

    Parameters
    ----------
    frames : dict of str to DataFrame
        The tables of the run by name.
    rasters : Rasters
        What the database keeps of the scene, the regions and the fused footprints.
    counts : dict
        By detector and stage: regions in, kept and dropped.
    """

    frames: dict[str, pd.DataFrame]
    rasters: Rasters
    counts: dict[str, dict[str, dict[str, int]]]


def settle(scene: Scene, regions: Mapping[str, Regions], params: Params, stages: Stages) -> Settled:
    """Fuse what the detectors found, and describe it: the steps that a build and a re-labelling share."""
    forest = forest_of(scene, regions, params)
    with stages.stage("fusion"):
        fused = fuse(forest, regions.get("flatregions"), scene, params)
    with stages.stage("outlines"):
        parts = outline_parts(forest, scene.heights, params.vector)
        frames = make_frames(scene, regions, forest, parts)
    counts = {"multiscale": forest.counts} | {name: found.counts for name, found in regions.items()}
    some = {name: stages for name, stages in counts.items() if stages}
    return Settled(frames, _rasters(scene, regions, fused), some)


def forest_of(scene: Scene, regions: Mapping[str, Regions], params: Params) -> Forest:
    """Return the parts; an empty forest where the multi-scale detector was not run."""
    found = regions.get("multiscale")
    if found is not None and found.forest is not None:
        return found.forest
    heights = scene.heights
    nothing = Grid(heights.values, np.zeros_like(heights.valid), heights.spec)
    return extract_parts(nothing, scene.cover.classes, survey=scene.survey.name, params=params)


def count_cells(heights: Grid, cover: Cover) -> dict[str, int]:
    """Count the cells: all, valid, and a class label each."""
    labels = cover.classes.labels
    found = np.bincount(cover.classes.index.ravel(), minlength=256)
    by_label: dict[str, int] = {}
    for index, label in sorted(labels.items()):
        by_label[label] = by_label.get(label, 0) + int(found[index])
    return {"all": int(heights.valid.size), "valid": int(np.count_nonzero(heights.valid)), **by_label}


def _rasters(scene: Scene, regions: Mapping[str, Regions], fused: NDArray[np.int32] | None) -> Rasters:
    """Return the rasters that the database keeps."""
    cover, flat = scene.cover, regions.get("flatregions")
    rasters = Rasters.of_heights(scene.heights, cover.structure.index)
    if fused is not None and scene.evidence is not None:
        rasters = replace(
            rasters,
            fused=fused,
            roughness_mm=scene.evidence.roughness_mm,
            roof_probability=scene.evidence.roof_probability,
        )
    return replace(
        rasters,
        spectral=None if cover.spectral is None else cover.spectral.index,
        regions={name: found.labels for name, found in regions.items() if name != "multiscale"},
        firm=None if flat is None else flat.firm,
    )


def _chosen(ground_filter: str, params: Params, cover: Cover) -> dict[str, object]:
    """Return what a run decided itself, to be kept with it (V21, X2).

    Parameters
    ----------
    ground_filter : str
        The filter that found the ground, where ``auto`` was asked for; ``given`` for a terrain raster.
    params : Params
        With the scales that were used.
    cover : Cover
        With the fit of the classes by colour, where there are any.
    """
    return {
        "ground_filter": ground_filter,
        "scales_m2": list(params.scale.scales_m2),
        "spectral": cover.model.as_dict() if cover.model else None,
    }


def _note_sources(scene: Scene) -> None:
    """Give notice of sources that are missing, without which buildings are harder to recognise."""
    echoes = scene.cloud is not None and scene.cloud.has_echoes
    if scene.cover.spectral is None:
        warnings.warn(NO_IMAGERY, MsbdbWarning, stacklevel=2)
    if not echoes:
        warnings.warn(NO_ECHOES, MsbdbWarning, stacklevel=2)

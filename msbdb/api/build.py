"""The main job, from end to end: from LiDAR and imagery to a multi-scale building database."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from msbdb.bands import Bands
from msbdb.database import PATIENCE_S, BuildBasis, OutdatedError, check_target, read_labelled_classes, store_build
from msbdb.detect.candidatelayer import CandidateLayer, find_regions, point_ndvi
from msbdb.detect.flatregions.flatlayer import Flat, find_flat_regions, no_flat_regions
from msbdb.errors import DatabaseError, ParameterError
from msbdb.fuse.footprints import Together, fuse, keep_evidence
from msbdb.grid import Grid
from msbdb.params import DETECTORS, POINT_DETECTORS, Params, as_dict
from msbdb.params import profile as named_profile
from msbdb.parts.forest import Forest
from msbdb.parts.tree import choose_scales, extract_parts
from msbdb.points.cloud import PointCloud
from msbdb.run.describe import make_frames, outline_parts
from msbdb.run.kept import pack_state
from msbdb.run.prepare import Inputs, collect_notices, make_surface, read_cloud, read_ortho, record_survey
from msbdb.run.stages import Progress, Stages
from msbdb.spectral.colours import spectral_bands
from msbdb.spectral.coverclasses import Cover, classify_cover, keep_labels
from msbdb.surface import Surface, cover_from_surface
from msbdb.tables import Build, Run, Survey
from msbdb.version import __version__

NO_IMAGERY = "There is no imagery: roofs and vegetation are told by height texture and echoes alone."

NO_POINTS = "There are no points: {names}, which {take} the points themselves, {were} left out."

NO_ECHOES = "No pulse has a second echo, or the source does not tell: height texture alone tells roofs from vegetation."


@dataclass(frozen=True, slots=True)
class BuildReport:
    """What a build did: counts, sentences for people, seconds a stage, and whether the database changed."""

    survey: str
    buildings: int
    parts: int
    flat_regions: int
    candidate_regions: dict[str, int]
    rejected: int
    notices: tuple[str, ...]
    timings: dict[str, float]
    changed: bool

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return asdict(self)


def build(
    points: Sequence[Path] = (),
    *,
    ortho: Sequence[Path] = (),
    dsm: Path | None = None,
    dtm: Path | None = None,
    ndsm: Path | None = None,
    db: str | Path,
    survey: str | None = None,
    date: str | None = None,
    crs: str | None = None,
    ortho_crs: str | None = None,
    z_unit: str = "auto",
    params: Params | None = None,
    profile: str = "default",
    extract: Sequence[str] = DETECTORS,
    denoising_figure: Path | None = None,
    progress: Progress | None = None,
) -> BuildReport:
    """Build or extend a database of buildings from one survey.

    Parameters
    ----------
    points : sequence of path
        LAS, LAZ or COPC files; or give ``dsm`` with ``dtm``, or ``ndsm``, as GeoTIFF.
    ortho : sequence of path
        Orthophotos of any bands, each on its own grid and CRS. Without them the points' colours serve.
    dsm, dtm, ndsm : path, optional
        Rasters of heights.
    db : str or path
        A SpatiaLite file, made when it is missing, or a ``postgresql+psycopg://`` URL.
    survey : str, optional
        Name of the survey; the first file's name by default. Building it again replaces it, or changes nothing.
    date : str, optional
        When the data were taken, ISO 8601.
    crs : str, optional
        CRS of point files and rasters of heights that state none.
    ortho_crs : str, optional
        CRS of orthophotos that state none.
    z_unit : str
        Unit of the heights: ``auto``, ``m``, ``ft`` or ``us-ft``.
    params : Params, optional
        Parameters; the profile's by default.
    profile : str
        Name of the profile that the parameters come from.
    extract : sequence of str
        ``multiscale`` finds buildings as trees of parts; ``flatregions`` finds flat regions, and ``area3d`` and
        ``adaptive`` find candidate regions on the points themselves, as their evidence.
    denoising_figure : path, optional
        PNG of the surface before and after the denoising for the flat regions.
    progress : callable, optional
        Called with stage, steps done and steps in all.

    Returns
    -------
    BuildReport

    Raises
    ------
    MsbdbError
        One of its kinds, when the inputs or the database cannot be used. Nothing is written then.
    """
    params = params or named_profile(profile)
    as_paths = [Path(path) for path in points], [Path(path) for path in ortho]
    inputs = Inputs(tuple(as_paths[0]), tuple(as_paths[1]), dsm, dtm, ndsm, crs, ortho_crs, z_unit)
    notices: list[str] = []
    methods = possible_extractors(check_extractors(extract), inputs, notices)
    check_target(db)
    stages = Stages(progress)
    with collect_notices(notices):
        name = survey or inputs.default_survey()
        labelled = read_labelled_classes(db, name)
        job = Job(inputs, params, name, date or "", methods, denoising_figure, labelled)
        found = run(job, stages, notices)
    counts: dict[str, object] = {
        "regions": found.regions,
        "cells": count_cells(found.ndsm, found.cover),
        "cover": {"colours_decide": int(found.cover.colours_decide), "green_decides": int(found.cover.green_decides)},
        "stated": inputs.stated(),
        "chosen": found.chosen,
    }
    values: dict[str, object] = dict(as_dict(params))
    entry = Run(tuple(sorted(methods)), profile, __version__, values, counts, stages.timings, tuple(notices))
    with stages.stage("write"):
        state = pack_state(found.ndsm, found.cover, found.flat, found.candidates, found.together)
        whole = Build(found.survey, entry, found.frames, state)
        changed = _store(whole, db, labelled)
    report = report_of(whole, stages, changed=changed)
    # What is said once of labels is no part of the content: built once more, all would be the same.
    return replace(report, notices=(*report.notices, *job.lost))


@dataclass(frozen=True, slots=True)
class Job:
    """What one run is to do: inputs, parameters, the survey's name and date, extractors, and an operator's labels."""

    inputs: Inputs
    params: Params
    survey: str
    date: str
    methods: tuple[str, ...]
    denoising_figure: Path | None
    labelled: pd.DataFrame
    lost: list[str] = field(default_factory=list)


def check_extractors(names: Sequence[str]) -> tuple[str, ...]:
    """Return the extractors in order of their names.

    Raises
    ------
    ParameterError
        When one does not exist, or none is named.
    """
    unknown = sorted(set(names) - set(DETECTORS))
    if unknown or not names:
        msg = f"The extractors are {', '.join(DETECTORS)}; got {', '.join(unknown) or 'none'}."
        raise ParameterError(msg)
    return tuple(sorted(set(names)))


def possible_extractors(names: tuple[str, ...], inputs: Inputs, notices: list[str]) -> tuple[str, ...]:
    """Leave out, with a notice, the extractors that take the points themselves, where the build is from rasters.

    Raises
    ------
    ParameterError
        When no other was asked for.
    """
    without = [name for name in names if name in POINT_DETECTORS]
    if inputs.points or not without:
        return names
    several = len(without) > 1
    told = NO_POINTS.format(
        names=" and ".join(without), take="take" if several else "takes", were="were" if several else "was"
    )
    left = tuple(name for name in names if name not in POINT_DETECTORS)
    if not left:
        msg = f"{told} Give LAS or LAZ files by --points, or ask for multiscale or flatregions."
        raise ParameterError(msg)
    notices.append(told)
    return left


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What one run found: the survey's record, what the database keeps of each stage, and the tables.

    ``regions`` are the counts of all stages, ``frames`` the tables by name, ``chosen`` is what the run decided itself
    (`chosen_of`).
    """

    survey: Survey
    ndsm: Grid
    cover: Cover
    flat: Flat
    candidates: tuple[CandidateLayer, ...]
    together: Together | None
    regions: dict[str, dict[str, dict[str, int]]]
    frames: dict[str, Any]
    chosen: dict[str, object]


def run(job: Job, stages: Stages, notices: list[str]) -> Found:
    """Take one tile through all stages, up to the tables that the database takes.

    Points and surfaces are let go as soon as no later stage needs them, for the peak of memory.
    """
    inputs, params = job.inputs, job.params
    with stages.stage("read"):
        cloud = read_cloud(inputs, stages.progress, notices)
    with stages.stage("surface"):
        surface = make_surface(inputs, cloud, params)
    with stages.stage("cover"):
        structure = cover_from_surface(surface, cloud, params)
        echoes = cloud is not None and cloud.has_echoes
    record = record_survey(inputs, name=job.survey, date=job.date, surface=surface, cloud=cloud)
    ndsm, ground_filter = surface.ndsm, surface.ground_filter
    flat = no_flat_regions(ndsm.spec)
    if "flatregions" in job.methods:
        with stages.stage("flat regions"):
            flat = find_flat_regions(surface, cloud, params, survey=job.survey, figure=job.denoising_figure)
    with stages.stage("bands"):
        ortho = read_ortho(inputs, ndsm.spec)
        bands = spectral_bands(ortho, cloud, ndsm.spec, max_gap_m=params.surface.max_gap_m)
        del ortho
    candidates = find_candidates(job, stages, surface, cloud, bands)
    del surface, cloud
    with stages.stage("classes"):
        params = choose_scales(ndsm, structure.cover, params)
        cover = classify_cover(structure.cover, bands, ndsm, structure.roughness_m, params, echoes=echoes)
        cover = keep_labels(cover, job.labelled, job.lost)
        notices += [NO_IMAGERY] * (cover.spectral is None) + [NO_ECHOES] * (not echoes)
        evidence = keep_evidence(structure) if {"multiscale", "flatregions"} <= set(job.methods) else None
        del bands, structure
    with stages.stage("parts"):
        searched = ndsm if "multiscale" in job.methods else Grid(ndsm.values, np.zeros_like(ndsm.valid), ndsm.spec)
        forest = extract_parts(searched, cover.classes, survey=job.survey, params=params)
    with stages.stage("together"):
        together = fuse(forest, flat, evidence, ndsm, params)
    with stages.stage("outlines"):
        parts = outline_parts(forest, ndsm, params.vector)
        frames = make_frames(forest, parts, cover, flat, candidates, ndsm=ndsm)
    regions = region_counts(forest, flat, candidates)
    return Found(
        record, ndsm, cover, flat, candidates, together, regions, frames, chosen_of(ground_filter, params, cover)
    )


def chosen_of(ground_filter: str, params: Params, cover: Cover) -> dict[str, object]:
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


def find_candidates(
    job: Job, stages: Stages, surface: Surface, cloud: PointCloud | None, bands: Bands | None
) -> tuple[CandidateLayer, ...]:
    """Find the candidate regions of each extractor on points that was asked for, a stage each."""
    layers = []
    for method in POINT_DETECTORS:
        if cloud is None or method not in job.methods:
            continue
        with stages.stage(method):
            ndvi = point_ndvi(bands, cloud)
            layers.append(find_regions(method, cloud, surface, ndvi=ndvi, params=job.params, survey=job.survey))
    return tuple(layers)


def _store(build: Build, db: str | Path, labelled: pd.DataFrame) -> bool:
    """Write a build in one transaction; return whether the database changed.

    Raises
    ------
    DatabaseError
        When an operator labelled classes since the build began: written over, the word would be lost.
    """
    try:
        basis = BuildBasis(labelled=labelled)
        return store_build(db, build, basis=basis, timeout_s=PATIENCE_S).status != "unchanged"
    except OutdatedError as error:
        msg = (
            f"An operator labelled classes of the survey '{build.survey.name}' while it was built. Nothing was "
            "written; build it again, and the labels are taken over."
        )
        raise DatabaseError(msg) from error


def region_counts(
    forest: Forest, flat: Flat, candidates: Sequence[CandidateLayer]
) -> dict[str, dict[str, dict[str, int]]]:
    """Return the counts by stage of each extractor that has any."""
    counts = {"multiscale": forest.counts, "flatregions": flat.counts}
    counts |= {layer.method: layer.counts for layer in candidates}
    return {method: stages for method, stages in counts.items() if stages}


def count_cells(ndsm: Grid, cover: Cover) -> dict[str, int]:
    """Count the cells: all, valid, and a class label each."""
    labels = cover.classes.labels
    found: NDArray[np.int64] = np.bincount(cover.classes.index.ravel(), minlength=256)
    by_label: dict[str, int] = {}
    for index, label in sorted(labels.items()):
        by_label[label] = by_label.get(label, 0) + int(found[index])
    return {"all": int(ndsm.valid.size), "valid": int(np.count_nonzero(ndsm.valid)), **by_label}


def candidates_by_method(build: Build) -> dict[str, int]:
    """Count the candidate regions of each extractor on points that was run."""
    found = build.frames["candidate_region"]["method"]
    return {name: int((found == name).sum()) for name in POINT_DETECTORS if name in build.run.methods}


def report_of(build: Build, stages: Stages, *, changed: bool) -> BuildReport:
    """Sum up a build."""
    return BuildReport(
        survey=build.survey.name,
        buildings=len(build.frames["building"]),
        parts=len(build.frames["part"]),
        flat_regions=len(build.frames["flat_region"]),
        candidate_regions=candidates_by_method(build),
        rejected=len(build.frames["rejection"]),
        notices=build.run.notices,
        timings={name: round(seconds, 3) for name, seconds in stages.timings.items()},
        changed=changed,
    )

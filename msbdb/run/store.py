"""Between a run and the database: written in one transaction, read back as a scene, labelled again.

Also the fused footprints of a kept run as outlines.
"""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from msbdb.database import (
    PATIENCE_S,
    BuildBasis,
    Engine,
    OutdatedError,
    opened,
    read_build,
    read_buildings,
    read_digest,
    read_rasters,
    read_run,
    read_survey,
    store_build,
)
from msbdb.detect.multiscale.vu2009 import detect_multiscale
from msbdb.detect.scene import Evidence, Regions, Scene
from msbdb.errors import DatabaseError, InputError
from msbdb.grid import Grid, GridSpec
from msbdb.kept import KeptRun, Rasters, heights_of, lattice_of
from msbdb.labels import height_statistics, order_heights, reorder, sizes, sums
from msbdb.landcover import ClassMap
from msbdb.outline.polygons import polygonise
from msbdb.outline.simplification import simplify_coverage
from msbdb.params import POINT_DETECTORS, Params, with_values
from msbdb.run.compose import count_cells, settle
from msbdb.run.reports import BuildReport
from msbdb.run.stages import Progress, Stages
from msbdb.spectral.coverclasses import Cover
from msbdb.tables import REJECTION

logger = logging.getLogger(__name__)

ATTEMPTS = 5
"""How often labels are given again, when others label the same survey meanwhile."""


def store_survey(kept: KeptRun, db: str | Path, labelled: pd.DataFrame) -> bool:
    """Write a run in one transaction; return whether the database changed.

    Raises
    ------
    DatabaseError
        When an operator labelled classes since the build began: written over, the word would be lost.
    """
    try:
        basis = BuildBasis(labelled=labelled)
        return store_build(db, kept, basis=basis, timeout_s=PATIENCE_S).status != "unchanged"
    except OutdatedError as error:
        msg = (
            f"An operator labelled classes of the survey '{kept.survey.name}' while it was built. Nothing was "
            "written; build it again, and the labels are taken over."
        )
        raise DatabaseError(msg) from error


def relabel_survey(
    db: str | Path, labels: Mapping[int, str], *, survey: str | None, progress: Progress | None
) -> BuildReport:
    """Give classes the operator's labels, and write what follows; see `msbdb.api.relabel`."""
    stages = Stages(progress)
    first: list[list[Any]] | None = None
    for _ in range(ATTEMPTS):
        with stages.stage("read"), opened(db) as engine:
            digest = read_digest(engine, read_survey(engine, survey).name)
            old = read_build(engine, survey)
        classes = old.frames["spectral_class"][["speindex", "cells"]].to_numpy().tolist()
        first = first or classes
        if classes != first:
            break
        kept = relabelled(old, labels, stages)
        with stages.stage("write"):
            try:
                basis = BuildBasis(content_sha256=digest)
                changed = store_build(db, kept, basis=basis, timeout_s=PATIENCE_S).status != "unchanged"
            except OutdatedError:
                logger.info("The survey %s changed meanwhile; labelling again", old.survey.name)
                continue
        return report_of(kept, stages, changed=changed)
    msg = (
        f"Others changed the survey '{old.survey.name}' meanwhile. Nothing was labelled; look at its classes with "
        "'msbdb classes', and try again."
    )
    raise DatabaseError(msg)


def report_of(kept: KeptRun, stages: Stages, *, changed: bool, passing: Sequence[str] = ()) -> BuildReport:
    """Sum up a run; ``passing`` are notices that it does not keep."""
    return BuildReport(
        survey=kept.survey.name,
        buildings=len(kept.frames["building"]),
        parts=len(kept.frames["part"]),
        flat_regions=len(kept.frames["flat_region"]),
        candidate_regions=kept.candidate_counts,
        rejected=len(kept.frames["rejection"]),
        notices=(*kept.run.notices, *passing),
        timings=stages.rounded(),
        changed=changed,
    )


def relabelled(kept: KeptRun, labels: Mapping[int, str], stages: Stages) -> KeptRun:
    """Return a run with other labels of its classes, and all that follows from them.

    Raises
    ------
    InputError
        For a class or a label that does not exist.
    """
    scene, regions = recall_scene(kept), recall_regions(kept)
    scene = replace(scene, cover=scene.cover.relabelled(labels))
    params = with_values(Params(), kept.run.parameters)  # type: ignore[arg-type]  # plain nested values
    # The run's own scales, because other labels would find others where the parameters give none.
    params = with_values(params, {"scale": {"scales_m2": kept.frames["scale"]["threshold_m2"].tolist()[::-1]}})
    if "multiscale" in kept.run.methods:
        with stages.stage("multiscale"):
            regions["multiscale"] = detect_multiscale(scene, params)
    settled = settle(scene, regions, params, stages)
    counts = replace(kept.run.counts, regions=settled.counts, cells=count_cells(scene.heights, scene.cover))
    run = replace(kept.run, counts=counts, timings={**kept.run.timings, **stages.timings})
    return KeptRun(kept.survey, run, settled.frames, settled.rasters)


def recall_scene(kept: KeptRun) -> Scene:
    """Return the scene of a kept run, with the operator's labels so far; without surface, points and bands."""
    return Scene(kept.survey, kept.heights, _cover(kept, lattice_of(kept.survey)), _evidence(kept.rasters))


def recall_regions(kept: KeptRun) -> dict[str, Regions]:
    """Return the regions of a kept run by detector, with their ledgers and counts.

    The regions of ``multiscale`` depend on the operator's labels and are detected again.
    """
    labels, found = kept.rasters.regions, {}
    if "flatregions" in labels:
        table = kept.frames["flat_region"].sort_values("region_id", ignore_index=True)
        found["flatregions"] = Regions(
            "flatregions",
            labels["flatregions"],
            gpd.GeoDataFrame(table),
            *_written_by(kept, "flatregions"),
            firm=kept.rasters.firm,
        )
    table = kept.frames["candidate_region"].sort_values("candidate_id", ignore_index=True)
    for method in kept.run.methods:
        if method in POINT_DETECTORS:
            own = gpd.GeoDataFrame(table[table["method"] == method].reset_index(drop=True))
            found[method] = Regions(method, labels[method], own, *_written_by(kept, method))
    return found


def _written_by(kept: KeptRun, method: str) -> tuple[pd.DataFrame, dict[str, dict[str, int]]]:
    """Return the ledger rows and the counts by stage of a detector."""
    ledger = kept.frames["rejection"]
    return ledger.loc[ledger["method"] == method, REJECTION.names], kept.run.counts.regions.get(method, {})


def _evidence(rasters: Rasters) -> Evidence | None:
    """Return each cell's evidence of roof; None where the run has none."""
    if rasters.roughness_mm is None or rasters.roof_probability is None:
        return None
    return Evidence(rasters.roughness_mm, rasters.roof_probability)


def _cover(kept: KeptRun, spec: GridSpec) -> Cover:
    """Return the land cover of a kept run, with the operator's labels so far."""
    table, rasters, rule = kept.frames["spectral_class"], kept.rasters, kept.run.counts.cover
    labels = dict(zip(table["speindex"].tolist(), table["label"].tolist(), strict=True))
    by_operator = set(table.loc[table["labelled_by"] == "operator", "speindex"].tolist())
    colours = set(table.loc[table["source"] == "spectral", "speindex"].tolist())
    spectral = None
    if rasters.spectral is not None:
        spectral = ClassMap(rasters.spectral, {k: labels[k] for k in colours}, spec)
    return Cover(
        structure=ClassMap(rasters.structure, {1: "building", 2: "vegetation"}, spec),
        spectral=spectral,
        table=table,
        bands=kept.frames["spectral_class_band"],
        colours_decide=bool(rule["colours_decide"]),
        green_decides=bool(rule["green_decides"]),
        operator={k: labels[k] for k in by_operator},
    )


NOT_THERE = (
    "The survey '{survey}' has no footprints of parts and flat regions together. Build it with the extractors "
    "multiscale and flatregions; 'msbdb classes --set' cannot make up for what an older msbdb did not keep."
)


def has_together(engine: Engine, survey: str | None = None) -> bool:
    """Tell whether a survey has footprints of parts and flat regions together."""
    return read_rasters(engine, survey).fused is not None


def read_together(engine: Engine, survey: str | None = None) -> gpd.GeoDataFrame:
    """Return the footprints of parts and flat regions together, measured anew, a row a building, in order of the ids.

    Parameters
    ----------
    engine : Engine
        An open database.
    survey : str, optional
        Not needed where the database holds one.

    Returns
    -------
    GeoDataFrame
        ``building_id``, ``root_id``, ``state`` and ``storeys`` of the building; ``h_max``, ``h_mean``, ``h_p50`` and
        ``h_p90`` (m), ``area_m2`` and ``volume_m3`` (heights below 0 count as 0) of the fused footprint's cells, and
        its outline. Buildings of which nothing is left are not there.

    Raises
    ------
    InputError
        When the survey was built without one of the two extractors, or by an msbdb that did not fuse them.
    """
    record, rasters = read_survey(engine, survey), read_rasters(engine, survey)
    if rasters.fused is None:
        raise InputError(NOT_THERE.format(survey=record.name))
    values: dict[str, object] = read_run(engine, survey).parameters
    params = with_values(Params(), values)  # type: ignore[arg-type]  # plain nested values
    spec = lattice_of(record)
    buildings = read_buildings(engine, survey)
    kept = rasters.fused
    there = np.flatnonzero(sizes(kept, len(buildings)))
    labels = reorder(kept, there, len(buildings))
    rows = buildings.iloc[there][["building_id", "root_id", "state", "storeys"]].reset_index(drop=True)
    rows = rows.assign(**_measured(labels, len(there), heights_of(record, rasters)))
    outlines = polygonise(labels, spec, len(there)) if len(there) else np.empty(0, dtype=object)
    shapes = list(simplify_coverage(outlines, params.vector.simplify_px * spec.cell_m)) if len(there) else []
    return gpd.GeoDataFrame(rows, geometry=shapes, crs=spec.crs)


def _measured(labels: NDArray[np.int32], count: int, heights: Grid) -> dict[str, NDArray[np.float64]]:
    """Return heights, areas and volumes of labelled footprints."""
    found = height_statistics(labels, slice(0, count), order_heights(heights, labels > 0))
    above = np.where(heights.valid, np.maximum(np.asarray(heights.values, dtype=np.float64), 0), 0)
    cell_m2 = heights.spec.cell_area_m2
    return {
        **{name: found[name].to_numpy() for name in ("h_max", "h_mean", "h_p50", "h_p90")},
        "area_m2": sizes(labels, count) * cell_m2,
        "volume_m3": sums(labels, above, count) * cell_m2,
    }

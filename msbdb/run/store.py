"""Between a run and the database: written in one transaction, read back as a scene and regions, labelled again."""

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from msbdb.database import (
    PATIENCE_S,
    BuildBasis,
    Former,
    OutdatedError,
    opened,
    read_build,
    read_digest,
    read_former,
    read_survey,
    shown,
    store_build,
)
from msbdb.database.dialects.dialect import database_url
from msbdb.detect.scene import Elevations, Evidence, Regions, Scene
from msbdb.errors import DatabaseError
from msbdb.grid import GridSpec
from msbdb.kept import KeptRun, Rasters, lattice_of
from msbdb.landcover import ClassMap
from msbdb.params import POINT_DETECTORS
from msbdb.run.compose import relabelled
from msbdb.run.inputs import Inputs
from msbdb.run.reports import FIRST, GROUND_RANGE_M, BuildReport, Overview, Progress, Stages
from msbdb.spectral.coverclasses import Cover
from msbdb.tables import REASONS, REJECTION, Reason, Survey
from msbdb.tables.building_tables import BUILDING_STATES

logger = logging.getLogger(__name__)

ATTEMPTS = 5
"""Attempts to give labels, when others label the same survey at the same time."""

AS_IS = (Reason.NO_DATA, Reason.BUILDING, Reason.LOW)
"""Reasons by which nothing that may be a building is refused."""


def require_replaceable(
    db: str | Path, name: str, inputs: Inputs, methods: Sequence[str], *, replace: bool
) -> Former | None:
    """Return the run that a build will replace, None for a new survey; check before the work that it may.

    Raises
    ------
    InputError
        Without ``replace``, when the run is of other files, or has results of detectors that the build lacks.
    """
    former = read_former(db, name)
    if former is not None and not replace:
        former.require_sources(inputs.sources(), inputs.longer_survey(name))
        former.require_methods(methods)
    return former


def replaced(former: Former | None, kept: KeptRun) -> tuple[str, ...]:
    """Return the notice that a run took the place of another one."""
    if former is None:
        return ()
    return (f"The survey '{former.name}' was there and is replaced: {former.differences(kept.survey, kept.run)}.",)


def store_survey(kept: KeptRun, db: str | Path, labelled: pd.DataFrame, *, replace: bool) -> bool:
    """Write a run in one transaction; return whether the database changed.

    Raises
    ------
    DatabaseError
        When an operator labelled classes since the build began; the build would overwrite the labels.
    InputError
        Without ``replace``, when the survey of this name is of other files or another place, or has more detectors.
    """
    try:
        basis = BuildBasis(labelled=labelled, replace=replace)
        return store_build(db, kept, basis=basis, timeout_s=PATIENCE_S).status != "unchanged"
    except OutdatedError as error:
        msg = (
            f"An operator labelled classes of the survey '{kept.survey.name}' while it was built. The "
            "database is unchanged. Build the survey again; the labels are then kept."
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
        kept = relabelled(old, recall_scene(old), recall_regions(old), labels, stages)
        with stages.stage("write"):
            try:
                basis = BuildBasis(content_sha256=digest)
                changed = store_build(db, kept, basis=basis, timeout_s=PATIENCE_S).status != "unchanged"
            except OutdatedError:
                logger.info("The survey %s changed meanwhile; it is labelled again", old.survey.name)
                continue
        return report_of(kept, stages, db, changed=changed)
    msg = (
        f"Others changed the survey '{old.survey.name}' meanwhile. No label was written. List its classes with "
        "'msbdb classes', and try again."
    )
    raise DatabaseError(msg)


def report_of(
    kept: KeptRun, stages: Stages, db: str | Path, *, changed: bool, passing: Sequence[str] = ()
) -> BuildReport:
    """Sum up a run; ``passing`` are notices that it does not keep."""
    return BuildReport(
        survey=kept.survey.name,
        buildings=len(kept.frames["building"]),
        parts=len(kept.frames["part"]),
        flat_regions=len(kept.frames["flat_region"]),
        candidate_regions=kept.candidate_counts,
        rejected=int(kept.frames["rejection_count"]["regions"].sum()),
        notices=(*kept.run.notices, *passing),
        timings=stages.rounded(),
        changed=changed,
        database=shown(database_url(db)),
        overview=overview_of(kept.frames["building"], refused_m2(kept), len(kept.frames["rejection"])),
    )


OVERVIEW = (
    "building_id",
    "state",
    "probability",
    "area_m2",
    "ridge",
    "z_ground_min",
    "z_ground_max",
    "xin",
    "yin",
)
"""The columns of buildings that an overview takes."""


def overview_of(found: pd.DataFrame, refused: dict[str, float], refused_regions: int) -> Overview:
    """Return what a person wants to know of a run first: its buildings, and what was refused, square metres."""
    buildings = pd.DataFrame(found[list(OVERVIEW)])
    by_area = buildings.sort_values(["area_m2", "building_id"], ascending=[False, True])
    by_ridge = buildings.sort_values(["ridge", "building_id"], ascending=[False, True])
    states = {state: int((buildings["state"] == state).sum()) for state in BUILDING_STATES}
    range_m = (by_area["z_ground_max"] - by_area["z_ground_min"]).astype("float64").fillna(0.0)
    unsure = by_area[by_area["state"] == "unsure"]
    uneven = by_area.assign(ground_range_m=range_m.round(1))[range_m > GROUND_RANGE_M]
    uneven = uneven.sort_values(["ground_range_m", "building_id"], ascending=[False, True])
    return Overview(
        states={state: count for state, count in states.items() if count},
        largest=next(iter(_named(by_area)), {}),
        highest=next(iter(_named(by_ridge[by_ridge["ridge"].notna()])), {}),
        refused_m2=refused,
        refused_regions=refused_regions,
        unsure=tuple(_named(unsure, "probability")),
        uneven=tuple(_named(uneven, "ground_range_m")),
        counts={"unsure": len(unsure), "uneven": len(uneven)},
    )


def _named(buildings: pd.DataFrame, *more: str) -> list[dict[str, Any]]:
    """Return the first buildings with their places and measures as plain values."""
    names = {
        "building_id": "building_id",
        "xin": "easting",
        "yin": "northing",
        "area_m2": "area_m2",
        "ridge": "ridge_m",
    }
    rows = buildings[[*names, *more]].rename(columns=names).head(FIRST).astype(object)
    return [
        {str(name): value for name, value in row.items()} for row in rows.where(rows.notna(), None).to_dict("records")
    ]


def refused_m2(kept: KeptRun) -> dict[str, float]:
    """Return the area that is as high as a building and is none, by reason, the largest first."""
    if kept.rasters.reason is None:
        return {}
    cells = np.bincount(kept.rasters.reason.ravel(), minlength=len(Reason))
    return refused_areas(cells, kept.heights.spec.cell_area_m2)


def refused_areas(cells: NDArray[np.integer], cell_area_m2: float) -> dict[str, float]:
    """Return the areas by reason from the number of cells of each reason, as `refused_m2` does."""
    area_m2 = {REASONS[why]: float(cells[why] * cell_area_m2) for why in Reason if why not in AS_IS}
    return {why: round(found, 1) for why, found in sorted(area_m2.items(), key=lambda item: -item[1]) if found}


def recall_scene(kept: KeptRun) -> Scene:
    """Return the scene of a kept run, with the operator's labels so far; without surface, points and bands."""
    cover, elevations = _cover(kept, lattice_of(kept.survey)), recall_elevations(kept.survey, kept.rasters)
    rasters = kept.rasters
    evidence = _evidence(rasters)
    return Scene(
        kept.survey, kept.heights, cover, evidence, elevations, parcels=rasters.parcels, intensity=rasters.intensity
    )


def recall_elevations(survey: Survey, rasters: Rasters) -> Elevations:
    """Return the terrain and the echoes of a kept run; without them where an older msbdb wrote it."""
    return Elevations(rasters.terrain_cm, rasters.echoes, any(source.role == "points" for source in survey.sources))


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
            **_answered_by(kept, "flatregions"),
        )
    table = kept.frames["candidate_region"].sort_values("candidate_id", ignore_index=True)
    for method in kept.run.methods:
        if method in POINT_DETECTORS:
            own = gpd.GeoDataFrame(table[table["method"] == method].reset_index(drop=True))
            own_ledger = _written_by(kept, method)
            found[method] = Regions(method, labels[method], own, *own_ledger, **_answered_by(kept, method))
    return found


def _written_by(kept: KeptRun, method: str) -> tuple[pd.DataFrame, dict[str, dict[str, int]]]:
    """Return the ledger rows and the counts by stage of a detector."""
    ledger = kept.frames["rejection"]
    return ledger.loc[ledger["method"] == method, REJECTION.names], kept.run.counts.regions.get(method, {})


def _answered_by(kept: KeptRun, method: str) -> dict[str, Any]:
    """Return which of its cells a detector dropped, and the numbers of its dropped regions."""
    counted = kept.frames["rejection_count"]
    own = counted[counted["method"] == method].reset_index(drop=True)
    return {"answers": kept.rasters.answers.get(method), "counted": own}


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

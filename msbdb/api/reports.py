"""What is done with a database that is there: tell, re-label, draw, export, evaluate."""

import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
from pyproj import CRS
from shapely import box

from msbdb.api.build import BuildReport, candidates_by_method, count_cells, region_counts, report_of
from msbdb.api.fused import has_together, read_together
from msbdb.database import (
    PATIENCE_S,
    BuildBasis,
    Engine,
    OutdatedError,
    list_runs,
    open_database,
    read_build,
    read_buildings,
    read_candidates,
    read_classes,
    read_digest,
    read_flat_regions,
    read_parts,
    read_survey,
    shown,
    store_build,
)
from msbdb.errors import DatabaseError, InputError
from msbdb.evaluate import Evaluation, PointReference, PolygonReference
from msbdb.evaluate import evaluate as score
from msbdb.export import export as write_export
from msbdb.fuse.footprints import fuse
from msbdb.grid import Grid
from msbdb.io.las import read_points
from msbdb.io.vector import read_polygons
from msbdb.params import POINT_DETECTORS, Params, with_values
from msbdb.params.parts import EvaluateParams
from msbdb.parts.tree import extract_parts
from msbdb.points.cloud import BUILDING_CLASS
from msbdb.run.describe import make_frames, outline_parts
from msbdb.run.kept import (
    lattice_of,
    pack_state,
    unpack_candidates,
    unpack_cover,
    unpack_evidence,
    unpack_flat,
    unpack_heights,
)
from msbdb.run.stages import Progress, Stages
from msbdb.tables import Build
from msbdb.view.buildingmap import draw_map
from msbdb.view.regionmap import draw_candidates, draw_zones

logger = logging.getLogger(__name__)

ATTEMPTS = 5
"""How often labels are given again, when others label the same survey meanwhile."""

POINT_SUFFIXES = {".las", ".laz"}


@contextmanager
def opened(db: str | Path) -> Iterator[Engine]:
    """Open a database that must be there, and close it."""
    engine = open_database(db)
    try:
        yield engine
    finally:
        engine.dispose()


def info(db: str | Path) -> dict[str, Any]:
    """Tell what a database holds: a record a run, with its survey, counts and notices."""
    with opened(db) as engine:
        where = shown(engine.url)
        runs = list_runs(engine)
        found = []
        for row in runs.to_dict(orient="records"):
            build = read_build(engine, row["survey"])
            survey = asdict(build.survey)
            survey.pop("crs_wkt")
            head: dict[str, Any] = {str(name): value for name, value in row.items()}
            found.append({**head, **_counts(build), "survey_record": survey, "notices": list(build.run.notices)})
    return {"database": where, "runs": found}


def classes(db: str | Path, survey: str | None = None) -> pd.DataFrame:
    """Return the land-cover classes of a survey with their statistics."""
    with opened(db) as engine:
        return read_classes(engine, survey)


def relabel(
    db: str | Path, labels: Mapping[int, str], *, survey: str | None = None, progress: Progress | None = None
) -> BuildReport:
    """Give classes the operator's labels (V36), and run the build again from there on.

    The source data are not needed: the heights and class maps of the run are in the database. Labels that others give
    to the same survey meanwhile are kept.

    Raises
    ------
    InputError
        When a class, a label or the survey does not exist.
    DatabaseError
        When the database cannot be written, or the survey was built anew meanwhile, so that its classes are others.
    """
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
        build = _relabelled(old, labels, stages)
        with stages.stage("write"):
            try:
                basis = BuildBasis(content_sha256=digest)
                changed = store_build(db, build, basis=basis, timeout_s=PATIENCE_S).status != "unchanged"
            except OutdatedError:
                logger.info("The survey %s changed meanwhile; labelling again", old.survey.name)
                continue
        return report_of(build, stages, changed=changed)
    msg = (
        f"Others changed the survey '{old.survey.name}' meanwhile. Nothing was labelled; look at its classes with "
        "'msbdb classes', and try again."
    )
    raise DatabaseError(msg)


def _relabelled(old: Build, labels: Mapping[int, str], stages: Stages) -> Build:
    """Return a build with other labels, and all that follows from them."""
    spec = lattice_of(old.survey, old.state)
    heights = unpack_heights(old.state, spec)
    cover = unpack_cover(old, spec).relabelled(labels)
    params = with_values(Params(), old.run.parameters)  # type: ignore[arg-type]  # plain nested values
    # The run's own scales, as other labels would find others where the parameters give none.
    params = with_values(params, {"scale": {"scales_m2": old.frames["scale"]["threshold_m2"].tolist()[::-1]}})
    flat, candidates = unpack_flat(old, spec), unpack_candidates(old)
    searched = heights if "multiscale" in old.run.methods else Grid(heights.values, np.zeros_like(heights.valid), spec)
    with stages.stage("parts"):
        forest = extract_parts(searched, cover.classes, survey=old.survey.name, params=params)
    with stages.stage("together"):
        together = fuse(forest, flat, unpack_evidence(old.state), heights, params)
    with stages.stage("outlines"):
        parts = outline_parts(forest, heights, params.vector)
        frames = make_frames(forest, parts, cover, flat, candidates, ndsm=heights)
    regions = region_counts(forest, flat, candidates)
    counts = {**old.run.counts, "regions": regions, "cells": count_cells(heights, cover)}
    run = replace(old.run, counts=counts, timings={**old.run.timings, **stages.timings})
    return Build(old.survey, run, frames, pack_state(heights, cover, flat, candidates, together))


def view(db: str | Path, out: Path, *, survey: str | None = None, of: str = "buildings") -> None:
    """Draw a map on a hillshade, as PNG.

    Parameters
    ----------
    db : str or path
        The database.
    out : path
        The picture.
    survey : str, optional
        Not needed where the database holds one.
    of : {'buildings', 'flatregions', 'area3d', 'adaptive'}
        Footprints and parts by scale and height, flat regions by their zone, or candidate regions by their height.
    """
    with opened(db) as engine:
        build = read_build(engine, survey)
    relief = unpack_heights(build.state, lattice_of(build.survey, build.state))
    scales, regions = build.frames["scale"], build.frames["flat_region"]
    place = CRS.from_wkt(build.survey.crs_wkt).name
    subtitle = " · ".join(word for word in (build.survey.date, place, f"cell {build.survey.cell_m:g} m") if word)
    if of == "flatregions":
        title = f"{build.survey.name}: {len(regions)} flat regions"
        draw_zones(gpd.GeoDataFrame(regions), relief, Path(out), title=title, subtitle=subtitle)
        return
    if of in POINT_DETECTORS:
        frame = build.frames["candidate_region"]
        chosen = gpd.GeoDataFrame(frame[frame["method"] == of])
        title = f"{build.survey.name}: {len(chosen)} candidate regions of {of}"
        draw_candidates(chosen, relief, Path(out), title=title, subtitle=subtitle)
        return
    draw_map(
        build.frames["part"],
        build.frames["building"],
        relief,
        Path(out),
        title=f"{build.survey.name}: {len(build.frames['building'])} buildings in {len(build.frames['part'])} parts",
        subtitle=subtitle,
        thresholds_m2=dict(zip(scales["scale"].tolist(), scales["threshold_m2"].tolist(), strict=True)),
    )


def export(db: str | Path, out: Path, *, survey: str | None = None, overwrite: bool = False) -> None:
    """Write parts and footprints of a survey to a GeoPackage, Shapefile or GeoJSON, by the file's ending."""
    with opened(db) as engine:
        layers = {
            "footprint": read_buildings(engine, survey),
            "part": read_parts(engine, survey),
            "flat_region": read_flat_regions(engine, survey),
            "candidate_region": read_candidates(engine, survey),
        }
        if has_together(engine, survey):
            layers["together"] = read_together(engine, survey)
    write_export(layers, Path(out), overwrite=overwrite)


def evaluate(
    db: str | Path,
    reference: Path,
    *,
    layer: str | None = None,
    aoi: Path | None = None,
    crs: str | None = None,
    height: str | None = None,
    overlap: float = 0.5,
    cell_m: float = 0.5,
    survey: str | None = None,
    of: str = "buildings",
) -> Evaluation:
    """Compare what was found in a survey with a reference.

    Parameters
    ----------
    db : str or path
        The database.
    reference : path
        Footprints in any vector format, or LAS or LAZ points whose class 6 is the truth.
    layer : str, optional
        Layer of a vector reference.
    aoi : path, optional
        Polygons within which to compare.
    crs : str, optional
        The reference's CRS where it states none.
    height : str, optional
        Column of the reference that holds heights above ground, metres; one called ``height`` (in any case) is found.
    overlap, cell_m : float
        Share that counts as found; cell of the grid on which areas are compared, metres.
    survey : str, optional
        Not needed where the database holds one.
    of : {'buildings', 'confirmed', 'together', 'parts', 'flatregions', 'area3d', 'adaptive'}
        What is compared: the buildings' footprints, those of the confirmed ones, those that parts and flat regions
        give together, the parts of all scales, the flat regions alone, or the candidate regions of an extractor on
        points.
    """
    with opened(db) as engine:
        outlines = compared(engine, survey, of)
        record = read_survey(engine, survey)
        shape = _shape(record.bounds, record.cell_m)
    spec = lattice_of(record, {"valid": np.empty(shape, dtype=np.uint8)})
    area = read_polygons(aoi, to=spec.crs) if aoi else None
    params = EvaluateParams(overlap=overlap, cell_m=cell_m)
    if Path(reference).suffix.lower() in POINT_SUFFIXES:
        points, _ = read_points([reference], crs=crs)
        truth = points.in_class(BUILDING_CLASS)
        given = PointReference(points.x, points.y, truth, points.crs, points.first_echo)
        return score(outlines, given, aoi=area, params=params)
    footprints = read_polygons(reference, layer=layer, crs=crs, to=spec.crs)
    footprints = footprints[footprints.intersects(box(*spec.bounds))]
    if footprints.empty:
        msg = (
            f"No footprint of {Path(reference).name} lies within the survey '{record.name}', {spec.bounds} in "
            f"'{spec.crs.name}'. Check that both are of one place, and the reference's CRS."
        )
        raise InputError(msg)
    surveyed = Grid(np.zeros(spec.shape, dtype=np.float32), np.ones(spec.shape, dtype=np.bool_), spec)
    return score(
        outlines,
        PolygonReference(footprints, height or _height_column(footprints)),
        aoi=area,
        valid=surveyed,
        params=params,
    )


def _shape(bounds: tuple[float, float, float, float], cell_m: float) -> tuple[int, int]:
    """Rows and columns of a lattice from its bounds."""
    west, south, east, north = bounds
    return round((north - south) / cell_m), round((east - west) / cell_m)


def _counts(build: Build) -> dict[str, Any]:
    """Count what a run holds."""
    parts, buildings = build.frames["part"], build.frames["building"]
    return {
        "buildings": len(buildings),
        "parts": len(parts),
        "flat_regions": len(build.frames["flat_region"]),
        "candidate_regions": candidates_by_method(build),
        "rejected": len(build.frames["rejection"]),
        "footprint_m2": round(float(buildings["area_m2"].sum()), 1),
        "volume_m3": round(float(buildings["volume_m3"].sum()), 1),
        "highest_m": round(float(buildings["h_max"].max()), 2) if len(buildings) else None,
        "scales_m2": build.frames["scale"].sort_values("scale")["threshold_m2"].tolist(),
        "seconds": round(sum(build.run.timings.values()), 2),
        "chosen": build.run.counts.get("chosen", {}),
    }


def _height_column(footprints: pd.DataFrame) -> str | None:
    """Return the numeric column called height, in any case, where there is one."""
    for name in footprints.columns:
        if str(name).lower() == "height" and pd.api.types.is_numeric_dtype(footprints[name]):
            return str(name)
    return None


def compared(engine: Engine, survey: str | None, of: str) -> gpd.GeoDataFrame:
    """Return the outlines that are to be compared; see `evaluate`."""
    if of in ("buildings", "confirmed"):
        buildings = read_buildings(engine, survey)
        return buildings if of == "buildings" else buildings[buildings["state"] == "confirmed"]
    if of == "together":
        return read_together(engine, survey)
    if of == "flatregions":
        return read_flat_regions(engine, survey)
    if of == "parts":
        return read_parts(engine, survey)
    if of in POINT_DETECTORS:
        return read_candidates(engine, survey, of)
    known = ", ".join(("buildings", "confirmed", "together", "parts", "flatregions", *POINT_DETECTORS))
    msg = f"There is nothing called '{of}' to evaluate; there are {known}."
    raise InputError(msg)

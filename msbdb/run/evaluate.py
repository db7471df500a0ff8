"""Evaluation of a database or a classified file against a reference, by area, object and point."""

from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
from numpy.typing import NDArray
from shapely import box

from msbdb.database import (
    Engine,
    opened,
    read_build,
    read_buildings,
    read_candidates,
    read_flat_regions,
    read_parts,
    read_survey,
)
from msbdb.errors import CRSError, InputError
from msbdb.evaluate import (
    EvaluateParams,
    Evaluation,
    PointEvaluation,
    PointReference,
    PolygonReference,
    match_points,
    score_points,
)
from msbdb.evaluate import evaluate as score
from msbdb.evaluate.reference import horizontal
from msbdb.grid import Grid
from msbdb.io.las import read_points, read_points_indexed
from msbdb.io.vector import read_polygons
from msbdb.kept import lattice_of
from msbdb.outline.polygons import rasterise
from msbdb.params import POINT_DETECTORS, Params, with_values
from msbdb.points.cloud import BUILDING_CLASS, NOISE_CLASSES, PointCloud
from msbdb.run.classify import points_in
from msbdb.surface import grid_surface

POINT_SUFFIXES = {".las", ".laz"}

Mask = NDArray[np.bool_]


def evaluate_survey(
    db: str | Path,
    reference: Path,
    *,
    layer: str | None,
    aoi: Path | None,
    crs: str | None,
    height: str | None,
    overlap: float,
    cell_m: float,
    survey: str | None,
    of: str,
) -> Evaluation:
    """Compare what was found in a survey with a reference; see `msbdb.api.evaluate`."""
    with opened(db) as engine:
        outlines = compared(engine, survey, of)
        record = read_survey(engine, survey)
    spec = lattice_of(record)
    area = read_polygons(aoi, to=spec.crs) if aoi else None
    params = EvaluateParams(overlap=overlap, cell_m=cell_m)
    if Path(reference).suffix.lower() in POINT_SUFFIXES:
        points = read_points([reference], crs=crs)
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
    if of == "flatregions":
        return read_flat_regions(engine, survey)
    if of == "parts":
        return read_parts(engine, survey)
    if of in POINT_DETECTORS:
        return read_candidates(engine, survey, of)
    known = ", ".join(("buildings", "confirmed", "parts", "flatregions", *POINT_DETECTORS))
    msg = f"'{of}' cannot be evaluated. Choose one of {known}."
    raise InputError(msg)


def evaluate_file(
    found: str | Path, reference: Path, *, crs: str | None, survey: str | None, of: str
) -> PointEvaluation:
    """Compare by point what was found with class 6 of a file; see `msbdb.api.evaluate_points`."""
    if reference.suffix.lower() not in POINT_SUFFIXES:
        msg = f"By point, the reference must be a LAS or LAZ file whose class 6 is the truth; got '{reference.name}'."
        raise InputError(msg)
    of_points = Path(found).suffix.lower() in POINT_SUFFIXES
    truth, _ = read_points_indexed(reference, crs=crs, noise=of_points)
    if not of_points:
        taken = _taken(found, truth, survey, of)
        return PointEvaluation("footprints", score_points(taken, truth.in_class(BUILDING_CLASS)))
    predicted, _ = read_points_indexed(Path(found), crs=crs, noise=True)
    index, matched = match_points(predicted, truth)
    scored = ~truth.in_class(*NOISE_CLASSES)
    mine, theirs = predicted.in_class(BUILDING_CLASS)[index], truth.in_class(BUILDING_CLASS)
    return PointEvaluation(matched, score_points(mine[scored], theirs[scored]))


def _taken(db: str | Path, cloud: PointCloud, survey: str | None, of: str) -> Mask:
    """Return the points that lie in an outline of a database and are not below it."""
    with opened(db) as engine:
        outlines = compared(engine, survey, of)
        build = read_build(engine, survey)
    spec = lattice_of(build.survey)
    if horizontal(cloud.crs) != horizontal(spec.crs):
        msg = f"The reference points are in '{cloud.crs.name}', the database in '{spec.crs.name}'; reproject one."
        raise CRSError(msg)
    params = with_values(Params(), build.run.parameters)  # type: ignore[arg-type]  # plain nested values
    kept = build.heights
    surface, _ = grid_surface(cloud, spec, params)
    known = surface.valid & kept.valid
    above = np.asarray(kept.values, dtype=np.float64)
    terrain = np.where(known, np.asarray(surface.values, dtype=np.float64) - above, np.nan)
    ground_m = spec.sample(terrain, cloud.x, cloud.y, outside=np.nan)
    cells = rasterise(outlines.geometry, spec) > 0
    return points_in(cells, spec, cloud, cloud.z - ground_m, params.surface.mask_m)

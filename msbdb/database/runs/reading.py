"""Reading the tables back as frames, by plain SQL and WKB."""

import zlib
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from sqlalchemy import Connection, Engine, select, text

from msbdb.database.dialects.connection import guarded, shown, snapshot
from msbdb.database.schema.sqltables import SQL
from msbdb.database.schema.srid import crs_from, horizontal
from msbdb.errors import InputError
from msbdb.kept import KeptRun, Rasters
from msbdb.params import POINT_DETECTORS
from msbdb.tables import (
    BUILDING,
    CANDIDATE_REGION,
    FLAT_REGION,
    FLAT_REGION_CANDIDATE,
    PART,
    PART_CANDIDATE,
    PART_FLAT_REGION,
    REJECTION,
    SCALE,
    SPECTRAL_CLASS,
    SPECTRAL_CLASS_BAND,
    TABLES,
    Counts,
    Run,
    Source,
    Survey,
    Table,
)

RUN = SQL["run"]

RUN_METHOD = SQL["run_method"]

RUN_STATE = SQL["run_state"]

SOURCE = SQL["source"]

SURVEY = SQL["survey"]


def list_runs(engine: Engine) -> pd.DataFrame:
    """Return one row a run: survey, methods, profile, version, date, EPSG code, density and cell size."""
    with guarded(engine.url), engine.connect() as connection:
        query = (
            select(
                RUN.c.run_id,
                SURVEY.c.name.label("survey"),
                RUN.c.profile,
                RUN.c.version,
                SURVEY.c.date,
                SURVEY.c.epsg,
                SURVEY.c.density,
                SURVEY.c.cell_m,
            )
            .join_from(RUN, SURVEY)
            .order_by(RUN.c.run_id)
        )
        result = connection.execute(query)
        rows = pd.DataFrame([tuple(row) for row in result], columns=list(result.keys()))
        methods = [", ".join(_methods_of(connection, int(run_id))) for run_id in rows.pop("run_id")]
    rows.insert(1, "methods", methods)
    return rows.sort_values("survey", ignore_index=True)


def read_build(engine: Engine, survey: str | None = None) -> KeptRun:
    """Return a run as the build that was written, its rows in the tables' order; one committed state.

    Parameters
    ----------
    engine : Engine
        From ``open_database``.
    survey : str, optional
        Its name; not needed where the database holds only one.

    Raises
    ------
    InputError
        When there is no such survey, or no name was given and there are several.
    """
    with snapshot(engine) as connection:
        return build_of(connection, survey)


def build_of(connection: Connection, survey: str | None) -> KeptRun:
    """Return a run as ``read_build`` does, as an open transaction sees it."""
    run = _find_run(connection, survey, shown(connection.engine.url))
    record = _survey_record(connection, run.survey_id)
    return KeptRun(
        survey=record,
        run=_run_record(connection, run),
        frames={table.name: _read_table(connection, table, run.run_id, record) for table in TABLES},
        rasters=_read_rasters(connection, run.run_id),
    )


def read_survey(engine: Engine, survey: str | None = None) -> Survey:
    """Return the survey of a run, with its sources."""
    with snapshot(engine) as connection:
        run = _find_run(connection, survey, shown(engine.url))
        return _survey_record(connection, run.survey_id)


def read_run(engine: Engine, survey: str | None = None) -> Run:
    """Return a run: parameters, counts, timings and notices."""
    with guarded(engine.url), engine.connect() as connection:
        return _run_record(connection, _find_run(connection, survey, shown(engine.url)))


def read_parts(engine: Engine, survey: str | None = None) -> gpd.GeoDataFrame:
    """Return a run's parts, columns as ``tables.PART`` and the geometry, in order of ids."""
    return _read(engine, PART, survey)


def read_buildings(engine: Engine, survey: str | None = None) -> gpd.GeoDataFrame:
    """Return a run's buildings, columns as ``tables.BUILDING`` and the geometry, in order of ids."""
    return _read(engine, BUILDING, survey)


def read_rejections(engine: Engine, survey: str | None = None) -> gpd.GeoDataFrame:
    """Return a run's ledger, columns as ``tables.REJECTION`` and the geometry."""
    return _read(engine, REJECTION, survey)


def read_flat_regions(engine: Engine, survey: str | None = None) -> gpd.GeoDataFrame:
    """Return a run's flat regions, columns as ``tables.FLAT_REGION`` and the geometry, in order of ids."""
    return _read(engine, FLAT_REGION, survey)


def read_part_flat_regions(engine: Engine, survey: str | None = None) -> pd.DataFrame:
    """Return which parts and flat regions share cells, columns as ``tables.PART_FLAT_REGION``."""
    return _read_plain(engine, PART_FLAT_REGION, survey)


def read_candidates(engine: Engine, survey: str | None = None, method: str | None = None) -> gpd.GeoDataFrame:
    """Return a run's candidate regions, columns as ``tables.CANDIDATE_REGION`` and the geometry, in order of ids.

    Parameters
    ----------
    engine : Engine
        From ``open_database``.
    survey : str, optional
        Its name; not needed where the database holds only one.
    method : str, optional
        ``area3d`` or ``adaptive``; both by default.

    Raises
    ------
    InputError
        When there is no such survey, no name was given and there are several, or no extractor of that name gives
        candidate regions.
    """
    if method not in (None, *POINT_DETECTORS):
        msg = f"Candidate regions come from {' and '.join(POINT_DETECTORS)}; got '{method}'."
        raise InputError(msg)
    found = _read(engine, CANDIDATE_REGION, survey)
    return found if method is None else found[found["method"] == method].reset_index(drop=True)


def read_part_candidates(engine: Engine, survey: str | None = None) -> pd.DataFrame:
    """Return which parts and candidate regions share cells, columns as ``tables.PART_CANDIDATE``."""
    return _read_plain(engine, PART_CANDIDATE, survey)


def read_flat_region_candidates(engine: Engine, survey: str | None = None) -> pd.DataFrame:
    """Return which flat and candidate regions share cells, columns as ``tables.FLAT_REGION_CANDIDATE``."""
    return _read_plain(engine, FLAT_REGION_CANDIDATE, survey)


def read_scales(engine: Engine, survey: str | None = None) -> pd.DataFrame:
    """Return a run's scales, columns as ``tables.SCALE``."""
    return _read_plain(engine, SCALE, survey)


def read_classes(engine: Engine, survey: str | None = None) -> pd.DataFrame:
    """Return a run's classes with their labels and who gave them, columns as ``tables.SPECTRAL_CLASS``."""
    return _read_plain(engine, SPECTRAL_CLASS, survey)


def read_class_bands(engine: Engine, survey: str | None = None) -> pd.DataFrame:
    """Return the bands' means by class, columns as ``tables.SPECTRAL_CLASS_BAND``."""
    return _read_plain(engine, SPECTRAL_CLASS_BAND, survey)


def read_rasters(engine: Engine, survey: str | None = None) -> Rasters:
    """Return a run's rasters, from which its classes can be labelled again without the source data."""
    with snapshot(engine) as connection:
        return _read_rasters(connection, _find_run(connection, survey, shown(engine.url)).run_id)


def _read_plain(engine: Engine, table: Table, survey: str | None) -> pd.DataFrame:
    """Return one table without geometry of one run."""
    frame: pd.DataFrame = _read(engine, table, survey)
    return frame


def _read(engine: Engine, table: Table, survey: str | None) -> Any:  # noqa: ANN401
    """Return one table of one run, as a GeoDataFrame where it has a geometry."""
    with snapshot(engine) as connection:
        run = _find_run(connection, survey, shown(engine.url))
        return _read_table(connection, table, run.run_id, _survey_record(connection, run.survey_id))


def _find_run(connection: Connection, survey: str | None, where: str) -> Any:  # noqa: ANN401
    """Return the row of the survey's run; without a name, of the only survey's."""
    query = select(SURVEY.c.name.label("survey"), RUN).join_from(RUN, SURVEY)
    runs = connection.execute(query.order_by(RUN.c.run_id)).all()
    found = [r for r in runs if survey in (None, r.survey)]
    if len(found) == 1:
        return found[0]
    there = "; ".join(sorted(r.survey for r in runs)) or "none"
    asked = f"no survey '{survey}'" if survey else f"{len(runs)} surveys"
    msg = f"The database {where} has {asked}. Name one of its surveys: {there}."
    raise InputError(msg)


def _survey_record(connection: Connection, survey_id: int) -> Survey:
    row = connection.execute(select(SURVEY).where(SURVEY.c.survey_id == survey_id)).one()
    sources = connection.execute(select(SOURCE).where(SOURCE.c.survey_id == survey_id).order_by(SOURCE.c.number))
    return Survey(
        name=row.name,
        date=row.date,
        crs_wkt=row.crs_wkt,
        epsg=row.epsg,
        vertical_crs=row.vertical_crs,
        density=row.density,
        cell_m=row.cell_m,
        bounds=(row.west, row.south, row.east, row.north),
        sources=tuple(Source(s.name, s.role, s.sha256, s.bytes) for s in sources),
    )


def _methods_of(connection: Connection, run_id: int) -> tuple[str, ...]:
    """Return a run's extractors in alphabetical order."""
    # Ordered here, as every server has its own order for texts.
    return tuple(sorted(connection.scalars(select(RUN_METHOD.c.method).where(RUN_METHOD.c.run_id == run_id))))


def _run_record(connection: Connection, row: Any) -> Run:  # noqa: ANN401  (a row of run)
    return Run(
        methods=_methods_of(connection, row.run_id),
        profile=row.profile,
        version=row.version,
        parameters=row.parameters,
        counts=Counts(**row.counts),
        timings=row.timings,
        notices=tuple(row.notices),
    )


def _read_table(connection: Connection, table: Table, run_id: int, survey: Survey) -> Any:  # noqa: ANN401
    """Return a table's rows of a run with the declared dtypes."""
    names = table.names
    chosen = ", ".join(names) + (", ST_AsBinary(geometry)" if table.geometry else "")
    query = text(f"SELECT {chosen} FROM {table.name} WHERE run_id = :run")  # noqa: S608  (names are the declaration's)
    rows = connection.execute(query, {"run": run_id}).all()
    columns = list(zip(*rows, strict=True)) or [()] * (len(names) + 1)
    frame = pd.DataFrame(
        {c.name: pd.Series(values, dtype=c.dtype) for c, values in zip(table.columns, columns, strict=False)}
    )
    if table.geometry:
        crs = horizontal(crs_from(survey.epsg, survey.crs_wkt))
        shapes = shapely.from_wkb(np.array([bytes(blob) for blob in columns[-1]], dtype=object))
        frame = gpd.GeoDataFrame(frame, geometry=shapes, crs=crs)
    return frame.sort_values(table.order, kind="stable", ignore_index=True)


def _read_rasters(connection: Connection, run_id: int) -> Rasters:
    rows = connection.execute(select(RUN_STATE).where(RUN_STATE.c.run_id == run_id).order_by(RUN_STATE.c.name))
    named = {
        row.name: np.frombuffer(zlib.decompress(row.data), dtype=np.dtype(row.dtype)).reshape(row.shape) for row in rows
    }
    return Rasters.from_names(named)

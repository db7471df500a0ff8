"""Reading runs: tables as frames, rasters, and a summary in numbers."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from numpy.typing import NDArray
from sqlalchemy import Connection, Engine, func, select, text

from msbdb.database.dialects.connection import snapshot
from msbdb.database.dialects.dialect import guarded, shown
from msbdb.database.runs.digests import RunContent
from msbdb.database.runs.mosaics import Mosaic, mosaics_of
from msbdb.database.runs.packing import unpack
from msbdb.database.schema.sqltables import SQL
from msbdb.database.schema.srid import crs_from, horizontal
from msbdb.errors import InputError, TableError
from msbdb.kept import REQUIRED_RASTERS, KeptRun, Rasters
from msbdb.params import POINT_DETECTORS
from msbdb.surveyplan import Plan
from msbdb.tables import (
    BUILDING,
    CANDIDATE_REGION,
    FLAT_REGION,
    PART,
    REJECTION,
    REJECTION_COUNT,
    SCALE,
    SPECTRAL_CLASS,
    TABLES,
    Counts,
    Run,
    Source,
    Survey,
    Table,
)

if TYPE_CHECKING:
    import geopandas as gpd
    import pandas as pd
    from pyproj import CRS

RUN, RUN_METHOD, RUN_STATE = SQL["run"], SQL["run_method"], SQL["run_state"]
SOURCE, SURVEY, SURVEY_PLAN = SQL["source"], SQL["survey"], SQL["survey_plan"]

ROWS = 50_000
"""Rows that are read at a time."""


def list_runs(engine: Engine) -> "pd.DataFrame":
    """Return one row for each run: survey, methods, profile, version, date, EPSG code, density and cell size."""
    import pandas as pd

    columns = ["survey", "methods", "profile", "version", "date", "epsg", "density", "cell_m"]
    return pd.DataFrame(run_heads(engine), columns=columns)


def run_heads(engine: Engine) -> list[dict[str, Any]]:
    """Return the rows of `list_runs` as dictionaries, in order of surveys."""
    run, survey = RUN.c, SURVEY.c
    columns = (
        run.run_id,
        survey.name,
        run.profile,
        run.version,
        survey.date,
        survey.epsg,
        survey.density,
        survey.cell_m,
    )
    with guarded(engine.url), engine.connect() as connection:
        rows = connection.execute(select(*columns).join_from(RUN, SURVEY)).all()
        heads = [
            {"survey": name, "methods": ", ".join(_methods_of(connection, run_id))}
            | dict(zip(("profile", "version", "date", "epsg", "density", "cell_m"), more, strict=True))
            for run_id, name, *more in rows
        ]
    return sorted(heads, key=lambda head: str(head["survey"]))


def read_build(engine: Engine, survey: str | None = None) -> KeptRun:
    """Return a run as the build that was written, rows in the tables' order, as one committed state.

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
        content = content_of(connection, survey)
    frames = {table.name: _as_frame(table, content.columns[table.name], content.survey) for table in TABLES}
    rasters = _known_rasters(content.rasters, content.survey.name, engine)
    return KeptRun(content.survey, content.run, frames, rasters, content.plan)


def read_tables(engine: Engine, tables: Sequence[Table], survey: str | None = None) -> "dict[str, pd.DataFrame]":
    """Return some tables of a run by name, as one committed state, without its rasters.

    Survey and errors are those of `read_build`; GeoDataFrames where the table has a geometry.
    """
    columns, record = read_columns(engine, tables, survey)
    return {table.name: _as_frame(table, columns[table.name], record) for table in tables}


def read_columns(
    engine: Engine, tables: Sequence[Table], survey: str | None = None
) -> tuple[dict[str, dict[str, NDArray[Any]]], Survey]:
    """Return some tables of a run as plain columns, as `RunContent` has them, and the survey; faster than frames.

    Survey and errors are those of `read_build`.
    """
    with snapshot(engine) as connection:
        run = _find_run(connection, survey, shown(engine.url))
        columns = {table.name: _columns_of(connection, table, run.run_id) for table in tables}
        return columns, survey_record(connection, run.survey_id)


def content_of(connection: Connection, survey: str | None, tables: Sequence[Table] | None = None) -> RunContent:
    """Return a run as plain columns, as an open transaction sees it.

    Survey and errors are those of `read_build`; a migration to 0006 or before gives the tables of its own schema, which
    had no plans.
    """
    run = _find_run(connection, survey, shown(connection.engine.url))
    return RunContent(
        survey=survey_record(connection, run.survey_id),
        run=_run_record(connection, run),
        columns={table.name: _columns_of(connection, table, run.run_id) for table in tables or TABLES},
        rasters=_read_rasters(connection, run.run_id, pieces=tables is None),
        plan=_plan_of(connection, run.run_id) if tables is None else None,
    )


def read_survey(engine: Engine, survey: str | None = None) -> Survey:
    """Return the survey of a run, with its sources."""
    with snapshot(engine) as connection:
        run = _find_run(connection, survey, shown(engine.url))
        return survey_record(connection, run.survey_id)


def read_run(engine: Engine, survey: str | None = None) -> Run:
    """Return a run: parameters, counts, timings and notices."""
    with guarded(engine.url), engine.connect() as connection:
        return _run_record(connection, _find_run(connection, survey, shown(engine.url)))


def read_plan(engine: Engine, survey: str | None = None) -> Plan | None:
    """Return the plan by which a run was built; None where an older msbdb kept none."""
    with snapshot(engine) as connection:
        return _plan_of(connection, _find_run(connection, survey, shown(engine.url)).run_id)


def _plan_of(connection: Connection, run_id: int) -> Plan | None:
    """Return the plan of a run."""
    kept = connection.scalar(select(SURVEY_PLAN.c.plan).where(SURVEY_PLAN.c.run_id == run_id))
    return None if kept is None else Plan.from_dict(kept)


@dataclass(frozen=True, slots=True)
class RunSummary:
    """A run in numbers, counted by the database.

    Parameters
    ----------
    survey : Survey
        The survey with its sources.
    run : Run
        Parameters, counts, timings and notices.
    rows : dict of str to int
        Rows by table, for parts, buildings and regions.
    rejected, rejected_rows : int
        Number of dropped regions, and of those that are as large as a building and have a row in the ledger.
    candidates : dict of str to int
        Candidate regions by detector, for those on points that were run.
    footprint_m2, volume_m3 : float
        Sums over all buildings, square and cubic metres.
    highest_m : float or None
        Largest height of a building above ground, metres; None without buildings.
    scales_m2 : list of float
        Area thresholds of the scales, square metres, coarsest first.
    """

    survey: Survey
    run: Run
    rows: dict[str, int]
    rejected: int
    rejected_rows: int
    candidates: dict[str, int]
    footprint_m2: float
    volume_m3: float
    highest_m: float | None
    scales_m2: list[float]


def summarise_run(engine: Engine, survey: str | None = None) -> RunSummary:
    """Return a run in numbers, without reading its tables.

    Parameters and errors are those of `read_build`.
    """
    building, candidate, scale = (SQL[name].c for name in ("building", "candidate_region", "scale"))
    with snapshot(engine) as connection:
        row = _find_run(connection, survey, shown(engine.url))
        run = _run_record(connection, row)
        counted = {
            name: select(func.count()).where(SQL[name].c.run_id == row.run_id)
            for name in ("part", "building", "flat_region")
        }
        methods = (
            select(candidate.method, func.count()).where(candidate.run_id == row.run_id).group_by(candidate.method)
        )
        found = {str(method): int(number) for method, number in connection.execute(methods)}
        sums = select(func.sum(building.area_m2), func.sum(building.volume_m3), func.max(building.h_max))
        area, volume, highest = connection.execute(sums.where(building.run_id == row.run_id)).one()
        lost = SQL["rejection_count"].c
        counts = select(func.sum(lost.regions), func.sum(lost.small)).where(lost.run_id == row.run_id)
        dropped, small = (int(count or 0) for count in connection.execute(counts).one())
        scales = select(scale.threshold_m2).where(scale.run_id == row.run_id).order_by(scale.scale)
        return RunSummary(
            survey=survey_record(connection, row.survey_id),
            run=run,
            rows={name: int(connection.scalar(query) or 0) for name, query in counted.items()},
            rejected=dropped,
            rejected_rows=dropped - small,
            candidates={name: found.get(name, 0) for name in POINT_DETECTORS if name in run.methods},
            footprint_m2=float(area or 0.0),
            volume_m3=float(volume or 0.0),
            highest_m=highest,
            scales_m2=list(connection.scalars(scales)),
        )


def read_parts(engine: Engine, survey: str | None = None) -> "gpd.GeoDataFrame":
    """Return a run's parts, columns as ``tables.PART`` and the geometry, in order of ids."""
    return _read(engine, PART, survey)


def read_buildings(engine: Engine, survey: str | None = None) -> "gpd.GeoDataFrame":
    """Return a run's buildings, columns as ``tables.BUILDING`` and the geometry, in order of ids."""
    return _read(engine, BUILDING, survey)


def read_rejections(engine: Engine, survey: str | None = None) -> "gpd.GeoDataFrame":
    """Return the rows of a run's ledger, columns as ``tables.REJECTION`` and the geometry."""
    return _read(engine, REJECTION, survey)


def read_rejection_counts(engine: Engine, survey: str | None = None) -> "pd.DataFrame":
    """Return the numbers of a run's ledger, columns as ``tables.REJECTION_COUNT``."""
    return _read_plain(engine, REJECTION_COUNT, survey)


def read_flat_regions(engine: Engine, survey: str | None = None) -> "gpd.GeoDataFrame":
    """Return a run's flat regions, columns as ``tables.FLAT_REGION`` and the geometry, in order of ids."""
    return _read(engine, FLAT_REGION, survey)


def read_candidates(engine: Engine, survey: str | None = None, method: str | None = None) -> "gpd.GeoDataFrame":
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
        When there is no such survey, no name was given and there are several, or the detector has no
        candidate regions.
    """
    if method not in (None, *POINT_DETECTORS):
        msg = f"Candidate regions come from {' and '.join(POINT_DETECTORS)}; got '{method}'."
        raise InputError(msg)
    found = _read(engine, CANDIDATE_REGION, survey)
    return found if method is None else found[found["method"] == method].reset_index(drop=True)


def read_scales(engine: Engine, survey: str | None = None) -> "pd.DataFrame":
    """Return a run's scales, columns as ``tables.SCALE``."""
    return _read_plain(engine, SCALE, survey)


def read_classes(engine: Engine, survey: str | None = None) -> "pd.DataFrame":
    """Return a run's classes with their labels and who gave them, columns as ``tables.SPECTRAL_CLASS``."""
    return _read_plain(engine, SPECTRAL_CLASS, survey)


def read_rasters(engine: Engine, survey: str | None = None, *, more: Collection[str] | None = None) -> Rasters:
    """Return a run's rasters, from which its classes can be labelled again without the source data.

    With ``more`` these are those that every run has, and those of these names; by default all.
    """
    names = None if more is None else {*REQUIRED_RASTERS, *more}
    with snapshot(engine) as connection:
        run = _find_run(connection, survey, shown(engine.url))
        return _known_rasters(_read_rasters(connection, run.run_id, names), run.survey, engine)


def _read_plain(engine: Engine, table: Table, survey: str | None) -> "pd.DataFrame":
    """Return one table without geometry of one run."""
    frame: pd.DataFrame = _read(engine, table, survey)
    return frame


def _read(engine: Engine, table: Table, survey: str | None) -> Any:  # noqa: ANN401  (pandas loads late)
    """Return one table of one run, as a GeoDataFrame where it has a geometry."""
    return read_tables(engine, (table,), survey)[table.name]


def _find_run(connection: Connection, survey: str | None, where: str) -> Any:  # noqa: ANN401  (a row)
    """Return the row of the survey's run; without a name, the run of the only survey."""
    query = select(SURVEY.c.name.label("survey"), RUN).join_from(RUN, SURVEY)
    runs = connection.execute(query.order_by(RUN.c.run_id)).all()
    found = [r for r in runs if survey in (None, r.survey)]
    if len(found) == 1:
        return found[0]
    there = "; ".join(sorted(r.survey for r in runs)) or "none"
    asked = f"no survey '{survey}'" if survey else f"{len(runs)} surveys"
    msg = f"The database {where} has {asked}. Name one of them by --survey: {there}."
    raise InputError(msg)


def survey_record(connection: Connection, survey_id: int) -> Survey:
    """Return a survey with its sources."""
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
    """Return a run's detectors in alphabetical order."""
    # Sorted here, because servers sort texts differently.
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


def _columns_of(connection: Connection, table: Table, run_id: int) -> dict[str, NDArray[Any]]:
    """Return a table's columns of a run as `RunContent` has them, in the table's order."""
    names = table.names
    chosen = ", ".join(names) + (", ST_AsBinary(geometry)" if table.geometry else "")
    query = text(f"SELECT {chosen} FROM {table.name} WHERE run_id = :run")  # noqa: S608  (names are the declaration's)
    dtypes = [column.dtype for column in table.columns]
    read: list[list[NDArray[Any]]] = []
    # Values of Python take several times the memory of arrays.
    for rows in connection.execute(query, {"run": run_id}, execution_options={"yield_per": ROWS}).partitions():
        values = list(zip(*rows, strict=True))
        read.append([_typed(own, dtype) for own, dtype in zip(values, dtypes, strict=False)])
        if table.geometry:
            read[-1].append(shapely.from_wkb(np.array([bytes(blob) for blob in values[-1]], dtype=object)))
    if not read:
        read = [[_typed((), dtype) for dtype in (*dtypes, *["str"] * bool(table.geometry))]]
    named = [*names, "geometry"] if table.geometry else names
    columns = {name: np.concatenate(own) for name, own in zip(named, zip(*read, strict=True), strict=True)}
    order = np.lexsort([columns[name] for name in reversed(table.order)])
    return {name: own[order] for name, own in columns.items()}


def _typed(values: tuple[Any, ...], dtype: str) -> NDArray[Any]:
    """Return a column as an array of its declared dtype, texts as objects; refuse a fraction among whole numbers.

    Whole numbers that may be null are int64 where all are known, else float64 with NaN.
    """
    if dtype == "int64" or (dtype == "Int64" and None not in values):
        return np.array(values, dtype=None if values else np.int64).astype(np.int64, casting="same_kind")
    return np.array(values, dtype={"str": object, "Int64": np.float64}.get(dtype, dtype))


def _as_frame(table: Table, columns: Mapping[str, NDArray[Any]], survey: Survey) -> Any:  # noqa: ANN401  (pandas loads late)
    """Return columns as a frame with the declared dtypes, geographic in the survey's CRS where it has a geometry."""
    import pandas as pd

    dtypes = {column.name: column.dtype for column in table.columns}
    frame = pd.DataFrame({name: pd.Series(own, dtype=dtypes.get(name, "object")) for name, own in columns.items()})
    if not table.geometry:
        return frame
    import geopandas as gpd

    return gpd.GeoDataFrame(frame, geometry="geometry", crs=crs_of(survey))


def crs_of(survey: Survey) -> "CRS":
    """Return the CRS of a survey's geometries."""
    return horizontal(crs_from(survey.epsg, survey.crs_wkt))


def _read_rasters(
    connection: Connection, run_id: int, names: Collection[str] | None = None, *, pieces: bool = True
) -> dict[str, NDArray[Any]]:
    """Return a run's rasters, or some, by the names of their rows; those in pieces only where the schema has them."""
    query = select(RUN_STATE).where(RUN_STATE.c.run_id == run_id).order_by(RUN_STATE.c.name)
    rows = connection.execute(query if names is None else query.where(RUN_STATE.c.name.in_(names)))
    found = {row.name: unpack(row.data, row.dtype, row.shape) for row in rows}
    cut = mosaics_of(connection, run_id) if pieces else {}
    return found | {name: each.whole() for name, each in cut.items() if names is None or name in names}


def _known_rasters(named: Mapping[str, NDArray[Any] | Mosaic], survey: str, engine: Engine) -> Rasters:
    """Return rasters as one value; refuse missing and unknown ones."""
    try:
        return Rasters.from_names({name: own for name, own in named.items() if not isinstance(own, Mosaic)})
    except TableError as error:
        msg = f"The survey '{survey}' of {shown(engine.url)} cannot be read. {error}"
        raise TableError(msg) from error

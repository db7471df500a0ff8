"""Loading a build in one transaction: the same rows for the same build, completely or not at all."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from os import PathLike
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import URL, Connection, Engine, delete, func, insert, select, text, update

from msbdb.database.dialects import migration as upgrade
from msbdb.database.dialects.connection import TIMEOUT_S, open_database, require_srid
from msbdb.database.dialects.dialect import Dialect, database_url, dialect_of, guarded, shown
from msbdb.database.runs.basis import BuildBasis
from msbdb.database.runs.checks import check_build
from msbdb.database.runs.digests import RunContent, ordered, portable, run_row, source_rows, survey_row
from msbdb.database.runs.packing import pack
from msbdb.database.runs.tiles import forget_tiles
from msbdb.database.schema.sqltables import METADATA, SQL
from msbdb.database.schema.srid import srid_of
from msbdb.identity import text_id
from msbdb.kept import KeptRun, Packed
from msbdb.tables import TABLES, Column
from msbdb.threads import in_threads, together

RUN = SQL["run"]

RUN_METHOD = SQL["run_method"]

RUN_STATE = SQL["run_state"]

SURVEY_PLAN = SQL["survey_plan"]

SOURCE = SQL["source"]

SURVEY = SQL["survey"]

logger = logging.getLogger(__name__)

BY_NAME = {table.name: table for table in TABLES}

LOADED = [table.name for table in METADATA.sorted_tables if table.name in BY_NAME]
"""The tables of a build's frames; a table comes after those that it refers to."""


@dataclass(frozen=True, slots=True)
class WriteReport:
    """The result of a load.

    ``status`` is 'created', 'replaced' or 'unchanged'; ``rows`` counts the run's rows by table.
    """

    survey: str
    methods: tuple[str, ...]
    survey_id: int
    run_id: int
    status: str
    rows: dict[str, int]


def store_build(
    target: str | PathLike[str] | URL, build: KeptRun, *, basis: BuildBasis | None = None, timeout_s: float = TIMEOUT_S
) -> WriteReport:
    """Write a build in one transaction, which also creates a missing database.

    So a first build that is stopped, or that fills the disk, leaves no empty database in its CRS.

    Parameters
    ----------
    target : str, path or URL
        The database. An older schema is upgraded.
    build : KeptRun
        See `write_build`.
    basis : BuildBasis, optional
        The content of the database from which the build was computed.
    timeout_s : float
        Seconds to wait for a lock or a server.

    Raises
    ------
    OutdatedError
        When the basis has changed; nothing was written.
    InputError
        When the basis keeps what the build would replace; nothing was written.
    MsbdbError
        See `open_database` and `write_build`.
    """
    survey = build.survey
    url = database_url(target)
    dialect = dialect_of(url)
    with guarded(url):
        if not dialect.exists(url, timeout_s) and (report := _created(url, dialect, build, timeout_s)):
            return report
        rows = _Rows.of(build, check_build(build))
    crs: dict[str, Any] = {"srid": survey.epsg, "crs_wkt": survey.crs_wkt}
    engine = open_database(url, create=True, **crs, timeout_s=timeout_s, keep_open=True)
    try:
        return _write(engine, build, rows, basis)
    finally:
        engine.dispose()


def _created(url: URL, dialect: Dialect, build: KeptRun, timeout_s: float) -> WriteReport | None:
    """Write a build into a new database; return None when another process created one meanwhile.

    The rows are made while the schema is written.
    """
    survey, made = build.survey, list[_Rows]()
    srid = srid_of(survey.epsg, survey.crs_wkt)

    def contents() -> tuple[_Rows, list[dict[str, Any]]]:
        return together(lambda: _Rows.of(build, check_build(build)), lambda: _packed(build))

    def fill(connection: Connection) -> None:
        schema = partial(upgrade.initialise, connection, dialect, srid, survey.crs_wkt)
        (rows, rasters), _ = together(contents, schema)
        _fill(connection, dialect, build, rows, rasters=rasters, srid=srid)
        made.append(rows)

    if not dialect.create(url, timeout_s, fill):
        return None
    logger.info("Created the database %s with the SRID %d", shown(url), srid)
    return _report(build, made[0], "created")


def write_build(engine: Engine, build: KeptRun, *, basis: BuildBasis | None = None) -> WriteReport:
    """Write a build in one transaction.

    A survey has one run, for any detectors. A load of the same content changes nothing, not even timings; other content
    replaces the survey's rows. The order of rows in the frames has no effect.

    Parameters
    ----------
    engine : Engine
        From ``open_database``.
    build : KeptRun
        With one frame for each of ``tables.TABLES``. Polygons become multipolygons.
    basis : BuildBasis, optional
        The content of the database from which the build was computed.

    Raises
    ------
    OutdatedError
        When the basis has changed; nothing was written.
    InputError, TableError
        When the build breaks its declaration, or would replace what the basis keeps; nothing was written.
    CRSError
        When the survey's CRS is not the database's.
    LoadError
        When the database refuses rows; nothing was written.
    DatabaseError
        When the database is locked, full or cannot be reached; nothing was written.
    """
    return _write(engine, build, _Rows.of(build, check_build(build)), basis)


def _write(engine: Engine, build: KeptRun, rows: "_Rows", basis: BuildBasis | None) -> WriteReport:
    """Write a build that was checked."""
    dialect = dialect_of(engine.url)
    _, run_id = keys_of(build)
    srid = srid_of(build.survey.epsg, build.survey.crs_wkt)
    with guarded(engine.url), engine.connect() as reading:
        with reading.begin():
            require_srid(reading, dialect, srid, shown(engine.url))
            if _is_there(reading, run_id, rows.digest, rows.counts):
                return _report(build, rows, "unchanged")
        # Compressed before the lock, because others wait for it.
        rasters = _packed(build)
        with dialect.writing(engine, reading) as connection:
            if basis is not None:
                basis.require(connection, build)
            removed = _fill(connection, dialect, build, rows, rasters=rasters, srid=srid)
    return _report(build, rows, "replaced" if removed else "created")


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """A build's rows in order, their number by table, and the digest of all."""

    columns: dict[str, dict[str, NDArray[Any]]]
    ledger_ids: NDArray[np.int64]
    counts: dict[str, int]
    digest: str

    @classmethod
    def of(cls, build: KeptRun, checked: Mapping[str, Mapping[str, NDArray[Any]]]) -> Self:
        """Return the rows of a build in the tables' order, of the columns that `check_build` returns."""
        columns = {table.name: ordered(checked[table.name], table) for table in TABLES}
        counts = {name: len(frame) for name, frame in build.frames.items()}
        counts |= {"run_method": len(build.run.methods), "run_state": len(build.rasters.by_name())}
        counts["survey_plan"] = int(build.plan is not None)
        content = RunContent(build.survey, build.run, columns, build.rasters.by_name(), build.plan)
        ids = rejection_ids(build.survey.name, columns["rejection"])
        return cls(columns, ids, counts, content.digest())


def _report(build: KeptRun, rows: _Rows, status: str) -> WriteReport:
    """Sum up a load."""
    logger.info("The survey %s by %s is %s", build.survey.name, ", ".join(build.run.methods), status)
    logger.debug("Rows by table: %s", rows.counts)
    return WriteReport(build.survey.name, build.run.methods, *keys_of(build), status, rows.counts)


def _fill(
    connection: Connection, dialect: Dialect, build: KeptRun, rows: _Rows, *, rasters: list[dict[str, Any]], srid: int
) -> int:
    """Write all of a build's rows in the caller's transaction; return how many runs they replace."""
    _, run_id = keys_of(build)
    with dialect.in_bulk(connection, rows.counts):
        removed = write_head(connection, dialect, build, rows.digest)
        forget_tiles(connection, build.survey.name)
        with dialect.keys_in_sets(connection, LOADED, run_id):
            for name in LOADED:
                ids = rows.ledger_ids if name == "rejection" else None
                write_columns(connection, dialect, name, rows.columns[name], run_id=run_id, srid=srid, ids=ids)
    for raster in rasters:
        connection.execute(insert(RUN_STATE), [{"run_id": run_id, **raster}])
    dialect.after_load(connection)
    return removed


def write_head(connection: Connection, dialect: Dialect, build: KeptRun, digest: str) -> int:
    """Write the survey, the run, its detectors and its plan in place of those before; return how many runs went."""
    survey_id, run_id = keys_of(build)
    removed = connection.execute(delete(RUN).where(RUN.c.survey_id == survey_id)).rowcount
    dialect.settle(connection)
    _write_survey(connection, survey_id, build)
    run = run_row(build.run) | {"run_id": run_id, "survey_id": survey_id, "content_sha256": digest}
    methods = [{"run_id": run_id, "method": method} for method in run.pop("methods")]
    connection.execute(insert(RUN), [run])
    connection.execute(insert(RUN_METHOD), methods)
    if build.plan is not None:
        connection.execute(insert(SURVEY_PLAN), [{"run_id": run_id, "plan": build.plan.as_dict()}])
    return removed


def keys_of(build: KeptRun) -> tuple[int, int]:
    """Return the keys of a build's survey and run, which do not depend on its detectors."""
    return text_id("survey", build.survey.name), text_id("run", build.survey.name)


def pack_rasters(rasters: Mapping[str, NDArray[Any]]) -> Packed:
    """Return rasters with the columns of their rows except the run's key, compressed one after another.

    `KeptRun.packed` takes them, so that a thread compresses rasters while a build still works on other things.
    """
    return {name: (values, raster_row((name, values))) for name, values in rasters.items()}


def _packed(build: KeptRun) -> list[dict[str, Any]]:
    """Return the columns of the rasters' rows except the run's key; the very rasters that are packed stay so."""

    def row(named: tuple[str, NDArray[Any]]) -> dict[str, Any]:
        values, packed = build.packed.get(named[0], (None, {}))
        return packed if values is named[1] else raster_row(named)

    return in_threads(row, sorted(build.rasters.by_name().items()))


def raster_row(named: tuple[str, NDArray[Any]]) -> dict[str, Any]:
    """Return the columns of a raster's row except the run's key; the cells are compressed.

    Whole numbers of 32 bits are written in 16 bits where all of them fit: heights then take a fifth less space.
    """
    name, values = named
    bounds = np.iinfo(np.int16)
    if values.dtype == np.int32 and bounds.min <= values.min(initial=0) <= values.max(initial=0) <= bounds.max:
        values = values.astype(np.int16)
    cells = portable(values)
    return {
        "name": name,
        "dtype": cells.dtype.str,
        "shape": list(cells.shape),
        "data": pack(cells),
    }


def _is_there(connection: Connection, run_id: int, digest: str, rows: dict[str, int]) -> bool:
    """Return whether the run has this content, and no row of it is missing."""
    if connection.scalar(select(RUN.c.content_sha256).where(RUN.c.run_id == run_id)) != digest:
        return False
    counted = "SELECT count(*) FROM {} WHERE run_id = :run"
    return all(connection.scalar(text(counted.format(name)), {"run": run_id}) == n for name, n in rows.items())


def _write_survey(connection: Connection, survey_id: int, build: KeptRun) -> None:
    """Write or update the survey and its sources."""
    row = survey_row(build.survey)
    known = connection.scalar(select(func.count()).select_from(SURVEY).where(SURVEY.c.survey_id == survey_id))
    if known:
        connection.execute(update(SURVEY).where(SURVEY.c.survey_id == survey_id).values(**row))
    else:
        connection.execute(insert(SURVEY), [{"survey_id": survey_id, **row}])
    connection.execute(delete(SOURCE).where(SOURCE.c.survey_id == survey_id))
    sources = [{"survey_id": survey_id, "number": n, **row} for n, row in enumerate(source_rows(build.survey), start=1)]
    if sources:
        connection.execute(insert(SOURCE), sources)


def write_columns(
    connection: Connection,
    dialect: Dialect,
    name: str,
    content: Mapping[str, NDArray[Any]],
    *,
    run_id: int,
    srid: int,
    ids: NDArray[np.int64] | None = None,
) -> None:
    """Write one table's rows in bulk, in the order of their keys, which is the quickest.

    ``content`` has the columns as `check_frames` returns them; ``ids`` are the keys of the ledger's rows.
    """
    count = len(next(iter(content.values())))
    columns: dict[str, Any] = {"run_id": np.full(count, run_id)}
    order: Any = slice(None)
    if ids is not None:
        order = np.argsort(ids)
        columns["rejection_id"] = ids[order]
    table = BY_NAME[name]
    for column, values in content.items():
        columns[column] = values[order] if column == "geometry" else _stored(values[order], table[column])
    dialect.insert_rows(connection, name, columns, srid)


def _stored(values: NDArray[Any], column: Column) -> NDArray[Any] | list[Any]:
    """Return a column's values: numbers as an array, in which NaN is missing, others as a list."""
    if column.dtype == "Int64":
        missing = np.isnan(values).tolist()
        return [None if gone else int(value) for value, gone in zip(values.tolist(), missing, strict=True)]
    return values if values.dtype.kind in "iubf" else values.tolist()


def rejection_ids(survey: str, ledger: Mapping[str, Any]) -> NDArray[np.int64]:
    """Return keys of ledger rows; rows with the same region, stage and reason are numbered.

    A region's id is a digest already. The key is this id XOR a digest of method, stage, reason and number. So it is
    unique among the rows with the same words, and almost certainly among all rows. ``ledger`` has the columns.
    """
    known: dict[tuple[str, str, str], int] = {}
    words = zip(*(ledger[name].tolist() for name in ("method", "stage", "reason")), strict=True)
    why = np.array([known.setdefault(one, len(known)) for one in words], dtype=np.int64)
    region = np.asarray(ledger["region_id"], dtype=np.int64)
    order = np.lexsort((region, why))
    again = np.empty(order.size, dtype=np.int64)
    again[order] = _repeats(why[order], region[order])
    kinds = why * (again.max(initial=0) + 1) + again
    _, first, group = np.unique(kinds, return_index=True, return_inverse=True)
    names = list(known)
    digests = [text_id("rejection", survey, *names[why[one]], again[one]) for one in first.tolist()]
    ids: NDArray[np.int64] = np.maximum(region ^ np.array(digests, dtype=np.int64)[group], 1)
    return ids


def _repeats(*sorted_keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return for each row of sorted keys how many rows before it have the same."""
    places = np.arange(sorted_keys[0].size)
    begins = np.ones(places.size, dtype=np.bool_)
    begins[1:] = np.any([own[1:] != own[:-1] for own in sorted_keys], axis=0)
    own: NDArray[np.int64] = places - np.maximum.accumulate(np.where(begins, places, 0))
    return own

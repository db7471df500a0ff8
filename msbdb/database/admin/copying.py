"""The canonical dump: the content as lines of text, the same for the same content on every dialect.

Copying a whole database into an empty one, of the same or the other dialect.
"""

import hashlib
import json
import logging
from collections.abc import Callable, Iterator, Sequence
from os import PathLike
from typing import Any

import numpy as np
import shapely
from sqlalchemy import JSON, URL, Connection, Engine, Row, Table, func, literal_column, select, text

from msbdb.database.dialects import migration as upgrade
from msbdb.database.dialects.connection import TIMEOUT_S, open_database, require_srid, snapshot
from msbdb.database.dialects.dialect import Dialect, database_url, dialect_of, guarded, shown
from msbdb.database.runs.mosaics import mosaics_of
from msbdb.database.runs.packing import unpack
from msbdb.database.schema.sqltables import METADATA
from msbdb.database.schema.srid import FIRST_OWN_SRID
from msbdb.errors import DatabaseError, ParameterError
from msbdb.identity import to_json

DECIMALS = 6
"""Decimals of numbers: a micrometre."""

COORDINATE_DECIMALS = 4

_LEFT_OUT = {"timings", "content_sha256", "row_digest", "decided_at"}
"""Timings and the time of a decision differ between equal runs; digests include more decimals than the dump."""

_OF_FILES = {"source"}
"""The table of source files: the same points in another order are another file."""

_OF_TILES = {"tile", "raster_tile"}
"""Tables of surveys that were built in tiles: how they were cut is not content; rasters are shown as in `run_state`."""

_ON_FILES = {"notices"}
"""The column that contains names of files."""


def canonical_dump(engine: Engine, *, provenance: bool = False) -> Iterator[str]:
    """Yield the content of all tables, one JSON list per row, in order of tables and keys: one committed state.

    Numbers have six decimals, geometries are normalised WKT with four, rasters are given by their checksum. Timings,
    the schema's version and the internal tables of a dialect are left out.

    Parameters
    ----------
    engine : Engine
        From ``open_database``.
    provenance : bool
        Also the names and checksums of the source files, and the notices that name them.

    Yields
    ------
    str
        First a line of names for each table, then its rows, without line ends.
    """
    with snapshot(engine) as connection:
        left_out = _LEFT_OUT if provenance else _LEFT_OUT | _ON_FILES
        for table in sorted(METADATA.tables.values(), key=lambda t: t.name):
            if table.name not in _OF_TILES and (provenance or table.name not in _OF_FILES):
                yield from _table_lines(connection, table, left_out)


def _table_lines(connection: Connection, table: Table, left_out: set[str]) -> Iterator[str]:
    columns = [c for c in table.columns if c.name not in left_out and c.computed is None]
    yield json.dumps(["table", table.name, *(c.name for c in columns)])
    plain = [c for c in columns if c.name != "geometry"]
    query = select(*plain)
    if "geometry" in table.columns:
        query = query.add_columns(text("ST_AsBinary(geometry)"))
    keys = [i for i, c in enumerate(plain) if c.primary_key]
    # Texts are sorted here, because servers sort them differently.
    rows = sorted(connection.execute(query), key=lambda row: [row[i] for i in keys])
    if table.name == "run_state":
        named = {(row.run_id, row.name): _raster_line(row) for row in rows} | _mosaic_lines(connection)
        yield from (named[key] for key in sorted(named))
        return
    for row in rows:
        cells = [_shown(value) for value in row[: len(plain)]]
        if len(row) > len(plain):
            cells.append(_shown_geometry(bytes(row[-1])))
        yield json.dumps([table.name, *cells], ensure_ascii=False)


def _raster_line(row: Row[Any]) -> str:
    """Return the line of a raster's row, with the checksum of its cells, however they are packed."""
    digest = hashlib.sha256(unpack(row.data, row.dtype, row.shape).tobytes()).hexdigest()
    return json.dumps(["run_state", row.run_id, row.name, row.dtype, to_json(row.shape), digest], ensure_ascii=False)


def _mosaic_lines(connection: Connection) -> dict[tuple[int, str], str]:
    """Return the lines of rasters in pieces by run and name, as if they were whole."""
    lines = {}
    for run_id in connection.scalars(select(METADATA.tables["run"].c.run_id)).all():
        for name, raster in mosaics_of(connection, run_id).items():
            cells = [run_id, name, raster.dtype.str, to_json(raster.shape), raster.sha256()]
            lines[run_id, name] = json.dumps(["run_state", *cells], ensure_ascii=False)
    return lines


def _shown(value: Any) -> Any:  # noqa: ANN401  (any column's value)
    if isinstance(value, float):
        # Adding zero turns a rounded -0.0 into 0.0.
        return f"{round(value, DECIMALS) + 0.0:.{DECIMALS}f}"
    if isinstance(value, dict | list):
        return to_json(value)
    return value


def _shown_geometry(wkb: bytes) -> str:
    shape = shapely.normalize(shapely.from_wkb(wkb))
    return str(shapely.to_wkt(shape, rounding_precision=COORDINATE_DECIMALS, trim=False))


logger = logging.getLogger(__name__)

BATCH = 10_000
"""Rows in memory at a time."""

Progress = Callable[[str, int, int], None]


def copy_database(
    source: str | PathLike[str] | URL,
    target: str | PathLike[str] | URL,
    *,
    timeout_s: float = TIMEOUT_S,
    progress: Progress | None = None,
) -> dict[str, int]:
    """Copy all rows of all tables in one transaction of the target.

    Parameters
    ----------
    source, target : str, path or URL
        Databases of either dialect. The target is created if it does not exist; otherwise it must be empty.
    progress : callable, optional
        Called with 'copy', the number of finished tables and the number of all tables.

    Returns
    -------
    dict
        The number of rows by table.

    Raises
    ------
    ParameterError
        When both are the same.
    DatabaseError
        When the target holds rows, or either cannot be opened; nothing was written.
    SchemaVersionError
        When either has an older schema.
    CRSError
        When the target has another CRS.
    LoadError
        When the target refuses rows; nothing was written.

    Notes
    -----
    The source is read as one committed state, also while others write to it. After a kill there is no target, or the
    same empty one as before, and the copy can be repeated. Afterwards the canonical dumps of both are equal.
    """
    origin, place = open_database(source, timeout_s=timeout_s), database_url(target)
    if origin.url == place:
        msg = f"A database cannot be copied onto itself; both are {shown(place)}. Give another place to copy to."
        raise ParameterError(msg)
    dialect = dialect_of(place)
    with snapshot(origin) as reading:
        srid = dialect_of(origin.url).database_srid(reading)
        coming = {table.name: _rows_of(reading, table) for table in METADATA.sorted_tables}
        if not _created(place, dialect, reading, coming, srid=srid, timeout_s=timeout_s, progress=progress):
            into = open_database(place, timeout_s=timeout_s)
            with guarded(place), dialect.writing(into) as writing:
                require_srid(writing, dialect, srid, shown(place))
                _require_empty(writing, shown(place))
                _copy_tables(reading, writing, dialect, coming, srid=srid, progress=progress)
    logger.info("Copied %d rows from %s to %s", sum(coming.values()), shown(origin.url), shown(place))
    return coming


def _created(
    place: URL,
    dialect: Dialect,
    reading: Connection,
    coming: dict[str, int],
    *,
    srid: int,
    timeout_s: float,
    progress: Progress | None,
) -> bool:
    """Create a missing target with all rows, in the source's CRS and with its SRID; return whether it was created."""

    def fill(writing: Connection) -> None:
        upgrade.initialise(writing, dialect, srid, _definition(reading, srid))
        _copy_tables(reading, writing, dialect, coming, srid=srid, progress=progress)

    with guarded(place):
        return not dialect.exists(place, timeout_s) and dialect.create(place, timeout_s, fill)


def _copy_tables(
    reading: Connection,
    writing: Connection,
    dialect: Dialect,
    coming: dict[str, int],
    *,
    srid: int,
    progress: Progress | None,
) -> None:
    """Copy all tables; a table comes after those that it refers to."""
    with dialect.in_bulk(writing, coming):
        for number, table in enumerate(METADATA.sorted_tables, start=1):
            _copy_table(reading, writing, dialect, table, srid)
            if progress is not None:
                progress("copy", number, len(coming))
    dialect.after_load(writing)


def _definition(connection: Connection, srid: int) -> str:
    """Return the WKT of a CRS without EPSG code as the database has it; empty for a CRS that PROJ knows by its code."""
    if srid < FIRST_OWN_SRID:
        return ""
    return str(connection.scalar(text("SELECT srtext FROM spatial_ref_sys WHERE srid = :srid"), {"srid": srid}))


def _require_empty(connection: Connection, where: str) -> None:
    held = [table.name for table in METADATA.sorted_tables if _rows_of(connection, table)]
    if held:
        msg = (
            f"The database {where} is not empty: there are rows in {', '.join(held)}. A copy needs a new or an empty "
            "database; give another place."
        )
        raise DatabaseError(msg)


def _rows_of(connection: Connection, table: Table) -> int:
    return int(connection.scalar(select(func.count()).select_from(table)) or 0)


def _copy_table(reading: Connection, writing: Connection, dialect: Dialect, table: Table, srid: int) -> None:
    """Copy a table's rows in batches, in the order of its key; parts after their fathers, which SQLite needs."""
    columns = [column for column in table.columns if column.computed is None]
    chosen: list[Any] = [literal_column("ST_AsBinary(geometry)") if c.name == "geometry" else c for c in columns]
    documents = [isinstance(column.type, JSON) for column in columns]
    fathers_first = [table.c.scale] if "supscale" in table.c else []
    query = select(*chosen).select_from(table).order_by(*fathers_first, *table.primary_key.columns)
    result = reading.execute(query, execution_options={"yield_per": BATCH})
    names = [column.name for column in columns]
    for rows in result.partitions():
        values = [
            _written(own, is_document) for own, is_document in zip(zip(*rows, strict=True), documents, strict=True)
        ]
        if "geometry" in names:
            place = names.index("geometry")
            shapes = shapely.from_wkb(np.array([bytes(blob) for blob in values[place]], dtype=object))
            values[place] = shapely.to_wkb(shapes, byte_order=1)
        dialect.insert_rows(writing, table.name, dict(zip(names, values, strict=True)), srid)


def _written(values: Sequence[Any], is_document: bool) -> Sequence[Any]:
    """Return a column's values as the drivers take them."""
    if is_document:
        return [None if value is None else to_json(value) for value in values]
    return values

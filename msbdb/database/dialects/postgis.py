"""The dialect of PostGIS, and bulk loads into its new tables: rows first, then indexes and foreign keys."""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Any

import psycopg
from numpy.typing import NDArray
from sqlalchemy import (
    JSON,
    URL,
    BigInteger,
    Boolean,
    Connection,
    Double,
    Engine,
    Integer,
    LargeBinary,
    NullPool,
    QueuePool,
    Text,
    create_engine,
    inspect,
    text,
)
from sqlalchemy.dialects.postgresql.base import ischema_names
from sqlalchemy.exc import DBAPIError
from sqlalchemy.types import TypeEngine

from msbdb.database.dialects import setkeys
from msbdb.database.dialects.binarycopy import NUMBERS, packed_rows
from msbdb.database.schema.sqlfiles import read_sql
from msbdb.database.schema.sqltables import SQL, VERSION_TABLE, Geometry
from msbdb.errors import DatabaseError, LoadError, MissingDependencyError, MsbdbError, TableError
from msbdb.identity import to_json

logger = logging.getLogger(__name__)

# Inspecting a table would warn of a type that it does not know.
ischema_names["geometry"] = Geometry

# The tables are declared without PostgreSQL, so that a file is opened without SQLAlchemy's dialect of it.
for _index in (index for table in SQL.values() for index in table.indexes):
    if (_where := _index.dialect_options["sqlite"]["where"]) is not None:
        _index.dialect_options["postgresql"]["where"] = _where

_WRITER_LOCK = 0x6D73626462
"""Number of the advisory lock of a database's only writer: 'msbdb' in ASCII."""

_ALIVE = {"keepalives_idle": 30, "keepalives_interval": 10, "keepalives_count": 3, "tcp_user_timeout": 60_000}
"""Times after which a lost connection is noticed: seconds, the last one in milliseconds.

With the systems' default values, a writer whose machine or network failed would keep its lock for two hours.
"""

_WIRE: dict[type[TypeEngine[Any]], str] = {
    BigInteger: "int8",
    Boolean: "bool",
    Double: "float8",
    Geometry: "bytea",
    Integer: "int4",
    JSON: "text",
    LargeBinary: "bytea",
    Text: "text",
}
"""Types in which the values of columns are sent, subclasses before their base classes; JSON is sent as text."""

_CONTENT = (
    "survey",
    "source",
    "run",
    "scale",
    "part",
    "spectral_class",
    "spectral_class_band",
    "rejection",
    "rejection_count",
    "building",
    "flat_region",
    "part_flat_region",
    "candidate_region",
    "part_candidate",
    "flat_region_candidate",
    "inventory_building",
    "building_version",
    "building_change",
    "survey_offset",
    "inventory_event",
    "operator_state",
    "roof_sample",
)

_OUTDATED = """
SELECT c.relname
FROM pg_class AS c JOIN pg_namespace AS n ON n.oid = c.relnamespace
WHERE n.nspname = current_schema() AND c.relname = ANY(:tables)
  AND (c.reltuples < 0
       OR COALESCE(pg_stat_get_mod_since_analyze(c.oid), 0) + pg_stat_get_xact_tuples_inserted(c.oid)
          + pg_stat_get_xact_tuples_updated(c.oid) + pg_stat_get_xact_tuples_deleted(c.oid) > 3 * c.reltuples)
ORDER BY c.relname
"""
"""The tables with outdated statistics: never made, or since then three times as many rows changed as there were.

Until then the planner takes the number of rows from the size of the table, and their shares from the statistics."""

_COMPRESSION = """
SELECT set_config('default_toast_compression', 'lz4', true) FROM pg_settings
WHERE name = 'default_toast_compression' AND 'lz4' = ANY(enumvals)
"""
"""Large outlines are compressed by LZ4 where the server supports it: a third of the default's time, some more space."""

_SAMPLE = """
SELECT set_config('default_statistics_target', '30', true) FROM pg_settings
WHERE name = 'default_statistics_target' AND CAST(setting AS integer) > 30
"""
"""Statistics from 9000 rows in place of 30 000: a third of the time. The server refines them in the background."""

WORTH = 1000
"""Rows from which it is quicker to make indexes and keys after the load."""

_NEW = """
SELECT c.relname
FROM pg_class AS c
WHERE c.relnamespace = current_schema()::regnamespace AND c.relkind = 'r' AND c.relname = ANY(:tables)
  AND c.xmin = pg_current_xact_id_if_assigned()::xid
ORDER BY c.relname
"""
"""Tables that this transaction made: nobody else sees them, so locking them disturbs nobody."""

_KEYS = """
SELECT format('ALTER TABLE %s DROP CONSTRAINT %I', conrelid::regclass, conname),
       format('ALTER TABLE %s ADD CONSTRAINT %I %s', conrelid::regclass, conname, pg_get_constraintdef(oid))
FROM pg_constraint
WHERE contype = 'f' AND connamespace = current_schema()::regnamespace AND conrelid = ANY(CAST(:tables AS regclass[]))
ORDER BY conrelid, conname
"""

_INDEXES = """
SELECT format('DROP INDEX %s', i.indexrelid::regclass), pg_get_indexdef(i.indexrelid)
FROM pg_index AS i
WHERE i.indrelid = ANY(CAST(:tables AS regclass[]))
  AND NOT EXISTS (SELECT FROM pg_constraint AS k WHERE k.conindid = i.indexrelid AND k.contype IN ('p', 'u', 'x'))
ORDER BY i.indrelid, i.indexrelid
"""
"""Statements that drop and make again foreign keys, and indexes that belong to no constraint."""

_ROOM = """
SELECT set_config('maintenance_work_mem', '256MB', true) FROM pg_settings
WHERE name = 'maintenance_work_mem' AND CAST(setting AS bigint) < 262144
"""
"""Memory for sorting an index until the end of the transaction; a larger setting of the server is kept."""


def exists(url: URL, timeout_s: float) -> bool:
    """Return whether the database has the tables of msbdb."""
    with make_engine(url, timeout_s).connect() as connection:
        return inspect(connection).has_table(VERSION_TABLE)


def require_writable(url: URL) -> None:
    """Do nothing: the server reports it at the first statement."""


def create(url: URL, timeout_s: float, fill: Callable[[Connection], None]) -> bool:
    """Create the extension and the tables in one transaction; a second process waits, finds them, and returns False."""
    with make_engine(url, timeout_s).begin() as connection:
        connection.execute(text("SELECT pg_advisory_xact_lock(:lock)"), {"lock": _WRITER_LOCK})
        if inspect(connection).has_table(VERSION_TABLE):
            return False
        if not connection.scalar(text("SELECT count(*) FROM pg_extension WHERE extname = 'postgis'")):
            connection.execute(text("CREATE EXTENSION postgis"))
        connection.execute(text(_COMPRESSION))
        fill(connection)
    return True


def make_engine(url: URL, timeout_s: float, *, keep_open: bool = False) -> Engine:
    """Return an engine that waits for locks and servers no longer than the timeout.

    A session that is kept open saves the next use the start of a process that loads PostGIS. One that was lost
    meanwhile is replaced.
    """
    pool: dict[str, Any] = {"poolclass": QueuePool, "pool_size": 1, "pool_pre_ping": True}
    return create_engine(
        url,
        **pool if keep_open else {"poolclass": NullPool},
        # Not the server's default: a writer that waited for its lock must see what others committed.
        isolation_level="READ COMMITTED",
        connect_args={
            "connect_timeout": max(2, round(timeout_s)),
            # Many queries have a small window; compiling such a query takes longer than running it.
            "options": f"-c lock_timeout={round(timeout_s * 1000)} -c client_min_messages=warning -c jit=off "
            + " ".join(f"-c tcp_{name.removeprefix('tcp_')}={value}" for name, value in _ALIVE.items()),
            **_ALIVE,
        },
        hide_parameters=True,
        json_serializer=to_json,
    )


def reading_engine(url: URL, timeout_s: float) -> Engine:
    """Return an engine whose transactions are all read-only."""
    return make_engine(url, timeout_s).execution_options(postgresql_readonly=True)


def geometry_ddl(table: str, kind: str, srid: int | str) -> list[str]:
    """Return the statements that add and index the column ``geometry``."""
    return [
        f"ALTER TABLE {table} ADD COLUMN geometry geometry({kind}, {srid}) NOT NULL",
        f"CREATE INDEX idx_{table}_geometry ON {table} USING gist (geometry)",
    ]


def view_ddl(view: str, key: str, base: str) -> list[str]:  # noqa: ARG001  (SpatiaLite keeps a register)
    """Return nothing: PostGIS reads type and SRID of a view's geometry from the view itself."""
    return []


def function_ddl() -> list[str]:
    """Return the statement that creates ``footprint_at``."""
    return [read_sql("functions", "footprint_at").sql]


def drop_geometry_ddl(table: str) -> list[str]:  # noqa: ARG001  (SpatiaLite keeps a register)
    """Return nothing: the column and its index are dropped with the table."""
    return []


def drop_view_ddl(view: str) -> list[str]:  # noqa: ARG001  (SpatiaLite keeps a register)
    """Return nothing: PostGIS has no register of views."""
    return []


def database_srid(connection: Connection) -> int:
    """Return the SRID of the parts' geometry."""
    # From the column's type: PostGIS's own Find_SRID reads the columns of all tables.
    query = text(
        "SELECT postgis_typmod_srid(atttypmod) FROM pg_attribute "
        "WHERE attrelid = to_regclass('part') AND attname = 'geometry'"
    )
    return int(connection.scalars(query).one())


@contextmanager
def writing(engine: Engine, resting: Connection | None = None) -> Iterator[Connection]:
    """Open the transaction of the only writer; readers see the last committed state.

    A resting connection is used, because each new one has the server start a process that loads PostGIS.
    """
    with nullcontext(resting) if resting is not None else engine.connect() as connection, connection.begin():
        connection.execute(text("SELECT pg_advisory_xact_lock(:lock)"), {"lock": _WRITER_LOCK})
        connection.execute(text(_COMPRESSION))
        yield connection


def keys_in_sets(connection: Connection, tables: Sequence[str], run_id: int) -> AbstractContextManager[None]:
    """Check the keys of a run's rows by one query each, where the user may leave out the triggers."""
    return setkeys.keys_in_sets(connection, tables, run_id)


def insert_rows(
    connection: Connection,
    table: str,
    columns: Mapping[str, Sequence[Any] | NDArray[Any]],
    srid: int,  # noqa: ARG001  (SpatiaLite takes it here)
) -> None:
    """Insert rows by binary COPY: the server converts no numbers or geometries, and gives these the column's SRID."""
    kinds = {name: _wire_type(SQL[table].columns[name].type) for name in columns}
    # Stable: numbers first, in their order.
    names = sorted(columns, key=lambda name: kinds[name] not in NUMBERS)
    statement = f"COPY {table} ({', '.join(names)}) FROM STDIN (FORMAT BINARY)"
    with connection.connection.cursor() as cursor, cursor.copy(statement) as copy:  # type: ignore[attr-defined]  # psycopg's own
        copy.write(packed_rows({name: columns[name] for name in names}, kinds))


def _wire_type(kind: TypeEngine[Any]) -> str:
    """Return the server's type in whose binary form a column's values are sent."""
    for known, name in _WIRE.items():
        if isinstance(kind, known):
            return name
    msg = f"No rows can be sent into a column of the type {kind!r}. This is a fault of msbdb; please report it."
    raise TableError(msg)


def settle(connection: Connection) -> None:
    """Check the deferred keys of the rows deleted so far, while the planner's statistics still fit.

    At the commit, with the statistics of a smaller run, the check of each deleted row would scan a whole table.
    """
    connection.execute(text("SET CONSTRAINTS ALL IMMEDIATE"))
    connection.execute(text("SET CONSTRAINTS ALL DEFERRED"))


def after_load(connection: Connection) -> None:
    """Update the planner's statistics, before the commit checks the new rows' keys with them.

    Only of tables in which most rows are new: sampling a large table takes longer than loading a survey. The server's
    autovacuum handles tables that changed by a tenth.
    """
    tables = connection.scalars(text(_OUTDATED), {"tables": list(_CONTENT)}).all()
    if tables:
        connection.execute(text(_SAMPLE))
    for table in tables:
        connection.execute(text(f"ANALYZE {table}"))


_LOCKED = ("{where} is locked: another program writes to it.", "Wait for it, and try again.")

_TAKEN = ("{where} holds a table of another program: {cause}", "Give msbdb a database of its own.")

_LOST = (
    "{where} is out of reach, or its connection was lost: {cause}",
    "Nothing incomplete was written; run the command again when the server is available.",
)

_EXPLAINED = {
    **dict.fromkeys(("08000", "08001", "08003", "08006", "57P01", "57P02", "57P03"), _LOST),
    "55P03": _LOCKED,
    "40P01": _LOCKED,
    "53100": ("{where} could not be written: {cause}", "Nothing was changed; free some space and try again."),
    "42501": ("{where} does not allow it: {cause}", "Ask its owner for the right."),
    "42P07": _TAKEN,
    "42710": _TAKEN,
}
"""The meaning of a SQLSTATE, and the next step."""


def driver_errors() -> tuple[type[Exception], ...]:
    """Return the driver's error, which COPY raises."""
    return (psycopg.Error,)


def explain(error: BaseException, where: str) -> MsbdbError:
    """Return the error of msbdb for an error of PostgreSQL, chosen by its SQLSTATE."""
    origin = error.orig if isinstance(error, DBAPIError) else error
    state = str(getattr(origin, "sqlstate", None) or "")
    cause = " ".join(str(origin).split())
    if not state and "closed the connection" in cause:
        # The server stopped without a reason.
        state = "08006"
    if state.startswith(("22", "23")):
        return LoadError(f"The database {where} refused the rows: {cause} Nothing was written.")
    if state in ("0A000", "58P01") and "postgis" in cause:
        return MissingDependencyError(
            f"The server of {where} has no PostGIS: {cause} "
            "Install it there, on Debian or Ubuntu by 'apt-get install postgis postgresql-15-postgis-3'."
        )
    what, step = _EXPLAINED.get(state, ("{where} failed: {cause}", "Check the URL, the server and the rights."))
    return DatabaseError(f"The database {what.format(where=where, cause=cause)} {step}")


@contextmanager
def in_bulk(connection: Connection, coming: Mapping[str, int]) -> Iterator[None]:
    """Drop the foreign keys and indexes of new tables while they are filled, and make them at the end.

    In other tables this would lock readers out.
    Primary keys and unique constraints are kept: rows come in their order, so they cost little.

    Parameters
    ----------
    connection : Connection
        In a writer's transaction. A failure or a kill undoes all of it.
    coming : Mapping
        Number of rows that will be inserted into each table. Tables of an earlier transaction, and those with fewer
        than `WORTH` incoming rows, keep their keys and indexes.

    Raises
    ------
    IntegrityError
        At the end, when a row breaks a key.
    """
    large = [table for table, rows in coming.items() if rows >= WORTH]
    new = list(connection.scalars(text(_NEW), {"tables": large})) if large else []
    keys = connection.execute(text(_KEYS), {"tables": new}).all()
    indexes = connection.execute(text(_INDEXES), {"tables": new}).all()
    for off, _ in [*keys, *indexes]:
        connection.exec_driver_sql(off)
    yield
    if new:
        logger.debug("%d indexes and %d keys are made for the new tables %s", len(indexes), len(keys), ", ".join(new))
        connection.execute(text(_ROOM))
    for _, on in [*indexes, *keys]:
        connection.exec_driver_sql(on)

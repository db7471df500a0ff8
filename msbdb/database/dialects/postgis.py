"""The hooks of PostGIS."""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from typing import Any

import psycopg
import shapely
from geoalchemy2 import Geometry
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
    Text,
    create_engine,
    inspect,
    text,
)
from sqlalchemy.exc import DBAPIError
from sqlalchemy.types import TypeEngine

from msbdb.database.dialects import freshtables as fresh
from msbdb.database.schema.canonical import to_json
from msbdb.database.schema.sqlfiles import read_sql
from msbdb.database.schema.sqltables import SQL
from msbdb.errors import DatabaseError, LoadError, MissingDependencyError, MsbdbError, TableError

logger = logging.getLogger(__name__)

VERSION_TABLE = "msbdb_schema_version"

_WRITER_LOCK = 0x6D73626462
"""Number of the advisory lock that one writer of a database holds: 'msbdb' in ASCII."""

_ALIVE = {"keepalives_idle": 30, "keepalives_interval": 10, "keepalives_count": 3, "tcp_user_timeout": 60_000}
"""When either end of a connection takes the other for gone: seconds, and for the last milliseconds.

By the systems' own values a writer whose machine or network is gone would keep its lock for two hours.
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
"""Types of the models' columns as they are sent, the narrower ones first; JSON comes as its text."""

_HAS_SRID = 0x20
"""Flag in the highest byte of a type's number in extended WKB."""

_CONTENT = (
    "survey",
    "source",
    "run",
    "scale",
    "part",
    "spectral_class",
    "spectral_class_band",
    "rejection",
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
  AND (c.reltuples <= 0
       OR COALESCE(pg_stat_get_mod_since_analyze(c.oid), 0) + pg_stat_get_xact_tuples_inserted(c.oid)
          + pg_stat_get_xact_tuples_updated(c.oid) + pg_stat_get_xact_tuples_deleted(c.oid) > c.reltuples)
ORDER BY c.relname
"""
"""The tables whose statistics no longer fit: never made, or as many rows came, changed or went since as there were."""

_COMPRESSION = """
SELECT set_config('default_toast_compression', 'lz4', true) FROM pg_settings
WHERE name = 'default_toast_compression' AND 'lz4' = ANY(enumvals)
"""
"""Large outlines are packed by LZ4 where the server knows it: a third of the time of its own way, some more space."""


def exists(url: URL, timeout_s: float) -> bool:
    """Tell whether the database holds msbdb's tables."""
    with make_engine(url, timeout_s).connect() as connection:
        return inspect(connection).has_table(VERSION_TABLE)


def require_writable(url: URL) -> None:
    """Do nothing: the server tells at the first statement."""


def create(url: URL, timeout_s: float, fill: Callable[[Connection], None]) -> bool:
    """Create the extension and the tables in one transaction; a second creator waits, finds them, and returns False."""
    with make_engine(url, timeout_s).begin() as connection:
        connection.execute(text("SELECT pg_advisory_xact_lock(:lock)"), {"lock": _WRITER_LOCK})
        if inspect(connection).has_table(VERSION_TABLE):
            return False
        if not connection.scalar(text("SELECT count(*) FROM pg_extension WHERE extname = 'postgis'")):
            connection.execute(text("CREATE EXTENSION postgis"))
        connection.execute(text(_COMPRESSION))
        fill(connection)
    return True


def make_engine(url: URL, timeout_s: float) -> Engine:
    """Return an engine that waits for locks and servers no longer than the timeout."""
    return create_engine(
        url,
        poolclass=NullPool,
        # Whatever the server's default is: a writer that waited for its lock must see what was committed meanwhile.
        isolation_level="READ COMMITTED",
        connect_args={
            "connect_timeout": max(2, round(timeout_s)),
            # What is asked for is often local, and compiling its query takes longer than its answer.
            "options": f"-c lock_timeout={round(timeout_s * 1000)} -c client_min_messages=warning -c jit=off "
            + " ".join(f"-c tcp_{name.removeprefix('tcp_')}={value}" for name, value in _ALIVE.items()),
            **_ALIVE,
        },
        hide_parameters=True,
        json_serializer=to_json,
    )


def geometry_ddl(table: str, kind: str, srid: int | str) -> list[str]:
    """Return the statements that add and index the column ``geometry``."""
    return [
        f"ALTER TABLE {table} ADD COLUMN geometry geometry({kind}, {srid}) NOT NULL",
        f"CREATE INDEX idx_{table}_geometry ON {table} USING gist (geometry)",
    ]


def view_ddl(view: str, key: str, base: str) -> list[str]:  # noqa: ARG001  (SpatiaLite keeps a register)
    """Return nothing: PostGIS reads a view's geometry type and SRID off the view itself."""
    return []


def function_ddl() -> list[str]:
    """Return the statement that creates ``footprint_at``."""
    return [read_sql("functions", "footprint_at").sql]


def drop_geometry_ddl(table: str) -> list[str]:  # noqa: ARG001  (SpatiaLite keeps a register)
    """Return nothing: the column and its index go with the table."""
    return []


def drop_view_ddl(view: str) -> list[str]:  # noqa: ARG001  (SpatiaLite keeps a register)
    """Return nothing: no register holds views."""
    return []


def database_srid(connection: Connection) -> int:
    """Return the SRID of the parts' geometry."""
    # Off the column's type: PostGIS's own Find_SRID reads the columns of all tables.
    query = text(
        "SELECT postgis_typmod_srid(atttypmod) FROM pg_attribute "
        "WHERE attrelid = to_regclass('part') AND attname = 'geometry'"
    )
    return int(connection.scalars(query).one())


@contextmanager
def writing(engine: Engine) -> Iterator[Connection]:
    """Open a transaction that is the only writer's; readers see the last committed state."""
    with engine.begin() as connection:
        connection.execute(text("SELECT pg_advisory_xact_lock(:lock)"), {"lock": _WRITER_LOCK})
        connection.execute(text(_COMPRESSION))
        yield connection


def in_bulk(connection: Connection, coming: Mapping[str, int]) -> AbstractContextManager[None]:
    """Index and check new tables once they are filled; in others that would lock readers out of the table."""
    return fresh.in_bulk(connection, coming)


def encode(geometries: NDArray[Any], srid: int) -> list[Any]:
    """Return extended WKB, which carries the SRID."""
    number = srid.to_bytes(4, "little")
    # The type's flag and the SRID are put into plain WKB, as shapely would copy every geometry to give it an SRID.
    return [
        wkb[:4] + bytes([wkb[4] | _HAS_SRID]) + number + wkb[5:] for wkb in shapely.to_wkb(geometries, byte_order=1)
    ]


def insert_rows(
    connection: Connection,
    table: str,
    columns: Sequence[str],
    rows: Sequence[tuple[Any, ...]],
    srid: int,  # noqa: ARG001  (SpatiaLite takes it here)
) -> None:
    """Insert rows by COPY, in binary: the server reads numbers and geometries as they are."""
    own = SQL[table].columns
    statement = f"COPY {table} ({', '.join(columns)}) FROM STDIN (FORMAT BINARY)"
    with connection.connection.cursor() as cursor, cursor.copy(statement) as copy:  # type: ignore[attr-defined]  # psycopg's own
        copy.set_types([_wire_type(own[name].type) for name in columns])
        for row in rows:
            copy.write_row(row)


def _wire_type(kind: TypeEngine[Any]) -> str:
    """Return the type of the server whose binary form a column's values are sent in."""
    for known, name in _WIRE.items():
        if isinstance(kind, known):
            return name
    msg = f"No rows can be sent into a column of the type {kind!r}. This is a fault of msbdb; please report it."
    raise TableError(msg)


def settle(connection: Connection) -> None:
    """Check the deferred keys of the rows deleted so far, while the planner's figures still fit them.

    Left to the commit, after the statistics of a smaller run, each deleted row would be looked up by a full scan.
    """
    connection.execute(text("SET CONSTRAINTS ALL IMMEDIATE"))
    connection.execute(text("SET CONSTRAINTS ALL DEFERRED"))


def after_load(connection: Connection) -> None:
    """Bring the planner's statistics up to date, before the commit checks the new rows' keys by them.

    Only of tables that changed as a whole since they were last looked at: to sample a large table takes longer than to
    load a survey. The server's own autovacuum looks at tables that changed by a tenth.
    """
    for table in connection.scalars(text(_OUTDATED), {"tables": list(_CONTENT)}).all():
        connection.execute(text(f"ANALYZE {table}"))


_LOCKED = ("{where} is locked: another program writes to it.", "Wait for it, and try again.")

_TAKEN = ("{where} holds a table of another program: {cause}", "Give msbdb a database of its own.")

_LOST = (
    "{where} is out of reach, or its connection was lost: {cause}",
    "Whatever was not complete is not there; run the command again when the server serves.",
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
"""What a SQLSTATE means here, and the next step."""


def driver_errors() -> tuple[type[Exception], ...]:
    """Return the driver's errors, which COPY raises."""
    return (psycopg.Error,)


def explain(error: BaseException, where: str) -> MsbdbError:
    """Return our error for one of PostgreSQL's, told apart by its SQLSTATE."""
    origin = error.orig if isinstance(error, DBAPIError) else error
    state = str(getattr(origin, "sqlstate", None) or "")
    cause = " ".join(str(origin).split())
    if not state and "closed the connection" in cause:
        # The server had no time to say why.
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

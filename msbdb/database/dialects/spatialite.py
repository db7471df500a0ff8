"""The dialect of SpatiaLite: one file, created completely or not at all, readable after a kill."""

import logging
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import Any
from urllib.parse import quote

from numpy.typing import NDArray
from sqlalchemy import URL, Connection, Engine, NullPool, create_engine, event, text
from sqlalchemy.exc import DBAPIError, IntegrityError

from msbdb.database.dialects import bulk
from msbdb.database.dialects.sqliteconnection import begin, driver, journal_mode, prepare
from msbdb.database.schema.sqltables import VERSION_TABLE, plain_rows
from msbdb.errors import DatabaseError, LoadError, MsbdbError, SchemaVersionError
from msbdb.identity import to_json

logger = logging.getLogger(__name__)

MAGIC = b"SQLite format 3\x00"


def exists(url: URL, timeout_s: float) -> bool:
    """Return whether the file is an msbdb database; a missing or empty file is none.

    Raises
    ------
    SchemaVersionError
        When the file is not SQLite, or SQLite of another program.
    DatabaseError
        When it cannot be read.
    """
    path = _path(url)
    try:
        with path.open("rb") as file:
            head = file.read(len(MAGIC))
    except FileNotFoundError:
        return False
    except OSError as error:
        msg = f"The database {path} cannot be read: {error.strerror}. Give the path of a file."
        raise DatabaseError(msg) from error
    if not head:
        return False
    foreign = f"The file {path} is no msbdb database: {{}}. Give another path; this file was not changed."
    if head != MAGIC:
        raise SchemaVersionError(foreign.format("it is not an SQLite file"))
    engine = make_engine(url, timeout_s)
    with engine.connect() as connection:
        query = text("SELECT count(*) FROM sqlite_master WHERE type = 'table' AND name = :name")
        if not connection.scalar(query, {"name": VERSION_TABLE}):
            raise SchemaVersionError(foreign.format(f"it is SQLite without the table {VERSION_TABLE}"))
    return True


def require_writable(url: URL) -> None:
    """Refuse a missing folder, and a read-only file or folder; remove the partial files of killed processes.

    Raises
    ------
    DatabaseError
        With the place that is missing or read-only.
    """
    path = _path(url)
    if not path.parent.is_dir():
        msg = f"The database {path} cannot be written: there is no folder {path.parent}. Make it, or give another path."
        raise DatabaseError(msg)
    # The journal is in the same folder, so the folder must be writable, too.
    for place in (path.parent, path):
        if place.exists() and not os.access(place, os.W_OK):
            msg = (
                f"The database {path} cannot be written: {place} is read-only. Check its rights, or give another path."
            )
            raise DatabaseError(msg)
    _remove_leftovers(path)


def create(url: URL, timeout_s: float, fill: Callable[[Connection], None]) -> bool:
    """Create the file under a hidden name and rename it when it is complete; return whether this process created it.

    A kill leaves at most a hidden ``.partial`` file, which the next creation removes.

    Raises
    ------
    DatabaseError
        When the folder cannot be written.

    Notes
    -----
    When another process creates the file meanwhile, that file is kept.
    """
    path = _path(url)
    growing = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        _remove_leftovers(path)
        growing.touch()
        engine = make_engine(url.set(database=str(growing)), timeout_s)
        msg = f"The database {path} could not be created: its first tables failed; free some space, try again."
        with engine.begin() as connection:
            if not connection.scalar(text("SELECT InitSpatialMetaData(0, 'NONE')")):
                raise DatabaseError(msg)
            try:
                fill(connection)
            except DBAPIError as error:
                # Functions of SpatiaLite keep a failed write to themselves. SQLite then takes back all tables, and the
                # next statement misses one of them.
                if connection.connection.dbapi_connection.in_transaction:  # type: ignore[union-attr]  # of SQLite
                    raise
                raise DatabaseError(msg) from error
        _publish(growing, path)
    except FileExistsError:
        logger.info("Another process created %s meanwhile", path)
        return False
    except OSError as error:
        msg = f"The database {path} cannot be created: {error.strerror}. Choose a folder that exists and is writable."
        raise DatabaseError(msg) from error
    finally:
        _remove(growing)
    return True


def make_engine(url: URL, timeout_s: float, *, keep_open: bool = False) -> Engine:  # noqa: ARG001  (PostGIS keeps one)
    """Return an engine of connections with SpatiaLite, foreign keys and real transactions.

    No connection stays open after use: a file at rest is a single closed file.
    """
    engine = create_engine(
        url,
        module=driver(),
        poolclass=NullPool,
        hide_parameters=True,
        json_serializer=to_json,
    )
    event.listen(engine, "connect", partial(prepare, timeout_s=timeout_s))
    event.listen(engine, "begin", begin)
    return engine


def reading_engine(url: URL, timeout_s: float) -> Engine:
    """Return an engine for which SQLite opens the file read-only."""
    place = f"file:{quote(str(_path(url).absolute()))}"
    return make_engine(url.set(database=place, query={"mode": "ro", "uri": "true"}), timeout_s)


def geometry_ddl(table: str, kind: str, srid: int | str) -> list[str]:
    """Return the statements that add and index the column ``geometry``; SpatiaLite registers both."""
    return [
        f"SELECT AddGeometryColumn('{table}', 'geometry', {srid}, '{kind}', 'XY', 1)",
        f"SELECT CreateSpatialIndex('{table}', 'geometry')",
    ]


def view_ddl(view: str, key: str, base: str) -> list[str]:
    """Return the statement that registers a view, so that GIS clients list it with type, SRID and spatial index."""
    columns = "view_name, view_geometry, view_rowid, f_table_name, f_geometry_column, read_only"
    values = f"'{view}', 'geometry', '{key}', '{base}', 'geometry', 1"
    return [f"INSERT INTO views_geometry_columns ({columns}) VALUES ({values})"]  # noqa: S608  (names are the views')


def function_ddl() -> list[str]:
    """Return nothing: SQLite stores no functions; `msbdb.database.footprint_at` replaces this one."""
    return []


def drop_geometry_ddl(table: str) -> list[str]:
    """Return the statements that unregister the column ``geometry``, before its table is dropped."""
    return [
        f"SELECT DisableSpatialIndex('{table}', 'geometry')",
        f"DROP TABLE idx_{table}_geometry",
        f"SELECT DiscardGeometryColumn('{table}', 'geometry')",
    ]


def drop_view_ddl(view: str) -> list[str]:
    """Return the statement that unregisters a view with its statistics."""
    return [f"DELETE FROM views_geometry_columns WHERE view_name = '{view}'"]  # noqa: S608  (names are the views')


def database_srid(connection: Connection) -> int:
    """Return the SRID of the parts' geometry."""
    query = text("SELECT srid FROM geometry_columns WHERE f_table_name = 'part' AND f_geometry_column = 'geometry'")
    return int(connection.scalars(query).one())


@contextmanager
def writing(engine: Engine, resting: Connection | None = None) -> Iterator[Connection]:
    """Open a transaction that has the write lock from its start, in write-ahead mode; a resting connection is closed.

    In this mode readers see the last committed state, also read-only ones after a kill. At rest the file is in rollback
    journal mode, because a write-ahead file without its two companion files cannot be opened on read-only media. A
    reader that stays connected may prevent the change back; then the next writer makes it.
    """
    if resting is not None:
        resting.close()
    _remove_leftovers(_path(engine.url))
    try:
        journal_mode(engine, "WAL")
    except driver().Error as error:
        raise explain(error, str(engine.url.database)) from error
    try:
        with engine.connect().execution_options(sqlite_begin="IMMEDIATE") as connection, connection.begin():
            yield connection
    finally:
        try:
            journal_mode(engine, "DELETE", wait=False)
        except driver().OperationalError as error:
            logger.info("The database stays in write-ahead mode, as somebody reads it: %s", error)


def in_bulk(connection: Connection, coming: Mapping[str, int]) -> AbstractContextManager[None]:
    """Drop the triggers of geometry columns while rows change, and do their work at the end."""
    return bulk.in_bulk(connection, coming)


def keys_in_sets(connection: Connection, tables: Sequence[str], run_id: int) -> AbstractContextManager[None]:  # noqa: ARG001  (PostGIS needs them)
    """Do nothing: SQLite looks up a key in the time of a row."""
    return nullcontext()


def insert_rows(
    connection: Connection, table: str, columns: Mapping[str, Sequence[Any] | NDArray[Any]], srid: int
) -> None:
    """Insert rows by one prepared statement, parts after their fathers.

    As long as a reference is open, SQLite looks with each row for all rows that wait for it, through an index that may
    hold the whole run: the time would grow with the square of the parts.
    """
    rows = plain_rows(columns)
    if not rows:
        return
    if "supscale" in columns:
        rows.sort(key=itemgetter(list(columns).index("scale")))
    values = ", ".join(f"ST_GeomFromWKB(?, {srid})" if name == "geometry" else "?" for name in columns)
    statement = f"INSERT INTO {table} ({', '.join(columns)}) VALUES ({values})"  # noqa: S608  (names are the models')
    connection.exec_driver_sql(statement, rows)


def settle(connection: Connection) -> None:
    """Do nothing: SQLite counts the open references as rows come and go."""


def after_load(connection: Connection) -> None:
    """Update the statistics of the layers and of the query planner."""
    bulk.update_statistics(connection)
    connection.execute(text("ANALYZE"))


def driver_errors() -> tuple[type[Exception], ...]:
    """Return none: errors outside SQLAlchemy are converted where they occur."""
    return ()


def explain(error: BaseException, where: str) -> MsbdbError:
    """Return the error of msbdb for an error of SQLite, chosen by its message."""
    cause = str(error.orig) if isinstance(error, DBAPIError) else str(error)
    if isinstance(error, IntegrityError):
        return LoadError(f"The database {where} refused the rows: {cause}. Nothing was written.")
    if "locked" in cause:
        return DatabaseError(
            f"The database {where} is locked: another program writes to it or holds it open. "
            "Close that program, or wait, and try again."
        )
    if "not a database" in cause or "malformed" in cause:
        return SchemaVersionError(f"The file {where} is damaged or no database: {cause}. Restore or rebuild it.")
    if "full" in cause or "disk I/O" in cause:
        return DatabaseError(
            f"The database {where} could not be written: {cause}. Nothing was changed; free some space and try again."
        )
    if "readonly" in cause or "unable to open" in cause:
        return DatabaseError(f"The database {where} cannot be written: {cause}. Check the rights of file and folder.")
    return DatabaseError(f"The database {where} failed: {cause}.")


def _path(url: URL) -> Path:
    return Path(url.database or "")


def _publish(growing: Path, path: Path) -> None:
    """Give a complete file its name; a file that another process created meanwhile is not replaced."""
    with growing.open("rb") as file:
        os.fsync(file.fileno())
    if path.exists() and path.stat().st_size == 0:
        growing.replace(path)
        return
    try:
        path.hardlink_to(growing)
    except FileExistsError:
        raise
    except OSError:
        # Some file systems do not support hard links.
        growing.rename(path)


def _remove(growing: Path) -> None:
    """Remove a growing file and its journal."""
    for file in (growing, growing.with_name(f"{growing.name}-journal")):
        try:
            file.unlink(missing_ok=True)
        except OSError as error:
            logger.debug("%s stays: %s", file, error)


def _remove_leftovers(path: Path) -> None:
    """Remove partial files of processes that no longer run."""
    for growing in path.parent.glob(f".{_escaped(path.name)}.*.partial"):
        number = growing.name.removesuffix(".partial").rpartition(".")[2]
        if number.isdigit() and not _runs(int(number)):
            _remove(growing)


def _escaped(name: str) -> str:
    return "".join(f"[{c}]" if c in "*?[" else c for c in name)


def _runs(process: int) -> bool:
    """Return whether another process with this number runs."""
    if process == os.getpid():
        return False
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OverflowError:
        return False
    except PermissionError:
        return True
    return True

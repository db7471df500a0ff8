"""The hooks of SpatiaLite: one file, created whole, readable after a kill."""

import logging
import os
import sqlite3
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from ctypes import CDLL
from functools import cache, partial
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from sqlalchemy import URL, Connection, Engine, NullPool, create_engine, event, text
from sqlalchemy.exc import DBAPIError, IntegrityError

from msbdb.database.dialects import bulk
from msbdb.database.schema.canonical import to_json
from msbdb.errors import DatabaseError, LoadError, MissingDependencyError, MsbdbError, SchemaVersionError

logger = logging.getLogger(__name__)

MAGIC = b"SQLite format 3\x00"

EXTENSION = "mod_spatialite"

VERSION_TABLE = "msbdb_schema_version"


def exists(url: URL, timeout_s: float) -> bool:
    """Tell whether the file is an msbdb database; a missing or empty file is none.

    Raises
    ------
    SchemaVersionError
        When the file is no SQLite, or a SQLite of somebody else.
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
    foreign = f"The file {path} is no msbdb database: {{}}. Give another path; this file was left as it is."
    if head != MAGIC:
        raise SchemaVersionError(foreign.format("it is not an SQLite file"))
    engine = make_engine(url, timeout_s)
    with engine.connect() as connection:
        query = text("SELECT count(*) FROM sqlite_master WHERE type = 'table' AND name = :name")
        if not connection.scalar(query, {"name": VERSION_TABLE}):
            raise SchemaVersionError(foreign.format(f"it is SQLite without the table {VERSION_TABLE}"))
    return True


def require_writable(url: URL) -> None:
    """Refuse a missing folder, and a file or folder that may not be written; remove what killed creations left.

    Raises
    ------
    DatabaseError
        Naming what is missing or may not be written.
    """
    path = _path(url)
    if not path.parent.is_dir():
        msg = f"The database {path} cannot be written: there is no folder {path.parent}. Make it, or give another path."
        raise DatabaseError(msg)
    # The journal lies beside the file, so that the folder must be writable too.
    for place in (path.parent, path):
        if place.exists() and not os.access(place, os.W_OK):
            msg = (
                f"The database {path} cannot be written: {place} is read-only. Check its rights, or give another path."
            )
            raise DatabaseError(msg)
    _remove_leftovers(path)


def create(url: URL, timeout_s: float, fill: Callable[[Connection], None]) -> bool:
    """Create the file beside its place and link it there when it is whole; return whether it was this one.

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
        with engine.begin() as connection:
            if not connection.scalar(text("SELECT InitSpatialMetaData(0, 'NONE')")):
                msg = f"The database {path} could not be created: its first tables failed; free some space, try again."
                raise DatabaseError(msg)
            fill(connection)
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


def make_engine(url: URL, timeout_s: float) -> Engine:
    """Return an engine of connections with SpatiaLite, foreign keys and real transactions.

    No connection outlives its use: a file at rest is a single file, closed.
    """
    engine = create_engine(
        url,
        module=_driver(),
        poolclass=NullPool,
        hide_parameters=True,
        json_serializer=to_json,
    )
    event.listen(engine, "connect", partial(_prepare, timeout_s=timeout_s))
    event.listen(engine, "begin", _begin)
    return engine


def geometry_ddl(table: str, kind: str, srid: int | str) -> list[str]:
    """Return the statements that add and index the column ``geometry``; SpatiaLite keeps a register of both."""
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
    """Return nothing: SQLite keeps no functions; `msbdb.database.footprint_at` serves."""
    return []


def drop_geometry_ddl(table: str) -> list[str]:
    """Return the statements that take the column ``geometry`` out of the register, before its table is dropped."""
    return [
        f"SELECT DisableSpatialIndex('{table}', 'geometry')",
        f"DROP TABLE idx_{table}_geometry",
        f"SELECT DiscardGeometryColumn('{table}', 'geometry')",
    ]


def drop_view_ddl(view: str) -> list[str]:
    """Return the statement that takes a view out of the register, with its figures."""
    return [f"DELETE FROM views_geometry_columns WHERE view_name = '{view}'"]  # noqa: S608  (names are the views')


def database_srid(connection: Connection) -> int:
    """Return the SRID of the parts' geometry."""
    query = text("SELECT srid FROM geometry_columns WHERE f_table_name = 'part' AND f_geometry_column = 'geometry'")
    return int(connection.scalars(query).one())


@contextmanager
def writing(engine: Engine) -> Iterator[Connection]:
    """Open a transaction that has the write lock from its start, in write-ahead mode.

    While the log is ahead, readers see the last committed state, also read-only ones after a kill; at rest the file
    goes back to the rollback journal, as a write-ahead file without its companions cannot be opened on read-only media.
    A reader that stays connected may hold up the way back; then the next writer takes it.
    """
    _remove_leftovers(_path(engine.url))
    try:
        _journal_mode(engine, "WAL")
    except _driver().Error as error:
        raise explain(error, str(engine.url.database)) from error
    try:
        with engine.connect().execution_options(sqlite_begin="IMMEDIATE") as connection, connection.begin():
            yield connection
    finally:
        try:
            _journal_mode(engine, "DELETE", wait=False)
        except _driver().OperationalError as error:
            logger.info("The database stays in write-ahead mode, as somebody reads it: %s", error)


def in_bulk(connection: Connection, coming: Mapping[str, int]) -> AbstractContextManager[None]:
    """Leave out the triggers of geometry columns while rows come and go, and make up for them at the end."""
    return bulk.in_bulk(connection, coming)


def encode(geometries: NDArray[Any], srid: int) -> list[Any]:  # noqa: ARG001  (PostGIS needs the SRID here)
    """Return WKB in the order of bytes that every machine writes alike."""
    return list(np.asarray(shapely.to_wkb(geometries, byte_order=1)))


def insert_rows(
    connection: Connection, table: str, columns: Sequence[str], rows: Sequence[tuple[Any, ...]], srid: int
) -> None:
    """Insert rows by one prepared statement."""
    if not rows:
        return
    values = ", ".join(f"ST_GeomFromWKB(?, {srid})" if name == "geometry" else "?" for name in columns)
    statement = f"INSERT INTO {table} ({', '.join(columns)}) VALUES ({values})"  # noqa: S608  (names are the models')
    connection.exec_driver_sql(statement, list(rows))


def settle(connection: Connection) -> None:
    """Do nothing: SQLite counts the open references as rows come and go."""


def after_load(connection: Connection) -> None:
    """Bring the statistics of the layers and of the query planner up to date."""
    bulk.update_statistics(connection)
    connection.execute(text("ANALYZE"))


def driver_errors() -> tuple[type[Exception], ...]:
    """Return none: SQLite is asked through SQLAlchemy, and where it is not, its errors are explained on the spot."""
    return ()


def explain(error: BaseException, where: str) -> MsbdbError:
    """Return our error for one of SQLite's, told apart by its message."""
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


def _driver() -> ModuleType:
    """Return Python's own SQLite where it can load extensions, and ``pysqlite3`` otherwise.

    Raises
    ------
    MissingDependencyError
        When there is neither.
    """
    if hasattr(sqlite3.Connection, "enable_load_extension"):
        return sqlite3
    try:
        import pysqlite3.dbapi2 as driver
    except ImportError as error:
        msg = (
            "This Python's sqlite3 cannot load extensions, and pysqlite3 is missing. "
            "Install it (pip install pysqlite3-binary), or use a Python with loadable SQLite extensions."
        )
        raise MissingDependencyError(msg) from error
    return driver  # type: ignore[no-any-return]  # the library has no type information


def _prepare(connection: Any, _record: object, *, timeout_s: float) -> None:  # noqa: ANN401  (either driver's)
    """Set a new connection up: transactions are ours to begin, geometry functions, foreign keys, the wait for locks."""
    _bind_others()
    connection.isolation_level = None
    connection.enable_load_extension(True)
    try:
        connection.load_extension(EXTENSION)
    except Exception as error:
        if EXTENSION not in str(error):
            raise
        msg = (
            f"SpatiaLite could not be loaded: {error}. "
            "Install it, on Debian or Ubuntu by 'apt-get install libsqlite3-mod-spatialite'."
        )
        raise MissingDependencyError(msg) from error
    connection.enable_load_extension(False)
    # SpatiaLite sets a wait of its own when it is loaded, so that ours comes after it.
    connection.execute(f"PRAGMA busy_timeout = {round(timeout_s * 1000)}")
    connection.execute("PRAGMA foreign_keys = ON")


@cache
def _bind_others() -> None:
    """Load the compiled modules of rasterio, pyogrio and pyproj, which bring a GDAL and a PROJ of their own.

    SQLite loads mod_spatialite with its symbols open to the whole process, those of the system's PROJ and GEOS among
    them. Modules that are loaded later would take these for their own library's, and crash. Once a module is loaded,
    its symbols are bound. To load the files takes a tenth of the time of importing the packages.
    """
    for package in ("rasterio", "pyogrio", "pyproj"):
        found = find_spec(package)
        for folder in (found.submodule_search_locations or ()) if found else ():
            for module in sorted(Path(folder).glob("*.so")):
                CDLL(str(module))


def _begin(connection: Connection) -> None:
    """Begin a transaction ourselves, as the driver would not begin one for a change of the schema."""
    connection.exec_driver_sql(f"BEGIN {connection.get_execution_options().get('sqlite_begin', 'DEFERRED')}")


def _journal_mode(engine: Engine, mode: str, *, wait: bool = True) -> None:
    """Change the journal outside a transaction; file systems that cannot hold a write-ahead log keep theirs."""
    connection = engine.raw_connection()
    try:
        cursor = connection.cursor()
        cursor.execute("PRAGMA busy_timeout")
        [timeout_ms] = cursor.fetchall()[0]
        deadline = time.monotonic() + (timeout_ms / 1000 if wait else 0)
        found = _try_journal_mode(cursor, mode, deadline)
        cursor.close()
    finally:
        connection.close()
    if found.upper() != mode:
        logger.info("The journal mode is %s; %s was not possible", found, mode)


def _try_journal_mode(cursor: Any, mode: str, deadline: float) -> str:  # noqa: ANN401  (either driver's cursor)
    """Try until the deadline, as SQLite itself does not wait when it changes the journal; return the mode found."""
    while True:
        try:
            cursor.execute(f"PRAGMA journal_mode = {mode}")
        except _driver().OperationalError as error:
            if "locked" not in str(error) or time.monotonic() >= deadline:
                raise
            time.sleep(0.05)
        else:
            [found] = cursor.fetchall()[0]
            return str(found)


def _publish(growing: Path, path: Path) -> None:
    """Give a whole file its name; a file that appeared there meanwhile is not replaced."""
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
        # Some file systems have no hard links.
        growing.rename(path)


def _remove(growing: Path) -> None:
    """Remove a growing file and its journal."""
    for file in (growing, growing.with_name(f"{growing.name}-journal")):
        try:
            file.unlink(missing_ok=True)
        except OSError as error:
            logger.debug("%s stays: %s", file, error)


def _remove_leftovers(path: Path) -> None:
    """Remove the partial files of processes that have ended."""
    for growing in path.parent.glob(f".{_escaped(path.name)}.*.partial"):
        number = growing.name.removesuffix(".partial").rpartition(".")[2]
        if number.isdigit() and not _runs(int(number)):
            _remove(growing)


def _escaped(name: str) -> str:
    return "".join(f"[{c}]" if c in "*?[" else c for c in name)


def _runs(process: int) -> bool:
    """Tell whether a process of this number runs and is another one."""
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

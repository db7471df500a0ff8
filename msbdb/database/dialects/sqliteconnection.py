"""Connections to SQLite files with SpatiaLite: driver, extension, transactions and journal mode."""

import logging
import sqlite3
import time
from contextlib import suppress
from ctypes import CDLL
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

from sqlalchemy import Connection, Engine

from msbdb.errors import MissingDependencyError

logger = logging.getLogger(__name__)

EXTENSION = "mod_spatialite"


def driver() -> ModuleType:
    """Return Python's own SQLite where it can load extensions, and ``pysqlite3`` otherwise.

    Raises
    ------
    MissingDependencyError
        When there is neither.
    """
    if hasattr(sqlite3.Connection, "enable_load_extension"):
        return sqlite3
    try:
        import pysqlite3.dbapi2 as found
    except ImportError as error:
        msg = (
            "This Python's sqlite3 cannot load extensions, and pysqlite3 is missing. "
            "Install it (pip install pysqlite3-binary), or use a Python with loadable SQLite extensions."
        )
        raise MissingDependencyError(msg) from error
    return found  # type: ignore[no-any-return]  # the library has no type information


def prepare(connection: Any, _record: object, *, timeout_s: float) -> None:  # noqa: ANN401  (either driver's)
    """Prepare a new connection: own transactions, geometry functions, foreign keys, wait for locks."""
    _bind_others()
    _keep_loaded(EXTENSION)
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
    # SpatiaLite sets its own wait when it is loaded, so this comes after it.
    connection.execute(f"PRAGMA busy_timeout = {round(timeout_s * 1000)}")
    connection.execute("PRAGMA foreign_keys = ON")


@cache
def _bind_others() -> None:
    """Load the compiled modules of rasterio, pyogrio and pyproj, which contain their own GDAL and PROJ.

    SQLite makes all symbols of mod_spatialite global in the process, with those of the system's PROJ and GEOS. Modules
    loaded later would use these in place of their own, and crash. In a module that is already loaded, the symbols are
    bound. Loading the files takes a tenth of the time of importing the packages.
    """
    for package in ("rasterio", "pyogrio", "pyproj"):
        found = find_spec(package)
        for folder in (found.submodule_search_locations or ()) if found else ():
            for module in sorted(Path(folder).glob("*.so")):
                CDLL(str(module))


@cache
def _keep_loaded(extension: str) -> None:
    """Keep an extension in the process, where the loader finds it under SQLite's usual suffix.

    Otherwise its libraries would be unloaded with each last connection and loaded by the next, which takes several
    times as long as the rest of opening a file.
    """
    with suppress(OSError):
        CDLL(f"{extension}.so")


def begin(connection: Connection) -> None:
    """Begin a transaction explicitly: the driver does not begin one for a change of the schema."""
    connection.exec_driver_sql(f"BEGIN {connection.get_execution_options().get('sqlite_begin', 'DEFERRED')}")


def journal_mode(engine: Engine, mode: str, *, wait: bool = True) -> None:
    """Change the journal mode outside a transaction; some file systems do not support the write-ahead log."""
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
    """Try until the deadline, because SQLite does not wait for this change; return the mode."""
    while True:
        try:
            cursor.execute(f"PRAGMA journal_mode = {mode}")
        except driver().OperationalError as error:
            if "locked" not in str(error) or time.monotonic() >= deadline:
                raise
            time.sleep(0.05)
        else:
            [found] = cursor.fetchall()[0]
            return str(found)

"""The interface of a dialect, which ``spatialite`` and ``postgis`` implement; URLs, and errors of the drivers."""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from os import PathLike, fspath
from pathlib import Path
from typing import Any, Protocol

from numpy.typing import NDArray
from sqlalchemy import URL, Connection, Engine, make_url
from sqlalchemy.exc import ArgumentError, SQLAlchemyError

from msbdb.errors import DatabaseError, MsbdbError


class Dialect(Protocol):
    """The functions of a dialect."""

    def exists(self, url: URL, timeout_s: float) -> bool:
        """Return whether there is an msbdb database; refuse a file of another kind."""

    def require_writable(self, url: URL) -> None:
        """Refuse a place that cannot be written, as far as this is known without writing."""

    def create(self, url: URL, timeout_s: float, fill: Callable[[Connection], None]) -> bool:
        """Create a database completely or not at all; ``fill`` writes the schema and first rows inside the transaction.

        Return False when another process created one meanwhile, which is kept.
        """

    def make_engine(self, url: URL, timeout_s: float, *, keep_open: bool = False) -> Engine:
        """Return an engine whose connections support geometries, wait for locks, and enforce foreign keys.

        With ``keep_open`` a session with a server stays open for the next use, until the engine is disposed of.
        """

    def reading_engine(self, url: URL, timeout_s: float) -> Engine:
        """Return an engine of a database that exists, through which nothing can be written."""

    def geometry_ddl(self, table: str, kind: str, srid: int | str) -> list[str]:
        """Return the statements that add a table's geometry column and spatial index."""

    def view_ddl(self, view: str, key: str, base: str) -> list[str]:
        """Return the statements that register a view's geometry, after the view was created."""

    def function_ddl(self) -> list[str]:
        """Return the statements that create the database's own functions, after all tables and views."""

    def drop_geometry_ddl(self, table: str) -> list[str]:
        """Return the statements that unregister a geometry column, before a migration drops the table."""

    def drop_view_ddl(self, view: str) -> list[str]:
        """Return the statements that unregister a view's geometry."""

    def database_srid(self, connection: Connection) -> int:
        """Return the SRID of the database's geometry columns."""

    def writing(self, engine: Engine, resting: Connection | None = None) -> AbstractContextManager[Connection]:
        """Open a writer's transaction: readers are not disturbed, and a kill leaves the old state.

        A ``resting`` connection of the engine is used for it, or closed.
        """

    def in_bulk(self, connection: Connection, coming: Mapping[str, int]) -> AbstractContextManager[None]:
        """Prepare each table for this number of new rows, and restore indexes and keys afterwards."""

    def keys_in_sets(self, connection: Connection, tables: Sequence[str], run_id: int) -> AbstractContextManager[None]:
        """Check the keys of a run's rows in these tables for all rows at once, where this is quicker."""

    def insert_rows(
        self, connection: Connection, table: str, columns: Mapping[str, Sequence[Any] | NDArray[Any]], srid: int
    ) -> None:
        """Insert rows in bulk, given by column; None and NaN are null, ``geometry`` has plain WKB."""

    def settle(self, connection: Connection) -> None:
        """Check the deferred constraints so far, where this is quicker now than at the commit."""

    def after_load(self, connection: Connection) -> None:
        """Update statistics and extents."""

    def driver_errors(self) -> tuple[type[Exception], ...]:
        """Return the errors of the driver itself, where it is used without SQLAlchemy."""

    def explain(self, error: BaseException, where: str) -> MsbdbError:
        """Return the error of msbdb for an error of the library."""


def dialect_of(url: URL) -> Dialect:
    """Return the dialect of a URL.

    Raises
    ------
    DatabaseError
        For a kind of database that msbdb does not support.
    """
    backend = url.get_backend_name()
    # Only one dialect is imported: a file needs no driver of PostgreSQL.
    if backend == "sqlite":
        from msbdb.database.dialects import spatialite

        return spatialite
    if backend == "postgresql":
        from msbdb.database.dialects import postgis

        return postgis
    msg = (
        f"A database must be a SpatiaLite file or a PostGIS URL; got '{backend}'. "
        "Give a path such as city.sqlite, or postgresql://user@host/name."
    )
    raise DatabaseError(msg)


def database_url(target: str | PathLike[str] | URL) -> URL:
    """Return a path or a URL's text as a URL, with the drivers of msbdb.

    Raises
    ------
    DatabaseError
        When it is neither of them.
    """
    if isinstance(target, URL):
        url = target
    else:
        words = fspath(target)
        # The message does not show the text, which may contain a password.
        unreadable = "The database URL cannot be read. Give one such as postgresql://user@host:5432/name."
        if _LIBPQ.match(words):
            raise DatabaseError(unreadable)
        if "://" not in words:
            return URL.create("sqlite+pysqlite", database=str(Path(words).absolute()))
        try:
            url = make_url(words)
        except (ArgumentError, ValueError) as error:
            raise DatabaseError(unreadable) from error
        if "@" in (url.host or ""):
            msg = f"{unreadable} Write an @ in a password as %40."
            raise DatabaseError(msg)
    if url.drivername in ("postgresql", "postgres", "postgis"):
        url = url.set(drivername="postgresql+psycopg")
    if url.get_backend_name() == "sqlite" and not url.database:
        msg = "A SpatiaLite database needs a file. Give its path."
        raise DatabaseError(msg)
    return url


def shown(url: URL) -> str:
    """Return a URL for messages: a file's path, or a server's URL without the password."""
    if url.get_backend_name() == "sqlite":
        return str(url.database)
    secret = dict.fromkeys(set(url.query) - _HARMLESS, "***")
    url = url.set(query={**url.query, **secret})
    return url.render_as_string(hide_password=True)


_LIBPQ = re.compile(r"\s*((host|hostaddr|port|dbname|user|password|service)\s*=|postgres(ql)?:(?!//))")
"""Beginnings of PostgreSQL's own connection strings and of URLs with a missing slash: no names of files."""

_HARMLESS = {"host", "port", "dbname", "user", "connect_timeout", "sslmode", "application_name", "service"}
"""The words of a URL's query that may be shown; others may be passwords, also mistyped ones."""


@contextmanager
def guarded(url: URL) -> Iterator[None]:
    """Convert errors of SQLAlchemy and the driver to errors of msbdb."""
    dialect = dialect_of(url)
    errors: tuple[type[Exception], ...] = (SQLAlchemyError, *dialect.driver_errors())
    try:
        yield
    except errors as error:
        raise dialect.explain(error, shown(url)) from error

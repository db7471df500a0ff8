"""The interface of a dialect; the modules ``spatialite`` and ``postgis`` implement it."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any, Protocol

from numpy.typing import NDArray
from sqlalchemy import URL, Connection, Engine

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

    def make_engine(self, url: URL, timeout_s: float) -> Engine:
        """Return an engine whose connections support geometries, wait for locks, and enforce foreign keys."""

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

    def writing(self, engine: Engine) -> AbstractContextManager[Connection]:
        """Open a writer's transaction: readers are not disturbed, and a kill leaves the old state."""

    def in_bulk(self, connection: Connection, coming: Mapping[str, int]) -> AbstractContextManager[None]:
        """Prepare each table for this number of new rows, and restore indexes and keys afterwards."""

    def encode(self, geometries: NDArray[Any], srid: int) -> list[Any]:
        """Return geometries as ``insert_rows`` takes them."""

    def insert_rows(
        self, connection: Connection, table: str, columns: Sequence[str], rows: Sequence[tuple[Any, ...]], srid: int
    ) -> None:
        """Insert rows in bulk; a column ``geometry`` has the values of ``encode``."""

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

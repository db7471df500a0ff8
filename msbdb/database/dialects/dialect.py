"""What the database room asks of a dialect; ``spatialite`` and ``postgis`` answer with the same names."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any, Protocol

from numpy.typing import NDArray
from sqlalchemy import URL, Connection, Engine

from msbdb.errors import DatabaseError, MsbdbError


class Dialect(Protocol):
    """The hooks of a dialect."""

    def exists(self, url: URL, timeout_s: float) -> bool:
        """Tell whether there is an msbdb database; refuse what is there but foreign."""

    def require_writable(self, url: URL) -> None:
        """Refuse a place that could not be written, as far as can be told without writing."""

    def create(self, url: URL, timeout_s: float, fill: Callable[[Connection], None]) -> bool:
        """Create a database whole or not at all; ``fill`` writes the schema, and first rows, inside the transaction.

        False when another process created one meanwhile, which is kept.
        """

    def make_engine(self, url: URL, timeout_s: float) -> Engine:
        """Return an engine whose connections know geometries, wait for locks, and hold foreign keys."""

    def geometry_ddl(self, table: str, kind: str, srid: int | str) -> list[str]:
        """Return the statements that give a table its geometry column and spatial index."""

    def view_ddl(self, view: str, key: str, base: str) -> list[str]:
        """Return the statements that register a view's geometry, after the view's own creation."""

    def function_ddl(self) -> list[str]:
        """Return the statements that create the database's own functions, after all tables and views."""

    def drop_geometry_ddl(self, table: str) -> list[str]:
        """Return the statements by which a migration forgets a geometry column, before it drops the table."""

    def drop_view_ddl(self, view: str) -> list[str]:
        """Return the statements by which a migration forgets a view's geometry."""

    def database_srid(self, connection: Connection) -> int:
        """Return the SRID of the database's geometry columns."""

    def writing(self, engine: Engine) -> AbstractContextManager[Connection]:
        """Open the one transaction of a writer: readers are not disturbed, and a kill leaves the old state."""

    def in_bulk(self, connection: Connection, coming: Mapping[str, int]) -> AbstractContextManager[None]:
        """Prepare for so many rows to come into each table, in place of old ones or beside them, and tidy up after."""

    def encode(self, geometries: NDArray[Any], srid: int) -> list[Any]:
        """Return geometries as ``insert_rows`` takes them."""

    def insert_rows(
        self, connection: Connection, table: str, columns: Sequence[str], rows: Sequence[tuple[Any, ...]], srid: int
    ) -> None:
        """Insert rows in bulk; a column ``geometry`` holds what ``encode`` gave."""

    def settle(self, connection: Connection) -> None:
        """Check what was put off in the transaction so far, where it is quicker now than at the commit."""

    def after_load(self, connection: Connection) -> None:
        """Bring statistics and extents up to date."""

    def driver_errors(self) -> tuple[type[Exception], ...]:
        """Return the errors of the driver itself, where it is used without SQLAlchemy."""

    def explain(self, error: BaseException, where: str) -> MsbdbError:
        """Return our error for one of the library's."""


def dialect_of(url: URL) -> Dialect:
    """Return the hooks for a URL.

    Raises
    ------
    DatabaseError
        For a kind of database that msbdb does not know.
    """
    backend = url.get_backend_name()
    # Only the asked dialect is loaded: PostgreSQL's driver is of no use to a file.
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

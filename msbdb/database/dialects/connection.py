"""Opening and creating databases, their CRS and their place for other programs, and reading one committed state."""

import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from os import PathLike
from typing import TYPE_CHECKING

from sqlalchemy import URL, Connection, Engine, text

from msbdb.database.dialects import migration as upgrade
from msbdb.database.dialects.dialect import Dialect, database_url, dialect_of, guarded, shown
from msbdb.database.dialects.migration import require_version
from msbdb.database.dialects.rights import kept_rights
from msbdb.database.schema.srid import FIRST_OWN_SRID, srid_of
from msbdb.errors import CRSError, DatabaseError, ParameterError, SchemaVersionError

if TYPE_CHECKING:
    from pyproj import CRS

    from msbdb.io.crs import Fallback

logger = logging.getLogger(__name__)

TIMEOUT_S = 5.0
"""Seconds to wait for another writer or for a server."""

PATIENCE_S = 60.0
"""Seconds a writer waits for other writers after minutes of computing; each of them needs a few seconds."""


def open_database(
    target: str | PathLike[str] | URL,
    *,
    create: bool = False,
    srid: int | None = None,
    crs_wkt: str = "",
    timeout_s: float = TIMEOUT_S,
    keep_open: bool = False,
) -> Engine:
    """Open a database, and create it or upgrade its schema when asked.

    Parameters
    ----------
    target : str, path or URL
        Path of a SpatiaLite file, or a URL ``postgresql://user@host/name`` of a PostgreSQL database.
    create : bool
        Create a missing database, and upgrade an older schema to the newest version.
    srid : int, optional
        EPSG code of the database's one CRS: required for a new database, compared with an existing one. 0 means a CRS
        without code, given by ``crs_wkt``.
    crs_wkt : str
        The CRS as WKT, for ``srid=0``.
    timeout_s : float
        Seconds to wait for a lock or a server.
    keep_open : bool
        Keep one session with a server open for the next use, until the engine's ``dispose`` is called.

    Returns
    -------
    Engine
        A SQLAlchemy engine. Without ``keep_open`` no connection stays open after use.

    Raises
    ------
    DatabaseError
        When the database is missing and ``create`` is not set, or it cannot be reached, written or locked.
    SchemaVersionError
        When the file is no msbdb database, or its schema is newer, or older and ``create`` is not set.
    CRSError
        When the database's CRS is another one.
    MissingDependencyError
        When SpatiaLite or PostGIS is not installed.
    """
    url = database_url(target)
    dialect = dialect_of(url)
    own_srid = None if srid is None else srid_of(srid, crs_wkt)
    with guarded(url):
        if not dialect.exists(url, timeout_s):
            _create(url, dialect, create=create, srid=own_srid, crs_wkt=crs_wkt, timeout_s=timeout_s)
        engine = dialect.make_engine(url, timeout_s, keep_open=keep_open)
        try:
            _require_newest(engine, upgraded=create)
            if own_srid is not None:
                with engine.connect() as connection:
                    require_srid(connection, dialect, own_srid, shown(url))
        except BaseException:
            engine.dispose()
            raise
    return engine


def _require_newest(engine: Engine, *, upgraded: bool) -> None:
    """Refuse an older schema, or upgrade it where asked."""
    where = shown(engine.url)
    with engine.connect() as connection:
        is_newest = upgrade.require_version(connection, where)
    if is_newest:
        return
    if not upgraded:
        msg = (
            f"The database {where} has an older schema than this msbdb. "
            f"Upgrade it with 'msbdb db upgrade {where}'; nothing in it is lost."
        )
        raise SchemaVersionError(msg)
    upgrade_database(engine)


def check_target(target: str | PathLike[str] | URL, *, timeout_s: float = TIMEOUT_S) -> None:
    """Check before a long build that its database can be written; nothing is changed.

    Raises
    ------
    DatabaseError
        When the place does not exist, may not be written, or cannot be reached.
    SchemaVersionError
        When the file is no msbdb database or its schema is newer.
    """
    url = database_url(target)
    dialect = dialect_of(url)
    with guarded(url):
        dialect.require_writable(url)
        if dialect.exists(url, timeout_s):
            with dialect.make_engine(url, timeout_s).connect() as connection:
                upgrade.require_version(connection, shown(url))


def upgrade_database(engine: Engine) -> None:
    """Bring a database of an older schema to the newest version, in one transaction."""
    dialect = dialect_of(engine.url)
    with guarded(engine.url), dialect.writing(engine) as connection:
        before = upgrade.schema_version(connection)
        with kept_rights(connection):
            upgrade.migrate(connection, dialect, dialect.database_srid(connection))
        dialect.after_load(connection)
        logger.info("Schema of %s upgraded from %s to %s", shown(engine.url), before, upgrade.head_version())


def require_srid(connection: Connection, dialect: Dialect, srid: int, where: str) -> None:
    """Refuse a CRS other than the database's.

    Raises
    ------
    CRSError
        With both CRSs and the next step.
    """
    found = dialect.database_srid(connection)
    if found != srid:
        msg = (
            f"The database {where} is in {_in_words(found)}, and {_in_words(srid)} was given; a database has one CRS. "
            "Reproject the data to it, or choose another database."
        )
        raise CRSError(msg)


def _in_words(srid: int) -> str:
    """Return the CRS of an SRID in words."""
    return f"EPSG:{srid}" if srid < FIRST_OWN_SRID else f"a CRS without EPSG code ({srid})"


def _create(url: URL, dialect: Dialect, *, create: bool, srid: int | None, crs_wkt: str, timeout_s: float) -> None:
    """Create a database, or raise an error with the reason."""
    if not create:
        msg = f"There is no msbdb database at {shown(url)}. Build one there, or check the path."
        raise DatabaseError(msg)
    if srid is None:
        msg = f"A new database needs its CRS; {shown(url)} is new. Give the EPSG code of the data as srid."
        raise ParameterError(msg)
    dialect.create(url, timeout_s, lambda connection: upgrade.initialise(connection, dialect, srid, crs_wkt))
    logger.info("Created the database %s with the SRID %d", shown(url), srid)


@contextmanager
def snapshot(engine: Engine) -> Iterator[Connection]:
    """Open a transaction that reads one committed state, also while others commit.

    SQLite's transactions do so by default; for PostgreSQL the isolation level is set.
    """
    with guarded(engine.url), engine.connect() as connection:
        if connection.dialect.name == "postgresql":
            connection.execute(text("SET TRANSACTION ISOLATION LEVEL REPEATABLE READ READ ONLY"))
        yield connection


@contextmanager
def opened(db: str | PathLike[str] | URL) -> Iterator[Engine]:
    """Open an existing database, and close it at the end of the block."""
    engine = open_database(db, keep_open=True)
    try:
        yield engine
    finally:
        engine.dispose()


@contextmanager
def connected(target: str | PathLike[str] | URL) -> Iterator[Connection | None]:
    """Connect to a database of any schema; None where the database is missing."""
    url = database_url(target)
    dialect = dialect_of(url)
    with guarded(url):
        if not dialect.exists(url, TIMEOUT_S):
            yield None
            return
        with dialect.make_engine(url, TIMEOUT_S).connect() as connection:
            yield connection


@dataclass(frozen=True, slots=True)
class ClientPlace:
    """Where another program finds a database.

    Parameters
    ----------
    file : str
        The path of a file; empty for a server.
    server : mapping of str to str
        In PostgreSQL's words: dbname, host, port, user, sslmode and service, where they are known.
    schema : str
        The schema of the tables; empty for a file.
    """

    file: str
    server: Mapping[str, str]
    schema: str


def client_place(engine: Engine) -> ClientPlace:
    """Return where another program finds a database; never with the password."""
    url = engine.url
    if engine.dialect.name == "sqlite":
        return ClientPlace(str(url.database), {}, "")
    query = {name: str(value) for name, value in url.query.items() if name in ("host", "port", "sslmode", "service")}
    found = {
        "dbname": url.database, "host": url.host or query.get("host"), "port": url.port or query.get("port"),
        "user": url.username, "sslmode": query.get("sslmode"), "service": query.get("service"),
    }  # fmt: skip
    with guarded(url), engine.connect() as connection:
        schema = str(connection.scalar(text("SELECT current_schema()")))
    return ClientPlace("", {name: str(value) for name, value in found.items() if value}, schema)


def database_crs_of(engine: Engine) -> "CRS":
    """Return the database's CRS."""
    with guarded(engine.url), engine.connect() as connection:
        return database_crs(connection)


def read_fallback(target: str | PathLike[str] | URL) -> "Fallback | None":
    """Return the CRS of a database of any schema, for files that state none; None where there is no database."""
    from msbdb.io.crs import Fallback

    with connected(target) as connection:
        if connection is None:
            return None
        require_version(connection, shown(connection.engine.url))
        return Fallback(database_crs(connection), "the database")


def database_crs(connection: Connection) -> "CRS":
    """Return the database's registered CRS."""
    from pyproj import CRS

    return CRS.from_user_input(_words(connection))


def crs_words_of(engine: Engine) -> str:
    """Return the database's CRS as GDAL takes it, by its EPSG code or as WKT, without loading PROJ."""
    with guarded(engine.url), engine.connect() as connection:
        return _words(connection)


def _words(connection: Connection) -> str:
    srid = dialect_of(connection.engine.url).database_srid(connection)
    if srid < FIRST_OWN_SRID:
        return f"EPSG:{srid}"
    return str(connection.scalar(text("SELECT srtext FROM spatial_ref_sys WHERE srid = :srid"), {"srid": srid}))

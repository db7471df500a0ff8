"""Opening and creating databases, and reading one committed state by several queries."""

import logging
import re
from collections.abc import Iterator
from contextlib import contextmanager
from os import PathLike, fspath
from pathlib import Path

from sqlalchemy import URL, Connection, Engine, make_url, text
from sqlalchemy.exc import ArgumentError, SQLAlchemyError

from msbdb.database.dialects.dialect import Dialect, dialect_of
from msbdb.database.dialects.rights import kept_rights
from msbdb.database.schema import migration as upgrade
from msbdb.database.schema.srid import srid_of
from msbdb.errors import CRSError, DatabaseError, ParameterError, SchemaVersionError

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

    Returns
    -------
    Engine
        A SQLAlchemy engine without a pool: no connection stays open after use.

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
        engine = dialect.make_engine(url, timeout_s)
        with engine.connect() as connection:
            is_newest = upgrade.require_version(connection, shown(url))
        if not is_newest:
            if not create:
                msg = (
                    f"The database {shown(url)} has an older schema than this msbdb. "
                    "Upgrade it with 'msbdb db upgrade'; nothing in it is lost."
                )
                raise SchemaVersionError(msg)
            upgrade_database(engine)
        if own_srid is not None:
            with engine.connect() as connection:
                require_srid(connection, dialect, own_srid, shown(url))
    return engine


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
            f"The database {where} is in the CRS {found}, the survey in {srid}; a database has one CRS. "
            f"Reproject the data to EPSG:{found}, or build into another database."
        )
        raise CRSError(msg)


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
    engine = open_database(db)
    try:
        yield engine
    finally:
        engine.dispose()

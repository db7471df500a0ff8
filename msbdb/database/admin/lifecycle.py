"""Creating, upgrading and downgrading databases by commands."""

import logging
from dataclasses import dataclass
from os import PathLike
from typing import Any

from sqlalchemy import URL, Connection, Engine, column, func, inspect, select
from sqlalchemy import table as sql_table

from msbdb.database.dialects import migration as upgrade
from msbdb.database.dialects.connection import TIMEOUT_S, open_database, upgrade_database
from msbdb.database.dialects.dialect import database_url, dialect_of, guarded, shown
from msbdb.database.dialects.rights import kept_rights
from msbdb.database.runs.digests import COLUMN
from msbdb.database.schema.sqltables import METADATA
from msbdb.database.schema.srid import horizontal
from msbdb.errors import CRSError, DatabaseError, SchemaVersionError

logger = logging.getLogger(__name__)

Target = str | PathLike[str] | URL


@dataclass(frozen=True, slots=True)
class Loss:
    """A loss by a downgrade: the number of rows of a table, or of values of a column in rows that are kept."""

    table: str
    column: str
    count: int

    def __str__(self) -> str:
        """Return it in words."""
        if self.column:
            return f"{self.count} values of {self.table}.{self.column}"
        return f"{self.count} rows of {self.table}"


def create_database(target: Target, crs: str, *, timeout_s: float = TIMEOUT_S) -> bool:
    """Create an empty database; an existing one is not changed.

    Parameters
    ----------
    target : str, path or URL
        Its place.
    crs : str
        Its one CRS: an EPSG code such as 'EPSG:28992', or any text that PROJ reads.

    Returns
    -------
    bool
        Whether it was created.

    Raises
    ------
    CRSError
        When PROJ does not know the CRS, it is not projected in metres, or the database exists in another one.
    SchemaVersionError
        When the database exists with an older schema.
    DatabaseError
        When it cannot be created.
    """
    epsg, wkt = _parsed(crs)
    url = database_url(target)
    with guarded(url):
        is_there = dialect_of(url).exists(url, timeout_s)
    engine = open_database(url, create=not is_there, srid=epsg, crs_wkt=wkt, timeout_s=timeout_s)
    engine.dispose()
    return not is_there


def open_any(target: Target, *, timeout_s: float = TIMEOUT_S) -> Engine:
    """Open a database of this or an older schema, without changes.

    Raises
    ------
    DatabaseError, SchemaVersionError
        When it does not exist, or its schema is newer.
    """
    url = database_url(target)
    dialect = dialect_of(url)
    with guarded(url):
        if not dialect.exists(url, timeout_s):
            msg = f"There is no msbdb database at {shown(url)}. Make one with 'msbdb db create', or check the path."
            raise DatabaseError(msg)
        engine = dialect.make_engine(url, timeout_s)
        with engine.connect() as connection:
            upgrade.require_version(connection, shown(url))
    return engine


def version_of(engine: Engine) -> str:
    """Return the version of a database's schema."""
    with guarded(engine.url), engine.connect() as connection:
        return upgrade.schema_version(connection)


def upgrade_schema(target: Target, *, timeout_s: float = TIMEOUT_S) -> tuple[str, str]:
    """Bring a database to the newest schema in one transaction, and return the versions before and after."""
    engine = open_any(target, timeout_s=timeout_s)
    before = version_of(engine)
    if before != upgrade.head_version():
        upgrade_database(engine)
    return before, version_of(engine)


def downgrade_schema(
    target: Target, to: str | None = None, *, force: bool = False, timeout_s: float = TIMEOUT_S
) -> tuple[str, str, list[Loss]]:
    """Bring a database to an older schema in one transaction.

    Parameters
    ----------
    target : str, path or URL
        The database.
    to : str, optional
        The version; by default the one before the database's own.
    force : bool
        Downgrade even if rows or values are lost.

    Returns
    -------
    str, str, list of Loss
        The versions before and after, and what was lost.

    Raises
    ------
    SchemaVersionError
        When there is no such older schema, or something would be lost and ``force`` is not set; the message lists it.
        Nothing was changed.

    Notes
    -----
    The loss is measured: rows and values are counted before and after, inside the transaction.
    """
    engine = open_any(target, timeout_s=timeout_s)
    dialect = dialect_of(engine.url)
    with guarded(engine.url), dialect.writing(engine) as connection:
        before = upgrade.schema_version(connection)
        older = _older(before, to, shown(engine.url))
        held = _counts(connection)
        with kept_rights(connection):
            upgrade.migrate_down(connection, dialect, older)
        lost = _losses(held, _counts(connection))
        if lost and not force:
            msg = (
                f"The schema {older} has no place for {', '.join(map(str, lost))} of {shown(engine.url)}. Nothing was "
                "changed; make a copy with 'msbdb db copy', then use --force to lose them."
            )
            raise SchemaVersionError(msg)
    logger.info("Schema of %s downgraded from %s to %s", shown(engine.url), before, older)
    return before, older, lost


def _parsed(crs: str) -> tuple[int, str]:
    """Return the EPSG code of a CRS, 0 where it has none, and its WKT."""
    from pyproj import CRS
    from pyproj.exceptions import CRSError as ProjError

    try:
        found = horizontal(CRS.from_user_input(crs))
    except ProjError as error:
        msg = f"The CRS '{crs}' is not known to PROJ. Give an EPSG code such as EPSG:28992."
        raise CRSError(msg) from error
    return found.to_epsg() or 0, found.to_wkt()


def _older(found: str, to: str | None, where: str) -> str:
    """Return the version to go down to."""
    older = upgrade.older_versions(found)
    if to is None and older:
        return older[0]
    if to is None or to not in older:
        known = ", ".join(sorted(older)) or "none"
        msg = (
            f"The database {where} has the schema {found}; it can be brought down to: {known}. "
            f"Got {to or 'no version'}; give one of these with --to."
        )
        raise SchemaVersionError(msg)
    return to


def _counts(connection: Connection) -> dict[str, dict[str, int]]:
    """Return by table the number of rows (under '') and of values of each column."""
    inspector = inspect(connection)
    names = sorted(set(inspector.get_table_names()) & set(METADATA.tables))
    counted: dict[str, dict[str, int]] = {}
    for name in names:
        columns = [str(found["name"]) for found in inspector.get_columns(name)]
        query = select(func.count(), *(func.count(column(own)) for own in columns)).select_from(sql_table(name))
        row: Any = connection.execute(query).one()
        counted[name] = dict(zip(["", *columns], row, strict=True))
    return counted


def _losses(before: dict[str, dict[str, int]], after: dict[str, dict[str, int]]) -> list[Loss]:
    """Return the lost rows, and the lost values (except digests) of rows that are kept."""
    lost = []
    for name, held in before.items():
        left = after.get(name, {})
        rows = held[""] - left.get("", 0)
        if rows:
            lost.append(Loss(name, "", rows))
        if left:
            gone = [(own, count) for own, count in held.items() if own not in {"", COLUMN, *left} and count]
            lost += [Loss(name, own, count) for own, count in gone]
    return lost

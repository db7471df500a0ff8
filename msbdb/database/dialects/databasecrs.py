"""The CRS of a database, which its files and frames are in."""

from os import PathLike
from typing import TYPE_CHECKING

from sqlalchemy import (
    URL,
    Connection,
    Engine,
    text,
)

from msbdb.database.dialects.connection import connected
from msbdb.database.dialects.dialect import dialect_of, guarded, shown
from msbdb.database.schema.migration import require_version
from msbdb.database.schema.srid import FIRST_OWN_SRID

if TYPE_CHECKING:
    from pyproj import CRS

    from msbdb.io.crs import Fallback


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

"""What is installed: msbdb, its libraries, the databases, and what to do about what is missing."""

import platform
import shutil
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import PackageNotFoundError, version

from sqlalchemy import Connection, text

from msbdb.database.dialects.dialect import database_url, dialect_of, guarded, shown
from msbdb.database.dialects.migration import head_version, schema_version
from msbdb.database.dialects.sqliteconnection import driver, prepare
from msbdb.errors import MsbdbError
from msbdb.version import __version__

LIBRARIES = ("numpy", "scipy", "numba", "scikit-image", "scikit-learn", "pandas", "geopandas", "sqlalchemy")
PROGRAMS = {
    "ogr2ogr": "Not needed by msbdb; it reads what msbdb writes ('apt-get install gdal-bin').",
    "psql": "Not needed by msbdb; the client of PostGIS ('apt-get install postgresql-client').",
    "qgis": "Not needed by msbdb; it opens its databases ('apt-get install qgis').",
}

BLOCKING_SQLITE = ("3.51.0", "3.51.1")
"""Versions in which two threads that open and close one file may block each other for ever; 3.51.2 mended it."""

WAIT_S = 5.0
"""How long to wait for a database, seconds."""


@dataclass(frozen=True, slots=True)
class Component:
    """A piece of software that msbdb uses, or a database.

    Parameters
    ----------
    name : str
    version : str
        Empty where it is missing.
    state : str
        'ok'; 'missing', where msbdb needs it; 'faulty', where it may fail; 'optional', where it is missing and not
        needed; 'old' or 'newer' of the schema of a database.
    advice : str
        What to do; empty where it is there.
    """

    name: str
    version: str
    state: str
    advice: str = ""


def installation(db: str | None = None) -> list[Component]:
    """Return what is installed, and what is missing with the command that installs it.

    Parameters
    ----------
    db : str, optional
        A database, whose server and schema are looked at too: the path of a SpatiaLite file or the URL of a PostGIS.

    Returns
    -------
    list of Component
        Nothing is changed, and no missing component raises.
    """
    return list(_components(db))


def _components(db: str | None) -> Iterator[Component]:
    """Look at one component after the other."""
    yield Component("msbdb", __version__, "ok")
    yield Component("Python", platform.python_version(), "ok")
    for name in LIBRARIES:
        yield _checked(name, partial(version, name), f"Install it: pip install {name}")
    again = "Install msbdb again, in an empty environment: pip install --force-reinstall msbdb"
    yield _checked("GDAL of rasterio", _gdal_of_rasterio, again)
    yield _checked("GDAL of pyogrio", _gdal_of_pyogrio, again)
    yield _checked("PROJ", _proj, again)
    yield _checked("GEOS", _geos, again)
    yield _checked("LAZ (lazrs)", partial(version, "lazrs"), "Install it: pip install 'laspy[lazrs]'")
    sqlite = _checked("SQLite", lambda: str(driver().sqlite_version), "Use a Python whose sqlite3 can load extensions.")
    yield _usable(sqlite)
    yield _checked("SpatiaLite", _spatialite, "Install it: apt-get install libsqlite3-mod-spatialite")
    yield _checked("PostGIS driver (psycopg)", partial(version, "psycopg"), "Install it: pip install 'psycopg[binary]'")
    for name, advice in PROGRAMS.items():
        path = shutil.which(name)
        yield Component(name, path or "", "ok" if path else "optional", "" if path else advice)
    if db is not None:
        yield from _database(db)


def _checked(name: str, look: Callable[[], str], advice: str) -> Component:
    """Return a component with its version, or with the advice and the reason where it cannot be used."""
    try:
        return Component(name, look(), "ok")
    except PackageNotFoundError:
        return Component(name, "", "missing", advice)
    except MsbdbError as error:
        return Component(name, "", "missing", str(error))
    except (ImportError, OSError) as error:
        return Component(name, "", "missing", f"{advice} ({error})")


def _usable(sqlite: Component) -> Component:
    """Return SQLite as it is, or as faulty with what to do."""
    if sqlite.version not in BLOCKING_SQLITE:
        return sqlite
    advice = (
        "In this version threads that use one file may block each other for ever. "
        "Install another one: pip install 'pysqlite3-binary!=0.5.4.post2', or a Python with SQLite 3.51.2 or newer."
    )
    return replace(sqlite, state="faulty", advice=advice)


def _gdal_of_rasterio() -> str:
    """Return the version of GDAL in rasterio."""
    import rasterio

    return str(rasterio.__gdal_version__)


def _gdal_of_pyogrio() -> str:
    """Return the version of GDAL in pyogrio, which has its own."""
    import pyogrio

    return str(pyogrio.__gdal_version_string__)


def _proj() -> str:
    """Return the version of PROJ; reading a CRS proves that its data are there."""
    import pyproj

    pyproj.CRS.from_epsg(28992)
    return str(pyproj.proj_version_str)


def _geos() -> str:
    """Return the version of GEOS in Shapely."""
    import shapely

    return str(shapely.geos_version_string)


def _spatialite() -> str:
    """Return the version of SpatiaLite, loaded as for a database."""
    with closing(driver().connect(":memory:")) as connection:
        prepare(connection, None, timeout_s=1.0)
        return str(connection.execute("SELECT spatialite_version()").fetchone()[0])


def _database(db: str) -> Iterator[Component]:
    """Look at a database: its server, its geometry functions and its schema."""
    try:
        url = database_url(db)
        with guarded(url):
            if url.get_backend_name() == "sqlite" and not dialect_of(url).exists(url, WAIT_S):
                yield Component("database", "", "missing", f"There is no {shown(url)}. 'msbdb build' creates it.")
                return
            engine = dialect_of(url).make_engine(url, WAIT_S)
            with engine.connect() as connection:
                yield from _served(connection, shown(url))
    except MsbdbError as error:
        yield Component("database", "", "missing", str(error))


def _served(connection: Connection, name: str) -> Iterator[Component]:
    """Return the versions that a database reports."""
    if connection.dialect.name == "postgresql":
        yield Component("PostgreSQL", str(connection.scalar(text("SHOW server_version"))), "ok")
        query = "SELECT installed_version, default_version FROM pg_available_extensions WHERE name = 'postgis'"
        used, there = connection.execute(text(query)).one_or_none() or (None, None)
        if used:
            yield Component("PostGIS", used, "ok")
        else:
            advice = "CREATE EXTENSION postgis" if there else "On the server: apt-get install postgresql-postgis"
            yield Component("PostGIS", "", "missing", advice)
    schema, newest = schema_version(connection), head_version()
    if not schema:
        yield Component("schema", "", "missing", f"Create it: msbdb db create {name} --crs EPSG:...")
    elif schema < newest:
        yield Component("schema", schema, "old", f"Upgrade it to {newest}, without loss: msbdb db upgrade {name}")
    elif schema > newest:
        yield Component("schema", schema, "newer", "Use a newer msbdb: pip install --upgrade msbdb")
    else:
        yield Component("schema", schema, "ok")

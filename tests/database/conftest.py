"""The databases under test: SpatiaLite always, PostGIS where MSBDB_TEST_POSTGIS names a server."""

import os
import shutil
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import psycopg
import pytest
from simulated.builds import EPSG, small_build
from sqlalchemy import URL, Engine, make_url

from msbdb.database import open_database, write_build


class Databases:
    """Databases on the server, copied from a template, as making the extension and the tables takes the server longer.

    A template has the extension alone, or msbdb's tables in a coordinate reference system.
    """

    def __init__(self, url: URL) -> None:
        self.url = url
        self.prefix = f"msbdb_test_{os.getpid()}"
        self.templates: dict[int | None, str] = {}
        self.names: set[str] = set()
        self.made = 0

    def acquire(self, srid: int | None = None) -> str:
        """Return the URL of a database with PostGIS, empty or with msbdb's tables in an SRID."""
        return self._url(self._create(self._template(srid)))

    def release(self, urls: list[str]) -> None:
        """Take databases back."""
        for url in urls:
            self._drop(str(make_url(url).database))

    def drop(self) -> None:
        """Leave nothing behind on the server."""
        for name in [*self.names]:
            self._drop(name)

    def _url(self, name: str) -> str:
        return self.url.set(database=name).render_as_string(hide_password=False)

    def _create(self, template: str | None = None) -> str:
        name = f"{self.prefix}_{self.made}"
        self.made += 1
        copied = f"TEMPLATE {template} STRATEGY wal_log" if template else ""
        run_on(self.url, f"CREATE DATABASE {name} {copied}")
        self.names.add(name)
        return name

    def _template(self, srid: int | None) -> str:
        if srid not in self.templates:
            name = self._create()
            run_on(self.url.set(database=name), "CREATE EXTENSION postgis")
            if srid is not None:
                open_database(self._url(name), create=True, srid=srid)
            self.templates[srid] = name
        return self.templates[srid]

    def _drop(self, name: str) -> None:
        run_on(self.url, f"DROP DATABASE {name} WITH (FORCE)")
        self.names.discard(name)


def run_on(url: URL, statements: str) -> None:
    """Run statements outside a transaction of ours."""
    conninfo = url.set(drivername="postgresql").render_as_string(hide_password=False)
    with psycopg.connect(conninfo, autocommit=True) as connection:
        connection.execute("SET client_min_messages = warning")
        connection.execute(statements.encode())


@pytest.fixture(scope="session")
def databases() -> Iterator[Databases]:
    """Return the server's databases."""
    words = os.environ.get("MSBDB_TEST_POSTGIS")
    if not words:
        pytest.skip("MSBDB_TEST_POSTGIS names no PostGIS server")
    made = Databases(make_url(words))
    yield made
    made.drop()


@pytest.fixture
def new_postgis(databases: Databases) -> Iterator[Callable[[], str]]:
    """Return a maker of URLs of empty databases with PostGIS."""
    urls: list[str] = []

    def make() -> str:
        urls.append(databases.acquire())
        return urls[-1]

    yield make
    databases.release(urls)


BOTH = ["spatialite", pytest.param("postgis", marks=pytest.mark.postgis)]


@pytest.fixture(params=BOTH)
def target(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """Return a path or URL where a database can be created, on each dialect."""
    if request.param == "spatialite":
        return str(tmp_path / "city.sqlite")
    return request.getfixturevalue("new_postgis")()


@pytest.fixture(scope="session")
def empty_file(tmp_path_factory: pytest.TempPathFactory) -> Callable[[int], Path]:
    """Return a maker of SpatiaLite files with msbdb's tables in an SRID, to be copied; each is made once."""
    folder = tmp_path_factory.mktemp("empty")

    @cache
    def make(srid: int) -> Path:
        open_database(folder / f"{srid}.sqlite", create=True, srid=srid)
        return folder / f"{srid}.sqlite"

    return make


@pytest.fixture(scope="module")
def srid() -> int:
    """Return the SRID of ``engine``; modules whose surveys lie elsewhere have a fixture of their own."""
    return EPSG


@pytest.fixture(params=BOTH)
def engine(request: pytest.FixtureRequest, srid: int, tmp_path: Path) -> Iterator[Engine]:
    """Return a new, empty database."""
    if request.param == "spatialite":
        yield open_database(shutil.copy(request.getfixturevalue("empty_file")(srid), tmp_path / "city.sqlite"))
        return
    databases = request.getfixturevalue("databases")
    place = databases.acquire(srid)
    yield open_database(place)
    databases.release([place])


@pytest.fixture(scope="module", params=BOTH)
def loaded(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Engine]:
    """Return a database that holds the small build, for tests that only read."""
    if request.param == "spatialite":
        place = str(tmp_path_factory.mktemp("loaded") / "city.sqlite")
    else:
        place = request.getfixturevalue("databases").acquire()
    engine = open_database(place, create=True, srid=EPSG)
    write_build(engine, small_build())
    yield engine
    if request.param == "postgis":
        request.getfixturevalue("databases").release([place])

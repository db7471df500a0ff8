"""The databases under test: SpatiaLite always, PostGIS where MSBDB_TEST_POSTGIS names a server."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import psycopg
import pytest
from simulated.builds import EPSG, small_build
from sqlalchemy import URL, Engine, make_url

from msbdb.database import open_database, write_build

EMPTY = """
SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = current_database() AND pid <> pg_backend_pid();
DROP EXTENSION IF EXISTS postgis CASCADE;
DROP SCHEMA public CASCADE;
CREATE SCHEMA public;
CREATE EXTENSION postgis;
"""


class Databases:
    """Empty databases on the server, used again and again, as dropping one takes the server a while."""

    def __init__(self, url: URL) -> None:
        self.url = url
        self.names: list[str] = []
        self.free: list[str] = []

    def acquire(self) -> str:
        """Return the URL of an empty database with PostGIS."""
        if not self.free:
            self.names.append(f"msbdb_test_{os.getpid()}_{len(self.names)}")
            run_on(self.url, f"CREATE DATABASE {self.names[-1]}")
            self.free.append(self.names[-1])
        url = self.url.set(database=self.free.pop())
        run_on(url, EMPTY)
        return url.render_as_string(hide_password=False)

    def release(self, urls: list[str]) -> None:
        """Take databases back."""
        self.free += [str(make_url(url).database) for url in urls]

    def drop(self) -> None:
        """Leave nothing behind on the server."""
        for name in self.names:
            run_on(self.url, f"DROP DATABASE {name} WITH (FORCE)")


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


@pytest.fixture
def engine(target: str) -> Engine:
    """Return a new, empty database."""
    return open_database(target, create=True, srid=EPSG)


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

"""The databases under test: SpatiaLite always, PostGIS where MSBDB_TEST_POSTGIS names a server."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import psycopg
import pytest
from builds import EPSG
from sqlalchemy import URL, Engine, make_url

from msbdb.database import open_database


def admin(url: URL, *statements: str) -> None:
    """Run statements outside a transaction."""
    conninfo = url.set(drivername="postgresql").render_as_string(hide_password=False)
    with psycopg.connect(conninfo, autocommit=True) as connection:
        for statement in statements:
            connection.execute(statement)


@pytest.fixture(scope="session")
def postgis_server() -> Iterator[tuple[URL, str]]:
    """Return the server's URL and the name of an empty database with PostGIS, from which others are copied."""
    words = os.environ.get("MSBDB_TEST_POSTGIS")
    if not words:
        pytest.skip("MSBDB_TEST_POSTGIS names no PostGIS server")
    url, template = make_url(words), f"msbdb_template_{os.getpid()}"
    admin(url, f"CREATE DATABASE {template}")
    admin(url.set(database=template), "CREATE EXTENSION postgis")
    yield url, template
    admin(url, f"DROP DATABASE {template} WITH (FORCE)")


@pytest.fixture
def new_postgis(postgis_server: tuple[URL, str]) -> Iterator[Callable[[], str]]:
    """Return a maker of URLs of fresh empty databases, which are dropped in the end."""
    url, template = postgis_server
    made: list[str] = []

    def make() -> str:
        made.append(f"msbdb_test_{os.getpid()}_{len(made)}")
        admin(url, f"CREATE DATABASE {made[-1]} TEMPLATE {template}")
        return url.set(database=made[-1]).render_as_string(hide_password=False)

    yield make
    admin(url, *(f"DROP DATABASE {name} WITH (FORCE)" for name in made))


@pytest.fixture(params=["spatialite", pytest.param("postgis", marks=pytest.mark.postgis)])
def target(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """Return a path or URL where a database can be created, on each dialect."""
    if request.param == "spatialite":
        return str(tmp_path / "city.sqlite")
    return request.getfixturevalue("new_postgis")()


@pytest.fixture
def engine(target: str) -> Engine:
    """Return a new, empty database."""
    return open_database(target, create=True, srid=EPSG)

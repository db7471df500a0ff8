"""``msbdb doctor``: a whole installation, one without SpatiaLite, and databases of all states."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from simulated.builds import EPSG

from msbdb.cli.main import cli
from msbdb.database import open_database
from msbdb.database.admin import installation as installed
from msbdb.database.dialects import migration, sqliteconnection


def found(*args: object, code: int = 0) -> dict[str, dict[str, Any]]:
    """Return what the command finds, by component."""
    result = CliRunner().invoke(cli, ["doctor", "--json", *map(str, args)])
    assert result.exit_code == code, result.output
    answer = json.loads(result.stdout)
    assert answer["complete"] == (code == 0)
    return {component["name"]: component for component in answer["components"]}


@pytest.fixture
def town(tmp_path: Path) -> Path:
    """Return an empty database."""
    path = tmp_path / "town.sqlite"
    open_database(path, create=True, srid=EPSG).dispose()
    return path


def test_a_whole_installation_has_a_version_of_each_component(town: Path) -> None:
    """Only programs beside msbdb may be missing."""
    components = found("--db", town)
    needed = [component for component in components.values() if component["state"] != "optional"]
    assert all(component["state"] == "ok" and component["version"] for component in needed)
    assert components["schema"]["version"] == migration.head_version()
    assert {"SQLite", "SpatiaLite", "GDAL of rasterio", "PROJ", "GEOS"} <= set(components)


def test_without_spatialite_the_command_to_install_it_is_given(monkeypatch: pytest.MonkeyPatch) -> None:
    """The exit code is 1, and the rest is looked at all the same."""
    monkeypatch.setattr(sqliteconnection, "EXTENSION", "mod_absent")
    components = found(code=1)
    assert components["SpatiaLite"]["state"] == "missing"
    assert "apt-get install libsqlite3-mod-spatialite" in components["SpatiaLite"]["advice"]
    assert components["SQLite"]["state"] == "ok"
    printed = CliRunner().invoke(cli, ["doctor"])
    assert printed.exit_code == 1
    assert "apt-get install libsqlite3-mod-spatialite" in printed.stdout
    assert printed.stdout.endswith("Something is missing or faulty, see above.\n")


def test_a_version_of_sqlite_that_blocks_is_faulty(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the command that installs another one."""
    used = found()["SQLite"]["version"]
    monkeypatch.setattr(installed, "BLOCKING_SQLITE", (used,))
    component = found(code=1)["SQLite"]
    assert (component["state"], component["version"]) == ("faulty", used)
    assert "pip install" in component["advice"]


def test_an_older_schema_is_to_be_upgraded(town: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And a newer one needs a newer msbdb."""
    known = migration.known_versions()
    monkeypatch.setattr(migration, "known_versions", lambda: [*known, "9999"])
    component = found("--db", town, code=1)["schema"]
    assert (component["state"], component["version"]) == ("old", known[-1])
    assert component["advice"].endswith(f"msbdb db upgrade {town}")
    monkeypatch.setattr(migration, "known_versions", lambda: known[:-1])
    assert found("--db", town, code=1)["schema"]["state"] == "newer"


def test_what_is_no_database_is_a_finding(tmp_path: Path) -> None:
    """A file that is absent, and one of another kind; neither is made or changed."""
    other = tmp_path / "notes.txt"
    other.write_text("not a database")
    assert "msbdb build" in found("--db", tmp_path / "absent.sqlite", code=1)["database"]["advice"]
    assert "no msbdb database" in found("--db", other, code=1)["database"]["advice"]
    assert other.read_text() == "not a database"
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


@pytest.mark.postgis
def test_a_server_without_the_schema_is_told_from_one_with_it(new_postgis: Callable[[], str]) -> None:
    """PostgreSQL and PostGIS have their versions in both."""
    url = new_postgis()
    before = found("--db", url, code=1)
    assert before["PostGIS"]["version"].startswith("3.")
    assert "msbdb db create" in before["schema"]["advice"]
    open_database(url, create=True, srid=EPSG).dispose()
    assert found("--db", url)["schema"]["state"] == "ok"

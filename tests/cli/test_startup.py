"""The commands start quickly: each loads only the libraries and rooms that its work needs."""

import os
import subprocess
import sys
from pathlib import Path

import pyogrio
import pytest
from simulated.builds import EPSG, small_build
from support.processes import environment
from support.sizes import sample

from msbdb.cli.main import cli
from msbdb.database import open_database, write_build

LIBRARIES = {
    "alembic", "geoalchemy2", "geopandas", "laspy", "matplotlib", "numba", "numpy", "pandas", "pyogrio", "pyproj",
    "rasterio", "rich", "scipy", "shapely", "skimage", "sklearn", "sqlalchemy",
}  # fmt: skip
"""Libraries that take time to load."""

DETECTION = {"laspy", "numba", "sklearn", "msbdb.detect", "msbdb.ground", "msbdb.parts", "msbdb.spectral"}
"""What only detection needs."""

FRAMES = {"affine", "geopandas", "pandas", "pyogrio", "pyproj", "rasterio", "scipy", "tomllib"}
"""What frames, files and places on the ground need, and the database's own rows do not."""

ELSEWHERE = {"alembic", "geoalchemy2", "matplotlib", "psycopg", "sqlalchemy.dialects.postgresql", "msbdb.view"}
"""What migrations, servers and maps need, and a file of a database does not."""

CALL = """
import sys
from msbdb.cli.main import cli
cli(sys.argv[1:], prog_name="msbdb", standalone_mode=False)
print(*sorted(sys.modules), file=sys.stderr)
"""

CPU_S = 1.0
"""Most processor time of a help page, several times what it takes, so that a busy machine passes."""


def loaded_by(*words: str) -> set[str]:
    """Return the modules that are loaded after a command line."""
    command = [sys.executable, "-c", CALL, *words]
    done = subprocess.run(command, env=environment(), capture_output=True, text=True, check=True)
    return set(done.stderr.splitlines()[-1].split())


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return a database of one survey."""
    path = tmp_path_factory.mktemp("startup") / "town.sqlite"
    write_build(open_database(path, create=True, srid=EPSG), small_build())
    return str(path)


@pytest.mark.parametrize("name", [None, *cli.commands])
def test_a_help_page_loads_no_library_that_takes_time(name: str | None) -> None:
    """Neither the overview nor the page of a command."""
    assert not LIBRARIES & loaded_by(*([name] if name else []), "--help")


def test_help_takes_little_processor_time() -> None:
    """A page of help is there at once."""
    before = os.times()
    loaded_by("--help")
    after = os.times()
    spent = after.children_user + after.children_system - before.children_user - before.children_system
    assert spent < CPU_S


def test_info_loads_no_frames_maps_or_detectors(town: str) -> None:
    """A summary reads the database alone."""
    assert not (DETECTION | FRAMES | ELSEWHERE | {"msbdb.io", "msbdb.labels"}) & loaded_by("info", town)


def test_a_check_loads_no_frames_maps_or_detectors(town: str) -> None:
    """A check reads the database alone, and draws a bar of its progress on terminals only."""
    more = {"msbdb.io", "msbdb.labels", "rich"}
    assert not (DETECTION | FRAMES | ELSEWHERE | more) & loaded_by("db", "check", town)


def test_a_view_loads_no_detectors(town: str, tmp_path: Path) -> None:
    """A map needs matplotlib, and nothing of the build."""
    loaded = loaded_by("view", town, "--out", str(tmp_path / "town.png"))
    assert "matplotlib" in loaded
    assert not DETECTION & loaded


@pytest.mark.parametrize("ending", sample(["gpkg", "geojson", "shp"], 3))
def test_an_export_loads_no_frames_maps_or_detectors(town: str, tmp_path: Path, ending: str) -> None:
    """Columns go from the database into a file as they are."""
    path = tmp_path / f"town.{ending}"
    loaded = loaded_by("export", town, str(path))
    assert ("footprint" if ending == "gpkg" else "town") in pyogrio.list_layers(path)[:, 0]
    assert not (DETECTION | (FRAMES - {"pyogrio"}) | ELSEWHERE | {"msbdb.labels", "rich"}) & loaded


def test_the_command_runs_as_a_module() -> None:
    """An interpreter whose scripts are not on the path runs the same command, and names it as ever."""
    done = subprocess.run(
        [sys.executable, "-m", "msbdb", "--version"], env=environment(), capture_output=True, text=True, check=True
    )
    assert done.stdout.startswith("msbdb, version ")

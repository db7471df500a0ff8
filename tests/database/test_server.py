"""The script that starts a PostGIS server for the tests leaves nothing behind."""

import os
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from simulated.builds import EPSG

from msbdb.database import open_database

SCRIPT = Path(__file__).resolve().parents[2] / "scripts" / "postgis_server"

pytestmark = [
    pytest.mark.postgis,
    pytest.mark.skipif(
        not list(Path("/usr/lib/postgresql").glob("*/lib/postgis-3.so")), reason="PostGIS is not installed"
    ),
]


def call(*words: str) -> "subprocess.CompletedProcess[str]":
    """Run the script, which waits a minute for the server at most."""
    return subprocess.run([str(SCRIPT), *words], capture_output=True, text=True, check=False, timeout=180)


@pytest.fixture
def folder() -> Iterator[Path]:
    """Return a folder that the server's user can enter, as pytest's own may be closed to it."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as name:
        place = Path(name)
        place.chmod(0o755)
        yield place / "pg"


def test_a_server_starts_serves_and_vanishes(folder: Path) -> None:
    """The URL works, a second start is refused, and after the stop there is no folder."""
    started = call("start", str(folder))
    try:
        assert started.returncode == 0, started.stderr
        open_database(started.stdout.strip(), create=True, srid=EPSG)
        again = call("start", str(folder))
        assert again.returncode == 1
        assert "not empty" in again.stderr
        open_database(started.stdout.strip())
    finally:
        stopped = call("stop", str(folder))
    assert (stopped.returncode, stopped.stderr) == (0, "")
    assert not folder.exists()
    assert call("stop", str(folder)).returncode == 0


def test_a_folder_of_something_else_is_left_alone(folder: Path) -> None:
    """Neither start nor stop touches a folder that holds other files."""
    folder.mkdir()
    (folder / "thesis.txt").write_text("years of work")
    assert call("start", str(folder)).returncode == 1
    assert call("stop", str(folder)).returncode == 1
    assert (folder / "thesis.txt").read_text() == "years of work"


def test_a_path_too_long_for_a_socket_is_told(folder: Path) -> None:
    """The limit is the kernel's; nothing stays."""
    deep = folder / ("x" * 100)
    refused = call("start", str(deep))
    assert refused.returncode == 1
    assert "too long" in refused.stderr
    assert not folder.exists()
    assert call("begin", str(deep)).returncode == 1


def test_a_start_that_fails_leaves_nothing(folder: Path) -> None:
    """Where the server's user cannot enter, the message says so, and the folder goes again."""
    if os.geteuid() != 0:
        pytest.skip("only root starts the server as another user")
    folder.mkdir(mode=0o700)
    refused = call("start", str(folder / "pg"))
    assert refused.returncode == 1
    assert "cannot reach" in refused.stderr
    assert list(folder.iterdir()) == []

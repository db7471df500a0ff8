"""The example scripts bring surveys in by date, leave alone what is there, and stop at the first failure."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from simulated import scenes
from simulated.files import write_points

from msbdb.database import footprint_at, open_database, read_changes

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def surveys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder of two surveys that are alike, and an empty one."""
    folder = tmp_path_factory.mktemp("surveys")
    cloud = replace(scenes.podium_tower(density=1.0).points, colours=None, colour_names=())
    for name, points in (("2020-04-01_first", cloud), ("2024-05-02_second", cloud)):
        (folder / name).mkdir()
        write_points(folder / name / "town.laz", points)
    (folder / "2025-01-01_third").mkdir()
    (folder / "surveys.csv").write_text(
        "survey,date,points,aoi\nsecond,2024-05-02,2024*/*.laz,\nfirst,2020-04-01,2020*/*.laz,\n", encoding="utf-8"
    )
    return folder


def run(*words: object) -> subprocess.CompletedProcess[str]:
    """Run a script with this Python's msbdb."""
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run([str(word) for word in words], env=env, capture_output=True, text=True, check=False)


@pytest.fixture
def msbdb(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the shell script find msbdb."""
    program = tmp_path / "msbdb"
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m msbdb.cli.main "$@"\n')
    program.chmod(0o755)
    monkeypatch.setenv("MSBDB", str(program))


@pytest.mark.long
def test_the_nightly_script_brings_surveys_in_once(surveys: Path, tmp_path: Path, msbdb: None) -> None:
    """By date; the second night finds nothing to do."""
    db = tmp_path / "town.sqlite"
    words = (ROOT / "scripts" / "update_nightly", db, surveys, "--extract", "multiscale")
    first = run(*words)
    assert first.returncode == 0, first.stderr
    assert "2025-01-01_third has no points yet" in first.stderr
    engine = open_database(db)
    assert set(read_changes(engine)["survey"]) == {"first", "second"}
    assert set(footprint_at(engine, "2024-05-02")["valid_from"]) == {"2020-04-01"}
    again = run(*words)
    assert again.returncode == 0, again.stderr
    assert again.stdout.count("this update was applied already") == 2


@pytest.mark.long
def test_the_nightly_script_stops_at_the_first_failure(surveys: Path, tmp_path: Path, msbdb: None) -> None:
    """Earlier surveys are in; a broken file keeps later ones from overtaking it."""
    folder, db = tmp_path / "surveys", tmp_path / "town.sqlite"
    (folder / "2019-01-01_broken").mkdir(parents=True)
    (folder / "2019-01-01_broken" / "town.laz").write_bytes(b"no points")
    for name, source in (("2018-04-01_sound", "2020-04-01_first"), ("2024-05-02_later", "2024-05-02_second")):
        (folder / name).symlink_to(surveys / source)
    done = run(ROOT / "scripts" / "update_nightly", db, folder, "--extract", "multiscale")
    assert done.returncode == 1
    assert "2019-01-01_broken could not be applied" in done.stderr
    assert set(read_changes(open_database(db))["survey"]) == {"sound"}
    assert "usage" in run(ROOT / "scripts" / "update_nightly").stderr


@pytest.mark.long
def test_the_python_script_brings_a_table_of_surveys_in(surveys: Path, tmp_path: Path) -> None:
    """By date, with a file and a map a survey."""
    words = (sys.executable, ROOT / "scripts" / "update_inventory", tmp_path / "town.sqlite", surveys / "surveys.csv")
    done = run(*words, "--out", tmp_path / "changes", "--extract", "multiscale")
    assert done.returncode == 0, done.stderr
    assert [line.split(":")[0] for line in done.stdout.splitlines()] == ["first (2020-04-01)", "second (2024-05-02)"]
    names = sorted(path.name for path in (tmp_path / "changes").iterdir())
    assert names == ["first.gpkg", "first.png", "second.gpkg", "second.png"]
    again = run(*words, "--extract", "multiscale")
    assert again.stdout.count("unchanged;") == 2

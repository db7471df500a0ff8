"""Builds stopped at every stage, by Ctrl-C and by SIGKILL: the database keeps its content, a second run completes."""

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner
from disturbance.forks import stop_at
from simulated.scenes import SCENES
from support.faultfiles import write_points
from support.processes import environment
from support.sizes import sample

import msbdb
from msbdb.cli import build as build_module
from msbdb.cli.main import cli
from msbdb.run.reports import STAGES

TOLD = "Interrupted. A database keeps its last complete build; run the command again."

OLD, NEW = "an old database", "no database"

STAGE_EDGES = [
    *((stage, 0, (OLD, NEW)[number % 2]) for number, stage in enumerate(STAGES)),
    ("write", 0, OLD),
    ("write", 1, OLD),
    ("write", 1, NEW),
]
"""Stage, its begin (0) or end (1), and what was there; before the writing, it is of no matter to the database."""

SPATIALITE = "msbdb.database.dialects.spatialite"
MOMENTS = {
    "before the file": ("create", 1, False, NEW),
    "with an empty file": ("geometry_ddl", 1, False, NEW),
    "in the schema": ("view_ddl", 1, True, NEW),
    "before the file has its name": ("_publish", 1, False, NEW),
    "when the file has its name": ("_publish", 1, True, NEW),
    "before the log": ("journal_mode", 1, False, OLD),
    "with an empty log": ("journal_mode", 1, True, OLD),
    "before the first rows": ("insert_rows", 1, False, OLD),
    "between the first rows": ("insert_rows", 4, True, NEW),
    "between more rows": ("insert_rows", 4, True, OLD),
    "before the statistics": ("after_load", 1, False, OLD),
    "before the commit": ("after_load", 1, True, OLD),
    "after the commit": ("journal_mode", 2, False, OLD),
    "with the log taken in": ("journal_mode", 2, True, OLD),
}
"""Steps of the writing: the function, at which call of it, whether after it, and what was there."""

COMMITTED = ("when the file has its name", "after the commit", "with the log taken in")
INTERRUPTED = ("between more rows", "in the schema", "between the first rows", "before the commit")


class Killer:
    """The server of forks that are killed; see ``disturbance.forks``."""

    def __init__(self):
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
        command = [sys.executable, "-m", "disturbance.forks"]
        self.process = subprocess.Popen(command, env=environment(), **pipes)

    def run(self, *argv, **how):
        """Run the program in a fork that is stopped as told; return its exit code and standard error."""
        request = {"argv": [str(arg) for arg in argv], "signal": signal.SIGKILL, **how}
        self.process.stdin.write(json.dumps(request) + "\n")
        self.process.stdin.flush()
        answer = json.loads(self.process.stdout.readline())
        return answer["code"], answer["stderr"]

    def close(self):
        """End the server."""
        self.process.stdin.close()
        self.process.wait(timeout=10)
        self.process.stdout.close()


@pytest.fixture(scope="module")
def killer():
    """Return a server of forks."""
    server = Killer()
    yield server
    server.close()


@pytest.fixture(scope="module")
def tile(tmp_path_factory):
    """Return a small tile with one building of three parts."""
    cloud = SCENES["podium_tower"](density=1.0).points
    return write_points(tmp_path_factory.mktemp("tile") / "tile.laz", cloud, crs=cloud.crs)


def build(tile, db):
    """Return the command line of the build under test."""
    return ["build", "--points", str(tile), "--db", str(db), "--survey", "new"]


def run(*args):
    """Run the program inside of this process."""
    return CliRunner().invoke(cli, [str(arg) for arg in args])


@pytest.fixture(scope="module")
def starts(tmp_path_factory, tile):
    """Return, by name, a database to start from and its content, and the content of an undisturbed build into it."""
    folder = tmp_path_factory.mktemp("starts")
    db, old = folder / "new.sqlite", folder / "old.sqlite"
    assert run(*build(tile, db)).exit_code == 0
    found = {NEW: (None, None, dump(db))}
    assert run("build", "--points", tile, "--db", old, "--survey", "old").exit_code == 0
    whole = Path(shutil.copy(old, folder / "whole.sqlite"))
    assert run(*build(tile, whole)).exit_code == 0
    found[OLD] = (old, dump(old), dump(whole))
    assert found[OLD][1] != found[OLD][2]
    return found


@pytest.fixture
def place(start, tmp_path, starts):
    """Return a path for the database, absent or with an older survey, and its contents before and after."""
    source, before, after = starts[start]
    db = tmp_path / "town.sqlite"
    if source is not None:
        shutil.copy(source, db)
    return db, before, after


def dump(db):
    """Return a database's content after checking that it is sound."""
    with msbdb.open(db) as inventory:
        with inventory.engine.connect() as connection:
            assert connection.exec_driver_sql("PRAGMA integrity_check").scalar() == "ok"
            assert connection.exec_driver_sql("PRAGMA foreign_key_check").all() == []
        return inventory.dump()


def check_and_complete(tile, place, *, written=False):
    """Check what a stopped build left, and that a second one makes what an undisturbed one makes."""
    db, before, after = place
    if db.exists():
        found = dump(db)
        assert found == (after if written else before)
    else:
        assert before is None
        assert not written
    result = run(*build(tile, db))
    assert result.exit_code == 0, result.stderr
    assert dump(db) == after
    # A build that finds all of it there writes nothing, and leaves SQLite's own files to the next writer.
    own = {f"{db.name}-{part}" for part in ("journal", "wal", "shm")} if written else set()
    assert {path.name for path in db.parent.iterdir()} - own == {db.name}


@pytest.mark.parametrize(("stage", "done", "start"), sample(STAGE_EDGES, 14, 3))
def test_ctrl_c_at_any_stage_ends_in_one_line(tile, place, monkeypatch, stage, done):
    """Exit code 130, no file beside the database, no database where there was none."""
    monkeypatch.setattr(build_module, "progress_bar", build_module.progress_bar)
    stop_at(stage, done, signal.SIGINT)
    db, before, _ = place
    result = run(*build(tile, db))
    monkeypatch.undo()
    assert result.exit_code == 130
    assert result.stderr.strip() == TOLD
    assert result.stdout == ""
    assert db.exists() == (before is not None or done == 1)
    assert {path.name for path in db.parent.iterdir()} <= {db.name}
    check_and_complete(tile, place, written=done == 1)


@pytest.mark.parametrize(("stage", "done", "start"), sample(STAGE_EDGES, len(STAGE_EDGES), 3))
def test_a_kill_at_any_stage_loses_nothing(killer, tile, place, stage, done):
    """The database stays as it was, or absent."""
    code, told = killer.run(*build(tile, place[0]), stage=stage, done=done)
    assert (code, told) == (-signal.SIGKILL, "")
    check_and_complete(tile, place, written=done == 1)


@pytest.mark.parametrize(("moment", "start"), sample([(moment, how[-1]) for moment, how in MOMENTS.items()], 7, 3))
def test_a_kill_within_the_writing_loses_nothing(killer, tile, place, moment):
    """At each step of it, from the empty file to the log taken in."""
    name, nth, after, _ = MOMENTS[moment]
    code, told = killer.run(*build(tile, place[0]), place=f"{SPATIALITE}:{name}", nth=nth, after=after)
    assert (code, told) == (-signal.SIGKILL, "")
    check_and_complete(tile, place, written=moment in COMMITTED)


@pytest.mark.parametrize(("moment", "start"), sample([(moment, MOMENTS[moment][-1]) for moment in INTERRUPTED], 4, 3))
def test_ctrl_c_within_the_writing_leaves_nothing(killer, tile, place, moment):
    """What was begun is rolled back and removed at once."""
    name, nth, after, _ = MOMENTS[moment]
    how = {"place": f"{SPATIALITE}:{name}", "nth": nth, "after": after, "signal": signal.SIGINT}
    code, told = killer.run(*build(tile, place[0]), **how)
    assert (code, told.strip()) == (130, TOLD)
    assert {path.name for path in place[0].parent.iterdir()} <= {place[0].name}
    check_and_complete(tile, place)


def test_a_killed_database_is_read_by_others_first(killer, tile, starts, tmp_path):
    """A reader that comes before the second build finds the old content, log or not."""
    source, before, _ = starts[OLD]
    db = Path(shutil.copy(source, tmp_path / "town.sqlite"))
    code, _ = killer.run(*build(tile, db), place=f"{SPATIALITE}:after_load", nth=1, after=True)
    assert code == -signal.SIGKILL
    assert db.with_name("town.sqlite-wal").exists()
    assert [run_["survey"] for run_ in json.loads(run("info", db, "--json").stdout)["runs"]] == ["old"]
    assert dump(db) == before


def test_a_leftover_of_a_killed_build_is_removed_by_the_next(killer, tile, tmp_path):
    """A half-made file has a hidden name with the process's number; that of a living process is left alone."""
    db, living = tmp_path / "town.sqlite", tmp_path / f".town.sqlite.{os.getppid()}.partial"
    living.write_bytes(b"")
    code, _ = killer.run(*build(tile, db), place=f"{SPATIALITE}:_publish", nth=1)
    assert code == -signal.SIGKILL
    assert not db.exists()
    assert len(list(tmp_path.glob(".town.sqlite.*.partial"))) == 2
    assert run(*build(tile, db)).exit_code == 0
    assert sorted(tmp_path.iterdir()) == [living, db]


@pytest.mark.parametrize("command", sample(["export", "view"], 2))
def test_ctrl_c_in_an_output_leaves_nothing(killer, tile, starts, tmp_path, command):
    """The former file stays, without strays."""
    db = Path(shutil.copy(starts[OLD][0], tmp_path / "town.sqlite"))
    out = tmp_path / ("town.gpkg" if command == "export" else "town.png")
    out.write_text("the former file")
    args = ["export", db, out, "--overwrite"] if command == "export" else ["view", db, "--out", out, "--overwrite"]
    places = {"export": "msbdb.io.layers:_replace", "view": "msbdb.io.files:_flush"}
    code, told = killer.run(*args, place=places[command], nth=1, signal=signal.SIGINT)
    assert (code, told.strip()) == (130, TOLD)
    assert out.read_text() == "the former file"
    assert sorted(tmp_path.iterdir()) == sorted([db, out])


def test_ctrl_c_of_the_program_itself(tile, tmp_path):
    """A real process, interrupted while it works: 130, and one line after what it had told."""
    db = tmp_path / "town.sqlite"
    command = [sys.executable, "-m", "msbdb.cli.main", *build(tile, db), "-v"]
    for _ in range(3):
        with subprocess.Popen(
            command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment()
        ) as process:
            told = process.stderr.readline()
            is_working = process.poll() is None
            process.send_signal(signal.SIGINT)
            out, rest = process.communicate(timeout=60)
        if is_working:
            break
        db.unlink()  # the machine stood still, and the build was done before it could be interrupted
    assert told.startswith("Read ")
    assert process.returncode == 130
    assert out == ""
    lines = [line for line in rest.splitlines() if line]
    assert lines[-1] == TOLD
    assert "Traceback" not in rest
    assert list(tmp_path.iterdir()) == []

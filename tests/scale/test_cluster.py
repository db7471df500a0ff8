"""Workers of dask.distributed build the same as one process, and what kills one of them kills no build."""

import json
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from threading import Event
from types import SimpleNamespace

import pytest
from support.processes import BENCHMARKS, environment, run_script
from support.tiledtown import KILLED, TILE_M, write_town

import msbdb
from msbdb.database import canonical_dump, check_database, open_database
from msbdb.errors import FileError, MissingDependencyError, ParameterError, TilesError
from msbdb.scale import cluster


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Return the files of the town."""
    return write_town(tmp_path_factory.mktemp("town"))


@pytest.fixture(scope="module")
def alone(files, tmp_path_factory):
    """Return the dump of the town that one process builds in tiles."""
    db = tmp_path_factory.mktemp("alone") / "town.sqlite"
    msbdb.build(files, db=db, survey="town", extract="multiscale", tile=TILE_M)
    return dump(db)


def dump(db):
    """Return the lines of the dump of a sound database."""
    engine = open_database(db)
    found = list(canonical_dump(engine))
    assert not check_database(engine)
    engine.dispose()
    return found


@pytest.mark.parametrize("workers", [1, 2])
def test_workers_give_the_content_of_one_process(files, alone, tmp_path, monkeypatch, workers):
    """The dump is the same to the byte, for any number of workers; these are threads, which open no port."""
    pytest.importorskip("distributed")
    # It is found out by a socket that sends nothing, and names the place of threads alone.
    monkeypatch.setattr("distributed.comm.inproc.get_ip", lambda: "127.0.0.1")
    monkeypatch.setattr(cluster, "cluster_of", partial(cluster.cluster_of, processes=False))
    db = tmp_path / "town.sqlite"
    msbdb.build(files, db=db, survey="town", extract="multiscale", tile=TILE_M, workers=workers)
    assert dump(db) == alone


@dataclass(frozen=True)
class Task:
    """What the cluster sees of a tile."""

    tile: int
    status: SimpleNamespace
    cores: int | None = None


def slow(task):
    """Do the work of a tile that takes its time."""
    time.sleep(0.2)
    return task


@pytest.mark.parametrize("aside", [True, False])
def test_workers_start_beside_the_plan(aside):
    """A cluster of this machine begins while the block works; one that is there is looked for first, and both end."""
    done, told = Event(), []

    @contextmanager
    def starting():
        told.append("begins")
        assert not aside or done.wait(20)
        yield "workers"
        told.append("ends")

    with cluster.beginning(starting(), aside=aside) as crew:
        assert aside or told == ["begins"]
        done.set()
        assert crew.client() == "workers"
        assert told == ["begins"]
    assert told == ["begins", "ends"]


@pytest.mark.parametrize("merges", [True, False])
def test_workers_end_beside_the_merge(merges):
    """A cluster that is dismissed ends once, while the block goes on, also when the block fails then."""
    merging, told = Event(), []

    @contextmanager
    def ending():
        yield "workers"
        assert merging.wait(20), "the block did not go on"
        told.append("ends")

    with suppress(OSError), cluster.beginning(ending(), aside=True) as crew:
        assert crew.client() == "workers"
        crew.dismiss()
        merging.set()
        if not merges:
            raise OSError
    assert told == ["ends"]


def test_an_error_of_the_end_of_workers_is_told():
    """What fails in their thread is raised when the block ends."""

    @contextmanager
    def broken():
        yield "workers"
        msg = "a worker does not end"
        raise RuntimeError(msg)

    with pytest.raises(RuntimeError, match="does not end"), cluster.beginning(broken(), aside=True) as crew:
        crew.dismiss()


def test_each_worker_is_prepared(monkeypatch):
    """Its process takes memory and searches for garbage as that of the command does."""
    pytest.importorskip("distributed")
    monkeypatch.setattr("distributed.comm.inproc.get_ip", lambda: "127.0.0.1")
    prepared = []
    monkeypatch.setattr(cluster, "own_process", lambda: prepared.append("worker"))
    with cluster.cluster_of(2, None, processes=False):
        assert prepared == ["worker"] * 2


def test_a_lost_scheduler_is_named(monkeypatch):
    """Its tiles are cancelled, which ends the build by a message with the next step."""
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr("distributed.comm.inproc.get_ip", lambda: "127.0.0.1")
    monkeypatch.setattr(cluster, "work", slow)
    tasks = [Task(number, SimpleNamespace(survey="town")) for number in range(3)]
    with cluster.cluster_of(1, None, processes=False) as client:
        outcomes = cluster.work_on(client, tasks, lambda _: None)
        first, summary, _ = next(outcomes)
        assert (first.tile, summary.cores) == (0, 1), "a worker of one thread has one core"
        client.cancel([distributed.Future(key, client) for key in list(client.futures)])
        with pytest.raises(TilesError, match=r"scheduler of the cluster is lost.*--resume"):
            list(outcomes)


def test_without_dask_the_error_says_what_to_install(files, tmp_path, monkeypatch):
    """A build in tiles alone needs no cluster; with workers it names the extra."""
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingDependencyError, match=r"pip install \"msbdb\[cluster\]\""):
        msbdb.build(files, db=tmp_path / "town.sqlite", tile=TILE_M, workers=2)
    assert not (tmp_path / "town.sqlite").exists()


def test_a_cluster_that_is_not_there_is_refused():
    """The number of workers, and the scheduler's file, are checked first."""
    pytest.importorskip("distributed")
    with pytest.raises(ParameterError, match="one worker or more"), cluster.cluster_of(0, None):
        pass
    with pytest.raises(FileError, match="cannot be reached"), cluster.cluster_of(None, "/nowhere/scheduler.json"):
        pass


@pytest.mark.long
def test_a_killed_worker_changes_nothing(files, alone, tmp_path):
    """Its tile is built by another process, and the dump is the same."""
    pytest.importorskip("distributed")
    db = tmp_path / "town.sqlite"
    code = (
        "import sys, msbdb\n"
        "from msbdb.scale import cluster\n"
        "from support.tiledtown import TILE_M, work_once_killed\n"
        "cluster.work = work_once_killed\n"
        "if __name__ == '__main__':\n"
        "    msbdb.build(sys.argv[2:], db=sys.argv[1], survey='town', extract='multiscale', tile=TILE_M, workers=2)\n"
    )
    script = tmp_path / "killed.py"
    script.write_text(code)
    ended = subprocess.run(
        [sys.executable, str(script), str(db), *map(str, files)],
        env=environment(**{KILLED: str(tmp_path / "killed")}), capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stderr
    assert (tmp_path / "killed").exists()
    assert dump(db) == alone


@pytest.mark.campaign
@pytest.mark.parametrize("of", ["points", "rasters"])
def test_disturbed_builds_in_tiles_end_as_undisturbed_ones(of):
    """Kills, files that vanish or may not grow, and a broken tile: scripts/benchmarks/tilefaults in short."""
    pytest.importorskip("distributed")
    words = ("--of", of, "--kills", 3, "--others", 1, "--dialect", "spatialite", "--json")
    done = run_script(BENCHMARKS / "tilefaults", *words)
    assert done.returncode == 0, done.stderr
    runs = json.loads(done.stdout)["runs"]
    assert {run["problem"] for run in runs} == {""}
    assert {run["fault"] for run in runs} >= {"client", "worker", "scheduler", "vanish", "raise", "limit"}
    # A kill may come too late where the build was timed on a busier machine; that a killed client goes on where it was
    # has tests of its own, which kill at a tile.
    assert {run["ended"] for run in runs} >= {"refused"}

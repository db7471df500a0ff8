"""Builds in tiles that are disturbed: whoever takes part is killed, files vanish, tiles raise, disks are full."""

import asyncio
import contextlib
import os
import random
import shutil
import signal
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path

import numpy as np
from affine import Affine
from simulated.files import write_heights, write_image, write_points
from simulated.scenes import DATUM_M, Block, Scene, Tree, World, scan

from disturbance.forks import end, fork
from disturbance.places import Files, Server, filled, limit_files
from disturbance.runs import ENDS, REFUSED, BrokenError, Outcome, content, require
from msbdb import api
from msbdb.database import opened, read_tile_status, tiles_with_results
from msbdb.errors import MsbdbError
from msbdb.grid import Grid, GridSpec
from msbdb.params import Params, with_values
from msbdb.run.preparation.drafts import build_surface
from msbdb.scale import tilework

TILE_M = 60.0
SURVEY = "town"
PATIENCE_S = 120.0
"""Seconds after which a build that waits for ever is a fault itself."""

ALONE = ("vanish", "raise", "full", "limit")
"""What leaves the other tiles alone: they are done, and only the rest is repeated."""

ROOM = {"full": (500_000, 1_500_000), "limit": (10_000, 800_000)}
"""Bytes between which a build comes to its end or not: of the disk, and of one file, also the database."""


Sources = Mapping[str, tuple[Path, ...]]
"""The files of a survey by role: points, or dsm, dtm and ortho."""


def town_files(folder: Path, of: str) -> Sources:
    """Write a town of six tiles of 60 m: a courtyard over a corner of tiles, houses and trees.

    Of points these are three files. They are LAS, because the readers of LAZ start threads, which a fork lacks. Of
    rasters these are a DSM of cells of 1 m, a DTM of 2 m, and an orthophoto.
    """
    blocks = [Block("ring", 44, 44, 34, 34, DATUM_M + 12.5, 1, hole=(54, 54, 14, 14))]
    for number, (west, south) in enumerate([(15, 20), (90, 12), (95, 85), (20, 92), (140, 30), (142, 88)]):
        blocks.append(Block(f"house {number}", west, south, 13, 11, DATUM_M + 6.5 + number, number + 2))
    trees = tuple(Tree(8.0 + 10 * n, 36.0, 3.5, 9.0 + n % 3, 2.5) for n in range(16))
    scene = scan(World("town", (180, 120), tuple(blocks), trees, origin=(389_040.0, 5_821_020.0)), density=1.0)
    if of == "rasters":
        return _rasters(scene, folder)
    column = ((scene.points.x - 389_040.0) // 60).astype(int)
    files = (write_points(folder / f"{name}.las", scene.points.take(column == n)) for n, name in enumerate("wme"))
    return {"points": tuple(files)}


def _rasters(scene: Scene, folder: Path) -> Sources:
    """Write the surface of a town, its ground and an orthophoto."""
    surface = build_surface(scene.points, with_values(Params(), {"surface": {"cell_m": 1.0}}))
    (west, south), crs = scene.world.origin, surface.dsm.spec.crs
    lattices = {
        name: GridSpec((round(120 / cell), round(180 / cell)), Affine(cell, 0, west, 0, -cell, south + 120), crs)
        for name, cell in (("dsm", 1.0), ("dtm", 2.0), ("ortho", 0.5))
    }
    centres = lattices["dsm"].centres()
    heights = surface.dsm.spec.sample(np.asarray(surface.dsm.values, np.float32), *centres, outside=0.0)
    dsm = Grid(heights, surface.dsm.spec.sample(surface.dsm.valid, *centres, outside=False), lattices["dsm"])
    flat = lattices["dtm"].shape
    dtm = Grid(np.full(flat, DATUM_M, np.float32), np.ones(flat, np.bool_), lattices["dtm"])
    bands = ("red", "green", "blue", "nir")
    return {
        "dsm": (write_heights(folder / "dsm.tif", dsm),),
        "dtm": (write_heights(folder / "dtm.tif", dtm),),
        "ortho": (write_image(folder / "ortho.tif", scene.ortho(lattices["ortho"]), lattices["ortho"], bands),),
    }


def build(files: Sources, target: str, scheduler: str | None, *, resume: bool) -> None:
    """Build the town in tiles."""
    given = {role: paths if role in {"points", "ortho"} else paths[0] for role, paths in files.items()}
    how = {"extract": "multiscale", "tile": TILE_M, "scheduler": scheduler, "resume": resume}
    api.build(given.pop("points", ()), db=target, survey=SURVEY, **given, **how)


@dataclass
class Cluster:
    """A scheduler and workers of dask, each a forked process of its own."""

    folder: Path
    workers: int
    before: Callable[[], None]
    address: str = ""
    scheduler: int = 0
    running: list[int] = field(default_factory=list)

    def start(self) -> None:
        """Start all of them, and wait until the scheduler has its address."""
        note = self.folder / "scheduler"
        note.unlink(missing_ok=True)
        self.scheduler = fork(lambda: _schedule(note))
        until = time.monotonic() + PATIENCE_S
        while not note.exists():
            require(time.monotonic() < until, "the scheduler does not start")
            time.sleep(0.01)
        self.address = note.read_text()
        for _ in range(self.workers):
            self.add()

    def add(self) -> None:
        """Start a worker."""
        self.running.append(fork(lambda: _work(self.address, self.folder, self.before)))

    def stop(self) -> None:
        """End all of them."""
        for process in (*self.running, self.scheduler):
            end(process)
        self.running.clear()


def _schedule(note: Path) -> int:
    """Run a scheduler until its process is killed."""
    from distributed import Scheduler

    async def run() -> None:
        async with Scheduler(host="127.0.0.1", port=0, dashboard=False, dashboard_address="127.0.0.1:0") as scheduler:
            growing = note.with_suffix(".new")
            growing.write_text(scheduler.address)
            growing.rename(note)
            await scheduler.finished()

    _quiet()
    asyncio.run(run())
    return 0


def _work(address: str, folder: Path, before: Callable[[], None]) -> int:
    """Run a worker until its scheduler is gone, or its process is killed."""
    from distributed import Worker

    async def run() -> None:
        async with Worker(address, nthreads=1, memory_limit=0, dashboard=False, local_directory=str(folder)) as worker:
            await worker.finished()

    _quiet()
    before()
    asyncio.run(run())
    return 0


def _quiet() -> None:
    """Drop what dask tells of lost connections."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)


class Client:
    """A build in a forked process, alone or on a cluster."""

    def __init__(
        self, files: Sources, target: str, scheduler: str | None, before: Callable[[], None], *, resume: bool
    ) -> None:
        self.words = tempfile.TemporaryFile()  # noqa: SIM115  (goes with this object)

        def action() -> int:
            os.dup2(self.words.fileno(), 2)
            if scheduler is None:
                before()
            try:
                build(files, target, scheduler, resume=resume)
            except MsbdbError as error:
                os.ftruncate(2, 0)
                os.write(2, str(error).encode())
                return REFUSED
            return 0

        self.process = fork(action)

    def wait(self) -> int:
        """Wait for its end; return its exit code."""
        until = time.monotonic() + PATIENCE_S
        while True:
            process, status = os.waitpid(self.process, os.WNOHANG)
            if process:
                return os.waitstatus_to_exitcode(status)
            if time.monotonic() > until:
                end(self.process)
                msg = f"it still waited after {PATIENCE_S:.0f} s"
                raise BrokenError(msg)
            time.sleep(0.01)

    def said(self) -> str:
        """Return what it said."""
        self.words.seek(0)
        return self.words.read().decode(errors="replace").strip("\0\n")


@dataclass
class TiledCourse:
    """The files of the town, what an undisturbed build ends in, and how long builds take."""

    folder: Path
    files: Sources
    expected: list[str]
    seconds: dict[tuple[str, int], float] = field(default_factory=dict)

    @classmethod
    def of(cls, folder: Path, of: str = "points") -> "TiledCourse":
        """Write the files, and build them undisturbed in this process, so that forks have all loaded and compiled."""
        import distributed  # noqa: F401  (before any fork)

        folder.mkdir(exist_ok=True)
        files = town_files(folder, of)
        db = folder / "undisturbed.sqlite"
        build(files, str(db), None, resume=False)
        return cls(folder, files, content(str(db)))

    def time_of(self, places: Files | Server, workers: int) -> float:
        """Return how long an undisturbed build takes, measured once; it has the same content."""
        key = places.kind, workers
        if key not in self.seconds:
            target = places.new()
            with _cluster(self.folder, workers, lambda: None) as cluster:
                begin = time.monotonic()
                client = Client(self.files, target, cluster and cluster.address, lambda: None, resume=False)
                require(client.wait() == 0, f"it failed undisturbed: {client.said()}")
                self.seconds[key] = time.monotonic() - begin
            require(content(target) == self.expected, f"{workers} workers give another content on {places.kind}")
            places.drop(target)
        return self.seconds[key]


@contextlib.contextmanager
def _cluster(folder: Path, workers: int, before: Callable[[], None]) -> Iterator[Cluster | None]:
    """Run a cluster, or none for no worker."""
    if not workers:
        yield None
        return
    with tempfile.TemporaryDirectory(dir=folder) as own:
        cluster = Cluster(Path(own), workers, before)
        try:
            cluster.start()
            yield cluster
        finally:
            cluster.stop()


def one_tiled_run(course: TiledCourse, places: Files | Server, fault: str, workers: int, rng: random.Random) -> Outcome:
    """Disturb one build in tiles, check what is left, resume it, and check again."""
    outcome = Outcome(places.kind, fault, f"{workers} workers")
    begin = time.monotonic()
    try:
        _run(course, places, workers, rng, outcome)
    except (BrokenError, MsbdbError, TimeoutError) as error:
        outcome.problem = str(error)
    outcome.seconds = round(time.monotonic() - begin, 1)
    return outcome


def _run(course: TiledCourse, places: Files | Server, workers: int, rng: random.Random, outcome: Outcome) -> None:
    """Do what `one_tiled_run` does, and note it down; raise at the first that does not hold."""
    fault, target = outcome.fault, places.new()
    usual = course.time_of(places, workers)
    own = course.folder / "own"
    shutil.rmtree(own, ignore_errors=True)
    own.mkdir()
    files = {role: tuple(Path(shutil.copy2(path, own)) for path in paths) for role, paths in course.files.items()}
    every = list(chain.from_iterable(files.values()))
    moment, place = rng.uniform(0, usual), rng.randrange(6)
    room = rng.randrange(*ROOM.get(fault, (0, 1)))
    before = {"raise": lambda: _raise_at(place), "limit": lambda: limit_files(room)}.get(fault, lambda: None)
    outcome.moment = f"{moment:.2f} of {usual:.2f} s"
    with contextlib.ExitStack() as stack:
        cluster = stack.enter_context(_cluster(own, workers, before))
        if fault == "full":
            outcome.moment = f"room for {room} bytes"
            stack.enter_context(filled(next(folder for folder in places.folder.parents if folder.is_mount()), room))
        client = Client(files, target, cluster and cluster.address, before, resume=False)
        time.sleep(0 if fault in {"raise", "full", "limit"} else moment)
        _strike(fault, client, cluster, places, vanishing=rng.choice(every), rng=rng)
        code = client.wait()
        outcome.ended, outcome.said = ENDS.get(code, f"with the code {code}"), client.said()
        for path, kept in zip(every, chain.from_iterable(course.files.values()), strict=True):
            shutil.copy2(kept, path)
    allowed = ("done", "killed") if fault == "client" else ("done", "refused")
    require(outcome.ended in allowed, f"it ended {outcome.ended}: {outcome.said}")
    if fault == "worker":
        require(outcome.ended == "done", f"a lost worker ended it: {outcome.said}")
    places.settle(target)
    outcome.left = _state_of(course, target, outcome)
    with _cluster(own, workers, lambda: None) as cluster:
        client = Client(files, target, cluster and cluster.address, lambda: None, resume=True)
        require(client.wait() == 0, f"the repeat failed: {client.said()}")
    require(content(target) == course.expected, "the repeat ended in another content")
    strays = places.strays(target)
    require(not strays, f"left behind: {', '.join(strays)}")
    with opened(target) as engine:
        require(not tiles_with_results(engine, SURVEY), "results of tiles are left in the database")
    places.drop(target)


def _strike(
    fault: str,
    client: Client,
    cluster: Cluster | None,
    places: Files | Server,
    *,
    vanishing: Path,
    rng: random.Random,
) -> None:
    """Disturb a build that runs."""
    if fault == "client":
        os.kill(client.process, signal.SIGKILL)
    elif fault == "worker" and cluster is not None:
        end(cluster.running.pop(rng.randrange(len(cluster.running))))
        cluster.add()
    elif fault == "scheduler" and cluster is not None:
        end(cluster.scheduler)
    elif fault == "server" and isinstance(places, Server):
        places.restart()
    elif fault == "vanish":
        vanishing.unlink()


def _raise_at(number: int) -> None:
    """Have a tile raise whenever it is built: the n-th of the town."""
    original = tilework.find_regions

    def raises(job: object, plan: object, stages: object, window: object) -> object:
        west, south = window.own[:2]
        if round((west - 389_040.0) / TILE_M) % 3 + 3 * (round((south - 5_821_020.0) / TILE_M) % 2) == number:
            msg = "this tile is broken"
            raise RuntimeError(msg)
        return original(job, plan, stages, window)

    tilework.find_regions = raises


def _state_of(course: TiledCourse, target: str, outcome: Outcome) -> str:
    """Return what a disturbed build left: no database, tiles without a survey, or all; nothing else may be."""
    try:
        with opened(target) as engine:
            tiles = read_tile_status(engine, SURVEY)
    except MsbdbError as error:
        require("There is no msbdb database" in str(error), f"the database is gone: {error}")
        return "absent"
    found = content(target)
    if found == course.expected:
        return "new"
    require(
        not any(line.startswith(('["survey"', '["building"', '["run"')) for line in found), "half a survey is there"
    )
    states = [tile.state for tile in tiles]
    if outcome.fault in ALONE and "--resume" in outcome.said:
        require(set(states) <= {"done", "failed"}, f"the rest was not completed: {states}")
        require("failed" in states and all(t.reason for t in tiles if t.state == "failed"), "no reason is kept")
    if outcome.ended == "refused":
        require(outcome.said.endswith(".") and len(outcome.said) > 40, f"it does not say what to do: {outcome.said!r}")
    return "between" if "done" in states else "old"

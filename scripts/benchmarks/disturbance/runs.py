"""Disturbed writers, and the checks afterwards.

A job is a command that writes. Undisturbed, it takes a database through known states, each committed by itself. After
a disturbance the database must be sound and in one of these states, not before the last one that the job reported; and
the same command must then bring it to the last state.
"""

import os
import random
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from sqlalchemy import Engine, text

from disturbance.forks import end, fork, wait
from disturbance.jobs import Job, Step, Town, jobs_of, starts_of
from disturbance.places import PATIENCE_S, Files, Server, filled, limit_files
from msbdb.database import canonical_dump, check_database, copy_database, open_database
from msbdb.errors import MsbdbError

Places = Files | Server
REFUSED = 3
"""Exit code of a job that ended with one of msbdb's own errors."""
WRITING = ("write", "inventory", "copy")
"""Stages that write."""

ROOM = {("limit", "spatialite"): 600_000, ("full", "spatialite"): 1_000_000, ("full", "postgis"): 2_000_000}
"""Bytes with which jobs come to their end, mostly: of one file, or of the disk."""


class BrokenError(Exception):
    """A disturbance left something that it must not leave."""


@dataclass
class Times:
    """When the stages that write began and how long they took, and how long all took; seconds."""

    writing: list[tuple[float, float]] = field(default_factory=list)
    total: float = 0.0


class Course:
    """Jobs with the databases that they start from, their states, and how long they take; made once."""

    def __init__(self, folder: Path, files: Files, density: float) -> None:
        town = Town(folder, density)
        self.files = files
        self.starts = starts_of(town)
        self.jobs = jobs_of(town, str(files.kept / "updated.sqlite"))
        self.states: dict[str, list[list[str]]] = {}
        self.times: dict[tuple[str, str], Times] = {}
        self._prepare("updated")

    def _prepare(self, name: str) -> None:
        """Make a database to start from, among the files, by way of those that it starts from itself."""
        before, step = self.starts[name]
        if before is not None and not self.files.has(before):
            self._prepare(before)
        target = self.files.new(before)
        # In this process, so that the forks have all loaded and compiled.
        step(target, lambda *_: None)
        self.files.keep(target, name)
        self.files.drop(target)

    def states_of(self, job: Job) -> list[list[str]]:
        """Return the contents that an undisturbed job goes through, the start's first."""
        if job.name not in self.states:
            target = self.new(job.start, self.files)
            found = [[] if job.start is None else content(target)]
            for step in job.steps:
                times = forked(step, target)
                found.append(content(target))
            if len(job.steps) == 1:
                self.times[job.name, self.files.kind] = times
            self.files.drop(target)
            if any(a == b for n, a in enumerate(found) for b in found[:n]):
                msg = f"A step of '{job.name}' changes nothing; the test would show nothing."
                raise SystemExit(msg)
            self.states[job.name] = found
        return self.states[job.name]

    def new(self, start: str | None, places: Places) -> str:
        """Return a database to start from, made from the files' one where the place has none yet."""
        if start is not None and not places.has(start):
            if start in self.starts and not self.files.has(start):
                self._prepare(start)
            if not places.has(start):
                target = places.new()
                self._fill(target, start)
                places.keep(target, start)
                places.drop(target)
        return places.new(start)

    def _fill(self, target: str, start: str) -> None:
        """Make a database to start from that no job makes, or as a copy of the files' one."""
        if start == "empty":
            open_database(target, create=True, srid=crs_of(self.files.kept / "older.sqlite")).dispose()
        else:
            copy_database(self.files.kept / f"{start}.sqlite", target)

    def times_of(self, job: Job, places: Places) -> Times:
        """Return how long a job takes undisturbed, measured once."""
        key = (job.name, places.kind)
        states = self.states_of(job)
        if key not in self.times:
            target = self.new(job.start, places)
            self.times[key] = forked(job.whole, target)
            require(content(target) == states[-1], f"'{job.name}' is another one on {places.kind}")
            places.drop(target)
        return self.times[key]


class Running:
    """A job in a forked process that tells by a pipe which stages of the writing it began and ended."""

    def __init__(self, step: Step, target: str, before: Callable[[], None] = lambda: None) -> None:
        self.reading, writing = os.pipe()
        self.words = tempfile.TemporaryFile()  # noqa: SIM115  (goes with this object)
        self.reported = b""

        def progress(stage: str, done: int, total: int) -> None:
            if stage in WRITING:
                os.write(writing, b"d" if done else b"w")

        def action() -> int:
            os.dup2(self.words.fileno(), 2)
            before()
            try:
                step(target, progress)
            except MsbdbError as error:
                sys.stderr.write(str(error))
                return REFUSED
            return 0

        self.begin = time.monotonic()
        self.process = fork(action)
        os.close(writing)

    def read(self) -> bytes:
        """Return the next report, nothing at the end."""
        word = os.read(self.reading, 1)
        self.reported += word
        return word

    def timed(self) -> Times:
        """Let it come to its end; return how long what took."""
        times, begun = Times(), 0.0
        while word := self.read():
            if word == b"w":
                begun = time.monotonic() - self.begin
            else:
                times.writing.append((begun, time.monotonic() - self.begin - begun))
        times.total = time.monotonic() - self.begin
        return times

    def sleep(self, moment: float, stage: int | None) -> None:
        """Wait until so long after the begin, or after the begin of a stage that writes."""
        while stage is not None and self.reported.count(b"w") <= stage and self.read():
            pass
        since = self.begin if stage is None else time.monotonic()
        time.sleep(max(0.0, since + moment - time.monotonic()))

    def come_to_end(self) -> None:
        """Wait until it has ended."""
        until = time.monotonic() + 2 * PATIENCE_S
        while os.waitid(os.P_PID, self.process, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None:
            if time.monotonic() > until:
                end(self.process)
                msg = f"It still waited {2 * PATIENCE_S:.0f} s after the disturbance."
                raise BrokenError(msg)
            time.sleep(0.005)

    def wait(self) -> int:
        """Wait for its end; return its exit code."""
        self.come_to_end()
        os.set_blocking(self.reading, False)
        while self.read():
            pass
        os.close(self.reading)
        return wait(self.process)

    def stderr(self) -> str:
        """Return what it said."""
        self.words.seek(0)
        return self.words.read().decode()


def forked(step: Step, target: str) -> Times:
    """Run a step undisturbed, in a fork; return how long what took."""
    run = Running(step, target)
    times = run.timed()
    require(run.wait() == 0, f"it failed undisturbed: {run.stderr()}")
    return times


def require(holds: bool, words: str) -> None:
    """Raise when something does not hold."""
    if not holds:
        raise BrokenError(words)


def crs_of(path: Path) -> int:
    """Return the EPSG code of a database."""
    with open_database(path).connect() as connection:
        return int(connection.scalar(text("SELECT epsg FROM survey")))


@cache
def engine_of(target: str) -> Engine:
    """Return an engine for looking at what comes and goes at one place; it keeps its compiled queries."""
    return open_database(target)


def content(target: str) -> list[str]:
    """Return the dump of a database that must be sound."""
    open_database(target).dispose()
    engine = engine_of(target)
    findings = check_database(engine)
    require(not findings, f"{len(findings)} findings of the check, first {findings[:3]}")
    if engine.dialect.name == "sqlite":
        require_sound(engine)
    return list(canonical_dump(engine))


def require_sound(engine: Engine) -> None:
    """Ask SQLite itself, which also looks at pages."""
    with engine.connect() as connection:
        sound = connection.exec_driver_sql("PRAGMA integrity_check").scalar()
        require(sound == "ok", f"SQLite finds {sound}")


def state_of(course: Course, job: Job, target: str) -> tuple[int, str]:
    """Return the number and name of the state that a disturbed job left."""
    states = course.states_of(job)
    try:
        open_database(target).dispose()
    except MsbdbError as error:
        require(job.start is None and "There is no msbdb database" in str(error), f"the database is gone: {error}")
        return 0, "absent"
    found = content(target)
    require(found in states, f"it holds none of the {len(states)} states, but {len(found)} lines")
    number = states.index(found)
    return number, "new" if number == len(states) - 1 else "between" if number else "old"


@dataclass
class Outcome:
    """What became of one disturbed run.

    ``ended`` is how the disturbed job ended: 'killed', 'refused' (by an error of msbdb's own, ``said``) or 'done', when
    the disturbance came too late; ``left`` is the state that it left. ``problem`` says what does not hold, empty when
    all does.
    """

    dialect: str
    fault: str
    job: str
    moment: str = ""
    ended: str = ""
    said: str = ""
    left: str = ""
    problem: str = ""
    seconds: float = 0.0


ENDS = {0: "done", REFUSED: "refused", -signal.SIGKILL: "killed"}


@dataclass(frozen=True)
class Case:
    """What is to be disturbed, where, by what; ``rng`` says when."""

    course: Course
    job: Job
    places: Places
    fault: str
    rng: random.Random


def one_run(case: Case) -> Outcome:
    """Disturb one job, check what is left, repeat the job, and check again."""
    outcome = Outcome(case.places.kind, case.fault, case.job.name)
    begin = time.monotonic()
    try:
        _run(case, outcome)
    except (BrokenError, MsbdbError, TimeoutError) as error:
        outcome.problem = str(error)
    outcome.seconds = round(time.monotonic() - begin, 1)
    return outcome


def _run(case: Case, outcome: Outcome) -> None:
    """Do what `one_run` does, and note it down; raise at the first that does not hold."""
    course, job, places = case.course, case.job, case.places
    target = course.new(job.start, places)
    run = disturb(case, target, outcome)
    code = run.wait()
    outcome.ended, outcome.said = ENDS.get(code, f"with the code {code}"), run.stderr()
    allowed = ("done", "killed") if case.fault == "kill" else ("done", "refused")
    require(outcome.ended in allowed, f"it ended {outcome.ended}: {outcome.said}")
    places.settle(target)
    number, outcome.left = state_of(course, job, target)
    commits = len(job.steps) if outcome.ended == "done" else run.reported.count(b"d")
    require(number >= commits, f"it reported {commits} commits, but the database has {number}")
    run = Running(job.whole, target)
    times = run.timed()
    if outcome.left == "absent":
        # The repeat was the whole job: what comes next is timed as the machine is now.
        course.times[job.name, places.kind] = times
    expected = REFUSED if job.once and outcome.left == "new" else 0
    require(run.wait() == expected, f"the repeat failed: {run.stderr()}")
    require(content(target) == course.states_of(job)[-1], "the repeat ended in another state")
    # Where the repeat found all there, it wrote nothing, and what lies beside a file waits for the next writer.
    strays = places.strays(target) if outcome.left != "new" else []
    require(not strays, f"left behind: {', '.join(strays)}")
    places.drop(target)


def disturb(case: Case, target: str, outcome: Outcome) -> Running:
    """Start a job and disturb it on the way, which is noted down; it may still run."""
    job, places = case.job, case.places
    if (case.fault, places.kind) in ROOM:
        return _without_room(case, target, outcome)
    times = case.course.times_of(job, places)
    stage = case.rng.choice([None, *range(len(times.writing))])
    moment = case.rng.uniform(0, times.total if stage is None else times.writing[stage][1])
    outcome.moment = f"{moment:.3f} s into {'all' if stage is None else f'its writing stage {stage + 1}'}"
    if case.fault == "kill":
        run = Running(job.whole, target)
        run.sleep(moment, stage)
        os.kill(run.process, signal.SIGKILL)
        return run
    with places.struck_by(case.fault, target) as (way, strike):
        run = Running(job.whole, way)
        run.sleep(moment, stage)
        strike()
        run.come_to_end()
    return run


def _without_room(case: Case, target: str, outcome: Outcome) -> Running:
    """Run a job while there is too little room for it, mostly."""
    job, places = case.job, case.places
    room = case.rng.randrange(ROOM[case.fault, places.kind])
    outcome.moment = f"room for {room} bytes"
    if case.fault == "limit":
        return Running(job.whole, target, lambda: limit_files(room))
    disk = next(folder for folder in places.folder.parents if folder.is_mount())
    with filled(disk, room):
        run = Running(job.whole, target)
        run.come_to_end()
    return run

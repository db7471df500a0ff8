"""What a command tells while it runs: one bar for the whole with the time left, notices, log records, a log file."""

import logging
import re
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING

import click

from msbdb.cli import output
from msbdb.errors import MsbdbWarning
from msbdb.run.reports import WORDS
from msbdb.version import __version__

if TYPE_CHECKING:
    from rich.console import RenderableType

logger = logging.getLogger(__name__)

Progress = Callable[[str, int, int], None]
"""Called with a stage's name, the steps done and the steps in all."""

SECONDS = {
    "read": 0.35,
    "surface": 0.5,
    "cover": 0.25,
    "bands": 0.2,
    "classes": 0.85,
    "adaptive": 1.4,
    "area3d": 3.4,
    "flatregions": 0.65,
    "multiscale": 0.8,
    "fusion": 0.15,
    "houses": 0.5,
    "parts": 1.0,
    "outlines": 1.9,
    "write": 0.65,
    "measure": 0.3,
    "inventory": 0.6,
}
"""Seconds that a stage takes for a million points: mean shares of Autzen's and of Nîmes' stages, on two cores.

They weigh the stages against each other; the pace is that of the machine.
"""

DETECTORS = ("adaptive", "area3d", "flatregions", "multiscale")

COMPILING = "Compiling, only the first time"

PRIOR, START_S = 0.05, 1.0
"""Share of the whole, and seconds, after which the measured pace counts more than the expected one."""

NEARLY = 0.95
"""Largest share of a stage that time alone fills; the rest comes with its end."""

WIDTH = 24
"""Characters of the bar."""


def stages_of(extract: Iterable[str], *more: str) -> dict[str, float]:
    """Return the stages of a build by these detectors, and others after them, with their expected seconds."""
    chosen = set(extract)
    left_out = {name for name in DETECTORS if name not in chosen}
    if len(chosen) < 3:
        left_out.add("houses")
    build = [name for name in SECONDS if name not in left_out and name not in ("inventory", "measure")]
    return {name: SECONDS[name] for name in [*build, *more]}


class Estimate:
    """How far a command is, and how long it will take.

    Parameters
    ----------
    plan : mapping of str to float
        The stages in their order with the seconds that are expected of each, for a million points. A stage that is not
        in the plan is all there is while it runs.

    Examples
    --------
    Half of the expected work took twice the expected time, so that the other half will, too:

    >>> clock = iter([0.0, 10.0, 20.0, 20.0])
    >>> estimate = Estimate({"read": 5.0, "write": 5.0}, now=lambda: next(clock))
    >>> estimate.advance("read", 1, 1)
    >>> estimate.advance("write", 0, 1)
    >>> share, left_s = estimate.state()
    >>> share, round(left_s)
    (0.5, 9)
    """

    def __init__(self, plan: Mapping[str, float], now: Callable[[], float] = time.monotonic) -> None:
        self._plan = dict(plan)
        self._now = now
        self._begin = self._since = now()
        self._stage, self._share, self._reached = "", 0.0, 0.0
        self._running: list[str] = []
        self._before, self._size, self._paused = 0.0, 1.0, 0.0
        self._held: float | None = None
        self._lock = Lock()

    def advance(self, stage: str, done: int, total: int) -> None:
        """Take what a command tells of a stage; of stages side by side, the one that began first is shown."""
        with self._lock:
            now = self._now()
            if not self._stage or stage not in self._plan:
                self._begin, self._paused, self._reached = now, 0.0, 0.0
            if stage not in self._plan:
                self._plan, self._size, self._running = {stage: 1.0}, 1.0, []
            if stage == "read" and total > 1:
                self._size = total / 1e6
            if done >= total:
                self._running = [name for name in self._running if name != stage]
            elif stage not in self._running:
                self._running.append(stage)
            shown = self._running[0] if self._running else stage
            if shown != self._stage:
                self._stage, self._since, self._share = shown, now, 0.0
                names = list(self._plan)
                over = [name for name in names[: names.index(shown)] if name not in self._running]
                self._before = sum(self._plan[name] for name in over)
            if shown == stage:
                self._share = done / total if total else 1.0

    def hold(self) -> None:
        """Begin a time that is left out of the pace."""
        with self._lock:
            self._held = self._now()

    def go_on(self) -> None:
        """End such a time, and leave it out."""
        with self._lock:
            if self._held is not None:
                seconds = self._now() - self._held
                self._paused += seconds
                self._since += seconds
                self._held = None

    @property
    def words(self) -> str:
        """What is being done now."""
        return WORDS.get(self._stage, self._stage.capitalize()) if self._stage else "Starting"

    def state(self) -> tuple[float, float | None]:
        """Return the share of the whole that is done, and the seconds left; None while nothing can be said."""
        with self._lock:
            now = self._now() if self._held is None else self._held
            if not self._stage:
                return 0.0, None
            if len(self._plan) == 1:
                spent = now - self._since
                return self._share, spent * (1 - self._share) / self._share if self._share else None
            whole, own = sum(self._plan.values()), self._plan[self._stage]
            expected_s, known = self._size * whole, PRIOR * self._size * whole + START_S
            pace = (self._since - self._begin - self._paused + known) / (self._size * self._before + known)
            by_time = min((now - self._since) / (pace * self._size * own), NEARLY)
            share = (self._before + own * max(self._share, by_time)) / whole
            self._reached = max(self._reached, share)
            return self._reached, pace * expected_s * (1 - self._reached)


def left_in_words(seconds: float | None) -> str:
    """Return the time left as people say it.

    Examples
    --------
    >>> [left_in_words(seconds) for seconds in (None, 3, 42, 100, 4000)]
    ['', 'a few seconds left', '40 s left', '2 min left', '1 h 7 min left']
    """
    if seconds is None:
        return ""
    if seconds < 10:
        return "a few seconds left"
    if seconds < 90:
        return f"{10 * round(seconds / 10)} s left"
    minutes = round(seconds / 60)
    return f"{minutes} min left" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min left"


@contextmanager
def progress_bar(plan: Mapping[str, float] | None = None) -> Iterator[Progress | None]:
    """Draw one bar for the whole command while the block runs, and give the callback that moves it.

    Where the standard error is no terminal, and under ``--quiet``, nothing is drawn and None is given.

    Parameters
    ----------
    plan : mapping of str to float, optional
        As for `Estimate`. It also announces the compilation of kernels, which comes once after an installation.
    """
    if output.is_quiet() or not output.on_terminal():
        yield None
        return
    from rich.live import Live

    estimate, compiling = Estimate(plan or {}), _Compiling()

    def line() -> "RenderableType":
        from rich.progress_bar import ProgressBar
        from rich.table import Table

        share, left_s = estimate.state()
        row = Table.grid(padding=(0, 1))
        for width in (max(map(len, (*WORDS.values(), COMPILING))), WIDTH, 5):
            row.add_column(width=width, no_wrap=True)
        row.add_column(no_wrap=True)
        words = COMPILING if compiling.now else estimate.words
        bar = ProgressBar(total=1, completed=share, width=WIDTH)
        row.add_row(words, bar, f"{100 * share:3.0f} %", "" if compiling.now else left_in_words(left_s))
        return row

    with Live(get_renderable=line, console=output.stderr_console(), transient=True, refresh_per_second=5):
        if plan is None:
            yield estimate.advance
            return
        from msbdb.threads import when_compiling

        with when_compiling(lambda begins: compiling.tell(begins=begins, estimate=estimate)):
            yield estimate.advance


class _Compiling:
    """Whether kernels are being compiled; several threads may compile at a time, and kernels inside of others."""

    def __init__(self) -> None:
        self.now = 0
        self._told = False
        self._lock = Lock()

    def tell(self, *, begins: bool, estimate: Estimate) -> None:
        """Count a compilation that begins or ends; the first one is announced above the bar."""
        with self._lock:
            self.now += 1 if begins else -1
            if begins and self.now == 1:
                estimate.hold()
            elif not self.now:
                estimate.go_on()
            first, self._told = begins and not self._told, True
        if first:
            line = "The first run compiles parts of the program; later ones start at once."
            output.stderr_console().print(line, style="dim")


@contextmanager
def reporting(verbose: int, ctx: click.Context, log: Path | None) -> Iterator[None]:
    """Send log records and notices to the standard error, and all of them to a file, while a command runs."""
    package = logging.getLogger("msbdb")
    before = package.level
    level = logging.ERROR if ctx.meta[output.QUIET] else (logging.WARNING, logging.INFO, logging.DEBUG)[min(verbose, 2)]
    handlers: list[logging.Handler] = [_ConsoleHandler(level)]
    if log is not None:
        ctx.meta[LOG] = log_handler(log)
        handlers.append(ctx.meta[LOG])
        level = logging.DEBUG
    for handler in handlers:
        package.addHandler(handler)
    package.setLevel(level)
    shown: set[str] = ctx.ensure_object(set)

    def show(message: Warning | str, category: type[Warning], *_: object, **__: object) -> None:
        if issubclass(category, MsbdbWarning):
            notice(str(message), shown)
        else:
            logger.info("%s: %s", category.__name__, message)

    try:
        keep(ctx, logging.INFO, f"{ctx.command_path} {__version__} begins")
        with warnings.catch_warnings():
            warnings.simplefilter("always", MsbdbWarning)
            warnings.showwarning = show
            yield
        keep(ctx, logging.INFO, f"{ctx.command_path} ends")
    finally:
        for handler in handlers:
            package.removeHandler(handler)
            handler.close()
        package.setLevel(before)


LOG = "msbdb.log"
"""Where the context of a command keeps the handler of its log file."""

LINE = re.compile(rb"\d{4}-\d{2}-\d{2} ")
"""How a log file of msbdb begins."""


def log_handler(path: Path) -> logging.FileHandler:
    """Return what adds records to a log file.

    Raises
    ------
    click.UsageError
        When the folder does not exist, or the file is there and is no log, such as a database.
    """
    if not path.parent.is_dir() or path.is_dir():
        msg = f"The log file {path} cannot be written: its folder does not exist, or it is a folder itself."
        raise click.UsageError(msg)
    if path.exists():
        with path.open("rb") as file:
            begin = file.read(11)
        if begin and not LINE.match(begin):
            msg = (
                f"{path} is there and is no log file of msbdb, so nothing is added to it. Give --log-file another name."
            )
            raise click.UsageError(msg)
    handler = logging.FileHandler(path, encoding="utf-8")
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    return handler


def keep(ctx: click.Context, level: int, message: str, failure: BaseException | None = None) -> None:
    """Add a line to the log file, where there is one; of a failure its traceback, too."""
    handler = ctx.meta.get(LOG)
    if handler is not None:
        info = None if failure is None else (type(failure), failure, failure.__traceback__)
        handler.handle(logging.LogRecord("msbdb", level, "", 0, message, None, info))


class _ConsoleHandler(logging.Handler):
    """Writes log records above the bar, a line each: steps and decisions as they are, details by their kind."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write one record."""
        kind = "" if record.levelno == logging.INFO else f"{record.levelname.lower()}: "
        line = f"{kind}{self.format(record)}"
        output.stderr_console().print(line, markup=False, highlight=False, soft_wrap=True, style="dim")


def notice(message: str, shown: set[str]) -> None:
    """Show the user a notice, once."""
    if message in shown:
        return
    shown.add(message)
    keep(click.get_current_context(), logging.WARNING, message)
    if not output.is_quiet():
        output.stderr_console().print(f"Notice: {message}", markup=False, highlight=False, soft_wrap=True)

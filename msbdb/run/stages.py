"""Stages of a run: their names, timings and progress, and the notices that arise in them."""

import logging
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from msbdb.errors import MsbdbWarning, PassingNotice

logger = logging.getLogger(__name__)

Progress = Callable[[str, int, int], None]
"""Called with the stage's name, the steps done and the steps in all."""

STAGES = (
    "read",
    "surface",
    "cover",
    "bands",
    "classes",
    "adaptive",
    "area3d",
    "flatregions",
    "multiscale",
    "fusion",
    "parts",
    "outlines",
    "write",
)
"""The stages of a build in their order; those of the detectors have the detectors' names."""


class Stages:
    """Times the stages of one run and reports them to the caller.

    Parameters
    ----------
    progress : callable, optional
        Called when a stage begins and ends.
    """

    def __init__(self, progress: Progress | None) -> None:
        self.timings: dict[str, float] = {}
        self.progress = progress

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time one stage; stages of the same name add up."""
        begin = time.perf_counter()
        self._report(name, 0)
        yield
        seconds = time.perf_counter() - begin
        self.timings[name] = self.timings.get(name, 0.0) + seconds
        self._report(name, 1)
        logger.info("%s: %.2f s", name, seconds)

    def rounded(self) -> dict[str, float]:
        """Return the timings for a report, seconds."""
        return {name: round(seconds, 3) for name, seconds in self.timings.items()}

    def _report(self, name: str, done: int) -> None:
        """Report a stage's state."""
        if self.progress is not None:
            self.progress(name, done, 1)


@dataclass(slots=True)
class Notices:
    """What a person should know, in the order in which it arose.

    Attributes
    ----------
    kept : list of str
        Those that the run keeps in the database.
    passing : list of str
        Those of this call alone, which the run does not keep.
    """

    kept: list[str] = field(default_factory=list)
    passing: list[str] = field(default_factory=list)


@contextmanager
def collect_notices(notices: Notices) -> Iterator[None]:
    """Collect the notices that arise inside: warnings of the kind `MsbdbWarning`. Other warnings pass.

    Parameters
    ----------
    notices : Notices
        Receives them when the block ends without an error.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", MsbdbWarning)
        yield
    for warning in caught:
        if issubclass(warning.category, PassingNotice):
            notices.passing.append(str(warning.message))
        elif issubclass(warning.category, MsbdbWarning):
            notices.kept.append(str(warning.message))
        else:
            warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)

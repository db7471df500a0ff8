"""Stages of a run: their names, timings and progress."""

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from msbdb.params import POINT_DETECTORS

logger = logging.getLogger(__name__)

Progress = Callable[[str, int, int], None]
"""Called with the stage's name, the steps done and the steps in all."""

STAGES = (
    "read",
    "surface",
    "cover",
    "flat regions",
    "bands",
    *POINT_DETECTORS,
    "classes",
    "parts",
    "together",
    "outlines",
    "write",
)


class Stages:
    """Times the stages of one run and tells the caller of them.

    Parameters
    ----------
    progress : callable, optional
        Told when a stage begins and ends.
    """

    def __init__(self, progress: Progress | None) -> None:
        self.timings: dict[str, float] = {}
        self.progress = progress

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time one stage; stages of the same name add up."""
        begin = time.perf_counter()
        self._tell(name, 0)
        yield
        seconds = time.perf_counter() - begin
        self.timings[name] = self.timings.get(name, 0.0) + seconds
        self._tell(name, 1)
        logger.info("%s: %.2f s", name, seconds)

    def _tell(self, name: str, done: int) -> None:
        """Report a stage's state."""
        if self.progress is not None:
            self.progress(name, done, 1)

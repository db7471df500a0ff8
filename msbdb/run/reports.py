"""What a run reports: the stages with progress and timings, the notices that arise in them, and the results."""

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

from msbdb.errors import PassingNotice, collected_notices

if TYPE_CHECKING:
    import geopandas as gpd


logger = logging.getLogger(__name__)

Progress = Callable[[str, int, int], None]
"""Called with the stage's name, the steps done and the steps in all."""

STAGES = {
    "read": "Reading the files",
    "surface": "Surface and ground",
    "cover": "Roofs and vegetation",
    "bands": "Colours",
    "classes": "Land-cover classes",
    "adaptive": "Detector adaptive",
    "area3d": "Detector area3d",
    "flatregions": "Detector flatregions",
    "multiscale": "Detector multiscale",
    "fusion": "All detectors together",
    "houses": "Dividing houses",
    "parts": "Trees of parts",
    "outlines": "Outlines and heights",
    "write": "Writing",
}
"""The stages of a build in their order, in words; those of the detectors have the detectors' names."""

WORDS = STAGES | {
    "tiles": "Building the tiles",
    "inventory": "Updating the inventory",
    "measure": "Measuring the footprints",
    "check": "Checking",
    "copy": "Copying",
}
"""All stages that a progress may name, in words."""


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
        logger.info("%s: %.1f s", WORDS.get(name, name), seconds)

    @contextmanager
    def side_by_side(self) -> Iterator[None]:
        """Share the time of the block among the stages that run in it at once, so that all add up to the whole."""
        before, begin = dict(self.timings), time.perf_counter()
        yield
        spent = {name: seconds - before.get(name, 0.0) for name, seconds in self.timings.items()}
        share = min(1.0, (time.perf_counter() - begin) / max(sum(spent.values()), 1e-9))
        self.timings = {name: before.get(name, 0.0) + share * seconds for name, seconds in spent.items()}

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
    """Collect the notices that arise inside, also in threads.

    Parameters
    ----------
    notices : Notices
        Receives them when the block ends without an error.
    """
    with collected_notices() as found:
        yield
    for notice in found:
        (notices.passing if isinstance(notice, PassingNotice) else notices.kept).append(str(notice))


@dataclass(frozen=True, slots=True)
class Overview:
    """What a person wants to know of a build first.

    Attributes
    ----------
    states : dict of str to int
        Buildings by state.
    largest, highest : dict
        The building of the largest area, and that of the highest ridge: ``building_id``, ``easting``, ``northing``,
        ``area_m2`` and ``ridge_m``. Empty without buildings.
    refused_m2 : dict of str to float
        Area that is as high as a building and is none, by the decisive reason in words, the largest first.
    refused_regions : int
        Refused regions as large as a building: the rows of the ledger.
    unsure : tuple of dict
        The largest unsure buildings, at most `FIRST`, with the values of ``largest`` and ``probability``.
    uneven : tuple of dict
        Buildings whose ground is unsure, by `GROUND_RANGE_M`, at most `FIRST`, with the values of ``largest`` and
        ``ground_range_m``.
    counts : dict of str to int
        Of ``unsure`` and ``uneven``, all of them.
    """

    states: dict[str, int]
    largest: dict[str, float | int]
    highest: dict[str, float | int]
    refused_m2: dict[str, float]
    refused_regions: int
    unsure: tuple[dict[str, float | int | None], ...]
    uneven: tuple[dict[str, float | int | None], ...]
    counts: dict[str, int]


FIRST = 3
"""Buildings of a kind that an overview names."""

GROUND_RANGE_M = 3.0
"""Ours: where the ground around a building differs by more than a storey, its height depends on the side."""


@dataclass(frozen=True, slots=True)
class BuildReport:
    """What a build did: counts, an overview, notices, seconds a stage, and whether the database changed."""

    survey: str
    buildings: int
    parts: int
    flat_regions: int
    candidate_regions: dict[str, int]
    rejected: int
    notices: tuple[str, ...]
    timings: dict[str, float]
    changed: bool
    database: str
    overview: Overview

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return asdict(self)


@dataclass(frozen=True, slots=True)
class AdvanceReport:
    """What an update did to the inventory.

    ``status`` is 'created', 'replaced' or 'unchanged'; ``counts`` has the buildings by kind of change and the
    ``versions`` that were written; ``offset`` is the measured offset of the survey to the inventory.
    """

    survey: str
    date: str
    status: str
    counts: dict[str, int]
    offset: dict[str, float | int | None]
    notices: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return asdict(self)


@dataclass(frozen=True, slots=True)
class UpdateReport:
    """What the build of a survey did, None where it was built already, and the update of the inventory by it."""

    build: BuildReport | None
    inventory: AdvanceReport

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {"build": None if self.build is None else self.build.as_dict(), "inventory": self.inventory.as_dict()}


@dataclass(frozen=True, slots=True)
class ClassifyReport:
    """What a classification did.

    Attributes
    ----------
    points, read : int
        Points of the file, and those that were read: noise, withheld and lone points are not, and keep their class.
    building_points : int
        Points that were found to be buildings.
    ground_points : int
        Points that were found to be ground; 0 where that was not asked for.
    changed : int
        Points whose class is another than before.
    demoted : int
        Points that were buildings before, and are unclassified now.
    regions : dict
        Buildings, flat regions or candidate regions that each detector found.
    notices : tuple of str
        Sentences for people.
    timings : dict
        Seconds a stage.
    """

    points: int
    read: int
    building_points: int
    ground_points: int
    changed: int
    demoted: int
    regions: dict[str, int]
    notices: tuple[str, ...]
    timings: dict[str, float]

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return asdict(self)


@dataclass(frozen=True, slots=True)
class ImportReport:
    """What an import did: ``status`` is 'created' or 'unchanged', ``rows`` counts buildings or samples."""

    name: str
    date: str
    status: str
    rows: int

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return asdict(self)


@dataclass(frozen=True, slots=True)
class MeasureReport:
    """What measuring footprints on a survey did.

    Attributes
    ----------
    survey, name : str
        The survey, and the name that the footprints have in the inventory.
    status : str
        'created', or 'unchanged' where the same measures were there already.
    footprints : int
        Footprints of the file; each has its row.
    states : dict of str to int
        Footprints by state.
    unseen : int
        Those that the survey has too few heights on; they are unsure.
    others : int
        Detected buildings without a footprint.
    database : str
        The database.
    build : BuildReport or None
        The build of the survey; None where it was built already.
    """

    survey: str
    name: str
    status: str
    footprints: int
    states: dict[str, int]
    unseen: int
    others: int
    database: str
    build: BuildReport | None

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return asdict(self)


@dataclass(frozen=True, slots=True, eq=False)
class Changes:
    """Changes between two dates.

    Parameters
    ----------
    table : GeoDataFrame
        A row for each building that a survey covered (a pair of buildings for merged and split): the net change
        (`msbdb.change.netchange`), or the changes by each survey (`msbdb.database.read_changes`).
        Buildings within an area of interest that no survey covered follow as 'not surveyed'. In the changes by each
        survey, those of the first survey of a place are 'first seen'.
    counts : dict
        The rows by kind.
    in_between : int
        Buildings that were new and then demolished between the dates; the net change has no row of them.
    """

    table: "gpd.GeoDataFrame"
    counts: dict[str, int]
    in_between: int

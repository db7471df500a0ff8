"""The records of a build besides its tables: survey, source files, run, counts, and the values of its reasons."""

from dataclasses import dataclass, field
from enum import IntEnum


@dataclass(frozen=True, slots=True)
class Source:
    """One input file of a survey."""

    name: str
    role: str
    sha256: str
    bytes: int


@dataclass(frozen=True, slots=True)
class Survey:
    """A survey: place and date of the data, and the source files.

    ``date`` is ISO 8601 or empty; ``density`` is in first echoes per square metre (0 for rasters); ``bounds`` are
    west, south, east and north in metres; ``cell_m`` is the lattice's cell.
    """

    name: str
    date: str
    crs_wkt: str
    epsg: int
    vertical_crs: str
    density: float
    cell_m: float
    bounds: tuple[float, float, float, float]
    sources: tuple[Source, ...]


@dataclass(frozen=True, slots=True)
class Counts:
    """What a run counted and chose by itself.

    Parameters
    ----------
    regions : dict
        By detector and stage: regions ``in``, ``kept`` and ``dropped``.
    cells : dict
        Cells of the lattice: all, valid, and of each class label.
    cover : dict
        Whether colours alone decide the classes, and whether green has priority over structure: 0 or 1.
    stated : dict
        What the user stated about the files.
    chosen : dict
        The ground filter, the scales, and the fit of the classes by colour (V21, X2).
    """

    regions: dict[str, dict[str, dict[str, int]]] = field(default_factory=dict)
    cells: dict[str, int] = field(default_factory=dict)
    cover: dict[str, int] = field(default_factory=dict)
    stated: dict[str, str] = field(default_factory=dict)
    chosen: dict[str, object] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Run:
    """The run that built a survey.

    ``methods`` names its detectors in alphabetical order: ``("multiscale",)`` or ``("flatregions", "multiscale")``.
    ``parameters`` are nested plain dictionaries; ``timings`` are seconds of each stage;
    the canonical dump leaves them out, because they differ between equal runs. ``notices`` are sentences for people.
    """

    methods: tuple[str, ...]
    profile: str
    version: str
    parameters: dict[str, object]
    counts: Counts
    timings: dict[str, float]
    notices: tuple[str, ...]


class Reason(IntEnum):
    """The decisive reason of a cell; ``REASONS`` has its meaning."""

    NO_DATA = 0
    BUILDING = 1
    LOW = 2
    SMALL = 3
    VEGETATION_BY_STRUCTURE = 4
    VEGETATION_BY_COLOUR = 5
    OTHER_CLASS = 6
    UNSUPPORTED = 7
    HARDLY_SUPPORTED = 8
    OUTVOTED = 9
    SMALL_PART = 10
    UNLIKE_PART = 11
    GAP = 12
    NO_PARTS = 13


REASONS = {
    Reason.NO_DATA: "no height is known, because no echo is near",
    Reason.BUILDING: "a building",
    Reason.LOW: "lower than the least height of a building",
    Reason.SMALL: "the object is smaller than the least area of a building",
    Reason.VEGETATION_BY_STRUCTURE: "vegetation by the echoes and the texture of the surface",
    Reason.VEGETATION_BY_COLOUR: "vegetation by colour",
    Reason.OTHER_CLASS: "the class of land cover is labelled as no building",
    Reason.UNSUPPORTED: "no detector takes it for a building",
    Reason.HARDLY_SUPPORTED: "too few detectors take it for a building",
    Reason.OUTVOTED: "enough detectors take it for a building, but it is rough, small, or beyond a building's edge",
    Reason.SMALL_PART: "a part of a building smaller than the finest scale",
    Reason.UNLIKE_PART: "a part with too few cells of building classes",
    Reason.GAP: "a gap between the parts of a larger region",
    Reason.NO_PARTS: "the multi-scale detector, which makes the buildings, was not run",
}
"""What each reason means."""

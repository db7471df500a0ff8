"""The values that go into the database besides the tables: a survey, its sources, the run, and the whole build."""

from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class Source:
    """One input file of a survey."""

    name: str
    role: str
    sha256: str
    bytes: int


@dataclass(frozen=True, slots=True)
class Survey:
    """A survey: where and when the data were taken, and from which files.

    ``date`` is ISO 8601 or empty; ``density`` is in first echoes a square metre (0 for rasters); ``bounds`` are
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
    """What a run counted, and what it decided itself.

    Parameters
    ----------
    regions : dict
        By detector and stage: regions ``in``, ``kept`` and ``dropped``.
    cells : dict
        Cells of the lattice: all, valid, and a class label each.
    cover : dict
        Whether colours alone decide the classes, and whether green overrules structure: 0 or 1.
    stated : dict
        What the user stated of the files.
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

    ``methods`` names its extractors in alphabetical order: ``("multiscale",)`` or ``("flatregions", "multiscale")``.
    ``parameters`` are nested plain dictionaries; ``timings`` are seconds a stage (and stay out of the
    canonical dump, as they are the one thing that differs between equal runs). ``notices`` are sentences for people.
    """

    methods: tuple[str, ...]
    profile: str
    version: str
    parameters: dict[str, object]
    counts: Counts
    timings: dict[str, float]
    notices: tuple[str, ...]

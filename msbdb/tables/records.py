"""The records of a build besides its tables: the survey, its source files, the run and its counts."""

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

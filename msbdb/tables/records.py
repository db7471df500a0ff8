"""The values that go into the database besides the tables: a survey, its sources, the run, and the whole build."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray


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
class Run:
    """The run that built a survey.

    ``methods`` names its extractors in alphabetical order: ``("multiscale",)`` or ``("flatregions", "multiscale")``.
    ``parameters`` and ``counts`` are nested plain dictionaries; ``timings`` are seconds a stage (and stay out of the
    canonical dump, as they are the one thing that differs between equal runs). ``notices`` are sentences for people.
    """

    methods: tuple[str, ...]
    profile: str
    version: str
    parameters: dict[str, object]
    counts: dict[str, object]
    timings: dict[str, float]
    notices: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Build:
    """All that one build writes into the database, in one transaction.

    ``frames`` holds one frame for each of ``TABLES`` by name (GeoDataFrames where the table has a geometry).
    ``state`` holds named rasters of the run, from which classes can be re-labelled without the source data.
    """

    survey: Survey
    run: Run
    frames: dict[str, pd.DataFrame]
    state: dict[str, NDArray[np.generic]]

"""What the public functions return: counts, notices and seconds a stage, as plain values."""

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import geopandas as gpd


@dataclass(frozen=True, slots=True)
class BuildReport:
    """What a build did: counts, notices, seconds a stage, and whether the database changed."""

    survey: str
    buildings: int
    parts: int
    flat_regions: int
    candidate_regions: dict[str, int]
    rejected: int
    notices: tuple[str, ...]
    timings: dict[str, float]
    changed: bool

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


@dataclass(frozen=True, slots=True, eq=False)
class Changes:
    """Changes between two dates.

    Parameters
    ----------
    table : GeoDataFrame
        A row for each building that a survey covered (a pair of buildings for merged and split): the net change
        (`msbdb.change.netchange`), or the changes by each survey (`msbdb.database.read_changes`).
        Buildings within an area of interest that no survey covered follow as 'not surveyed'.
    counts : dict
        The rows by kind.
    in_between : int
        Buildings that were new and then demolished between the dates; the net change has no row of them.
    """

    table: "gpd.GeoDataFrame"
    counts: dict[str, int]
    in_between: int

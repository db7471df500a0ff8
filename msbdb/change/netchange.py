"""The net change between two dates: the changes of a building by several surveys, as one change."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import groupby
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely

from msbdb.change.differences import moved
from msbdb.tables import ACROSS, FIRST_SURVEY

RELATED_SHARE = 0.3
"""Buildings that were merged or split on the way are related at the end when they share this much of the smaller; a
strip along a common wall is less."""

STATES = ("state", "probability", "storeys", "h_max", "h_p90", "area_m2", "volume_m3", "attributes")
"""Attributes of a building before and after."""

FIRST_SEEN = "first seen"
"""Kind of a building in the first survey of its place: its first state is the beginning there, not a change."""

NO_CHANGE = ("unchanged", FIRST_SEEN)

COLUMNS = (
    "kind", "uid_before", "uid_after", "version_before", "version_after", "outline", "height", "parts", "times",
    "overlap_m2", "iou", "dh_m", "darea_m2", "survey", "date", "note",
)  # fmt: skip
"""The columns of a net change, before those of `STATES`."""

_TYPES = (
    dict.fromkeys(("uid_before", "uid_after", "version_before", "version_after"), "Int64")
    | dict.fromkeys(("storeys_before", "storeys_after"), "Int64")
    | dict.fromkeys(("outline", "height", "parts"), "bool")
    | {"times": "int64"}
)

_NOTHING: dict[str, Any] = {"outline": False, "height": False, "parts": False}


@dataclass(frozen=True, slots=True, eq=False)
class Net:
    """The net change.

    Parameters
    ----------
    table : GeoDataFrame
        A row for each building, or pair of buildings for ``merged`` and ``split``: `COLUMNS`, and each of `STATES` with
        ``_before`` and ``_after``. ``times`` counts the surveys that changed it; ``survey`` and ``date`` are of the
        last one of them, or of the last one that saw an unchanged building.
    passing : GeoDataFrame
        The last versions of the buildings that came and went in between.
    """

    table: gpd.GeoDataFrame
    passing: gpd.GeoDataFrame


@dataclass(frozen=True, slots=True)
class _Trail:
    """The changes of a building through the surveys of the period: which, how often, when last, and the notes."""

    outline: bool = False
    height: bool = False
    parts: bool = False
    times: int = 0
    survey: str = ""
    date: str = ""
    notes: tuple[str, ...] = ()

    def after(self, row: dict[str, Any]) -> "_Trail":
        """Return the trail with a survey's row behind it."""
        changed = row["kind"] not in NO_CHANGE
        note = (row["note"],) if row["note"] and row["note"] not in self.notes else ()
        found = replace(
            self,
            outline=self.outline or bool(row["outline"]),
            height=self.height or bool(row["height"]),
            parts=self.parts or bool(row["parts"]),
            times=self.times + changed,
            notes=self.notes + note,
        )
        if changed or not self.times:
            found = replace(found, survey=row["survey"], date=row["date"])
        return found


Origins = dict[int, _Trail]
"""The buildings of the beginning from which one came, with the way of each; none for one that was built since."""


@dataclass(slots=True, eq=False)
class _Chains:
    """The buildings followed through the surveys.

    ``standing`` has the origins of each building that exists now, and ``born`` its trail in case no origin is left.
    ``begins`` has the version of each building of the beginning, and ``latest`` its trail, even if it is gone.
    ``current`` has the version of each building now, and ``passing`` the last versions of those that came and went.
    """

    standing: dict[int, Origins] = field(default_factory=dict)
    born: dict[int, _Trail] = field(default_factory=dict)
    begins: dict[int, int] = field(default_factory=dict)
    current: dict[int, int] = field(default_factory=dict)
    latest: dict[int, _Trail] = field(default_factory=dict)
    passing: list[int] = field(default_factory=list)

    def follow(self, rows: list[dict[str, Any]]) -> None:
        """Go through one survey's rows, which happen at once."""
        arrived: dict[int, Origins] = {}
        fresh: dict[int, _Trail] = {}
        left: set[int] = set()
        for row in rows:
            before, after = row["uid_before"], row["uid_after"]
            origins, trail = self._from(row)
            if before is not None:
                left.add(before)
            self.latest.update(origins)
            if after is None:
                if not origins:
                    self.passing.append(row["version_before"])
                continue
            self.current[after] = row["version_after"]
            arrived.setdefault(after, {}).update(origins)
            fresh.setdefault(after, trail)
        for uid, origins in arrived.items():
            # A piece beyond the border of an earlier survey may arrive in a building that stands.
            if uid in self.standing and uid not in left:
                arrived[uid] = self.standing[uid] | origins
        for uid in left:
            self.standing.pop(uid, None)
            self.born.pop(uid, None)
        self.standing.update(arrived)
        self.born.update(fresh)

    def _from(self, row: dict[str, Any]) -> tuple[Origins, _Trail]:
        """Return the origins of a row's building, and the row's own trail, each with the row behind it."""
        before, after = row["uid_before"], row["uid_after"]
        if before is None and row["kind"] in NO_CHANGE:
            # It is older than this survey, which detects it or surveys its place for the first time.
            self.begins[after] = row["version_after"]
            trail = _Trail().after(row | {"note": ""} if row["kind"] == FIRST_SEEN else row)
            return {after: trail}, trail
        if before is None:
            return {}, _Trail().after(row)
        if before not in self.standing:
            self.begins[before] = row["version_before"]
            self.standing[before] = {before: _Trail()}
        origins = {origin: trail.after(row) for origin, trail in self.standing[before].items()}
        return origins, self.born.get(before, _Trail()).after(row)


def with_beginnings(rows: gpd.GeoDataFrame, events: gpd.GeoDataFrame, since: str | None) -> gpd.GeoDataFrame:
    """Return the changes with `FIRST_SEEN` for 'new' where a survey is the first one of its place.

    Parameters
    ----------
    rows : GeoDataFrame
        From `msbdb.database.read_changes`.
    events : GeoDataFrame
        All imports and updates: ``kind``, ``date`` and area.
    since : str, optional
        The day with whose state a later one is compared. Before the first event the inventory was empty: then all
        buildings are new.

    Returns
    -------
    GeoDataFrame
        The same rows. A building that an import of the same place lacks stays new.
    """
    if since is not None and not (events["date"] <= since).any():
        return rows
    first = (rows["kind"] == "new") & rows["note"].str.contains(FIRST_SURVEY, regex=False)
    imported = events.loc[events["kind"] == "import"].geometry.union_all()
    rows = rows.copy()
    rows.loc[first & ~rows.representative_point().intersects(imported), "kind"] = FIRST_SEEN
    return rows


def net_changes(rows: pd.DataFrame, versions: gpd.GeoDataFrame, offsets: pd.DataFrame) -> Net:
    """Return the net change of a period.

    Parameters
    ----------
    rows : DataFrame
        The changes of the surveys of the period from `msbdb.database.read_changes`, survey by survey in their order;
        those of `with_beginnings` have `FIRST_SEEN` buildings.
    versions : GeoDataFrame
        The versions that the rows name: ``version_id``, ``survey_id``, `STATES`, and outlines in metres.
    offsets : DataFrame
        The offset of each survey to the inventory: ``survey_id``, ``dx_m``, ``dy_m``, ``dz_m``.

    Returns
    -------
    Net
        Buildings of the beginning in order of their uid, then those that were built since.

    Notes
    -----
    - A building that surveys modified twice is modified once: in all that either of them modified. ``dh_m`` is the
      difference of ``h_p90``, and ``darea_m2`` that of the area, between its first and its last state; ``overlap_m2``
      and ``iou`` are of both outlines. Surveys' offsets are taken out of heights and outlines.
    - Buildings that were merged and split are followed through all of their identities. A pair is reported when both
      share `RELATED_SHARE` of the smaller at the end. Buildings that were joined and divided again are no pair. A part
      that was joined and then pulled down was demolished.
    - The first row of a building gives its state at the beginning. So an import within the period counts as older than
      the period, and so does an older building that is detected for the first time, or first seen.
    """
    chains = _Chains()
    plain = pd.DataFrame(rows).drop(columns="geometry", errors="ignore").astype(object)
    records: list[dict[str, Any]] = plain.where(plain.notna(), None).to_dict(orient="records")  # type: ignore[assignment]  # names are str
    records = _joined(records)
    for _, group in groupby(records, key=lambda row: (row["date"], row["survey"])):
        chains.follow(list(group))
    known = _Versions(versions, offsets)
    # Ids beyond 2^53 must not become floats.
    frame = pd.DataFrame(list(_rows(chains, known)), columns=[*COLUMNS, *known.columns()], dtype=object)
    shapes = known.outlines(frame["version_after"].where(frame["version_after"].notna(), frame["version_before"]))
    table = gpd.GeoDataFrame(_typed(frame), geometry=shapes, crs=versions.crs)
    passing = versions[versions["version_id"].isin(chains.passing)]
    return Net(table, passing.sort_values("version_id", ignore_index=True))


def _joined(records: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the rows of changes with whole buildings in place of pieces that were joined across a border.

    A piece that begins in the period begins as its building does.
    """
    joins = {row["version_before"]: row for row in records if (row["note"] or "").startswith(ACROSS)}
    made = {row["version_after"] for row in records if row["version_after"] != row["version_before"]}
    found = []
    for row in records:
        if joins.get(row["version_before"]) is row and row["version_before"] in made:
            continue
        whole = row
        while whole["version_after"] in joins:
            whole = joins[whole["version_after"]]
        found.append(row | {name: whole[name] for name in ("uid_after", "version_after")})
    return found


def _rows(chains: _Chains, known: "_Versions") -> Iterator[dict[str, Any]]:
    """Yield the rows of the table."""
    pairs = _related(chains, known)
    heirs: dict[int, list[int]] = {}
    origins: dict[int, list[int]] = {}
    for first, last in pairs:
        heirs.setdefault(first, []).append(last)
        origins.setdefault(last, []).append(first)
    for first in sorted(chains.begins):
        for last in sorted(heirs.get(first, [])):
            trail = chains.standing[last][first]
            kind = "modified" if trail.outline or trail.height or trail.parts else "unchanged"
            if len(origins[last]) > 1 or len(heirs[first]) > 1:
                kind = "merged" if len(origins[last]) > 1 else "split"
            yield known.row(kind, first, last, chains, trail)
        if first not in heirs:
            yield known.row("demolished", first, None, chains, replace(chains.latest[first], **_NOTHING))
    for last in sorted(set(chains.standing) - set(origins)):
        yield known.row("new", None, last, chains, replace(chains.born[last], **_NOTHING))


def _related(chains: _Chains, known: "_Versions") -> list[tuple[int, int]]:
    """Return the pairs of buildings of the beginning and of the end that are one, or were merged or split."""
    pairs = [(first, last) for last, origins in chains.standing.items() for first in origins]
    starts, ends = (pd.Series([pair[side] for pair in pairs], dtype="int64").value_counts() for side in (0, 1))
    simple = [pair for pair in pairs if starts[pair[0]] == ends[pair[1]] == 1]
    involved = [pair for pair in pairs if starts[pair[0]] > 1 or ends[pair[1]] > 1]
    kept = [
        (first, last)
        for first, last in involved
        if known.share(chains.begins[first], chains.current[last]) >= RELATED_SHARE
    ]
    return simple + kept


@dataclass(eq=False)
class _Versions:
    """The versions by their id, each in the place and at the height that it has without its survey's offset."""

    versions: gpd.GeoDataFrame
    offsets: pd.DataFrame

    def __post_init__(self) -> None:
        """Find each version's row and offset."""
        self.place = {int(version): row for row, version in enumerate(self.versions["version_id"])}
        shift = self.offsets.set_index("survey_id")[["dx_m", "dy_m", "dz_m"]]
        self.shifts = shift.reindex(self.versions["survey_id"].astype("float64")).fillna(0.0).to_numpy()
        self.shapes = self.versions.geometry.to_numpy()
        self.states = {name: self.versions[name].tolist() for name in STATES}

    def columns(self) -> list[str]:
        """Return the names of the states' columns."""
        return [f"{name}_{side}" for name in STATES for side in ("before", "after")]

    def outlines(self, versions: pd.Series) -> list[shapely.Geometry]:
        """Return the outlines as they are stored."""
        return [self.shapes[self.place[int(version)]] for version in versions]

    def share(self, one: int, two: int) -> float:
        """Return how much of the smaller of two outlines the other one covers."""
        return self._common(one, two)[0] / min(
            float(shapely.area(self.shapes[self.place[version]])) for version in (one, two)
        )

    def row(self, kind: str, first: int | None, last: int | None, chains: _Chains, trail: _Trail) -> dict[str, Any]:
        """Return a row of the table."""
        one = None if first is None else chains.begins[first]
        two = None if last is None else chains.current[last]
        row: dict[str, Any] = {
            "kind": kind, "uid_before": first, "uid_after": last, "version_before": one, "version_after": two,
            "outline": trail.outline, "height": trail.height, "parts": trail.parts, "times": trail.times,
            "survey": trail.survey, "date": trail.date, "note": "; ".join(trail.notes),
        }  # fmt: skip
        for side, version in (("before", one), ("after", two)):
            at = None if version is None else self.place[version]
            row |= {f"{name}_{side}": None if at is None else values[at] for name, values in self.states.items()}
        shared, iou, area = self._common(one, two)
        height = self._height(two) - self._height(one)
        return row | {"overlap_m2": shared, "iou": iou, "darea_m2": area, "dh_m": height}

    def _height(self, version: int | None) -> float:
        """Return a version's height; zero without a building."""
        if version is None:
            return 0.0
        at = self.place[version]
        value = self.states["h_p90"][at]
        return float("nan") if pd.isna(value) else float(value - self.shifts[at, 2])

    def _common(self, one: int | None, two: int | None) -> tuple[float, float, float]:
        """Return the area that two versions share, its share of what either covers, and the second less the first."""
        areas = [0.0 if v is None else float(self.states["area_m2"][self.place[v]]) for v in (one, two)]
        if one is None or two is None:
            return 0.0, 0.0, areas[1] - areas[0]
        if one == two:
            return areas[0], 1.0, 0.0
        first, second = (self._moved_back(version) for version in (one, two))
        shared = float(shapely.intersection(first, second).area)
        either = float(shapely.area(shapely.union(first, second)))
        return shared, shared / either, areas[1] - areas[0]

    def _moved_back(self, version: int) -> shapely.Geometry:
        at = self.place[version]
        dx, dy, _ = self.shifts[at]
        shape: shapely.Geometry = moved(np.array([self.shapes[at]], dtype=object), -dx, -dy)[0]
        return shape


def _typed(frame: pd.DataFrame) -> pd.DataFrame:
    """Return the rows in settled dtypes."""
    numbers = [
        f"{name}_{side}"
        for name in ("probability", "h_max", "h_p90", "area_m2", "volume_m3")
        for side in ("before", "after")
    ]
    numbers += ["overlap_m2", "iou", "dh_m", "darea_m2"]
    return frame.astype(_TYPES | dict.fromkeys(numbers, "float64"))

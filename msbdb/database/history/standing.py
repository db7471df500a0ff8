"""The state of the inventory that an update starts from, and whether the update may be applied."""

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import shapely
from numpy.typing import NDArray
from sqlalchemy import ColumnElement, Connection, Engine, func, or_, select

from msbdb.database.dialects.connection import snapshot
from msbdb.database.history.joins import joined_by, leaves_of, read_members
from msbdb.database.history.periods import (
    read_before,
    read_began,
    read_born,
    read_decided,
    read_events,
    read_offsets,
    read_versions,
)
from msbdb.database.schema.sqltables import SQL
from msbdb.errors import InputError
from msbdb.identity import text_id
from msbdb.tables import ACROSS

if TYPE_CHECKING:
    import geopandas as gpd
    import pandas as pd

BUILDING_CHANGE = SQL["building_change"]

BUILDING_VERSION = SQL["building_version"]

INVENTORY_EVENT = SQL["inventory_event"]

RUN = SQL["run"]

SURVEY = SQL["survey"]

SEAM_SHARE = 0.02
"""Surveys that share at most this part of the smaller one are neighbours: they may be applied in any order."""

RIM_SHARE = 0.3
"""Tiles of one day that share at most this part of the smaller one are neighbours, too: tiles may have a rim."""

SEAM_M = 3.0
"""Surveys side by side may end this far apart: a few cells, where the last points lie inside of the border."""


@dataclass(frozen=True, slots=True)
class Basis:
    """The basis of an update: the run of its survey, and the events in the survey's area."""

    run_sha256: str
    events: tuple[tuple[int, str], ...]


@dataclass(frozen=True, slots=True, eq=False)
class Standing:
    """The state of the inventory in a survey's area, from which an update starts.

    Parameters
    ----------
    digest : str
        Digest of everything that determines the update's result, except the inventory: updates are applied in order.
    basis : Basis
        The basis of the update.
    applied : mapping, optional
        Counts of the same update if it was applied already.
    before, born : GeoDataFrame
        See `Advance`; ``before`` has all columns of ``building_version``. Buildings of surveys beside this one that end
        at the border are left out: the survey shows a strip of them at most.
    events : GeoDataFrame
        The updates of this area by other surveys, the latest first, without surveys beside this one.
    offsets : DataFrame
        ``survey_offset``.
    known : GeoDataFrame
        The current versions in the area and close to it, with ``survey`` and ``began``, the building's first day.
        In place of versions that are joined across a border, and may be joined anew, it has those before them.
    loose : frozenset of int
        The versions among them that may be joined anew.
    released : tuple of int
        The joined versions that are made anew.
    decided : frozenset of int
        The buildings on which an operator decided.
    """

    digest: str
    basis: Basis
    applied: dict[str, int] | None
    before: "gpd.GeoDataFrame"
    born: "gpd.GeoDataFrame"
    events: "gpd.GeoDataFrame"
    offsets: "pd.DataFrame"
    known: "gpd.GeoDataFrame"
    loose: frozenset[int]
    released: tuple[int, ...]
    decided: frozenset[int]


def survey_key(survey: str) -> int:
    """Return a survey's key."""
    return text_id("survey", survey)


def read_standing(
    engine: Engine, survey: str, date: str, bounds: tuple[float, float, float, float], area: shapely.MultiPolygon
) -> Standing:
    """Read the state from which an update by a survey is computed.

    Parameters
    ----------
    engine : Engine
        From ``open_database``.
    survey, date : str
        Its name and day.
    bounds : tuple of float
        Its west, south, east and north, metres.
    area : MultiPolygon
        Area of the update.

    Raises
    ------
    InputError
        When a later survey was applied to the same area already.
    """
    survey_id = survey_key(survey)
    with snapshot(engine) as connection:
        basis = basis_of(connection, survey_id, area)
        digest = _digest(basis, date, area)
        applied = _applied(connection, survey_id, digest)
        if applied is None:
            _require_last(connection, survey, survey_id, date, area)
        events = read_events(connection)
        others = events["number"].isin([number for number, _ in basis.events]) & (events["kind"] == "update")
        others &= events["survey_id"].fillna(0) != survey_id
        beside = _beside(events[others], area, date)
        west, south, east, north = bounds
        around = (west - SEAM_M, south - SEAM_M, east + SEAM_M, north + SEAM_M)
        known = read_before(connection, around, survey_id)
        known, loose, released = _unjoined(connection, known, survey_id, set(beside))
        names = {int(key): str(name) for key, name in connection.execute(select(SURVEY.c.survey_id, SURVEY.c.name))}
        known["survey"] = [None if key is None else names[key] for key in _plain_keys(known["survey_id"])]
        known["began"] = known["uid"].map(read_began(connection, known["uid"].tolist()))
        return Standing(
            digest=digest,
            basis=basis,
            applied=applied,
            before=_compared(known, shapely.box(*bounds), beside),
            born=read_born(connection, survey_id),
            events=events[others & ~events["survey_id"].isin(list(beside))].sort_values(
                ["date", "number"], ascending=False
            ),
            offsets=read_offsets(connection),
            known=known,
            loose=loose,
            released=released,
            decided=read_decided(connection, known["uid"].tolist()),
        )


def _plain_keys(column: "pd.Series[int]") -> list[int | None]:
    """Return keys as plain numbers, None where one is missing."""
    return [None if missing else int(key) for key, missing in zip(column, column.isna(), strict=True)]


def _beside(events: "gpd.GeoDataFrame", area: shapely.MultiPolygon, date: str) -> dict[int, shapely.Geometry]:
    """Return the areas of the surveys that share no more than a seam with an area, by their keys."""
    share = np.where(events["date"] == date, RIM_SHARE, SEAM_SHARE)
    seam = events.intersection(area).area <= share * np.minimum(events.area, area.area)
    return {int(key): shape for key, shape in zip(events["survey_id"][seam], events.geometry[seam], strict=True)}


def _unjoined(
    connection: Connection, known: "gpd.GeoDataFrame", survey_id: int, beside: set[int]
) -> tuple["gpd.GeoDataFrame", frozenset[int], tuple[int, ...]]:
    """Return versions with those that were joined across a border apart again, where the survey may join them anew.

    These are the joined versions of the survey itself, and of surveys that are all beside it.
    """
    import geopandas as gpd
    import pandas as pd

    own = set(_current(connection, BUILDING_VERSION.c.survey_id == survey_id))
    members = read_members(connection, {*known["version_id"].astype(int).tolist(), *own})
    current = set(known.loc[known["valid_to"].isna(), "version_id"].astype(int)) | own
    leaves = {joined: leaves_of(members, joined) for joined in sorted(current & set(members))}
    every = read_versions(connection, sorted({leaf for some in leaves.values() for leaf in some}))
    maker = dict(zip(every["version_id"].astype(int), _plain_keys(every["survey_id"]), strict=True))
    free = [
        joined
        for joined, some in leaves.items()
        if survey_id in {maker[leaf] for leaf in some} or {maker[leaf] for leaf in some} <= {*beside, survey_id}
    ]
    released = tuple(sorted({each for joined in free for each in joined_by(members, joined)}))
    apart = {leaf for joined in free for leaf in leaves[joined] if maker[leaf] != survey_id}
    left = known[~known["version_id"].isin([*released, *apart]) & (known["survey_id"].fillna(0) != survey_id)]
    again = every[every["version_id"].isin(apart)]
    both = pd.concat([frame.dropna(axis=1, how="all") for frame in (left, again) if len(frame)] or [left])
    found = gpd.GeoDataFrame(both.reindex(columns=known.columns), geometry="geometry", crs=known.crs)
    found = found.astype({name: known[name].dtype for name in known.columns if name != "geometry"})
    alone = left.loc[left["survey_id"].isin(list(beside)) & ~left["version_id"].isin(list(members)), "version_id"]
    return found.sort_values("uid", ignore_index=True), frozenset({*apart, *alone.astype(int)}), released


def _current(connection: Connection, condition: ColumnElement[bool]) -> list[int]:
    """Return the keys of the current versions that fulfil a condition."""
    query = select(BUILDING_VERSION.c.version_id).where(condition, BUILDING_VERSION.c.valid_to.is_(None))
    return [int(key) for key in connection.scalars(query)]


def _compared(
    known: "gpd.GeoDataFrame", box: shapely.Polygon, beside: dict[int, shapely.Geometry]
) -> "gpd.GeoDataFrame":
    """Return the versions with which a survey is compared: in its box, and not cut by the border of one beside it."""
    kept = np.array(known.intersects(box))
    for survey_id, area in beside.items():
        own = (known["survey_id"].fillna(0) == survey_id).to_numpy(dtype=bool)
        kept &= ~(own & known.within(area.buffer(SEAM_M, join_style="mitre")).to_numpy())
    return known[kept].drop(columns=["survey", "began"]).reset_index(drop=True)


def _digest(basis: Basis, date: str, area: shapely.MultiPolygon) -> str:
    """Return the digest of an update."""
    digest = hashlib.sha256(f"{basis.run_sha256}\0{date}\0".encode())
    digest.update(shapely.to_wkb(area, byte_order=1))
    return digest.hexdigest()


def basis_of(connection: Connection, survey_id: int, area: shapely.Geometry) -> Basis:
    """Return the present basis of an update of an area."""
    run = connection.scalar(select(RUN.c.content_sha256).where(RUN.c.survey_id == survey_id))
    events = read_events(connection)
    near = events[events.dwithin(area, SEAM_M)]
    return Basis(str(run), tuple(zip(near["number"].astype(int), near["content_sha256"], strict=True)))


def _applied(connection: Connection, survey_id: int, digest: str) -> dict[str, int] | None:
    """Return the counts of just this update, where it was applied and all of its rows are still there."""
    query = select(INVENTORY_EVENT.c.content_sha256, INVENTORY_EVENT.c.counts).where(
        INVENTORY_EVENT.c.survey_id == survey_id
    )
    found = connection.execute(query).one_or_none()
    if found is None or found.content_sha256 != digest:
        return None
    kinds = select(BUILDING_CHANGE.c.kind, func.count()).where(BUILDING_CHANGE.c.survey_id == survey_id)
    there = {str(kind): int(n) for kind, n in connection.execute(kinds.group_by(BUILDING_CHANGE.c.kind))}
    versions = select(func.count()).where(BUILDING_VERSION.c.survey_id == survey_id)
    there["versions"] = int(connection.scalar(versions) or 0)
    return there if there == dict(found.counts) else None


def _require_last(connection: Connection, survey: str, survey_id: int, date: str, area: shapely.MultiPolygon) -> None:
    """Refuse an update of a place to which something later was applied already.

    Raises
    ------
    InputError
        Naming the later event.
    """
    events = read_events(connection)
    shared = events.intersection(area).area
    overlaps = shared > SEAM_SHARE * np.minimum(events.area, area.area)
    near = events[overlaps & (events["survey_id"].fillna(0) != survey_id)]
    own = events.loc[events["survey_id"] == survey_id, "number"]
    later = near[near["date"] > date]
    if len(own):
        later = near[(near["date"] > date) | (near["number"] > int(own.iloc[0]))]
    if len(later):
        last = later.iloc[-1]
        msg = (
            f"The survey '{survey}' of {date} cannot be applied: '{last['name']}' of {last['date']} was applied to the "
            "same place already. Apply surveys in the order of their dates; of those that overlap only the last one "
            "can be applied again."
        )
        raise InputError(msg)
    _require_unused(connection, survey, survey_id)


def require_begun(before: "gpd.GeoDataFrame", ended: NDArray[np.intp], survey: str, date: str) -> None:
    """Refuse to end versions before they began, which may occur at the seam of neighbouring surveys.

    Raises
    ------
    InputError
        With the first building.
    """
    late = before.iloc[ended]
    late = late[late["valid_from"] > date]
    if len(late):
        first = late.iloc[0]
        msg = (
            f"The survey '{survey}' of {date} changes the building {first['uid']}, whose present state began on "
            f"{first['valid_from']}. Apply surveys that share buildings in the order of their dates."
        )
        raise InputError(msg)


def _require_unused(connection: Connection, survey: str, survey_id: int) -> None:
    """Refuse to withdraw versions that a later survey of a neighbouring area uses."""
    own = select(BUILDING_VERSION.c.version_id).where(BUILDING_VERSION.c.survey_id == survey_id)
    across = BUILDING_CHANGE.c.note.startswith(ACROSS, autoescape=True)
    # What was joined across a border is made anew, unless a later survey has changed it.
    joined = select(BUILDING_CHANGE.c.version_after).where(
        across, or_(BUILDING_CHANGE.c.version_before.in_(own), BUILDING_CHANGE.c.survey_id == survey_id)
    )
    uses = or_(
        BUILDING_CHANGE.c.version_before.in_(own),
        BUILDING_CHANGE.c.version_after.in_(own),
        BUILDING_CHANGE.c.version_before.in_(joined),
    )
    query = (
        select(SURVEY.c.name)
        .join(BUILDING_CHANGE, BUILDING_CHANGE.c.survey_id == SURVEY.c.survey_id)
        .where(uses, BUILDING_CHANGE.c.survey_id != survey_id, ~across)
        .limit(1)
    )
    later = connection.scalar(query)
    if later is not None:
        msg = f"The survey '{survey}' cannot be applied again: '{later}' has built on buildings that both have seen."
        raise InputError(msg)

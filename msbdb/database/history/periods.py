"""Reading the living inventory: buildings at a date, changes by surveys, and the order of updates."""

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from sqlalchemy import (
    Column,
    ColumnElement,
    Connection,
    Engine,
    Select,
    Table,
    TextClause,
    and_,
    func,
    null,
    or_,
    select,
    text,
    union,
)

from msbdb.database.dialects.connection import database_crs, snapshot
from msbdb.database.dialects.dialect import dialect_of, guarded
from msbdb.database.history.days import first_day
from msbdb.database.history.joins import batches
from msbdb.database.runs.digests import COLUMN
from msbdb.database.schema.sqlfiles import footprint_at_query
from msbdb.database.schema.sqltables import SQL

if TYPE_CHECKING:
    import geopandas as gpd
    import pandas as pd


BUILDING_CHANGE = SQL["building_change"]

BUILDING_VERSION = SQL["building_version"]

INVENTORY_BUILDING = SQL["inventory_building"]

INVENTORY_EVENT = SQL["inventory_event"]

OPERATOR_STATE = SQL["operator_state"]

SURVEY = SQL["survey"]

SURVEY_OFFSET = SQL["survey_offset"]

Bounds = tuple[float, float, float, float]


_WINDOWS = {
    "sqlite": (
        "building_version.version_id IN (SELECT rowid FROM SpatialIndex WHERE f_table_name = 'building_version' "
        "AND search_frame = BuildMbr(:west, :south, :east, :north))"
    ),
    "postgresql": "building_version.geometry && ST_MakeEnvelope(:west, :south, :east, :north, :srid)",
}
"""The condition that a version's bounds intersect a window, by the spatial index."""


def footprint_at(engine: Engine, date: str) -> "gpd.GeoDataFrame":
    """Return the inventory on a day; operators' decisions have priority over detected states.

    Parameters
    ----------
    engine : Engine
        From ``open_database``.
    date : str
        The day, ISO 8601; a month or year means its first day.

    Returns
    -------
    GeoDataFrame
        The columns of the view ``footprint_current``, in order of ``uid``.
    """
    with guarded(engine.url), engine.connect() as connection:
        query = text(f"SELECT f.*, ST_AsBinary(f.geometry) AS wkb FROM ({footprint_at_query()}) AS f ORDER BY uid")  # noqa: S608  (our own text)
        return _frame(connection, query, {"date": first_day(date)})


def read_history(engine: Engine, uid: int | None = None) -> "gpd.GeoDataFrame":
    """Return the versions of a building of the inventory, or of all: columns of ``building_version``, and geometry."""
    query = select(*_version_columns()).order_by(BUILDING_VERSION.c.uid, BUILDING_VERSION.c.valid_from, "version_id")
    if uid is not None:
        query = query.where(BUILDING_VERSION.c.uid == uid)
    with guarded(engine.url), engine.connect() as connection:
        return _frame(connection, query)


def read_events(connection: Connection) -> "gpd.GeoDataFrame":
    """Return imports and updates in the order of application: columns of ``inventory_event``, and geometry."""
    query = select(*_columns_of(INVENTORY_EVENT), func.ST_AsBinary(INVENTORY_EVENT.c.geometry).label("wkb")).order_by(
        INVENTORY_EVENT.c.number
    )
    return _frame(connection, query)


def read_events_near(engine: Engine, area: shapely.Geometry) -> list[tuple[str, str]]:
    """Return kind and name of the imports and updates whose area meets another one, in their order."""
    with snapshot(engine) as connection:
        events = read_events(connection)
    near = events[events.intersects(area)]
    return list(zip(near["kind"], near["name"], strict=True))


def read_offsets(connection: Connection) -> "pd.DataFrame":
    """Return the offset of each survey: columns of ``survey_offset``."""
    return _plain(connection, select(*_columns_of(SURVEY_OFFSET)))


def read_before(connection: Connection, bounds: Bounds, survey_id: int) -> "gpd.GeoDataFrame":
    """Return the versions within a window that were current before a survey, also if it was applied already.

    Parameters
    ----------
    connection : Connection
        An open one.
    bounds : tuple of float
        West, south, east and north, metres.
    survey_id : int
        Versions made by this survey are left out; versions that it ended are included.

    Returns
    -------
    GeoDataFrame
        Columns of ``building_version``, in order of ``uid``; heights are NaN where unknown.
    """
    others = or_(BUILDING_VERSION.c.survey_id.is_(None), BUILDING_VERSION.c.survey_id != survey_id)
    current = or_(and_(BUILDING_VERSION.c.valid_to.is_(None), others), BUILDING_VERSION.c.closed_by == survey_id)
    query = select(*_version_columns()).where(current, window(connection, bounds)).order_by(BUILDING_VERSION.c.uid)
    return _frame(connection, query)


def read_versions(connection: Connection, versions: list[int]) -> "gpd.GeoDataFrame":
    """Return versions by their keys: columns of ``building_version``."""
    import geopandas as gpd
    import pandas as pd

    found = [
        _frame(connection, select(*_version_columns()).where(BUILDING_VERSION.c.version_id.in_(some)))
        for some in batches(versions) or [[]]
    ]
    return gpd.GeoDataFrame(pd.concat(found, ignore_index=True), geometry="geometry", crs=found[0].crs)


def read_began(connection: Connection, uids: list[int]) -> dict[int, str]:
    """Return the first day of each building."""
    found: dict[int, str] = {}
    for some in batches(sorted({int(uid) for uid in uids})):
        query = select(BUILDING_VERSION.c.uid, func.min(BUILDING_VERSION.c.valid_from))
        rows = connection.execute(query.where(BUILDING_VERSION.c.uid.in_(some)).group_by(BUILDING_VERSION.c.uid))
        found |= {int(uid): str(day) for uid, day in rows}
    return found


def read_decided(connection: Connection, uids: list[int]) -> frozenset[int]:
    """Return which buildings an operator decided on."""
    wanted = {int(uid) for uid in uids}
    return frozenset(int(uid) for uid in connection.scalars(select(OPERATOR_STATE.c.uid)) if int(uid) in wanted)


def read_born(connection: Connection, survey_id: int) -> "gpd.GeoDataFrame":
    """Return the first versions of the buildings that began in a survey: columns of ``building_version``."""
    earlier = BUILDING_VERSION.alias("earlier")
    before = or_(earlier.c.survey_id.is_(None), earlier.c.survey_id != survey_id)
    has_earlier = select(null()).where(earlier.c.uid == BUILDING_VERSION.c.uid, before).exists()
    query = select(*_version_columns()).where(BUILDING_VERSION.c.survey_id == survey_id, ~has_earlier)
    return _frame(connection, query.order_by(BUILDING_VERSION.c.uid))


def window(connection: Connection, bounds: Bounds) -> ColumnElement[bool]:
    """Return the condition that a version's bounds intersect a window, for the spatial index."""
    values: dict[str, Any] = dict(zip(("west", "south", "east", "north"), bounds, strict=True))
    if connection.dialect.name == "postgresql":
        values["srid"] = dialect_of(connection.engine.url).database_srid(connection)
    return text(_WINDOWS[connection.dialect.name]).bindparams(**values)  # type: ignore[return-value]  # a condition


def read_changes(engine: Engine, since: str | None = None, until: str | None = None) -> "gpd.GeoDataFrame":
    """Return the changes of buildings in surveys.

    Parameters
    ----------
    engine : Engine
        From ``open_database``.
    since, until : str, optional
        Surveys later than ``since`` and until ``until``; all by default.

    Returns
    -------
    GeoDataFrame
        A row for each change (for each pair of buildings of merged and split): columns of ``building_change``,
        ``survey``, ``date``, and state, storeys, heights, area and attributes before and after. The geometry is the one
        after, or the one before if nothing is left. In order of date, survey and change.
    """
    with guarded(engine.url), engine.connect() as connection:
        return _changes(connection, since, until)


@dataclass(frozen=True, slots=True, eq=False)
class Period:
    """The changes of buildings within a period.

    Parameters
    ----------
    changes : GeoDataFrame
        From `read_changes`.
    versions : GeoDataFrame
        The versions before and after the changes: columns of ``building_version``.
    offsets : DataFrame
        ``survey_offset``, of all surveys.
    events : GeoDataFrame
        All imports and updates, from `read_events`, also those outside of the period.
    """

    changes: "gpd.GeoDataFrame"
    versions: "gpd.GeoDataFrame"
    offsets: "pd.DataFrame"
    events: "gpd.GeoDataFrame"


def read_period(engine: Engine, since: str | None = None, until: str | None = None) -> Period:
    """Return the changes of buildings with the versions before and after, as one committed state.

    The parameters are those of `read_changes`.
    """
    ids = [
        select(version)
        .join(INVENTORY_EVENT, INVENTORY_EVENT.c.survey_id == BUILDING_CHANGE.c.survey_id)
        .where(version.is_not(None), *_between(since, until))
        for version in (BUILDING_CHANGE.c.version_before, BUILDING_CHANGE.c.version_after)
    ]
    named = BUILDING_VERSION.c.version_id.in_(union(*ids))
    query = select(*_version_columns()).where(named).order_by(BUILDING_VERSION.c.version_id)
    with snapshot(engine) as connection:
        changes, versions = _changes(connection, since, until), _frame(connection, query)
        return Period(changes, versions, read_offsets(connection), read_events(connection))


def _changes(connection: Connection, since: str | None, until: str | None) -> "gpd.GeoDataFrame":
    """Return the changes of a period."""
    one, two = (BUILDING_VERSION.alias(name) for name in ("version_1", "version_2"))
    states = ("state", "probability", "storeys", "h_max", "h_p90", "area_m2", "volume_m3", "attributes")
    columns = [c for c in _columns_of(BUILDING_CHANGE) if c.name != "survey_id"]
    query = (
        select(
            SURVEY.c.name.label("survey"),
            INVENTORY_EVENT.c.date,
            *columns,
            *(v.c[name].label(f"{name}_{which}") for name in states for v, which in ((one, "before"), (two, "after"))),
            func.ST_AsBinary(func.coalesce(two.c.geometry, one.c.geometry)).label("wkb"),
        )
        .select_from(BUILDING_CHANGE)
        .join(SURVEY, SURVEY.c.survey_id == BUILDING_CHANGE.c.survey_id)
        .join(INVENTORY_EVENT, INVENTORY_EVENT.c.survey_id == BUILDING_CHANGE.c.survey_id)
        .outerjoin(one, one.c.version_id == BUILDING_CHANGE.c.version_before)
        .outerjoin(two, two.c.version_id == BUILDING_CHANGE.c.version_after)
        .order_by(INVENTORY_EVENT.c.date, INVENTORY_EVENT.c.number, BUILDING_CHANGE.c.change_id)
    )
    return _frame(connection, query.where(*_between(since, until)))


def read_states(engine: Engine) -> "pd.DataFrame":
    """Return the operators' decisions on buildings: columns of ``operator_state``, in order of ``uid``."""
    with guarded(engine.url), engine.connect() as connection:
        return _plain(connection, select(*_columns_of(OPERATOR_STATE)).order_by(OPERATOR_STATE.c.uid))


def has_inventory(engine: Engine) -> bool:
    """Return whether anything was imported into the inventory, or updated it."""
    with guarded(engine.url), engine.connect() as connection:
        return bool(connection.scalar(select(func.count()).select_from(INVENTORY_EVENT)))


def summarise_inventory(engine: Engine) -> dict[str, Any]:
    """Return the inventory in numbers, of one committed state.

    Returns
    -------
    dict
        ``buildings``, the current ones by state, operators' decisions included, and all; ``decided``, those that an
        operator decided; ``events``, a record for each import and update in their order, with its ``kind``, ``name``,
        ``date`` and ``counts``. Empty where nothing was imported and no survey was applied.
    """
    with snapshot(engine) as connection:
        columns = (INVENTORY_EVENT.c.kind, INVENTORY_EVENT.c.name, INVENTORY_EVENT.c.date, INVENTORY_EVENT.c.counts)
        rows = connection.execute(select(*columns).order_by(INVENTORY_EVENT.c.number)).all()
        if not rows:
            return {}
        found = connection.execute(text("SELECT state, COUNT(*) FROM footprint_current GROUP BY state ORDER BY state"))
        states = {str(state): int(count) for state, count in found}
        decided = int(connection.scalar(select(func.count()).select_from(OPERATOR_STATE)) or 0)
    events = [
        {"kind": kind, "name": name, "date": date, "counts": json.loads(counts) if isinstance(counts, str) else counts}
        for kind, name, date, counts in rows
    ]
    return {"buildings": {"all": sum(states.values()), **states}, "decided": decided, "events": events}


def has_building(connection: Connection, uid: int) -> bool:
    """Return whether the inventory has a building."""
    return bool(connection.scalar(select(func.count()).where(INVENTORY_BUILDING.c.uid == uid)))


def _between(since: str | None, until: str | None) -> list[ColumnElement[bool]]:
    """Return the conditions that a survey is later than one day and not later than another."""
    conditions = []
    if since is not None:
        conditions.append(INVENTORY_EVENT.c.date > first_day(since))
    if until is not None:
        conditions.append(INVENTORY_EVENT.c.date <= first_day(until))
    return conditions


def _columns_of(table: Table) -> list[Column[Any]]:
    """Return a table's columns except the geometry, which is read as WKB, and the row's digest."""
    return [column for column in table.columns if column.name not in ("geometry", COLUMN)]


def _plain(connection: Connection, query: Select[Any]) -> "pd.DataFrame":
    """Return the rows of a query without geometry."""
    import pandas as pd

    result = connection.execute(query)
    return pd.DataFrame([dict(row) for row in result.mappings()], columns=list(result.keys()))


def _version_columns() -> list[ColumnElement[Any]]:
    """Return the columns of building_version, with the geometry as WKB."""
    return [*_columns_of(BUILDING_VERSION), func.ST_AsBinary(BUILDING_VERSION.c.geometry).label("wkb")]


_INTEGERS = {
    "version_id", "uid", "survey_id", "closed_by", "building_id", "storeys", "storeys_min", "storeys_max",
    "storeys_top", "parts", "change_id", "uid_before", "uid_after", "version_before", "version_after",
    "storeys_before", "storeys_after", "number", "sample_id",
}  # fmt: skip

_WORDS = {
    "valid_from", "valid_to", "source", "state", "found_state", "survey", "operator", "note", "kind", "name", "date",
    "content_sha256", "state_before", "state_after", "material",
}  # fmt: skip

_OBJECTS = {"attributes", "attributes_before", "attributes_after", "counts"}

_FLAGS = {"outline", "height"}


def _frame(
    connection: Connection, query: Select[Any] | TextClause, values: dict[str, Any] | None = None
) -> "gpd.GeoDataFrame":
    """Return the rows of a query with a column ``wkb`` as a frame with fixed dtypes."""
    import geopandas as gpd

    result = connection.execute(query, values or {})
    names = list(result.keys())
    columns = dict(zip(names, zip(*result.all(), strict=True), strict=False))
    shapes = shapely.from_wkb(np.array([bytes(blob) for blob in columns.get("wkb", ())], dtype=object))
    found = {name: _typed(name, list(columns.get(name, ()))) for name in names if name not in ("wkb", "geometry")}
    return gpd.GeoDataFrame(found, geometry=shapes, crs=database_crs(connection))


def _typed(name: str, values: list[Any]) -> Any:  # noqa: ANN401  (a pandas array of any dtype)
    """Return a column's values in the dtype for its name."""
    import pandas as pd

    if name in _OBJECTS:
        found = [json.loads(v) if isinstance(v, str) else v for v in values]
        # There is an empty object where there are none.
        return pd.Series([None if v == {} and name != "counts" else v for v in found], dtype=object)
    if name in _FLAGS or (values and isinstance(values[0], bool)):
        return pd.Series(values, dtype=bool)
    if name in _INTEGERS:
        return pd.Series(values, dtype="Int64")
    return pd.Series(values, dtype="object" if name in _WORDS else "float64")

"""Layers read page by page, as servers of features read them: bounds, days, conditions, order and numbers of rows."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from os import PathLike
from typing import TYPE_CHECKING, Any

import sqlalchemy as sa
from sqlalchemy import Connection, Engine
from sqlalchemy.exc import DataError, DBAPIError, OperationalError, ProgrammingError, StatementError

from msbdb.database.dialects.connection import TIMEOUT_S, open_database, snapshot
from msbdb.database.dialects.dialect import dialect_of
from msbdb.database.schema.sqltables import SQL, sql_type
from msbdb.errors import InputError, ParameterError
from msbdb.tables import (
    BUILDING,
    BUILDING_VERSION,
    CANDIDATE_REGION,
    FLAT_REGION,
    INVENTORY_EVENT,
    PART,
    REJECTION,
    Column,
    Table,
)
from msbdb.tables.view_columns import IDS, SURVEY_NAME, VIEW_COLUMNS

if TYPE_CHECKING:
    import shapely

RUN, SURVEY = SQL["run"], SQL["survey"]

PATIENCE_MS = 30_000
"""Milliseconds that a server of PostgreSQL may work on a page (ours): one of a million rows takes a second."""

MOST = 2**63
"""Whole numbers of databases are below it."""


class TextOfId(sa.TypeDecorator[str]):
    """The type of an id: a whole number in the database, a text for clients."""

    impl = sa.BigInteger
    cache_ok = True

    def process_bind_param(self, value: Any, dialect: sa.Dialect) -> int | None:  # noqa: ANN401, ARG002  (SQLAlchemy's)
        """Return the number of a value to compare with."""
        return None if value is None else int(value)

    def process_result_value(self, value: Any, dialect: sa.Dialect) -> str | None:  # noqa: ANN401, ARG002  (as above)
        """Return an id as text."""
        return None if value is None else str(value)


@dataclass(frozen=True, slots=True)
class FeatureLayer:
    """A layer of features: a view, or a table of runs with the survey of each row.

    Parameters
    ----------
    name, title, doc : str
        The name in the database, and what it is for people.
    columns : tuple of Column
        Its columns in order, without the geometry.
    key : str
        The column that identifies a feature.
    base, row : str
        The table with the geometry, and the column with its row number.
    days : tuple of str
        The column of its day, or of the first day and the first day after; empty for none.
    is_view : bool
        Whether ``name`` is a view.
    """

    name: str
    title: str
    doc: str
    columns: tuple[Column, ...]
    key: str
    base: str
    row: str
    days: tuple[str, ...] = ()
    is_view: bool = True

    def column(self, name: str) -> Column:
        """Return a column that may be compared and ordered by.

        Raises
        ------
        ParameterError
            For an unknown name, or JSON.
        """
        known = {column.name: column for column in self.columns if column.dtype != "json"}
        if name not in known:
            msg = f"The layer {self.name} has no column {name!r} to compare or to order by. It has {', '.join(known)}."
            raise ParameterError(msg)
        return known[name]


def _view(
    name: str, title: str, doc: str, key: str, base: str, *, row: str = "", days: tuple[str, ...] = ()
) -> FeatureLayer:
    return FeatureLayer(name, title, doc, VIEW_COLUMNS[name], key, base, row or key, days)


def _table(table: Table, title: str, key: str) -> FeatureLayer:
    columns = tuple(column for column in table.stored if column.name == key or column.in_frame)
    return FeatureLayer(table.name, title, table.doc, (SURVEY_NAME, *columns), key, table.name, key, is_view=False)


_VERSION_DAYS = ("valid_from", "valid_to")
_OF_VERSIONS = BUILDING_VERSION.name

LAYERS: Mapping[str, FeatureLayer] = {
    layer.name: layer
    for layer in (
        _view(
            "footprint_current",
            "Inventory",
            "The present inventory: the current version of each building",
            "uid",
            _OF_VERSIONS,
            row="version_id",
            days=_VERSION_DAYS,
        ),
        _view("part_current", "Parts of the inventory", "The parts of the present inventory", "part_id", PART.name),
        _view(
            "building_history",
            "History",
            "All versions of the inventory's buildings, with the change by which each began and ended",
            "version_id",
            _OF_VERSIONS,
            days=_VERSION_DAYS,
        ),
        _view(
            "building_summary",
            "Buildings of surveys",
            "The buildings of each survey, as that survey found them",
            "building_id",
            BUILDING.name,
            days=("survey_date",),
        ),
        _table(PART, "Parts of surveys", "part_id"),
        _table(FLAT_REGION, "Flat regions", "region_id"),
        _table(CANDIDATE_REGION, "Candidate regions", "candidate_id"),
        _table(REJECTION, "Dropped regions", "rejection_id"),
    )
}
"""The layers by name, in the order in which they are listed."""

Condition = Callable[[Mapping[str, sa.ColumnElement[Any]]], sa.ColumnElement[bool]]
"""Makes a condition of the columns by name."""


@dataclass(frozen=True, slots=True)
class FeatureQuery:
    """What is wanted of a layer.

    Parameters
    ----------
    window : shapely geometry, optional
        Features that meet it, in the database's CRS.
    days : tuple of date or None, optional
        First and last day; None at one side for no end.
    equal : sequence of (str, str)
        Columns and the texts of their values.
    condition : callable, optional
        A further condition.
    order : sequence of (str, bool)
        Columns to order by, each with whether it falls; the key decides at last.
    names : sequence of str
        The columns to return; all by default.
    with_shape : bool
        Return the geometries, too.
    offset, limit : int
        Rows to leave out, and the most to return.
    """

    window: "shapely.Geometry | None" = None
    days: tuple[date | None, date | None] | None = None
    equal: Sequence[tuple[str, str]] = ()
    condition: Condition | None = None
    order: Sequence[tuple[str, bool]] = ()
    names: Sequence[str] = ()
    with_shape: bool = True
    offset: int = 0
    limit: int = 100


@dataclass(frozen=True, slots=True)
class Rows:
    """Rows of a layer: dictionaries by column, the geometry as ``wkb``, and the number of all rows that are wanted."""

    rows: list[dict[str, Any]]
    matched: int


@dataclass(frozen=True, slots=True)
class ServedState:
    """The committed state of a database.

    Parameters
    ----------
    token : str
        Another one after every change of what the layers show.
    bounds : tuple of float or None
        West, south, east and north of all surveys and imports, metres; None for an empty database.
    begin : str
        The first day of a survey or import, ISO 8601; empty where none is known.
    """

    token: str
    bounds: tuple[float, float, float, float] | None
    begin: str


def open_to_read(target: str | PathLike[str]) -> Engine:
    """Open a database through which nothing can be written; errors are those of ``open_database``."""
    url = open_database(target).url
    return dialect_of(url).reading_engine(url, TIMEOUT_S)


def read_page(engine: Engine, layer: FeatureLayer, wanted: FeatureQuery) -> Rows:
    """Read a page of a layer, as one committed state.

    Raises
    ------
    ParameterError
        For a column that is unknown or cannot be compared.
    InputError
        For a value or a condition that does not fit its column.
    """
    own = _origin(layer)
    names = [column.name for column in layer.columns if not wanted.names or column.name in {*wanted.names, layer.key}]
    shown = [own.c[name] for name in names]
    if wanted.with_shape:
        shown.append(sa.func.ST_AsBinary(own.c.geometry, type_=sa.LargeBinary()).label("wkb"))
    order = [own.c[layer.column(name).name] for name, _ in wanted.order]
    falling = [falls for _, falls in wanted.order]
    ordered = [column.desc() if falls else column.asc() for column, falls in zip(order, falling, strict=True)]
    with snapshot(engine) as connection:
        _limit_time(connection)
        conditions = [*_conditions(connection, layer, own, wanted)]
        count = sa.select(sa.func.count()).select_from(own).where(*conditions)
        query = sa.select(*shown).where(*conditions).order_by(*ordered, own.c[layer.key])
        query = query.offset(min(wanted.offset, MOST - 1)).limit(wanted.limit)
        try:
            matched = int(connection.scalar(count) or 0)
            rows = connection.execute(query).mappings().all() if wanted.limit else []
        except (OverflowError, StatementError) as error:
            if not _is_of_the_question(error, wanted):
                raise
            msg = "A value or a filter does not fit the columns that it is compared with, or is too complex."
            raise InputError(msg) from error
    return Rows([dict(row) for row in rows], matched)


def read_feature(engine: Engine, layer: FeatureLayer, key: str) -> dict[str, Any] | None:
    """Return the row with a key, given as text, with its geometry as ``wkb``; None for an unknown key."""
    if not key.isascii() or not key.isdecimal() or int(key) >= MOST:
        return None
    page = read_page(engine, layer, FeatureQuery(equal=[(layer.key, key)], limit=1))
    return page.rows[0] if page.rows else None


def read_state(engine: Engine, known: ServedState | None = None) -> ServedState:
    """Return the committed state; ``known`` itself where it is the same, so that its bounds need not be read again."""
    import shapely

    run, event, decided, survey = RUN.c, SQL[INVENTORY_EVENT.name].c, SQL["operator_state"].c, SURVEY.c
    with snapshot(engine) as connection:
        told = (
            sa.select(run.run_id, run.content_sha256).order_by(run.run_id),
            sa.select(event.number, event.content_sha256).order_by(event.number),
            sa.select(sa.func.count(), sa.func.max(decided.decided_at)),
        )
        rows = [row for query in told for row in connection.execute(query)]
        token = "|".join(str(word) for row in rows for word in row)
        if known is not None and known.token == token:
            return known
        edges = sa.select(survey.west, survey.south, survey.east, survey.north, survey.date)
        surveys = connection.execute(edges.join_from(SURVEY, RUN)).all()
        shape = sa.func.ST_AsBinary(event.geometry, type_=sa.LargeBinary())
        events = connection.execute(sa.select(shape, event.date)).all()
    boxes = [tuple(row[:4]) for row in surveys] + [shapely.from_wkb(bytes(row[0])).bounds for row in events]
    days = [row[-1] for row in (*surveys, *events) if row[-1]]
    if not boxes:
        return ServedState(token, None, "")
    west, south, east, north = zip(*boxes, strict=True)
    return ServedState(token, (min(west), min(south), max(east), max(north)), min(days, default=""))


def _origin(layer: FeatureLayer) -> sa.FromClause:
    """Return what a layer's rows are selected from."""
    names = [column.name for column in layer.columns]
    if layer.is_view:
        columns = [sa.column(column.name, _type(column)) for column in layer.columns]
        shown = sa.table(layer.name, *columns, sa.column("geometry"), *_further(layer, names))
        return shown.alias("f")
    own = SQL[layer.base]
    with_survey = [
        SURVEY.c.name.label("survey"),
        *(_shown(own.c[column.name], column) for column in layer.columns[1:]),
    ]
    return sa.select(*with_survey, own.c.geometry).join_from(own, RUN).join(SURVEY).subquery("f")


def _type(column: Column) -> sa.types.TypeEngine[Any]:
    return TextOfId() if column.name in IDS else sql_type(column)


def _shown(own: sa.ColumnElement[Any], column: Column) -> sa.ColumnElement[Any]:
    """Return a table's column with the type in which clients have it."""
    return sa.type_coerce(own, _type(column)).label(column.name)


def _further(layer: FeatureLayer, names: Sequence[str]) -> list[sa.ColumnClause[Any]]:
    """Return the row number, where a view does not show it among its columns."""
    return [] if layer.row in names else [sa.column(layer.row)]


def _conditions(connection: Connection, layer: FeatureLayer, own: sa.FromClause, wanted: FeatureQuery) -> list[Any]:
    """Return the conditions of what is wanted, with all values bound."""
    found: list[Any] = [own.c[name] == _value(layer.column(name), text) for name, text in wanted.equal]
    if wanted.days is not None:
        found += _of_days(layer, own, *wanted.days)
    if wanted.window is not None:
        found += _in_window(connection, layer, own, wanted.window)
    if wanted.condition is not None:
        known = {column.name: own.c[column.name] for column in layer.columns if column.dtype != "json"}
        found.append(wanted.condition(known))
    return found


def _value(column: Column, text: str) -> int | float | bool | str:
    """Return the value of a column that a text names."""
    if column.dtype == "str":
        return text
    try:
        if column.dtype == "bool":
            return {"true": True, "1": True, "false": False, "0": False}[text.lower()]
        number = int(text) if "int" in column.dtype.lower() else float(text)
    except (KeyError, ValueError):
        number = math.nan
    if not abs(number) < MOST:
        msg = f"The column {column.name} has values of the type {column.dtype}; {text[:40]!r} is none."
        raise ParameterError(msg)
    return number


def _of_days(layer: FeatureLayer, own: sa.FromClause, first: date | None, last: date | None) -> list[Any]:
    """Return the conditions that a feature is valid on one of the days."""
    if not layer.days:
        msg = f"The features of the layer {layer.name} have no day. Leave out datetime."
        raise ParameterError(msg)
    begin, end = own.c[layer.days[0]], own.c[layer.days[-1]]
    found: list[Any] = [begin != ""]
    if last is not None:
        found.append(begin <= last.isoformat())
    if first is not None:
        found.append(begin >= first.isoformat() if begin is end else sa.or_(end.is_(None), end > first.isoformat()))
    return found


def _in_window(
    connection: Connection, layer: FeatureLayer, own: sa.FromClause, window: "shapely.Geometry"
) -> list[Any]:
    """Return the conditions that a feature meets a window, by the spatial index first."""
    dialect = dialect_of(connection.engine.url)
    shape = sa.func.ST_GeomFromWKB(sa.bindparam(None, window.wkb, sa.LargeBinary()), dialect.database_srid(connection))
    meets = sa.func.ST_Intersects(own.c.geometry, shape, type_=sa.Boolean())
    if connection.dialect.name == "postgresql":
        return [meets]
    west, south, east, north = window.bounds
    edges: list[sa.ColumnClause[float]] = [sa.column(name, sa.Double()) for name in ("xmin", "ymin", "xmax", "ymax")]
    index = sa.table(f"idx_{layer.base}_geometry", sa.column("pkid"), *edges)
    near = sa.select(index.c.pkid).where(
        index.c.xmin <= east, index.c.xmax >= west, index.c.ymin <= north, index.c.ymax >= south
    )
    return [own.c[layer.row].in_(near), meets]


def _limit_time(connection: Connection) -> None:
    """End a query that takes too long, where the database can."""
    if connection.dialect.name == "postgresql":
        setting = sa.select(sa.func.set_config("statement_timeout", str(PATIENCE_MS), True))
        connection.execute(setting)


def _is_of_the_question(error: Exception, wanted: FeatureQuery) -> bool:
    """Return whether the error comes of a value or condition, and not of the database."""
    if isinstance(error, OverflowError | DataError | ProgrammingError) or not isinstance(error, DBAPIError):
        return True
    at_rest = isinstance(error, OperationalError) and "locked" not in str(error) and not error.connection_invalidated
    return wanted.condition is not None and at_rest

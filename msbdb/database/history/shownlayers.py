"""Layers for files and maps as plain columns, of surveys or of the inventory, read as one committed state."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from sqlalchemy import Connection, Engine, func, select, text

from msbdb.database.dialects.connection import snapshot
from msbdb.database.dialects.dialect import dialect_of, shown
from msbdb.database.history.days import first_day
from msbdb.database.history.joins import PIECE
from msbdb.database.history.periods import INVENTORY_EVENT
from msbdb.database.runs.reading import RUN, SURVEY, survey_record
from msbdb.database.schema.sqlfiles import footprint_at_query
from msbdb.errors import InputError
from msbdb.identity import to_json
from msbdb.tables import BUILDING, CANDIDATE_REGION, FLAT_REGION, PART, REJECTION, Column, Survey, Table
from msbdb.tables.view_columns import SURVEY_NAME, VIEW_COLUMNS

Columns = dict[str, NDArray[Any]]

TABLE_LAYERS: Mapping[str, Table] = {
    "footprint": BUILDING,
    "part": PART,
    "flat_region": FLAT_REGION,
    "candidate_region": CANDIDATE_REGION,
    "rejection": REJECTION,
}
"""The layers that are tables of runs."""

VIEW_LAYERS = ("building_evidence", "part_evidence", "candidate_evidence")
"""The layers that are views, with the key of each as first column."""

CURRENT = "footprint_current"

ROWS_AT_A_TIME = 5000
"""Rows that are in memory as the driver gives them, which takes several times as much as their arrays."""


@dataclass(frozen=True, slots=True, eq=False)
class ShownLayers:
    """Layers as plain columns.

    Parameters
    ----------
    layers : dict of str to dict of str to (N,) ndarray
        Columns by layer, ``survey`` and ``geometry`` among them: numbers, where NaN is null; objects, which are texts
        or None; masked whole numbers, null where masked. Geometries, or WKB where this was asked for.
    surveys : tuple of Survey
        Those that were read, the newest first.
    present : bool
        ``footprint`` is the inventory's, and ``part`` has the parts of these buildings.
    srid : int
        The database's SRID.
    runs : dict of str to int
        The run of each survey, by the survey's name.
    """

    layers: dict[str, Columns]
    surveys: tuple[Survey, ...]
    present: bool
    srid: int
    runs: dict[str, int]


def columns_of(name: str, *, present: bool = False) -> tuple[Column, ...]:
    """Return the declared columns of a layer in order, without the geometry; ``present`` for the inventory's."""
    if name == "footprint" and present:
        return VIEW_COLUMNS[CURRENT]
    if name in TABLE_LAYERS:
        return (SURVEY_NAME, *TABLE_LAYERS[name].columns)
    return VIEW_COLUMNS[name]


def read_shown(
    engine: Engine,
    names: Sequence[str],
    *,
    survey: str | None = None,
    inventory: bool = True,
    date: str | None = None,
    encoded: bool = False,
) -> ShownLayers:
    """Read layers of one survey, of the inventory, or of all surveys.

    Parameters
    ----------
    engine : Engine
        From ``open_database``.
    names : sequence of str
        Layers.
    survey : str, optional
        Its name. By default all surveys are read.
    inventory : bool
        Without ``survey``, take the footprints of the inventory, where there is one, and their parts alone.
    date : str, optional
        The day of the inventory, ISO 8601; its present state by default.
    encoded : bool
        Leave geometries as WKB, which takes a seventh of the memory of small polygons.

    Raises
    ------
    InputError
        When there is no such survey, or a day is given where there is no inventory.
    """
    with snapshot(engine) as connection:
        runs = _runs(connection, survey, shown(engine.url))
        has_events = bool(connection.scalar(select(func.count()).select_from(INVENTORY_EVENT)))
        present = inventory and survey is None and has_events
        if date is not None and not present:
            msg = f"The database {shown(engine.url)} has no inventory, so it has no state on {date}. Leave out --at."
            raise InputError(msg)
        buildings = _inventory(connection, date) if present else None
        layers = {}
        for name in names:
            if name == "footprint" and buildings is not None:
                layers[name] = buildings
                continue
            found = _layer(connection, name, runs)
            if buildings is not None and name == "part":
                found = _of_buildings(connection, found, buildings)
            layers[name] = found
        for columns in () if encoded else layers.values():
            columns["geometry"] = shapely.from_wkb(columns["geometry"])
        surveys = tuple(survey_record(connection, run.survey_id) for run in runs)
        srid = dialect_of(engine.url).database_srid(connection)
        return ShownLayers(layers, surveys, present, srid, {str(run.name): int(run.run_id) for run in runs})


def _runs(connection: Connection, survey: str | None, where: str) -> list[Any]:
    """Return the rows of the chosen runs, the newest survey first."""
    query = select(SURVEY.c.name, SURVEY.c.date, RUN.c.run_id, RUN.c.survey_id).join_from(RUN, SURVEY)
    runs = sorted(connection.execute(query).all(), key=lambda run: str(run.name))
    if survey is None:
        return sorted(runs, key=lambda run: str(run.date), reverse=True)
    found = [run for run in runs if run.name == survey]
    if not found:
        there = "; ".join(run.name for run in runs) or "none"
        msg = f"The database {where} has no survey '{survey}'. Name one of them by --survey: {there}."
        raise InputError(msg)
    return found


def _inventory(connection: Connection, date: str | None) -> Columns:
    """Return the inventory on a day, in order of ``uid``."""
    origin = CURRENT if date is None else f"({footprint_at_query()})"
    columns = VIEW_COLUMNS[CURRENT]
    values = {} if date is None else {"date": first_day(date)}
    found = _read(connection, origin, columns, "", values)
    return _ordered(found, np.argsort(np.asarray(found["uid"]), kind="stable"))


def _layer(connection: Connection, name: str, runs: Sequence[Any]) -> Columns:
    """Return a layer of some runs, one run after the other, each in the order of its key."""
    columns = columns_of(name)
    pieces = []
    for run in runs:
        if name in TABLE_LAYERS:
            found = _read(
                connection, TABLE_LAYERS[name].name, columns[1:], "WHERE f.run_id = :run", {"run": run.run_id}
            )
            names = np.full(len(found["geometry"]), run.name, dtype=object)
            found = {"survey": names} | found
            order = np.lexsort([np.asarray(found[own]) for own in reversed(TABLE_LAYERS[name].order)])
        else:
            found = _read(connection, name, columns, "WHERE f.survey = :survey", {"survey": run.name})
            order = np.argsort(np.asarray(found[columns[0].name]), kind="stable")
        pieces.append(_ordered(found, order))
    return _together(pieces or [_arrays(columns)])


def _read(
    connection: Connection, origin: str, columns: Sequence[Column], where: str, values: Mapping[str, object]
) -> Columns:
    """Return the rows of a table, view or query."""
    names = ", ".join(f"f.{column.name}" for column in columns)
    query = f"SELECT {names}, ST_AsBinary(f.geometry) FROM {origin} AS f {where}"  # noqa: S608  (our own names)
    rows = connection.execute(text(query), values, execution_options={"stream_results": True})
    words: dict[str, str] = {}
    return _together([_arrays(columns, some, words) for some in rows.partitions(ROWS_AT_A_TIME)] or [_arrays(columns)])


def _arrays(columns: Sequence[Column], rows: Sequence[Any] = (), words: dict[str, str] | None = None) -> Columns:
    """Return rows as arrays by column, the last value as geometry in WKB; ``words`` gets the texts that rows share."""
    values = list(zip(*rows, strict=True)) or [()] * (len(columns) + 1)
    known = {} if words is None else words
    found = {column.name: _array(own, column.dtype, known) for column, own in zip(columns, values, strict=False)}
    found["geometry"] = np.array([bytes(blob) for blob in values[-1]], dtype=object)
    return found


def _ordered(found: Columns, order: NDArray[np.intp]) -> Columns:
    """Return the columns in another order, and take each from ``found``, so that no two copies of all exist."""
    return {name: found.pop(name)[order] for name in list(found)}


def _together(pieces: list[Columns]) -> Columns:
    """Return the columns of several pieces as one, taken from them one by one, as `_ordered` does."""
    return {name: _joined([piece.pop(name) for piece in pieces]) for name in list(pieces[0])}


def _array(values: Sequence[Any], dtype: str, known: dict[str, str]) -> NDArray[Any]:
    """Return values as an array: whole numbers with nulls are masked, texts are objects, and JSON is canonical text.

    Equal texts become one object, that in ``known``: most columns of texts have few words.
    """
    if dtype in ("int64", "Int64", "int32"):
        if None not in values:
            return np.array(values, dtype=np.int64)
        null = [value is None for value in values]
        return np.ma.MaskedArray(np.array([value or 0 for value in values], dtype=np.int64), mask=null)
    if dtype == "float64":
        return np.array(values, dtype=np.float64)
    words = np.empty(len(values), dtype=object)
    if dtype == "json":
        words[:] = [_json(value) for value in values]
    else:
        words[:] = [value if value is None else known.setdefault(value, value) for value in values]
    return words


def _json(value: object) -> str | None:
    """Return a JSON value, which only some drivers parse, as canonical text; None for an empty object."""
    words = value if value is None or isinstance(value, str) else to_json(value)
    return None if words == "{}" else words


def _joined(pieces: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Return one array of several, masked where one of them is."""
    if any(isinstance(piece, np.ma.MaskedArray) for piece in pieces):
        null = np.concatenate([np.ma.getmaskarray(piece) for piece in pieces])
        return np.ma.MaskedArray(np.concatenate([np.asarray(piece) for piece in pieces]), mask=null)
    return np.concatenate(pieces)


def _of_buildings(connection: Connection, parts: Columns, buildings: Columns) -> Columns:
    """Return the parts of the inventory's buildings, each in the survey that its building was copied from.

    A building that the border of surveys cuts has parts of several: ``building_id`` is that of the whole building.
    """
    row_of = {version: row for row, version in enumerate(np.asarray(buildings["version_id"]).tolist())}
    pieces = connection.execute(select(PIECE.c.building_id, PIECE.c.version_id))
    rows_of = {building: row_of[version] for building, version in pieces if version in row_of}
    rows = np.array([rows_of.get(own, -1) for own in np.asarray(parts["building_id"]).tolist()], dtype=np.int64)
    found = {name: values[rows >= 0] for name, values in parts.items()}
    return found | {"building_id": np.asarray(buildings["building_id"])[rows[rows >= 0]]}

"""Checks of a build before it is loaded; their errors name the row, not a constraint of the database."""

from collections.abc import Collection, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from numpy.typing import NDArray

from msbdb.errors import InputError, TableError
from msbdb.kept import KeptRun
from msbdb.params import DETECTORS, POINT_DETECTORS
from msbdb.tables import (
    BUILDING,
    CANDIDATE_REGION,
    REJECTION,
    TABLES,
    KeyReference,
    Table,
    Unique,
    validate,
    validate_parts,
)
from msbdb.tables.declaration import RUN_ID
from msbdb.threads import cores, in_threads

if TYPE_CHECKING:
    import pandas as pd

_SHAPES = {"MULTIPOLYGON": (shapely.GeometryType.POLYGON, shapely.GeometryType.MULTIPOLYGON)}

_POINT = (shapely.GeometryType.POINT,)


def check_build(build: KeptRun) -> dict[str, dict[str, NDArray[Any]]]:
    """Check that a build can be stored: names, declared columns, numbers, geometries and references.

    Returns
    -------
    dict
        See `check_frames`.

    Raises
    ------
    InputError
        For a survey without a name, or detectors that are missing, unknown, not in order or named twice.
    TableError
        With the table, the column and the first wrong rows.
    """
    _check_names(build)
    expected = {table.name for table in TABLES}
    if set(build.frames) != expected:
        msg = f"A build needs the tables {sorted(expected)}; got {sorted(build.frames)}."
        raise TableError(msg)
    columns = check_frames(build.frames)
    _check_keys(build.frames)
    _check_references(build.frames, build.run.methods)
    validate_parts(build.frames["part"])
    return columns


def check_frames(frames: "dict[str, pd.DataFrame]") -> dict[str, dict[str, NDArray[Any]]]:
    """Check the declared columns, numbers and geometries of some tables.

    Returns
    -------
    dict
        By table its columns as ``RunContent`` has them, with geometries as the database keeps them: (N,) little-endian
        WKB, polygons as multipolygons.

    Raises
    ------
    TableError
        With the table, the column and the first wrong rows.
    """
    columns = {}
    for table in TABLES:
        if table.name in frames:
            frame = frames[table.name]
            validate(frame, table)
            own = columns[table.name] = {str(name): _array(one) for name, one in frame.items() if name != "geometry"}
            _check_numbers(own, frame, table)
    for name, wkb in _check_geometries(frames).items():
        columns[name]["geometry"] = wkb
    return columns


def _array(column: "pd.Series") -> NDArray[Any]:
    """Return a column as ``RunContent`` has it."""
    if column.dtype == "Int64":
        return column.to_numpy(np.float64, na_value=np.nan) if column.hasnans else column.to_numpy(np.int64)
    return column.to_numpy()


def _check_names(build: KeptRun) -> None:
    """Refuse a survey without a name, and detectors that are unknown or not in alphabetical order."""
    if not build.survey.name.strip():
        msg = f"A build needs the name of a survey; got '{build.survey.name}'. Give a name."
        raise InputError(msg)
    methods = build.run.methods
    if not methods or list(methods) != sorted(set(methods) & set(DETECTORS)):
        msg = (
            f"A run's methods must be detectors in alphabetical order, from {', '.join(sorted(DETECTORS))}; got "
            f"{', '.join(repr(name) for name in methods) or 'none'}. Give for instance 'flatregions', 'multiscale'."
        )
        raise InputError(msg)


def geometries(frame: "pd.DataFrame") -> NDArray[np.object_]:
    """Return the (N,) geometries of a frame, plain or geographic."""
    return np.asarray(frame["geometry"], dtype=object)


def _check_numbers(columns: Mapping[str, NDArray[Any]], frame: "pd.DataFrame", table: Table) -> None:
    """Refuse infinite values, and missing values in columns that are not nullable."""
    for column in table.columns:
        values = columns[column.name]
        if column.dtype == "float64":
            holds = ~np.isinf(values) if column.nullable else np.isfinite(values)
            _require(holds, frame, table, f"{column.name} is missing or infinite")
        elif not column.nullable and column.dtype != "int64":
            _require(frame[column.name].notna(), frame, table, f"{column.name} is missing or infinite")


def _check_geometries(frames: "dict[str, pd.DataFrame]") -> dict[str, NDArray[np.object_]]:
    """Refuse geometries that are missing, empty, not valid, or of another type; return them as WKB."""
    tables = [table for table in TABLES if table.geometry and table.name in frames]
    for table in tables:
        frame = frames[table.name]
        shapes = geometries(frame)
        allowed = _SHAPES.get(str(table.geometry), _POINT)
        kind = shapely.get_type_id(shapes)
        _require(np.isin(kind, [int(k) for k in allowed]), frame, table, f"the geometry is no {table.geometry}")
        _require(~shapely.is_empty(shapes), frame, table, "the geometry is empty")
    # Those of all tables at once, because threads take longer to start than a small table to check.
    everything = np.concatenate([np.empty(0, dtype=object), *(geometries(frames[table.name]) for table in tables)])
    decided = in_threads(_as_wkb, np.array_split(everything, cores()))
    wkb, valid = (np.concatenate(own) for own in zip(*decided, strict=True))
    ends = np.cumsum([len(frames[table.name]) for table in tables])
    for table, holds in zip(tables, np.split(valid, ends), strict=False):
        _require(holds, frames[table.name], table, "the geometry is not valid")
    return {table.name: own for table, own in zip(tables, np.split(wkb, ends), strict=False)}


def _as_wkb(shapes: NDArray[np.object_]) -> tuple[NDArray[np.object_], NDArray[np.bool_]]:
    """Return geometries as the database keeps them, and which are valid."""
    from msbdb.database.runs.wkbrings import are_valid, as_multipolygons  # numba takes long to load

    wkb = as_multipolygons(shapely.to_wkb(shapes, byte_order=1))
    return wkb, are_valid(wkb)


def _check_keys(frames: "dict[str, pd.DataFrame]") -> None:
    """Refuse two rows with the same key."""
    for table in TABLES:
        # Columns of the database alone belong to no key of a frame: the run is the same in all rows.
        unique = [
            rule.columns for rule in table.rules if isinstance(rule, Unique) and set(rule.columns) <= set(table.names)
        ]
        for key in filter(None, (table.key, *unique)):
            frame = frames[table.name]
            _require(~frame.duplicated(list(key)), frame, table, f"{' with '.join(key)} is given twice")


def _check_references(frames: "dict[str, pd.DataFrame]", methods: tuple[str, ...]) -> None:
    """Refuse rows that refer to a missing scale, class, part, region or detector."""
    for table in TABLES:
        frame = frames[table.name]
        for column, other, key, allows_none in references(table):
            known = frames[other][key]
            holds = frame[column].isin(known) | (allows_none & (frame[column] == 0))
            _require(holds, frame, table, f"{column} refers to no row")
    parts, buildings, candidates = frames["part"], frames["building"], frames["candidate_region"]
    roots = parts.loc[parts["supid"] == 0, "building_id"]
    _require(buildings["building_id"].isin(roots), buildings, BUILDING, "the building has no tree of parts")
    asked = [name for name in POINT_DETECTORS if name in methods]
    _require(candidates["method"].isin(asked), candidates, CANDIDATE_REGION, "method refers to no row")
    rejected = frames["rejection"]
    _require(rejected["method"].isin(DETECTORS), rejected, REJECTION, "method refers to no row")


def references(table: Table) -> Iterator[tuple[str, str, str, bool]]:
    """Yield a table's declared references by one column: column, other table and column, and whether 0 means none.

    The run is left out, because it is the same in all rows, and the father, because `validate_parts` checks it.

    Examples
    --------
    >>> from msbdb.tables import PART
    >>> for reference in references(PART):
    ...     print(*reference)
    building_id building building_id False
    scale scale scale False
    speindex spectral_class speindex True
    """
    for column in table.columns:
        if column.refers:
            other, key = column.refers.split(".")
            yield column.name, other, key, False
    for rule in table.rules:
        if isinstance(rule, KeyReference):
            pairs = [(own, to) for own, to in zip(rule.columns, rule.to, strict=True) if own != RUN_ID.name]
            if len(pairs) == 1:
                [(own, key)] = pairs
                yield table[own].zero_of or own, rule.table, key, bool(table[own].zero_of)


def _require(holds: Collection[bool], frame: "pd.DataFrame", table: Table, what: str) -> None:
    """Raise for the rows where a condition fails, by their first column."""
    fails = ~np.asarray(holds, dtype=bool)
    if fails.any():
        key = table.columns[0].name
        rows = ", ".join(str(value) for value in frame.loc[fails, key][:5])
        msg = f"Table {table.name} cannot be stored: {what} in {fails.sum()} rows, first at {key} {rows}."
        raise TableError(msg)

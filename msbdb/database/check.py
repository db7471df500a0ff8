"""Checks of a build before it is loaded, so that what is wrong is named by its row, not by a constraint."""

from collections.abc import Collection

import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray

from msbdb.errors import InputError, TableError
from msbdb.params import POINT_DETECTORS
from msbdb.tables import TABLES, Build, Table, validate, validate_parts
from msbdb.threads import cores, in_threads

_SHAPES = {"MULTIPOLYGON": (shapely.GeometryType.POLYGON, shapely.GeometryType.MULTIPOLYGON)}
_TABLES = {table.name: table for table in TABLES}
_POINT = (shapely.GeometryType.POINT,)


def check_build(build: Build) -> None:
    """Check that a build can be stored: names, declared columns, numbers, geometries and references.

    Raises
    ------
    InputError
        For a survey without a name, or extractors that are missing, unsorted or named twice.
    TableError
        Naming the table, the column and the first rows that are wrong.
    """
    _check_names(build)
    expected = {table.name for table in TABLES}
    if set(build.frames) != expected:
        msg = f"A build needs the tables {sorted(expected)}; got {sorted(build.frames)}."
        raise TableError(msg)
    for table in TABLES:
        frame = build.frames[table.name]
        validate(frame, table)
        _check_numbers(frame, table)
        if table.geometry:
            _check_geometries(frame, table)
    _check_keys(build.frames)
    _check_references(build.frames, build.run.method.split(","))
    validate_parts(build.frames["part"])


def _check_names(build: Build) -> None:
    """Refuse a survey without a name, and extractors that are not a sorted list."""
    if not build.survey.name.strip():
        msg = f"A build needs a survey's name; got '{build.survey.name}'. Give one."
        raise InputError(msg)
    names = build.run.method.split(",")
    if not all(name.strip() for name in names) or names != sorted(set(names)):
        msg = (
            f"A run's method must name its extractors, sorted and joined by commas; got '{build.run.method}'. "
            "Give for instance 'flatregions,multiscale'."
        )
        raise InputError(msg)


def geometries(frame: pd.DataFrame) -> NDArray[np.object_]:
    """Return the (N,) geometries of a frame, plain or geographic."""
    return np.asarray(frame["geometry"], dtype=object)


def _check_numbers(frame: pd.DataFrame, table: Table) -> None:
    """Refuse infinities everywhere, and missing values where none are declared."""
    for column in table.columns:
        values = frame[column.name]
        wrong = values.isna() & (not column.nullable)
        if column.dtype == "float64":
            wrong |= np.isinf(values)
        _require(~wrong, frame, table, f"{column.name} is missing or infinite")


def _check_geometries(frame: pd.DataFrame, table: Table) -> None:
    """Refuse geometries that are missing, empty, of another type, or not valid."""
    shapes = geometries(frame)
    kind = shapely.get_type_id(shapes)
    allowed = _SHAPES.get(str(table.geometry), _POINT)
    _require(np.isin(kind, [int(k) for k in allowed]), frame, table, f"the geometry is no {table.geometry}")
    _require(~shapely.is_empty(shapes), frame, table, "the geometry is empty")
    valid = in_threads(shapely.is_valid, np.array_split(shapes, cores()))
    _require(np.concatenate(valid), frame, table, "the geometry is not valid")


def _check_keys(frames: dict[str, pd.DataFrame]) -> None:
    """Refuse two rows of one key."""
    keys = (
        ("scale", ["scale"]),
        ("spectral_class", ["speindex"]),
        ("building", ["building_id"]),
        ("building", ["root_id"]),
        ("flat_region", ["region_id"]),
        ("part_flat_region", ["part_id", "region_id"]),
        ("candidate_region", ["candidate_id"]),
        ("part_candidate", ["part_id", "candidate_id"]),
        ("flat_region_candidate", ["region_id", "candidate_id"]),
    )
    for name, key in keys:
        frame = frames[name]
        _require(~frame.duplicated(key), frame, _TABLES[name], f"{' with '.join(key)} is given twice")


def _check_references(frames: dict[str, pd.DataFrame], methods: list[str]) -> None:
    """Refuse rows that speak of a scale, class, root, part, region or extractor that is not there."""
    part, regions = frames["part"], frames["flat_region"]["region_id"]
    candidates = frames["candidate_region"]["candidate_id"]
    roots = part.loc[part["supid"] == 0, "part_id"]
    classes = frames["spectral_class"]["speindex"]
    or_none = [*classes, 0]
    for name, column, known in (
        ("part", "scale", frames["scale"]["scale"]),
        ("part", "speindex", or_none),
        ("building", "root_id", roots),
        ("building", "speindex", or_none),
        ("spectral_class_band", "speindex", classes),
        ("part_flat_region", "part_id", part["part_id"]),
        ("part_flat_region", "region_id", regions),
        ("candidate_region", "method", [name for name in POINT_DETECTORS if name in methods]),
        ("part_candidate", "part_id", part["part_id"]),
        ("part_candidate", "candidate_id", candidates),
        ("flat_region_candidate", "region_id", regions),
        ("flat_region_candidate", "candidate_id", candidates),
    ):
        frame = frames[name]
        _require(frame[column].isin(list(known)), frame, _TABLES[name], f"{column} names nothing that exists")


def _require(holds: Collection[bool], frame: pd.DataFrame, table: Table, what: str) -> None:
    """Raise for the rows where a condition fails, by their first column."""
    fails = ~np.asarray(holds, dtype=bool)
    if fails.any():
        key = table.columns[0].name
        rows = ", ".join(str(value) for value in frame.loc[fails, key][:5])
        msg = f"Table {table.name} cannot be stored: {what} in {fails.sum()} rows, first at {key} {rows}."
        raise TableError(msg)

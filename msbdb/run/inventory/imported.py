"""Imports into the inventory: footprints of other sources, and samples of roofs."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely

from msbdb.database import (
    Engine,
    database_crs_of,
    first_day,
    open_database,
    opened,
    read_fallback,
    require_past,
    write_import,
    write_samples,
)
from msbdb.errors import DatabaseError, InputError, ParameterError, SchemaVersionError
from msbdb.io.vector import read_point_features, read_polygons
from msbdb.run.reports import ImportReport
from msbdb.tables import EXTRACTOR_SHARES, HEIGHTS

SINCE_EVER = "0001-01-01"
"""First day of an inventory of unknown age."""

MEASURED = (
    *HEIGHTS,
    "h_max",
    "h_mean",
    "h_p50",
    "h_p90",
    "volume_m3",
    "parts",
    *EXTRACTOR_SHARES.values(),
    "probability",
)


def take_inventory(
    db: str | Path,
    file: Path,
    *,
    name: str | None,
    layer: str | None,
    date: str | None,
    mapping: Mapping[str, str],
    id_column: str | None,
    crs: str | None,
) -> ImportReport:
    """Import the footprints of a file as the inventory; see `msbdb.api.import_inventory`."""
    if date:
        require_past(date, f"the footprints of {file.name}")
    frame = read_polygons(file, layer=layer, crs=crs or read_fallback(db))
    engine = _opened_or_created(db, frame)
    try:
        frame = frame.to_crs(database_crs_of(engine))
        rows = as_versions(frame, dict(mapping), id_column)
        chosen, day = name or file.stem, first_day(date) if date else SINCE_EVER
        status, count = write_import(engine, chosen, day, rows, digest=digest_of(chosen, day, rows))
    finally:
        engine.dispose()
    return ImportReport(chosen, day, status, count)


def take_samples(
    db: str | Path, file: Path, *, layer: str | None, mapping: Mapping[str, str], crs: str | None
) -> ImportReport:
    """Import points at which the material of a roof is known; see `msbdb.api.import_roof_samples`."""
    columns = {"material": "material", **mapping}
    with opened(db) as engine:
        frame = read_point_features(file, layer=layer, crs=crs or read_fallback(db), to=database_crs_of(engine))
        _require_columns(frame, columns)
        material = frame[columns["material"]].astype("string").fillna("").str.strip()
        if (material == "").any():
            row = int(np.flatnonzero(material == "")[0]) + 1
            msg = f"{file.name} has a sample without a material, first in row {row}. Complete or delete it."
            raise InputError(msg)
        note = frame[columns["note"]].astype("string").fillna("") if "note" in columns else ""
        attributes = _attributes(frame.drop(columns=["geometry", *columns.values()]), {})
        samples = gpd.GeoDataFrame(
            {"material": material.astype(object), "note": note, "attributes": attributes}, geometry=frame.geometry
        )
        count = write_samples(engine, samples)
    return ImportReport(file.stem, "", "created", count)


def _opened_or_created(db: str | Path, frame: gpd.GeoDataFrame) -> Engine:
    """Open a database, or make one in a frame's CRS."""
    try:
        return open_database(db)
    except SchemaVersionError:
        return open_database(db, create=True)
    except DatabaseError:
        return open_database(db, create=True, srid=frame.crs.to_epsg() or 0, crs_wkt=frame.crs.to_wkt())


def as_versions(frame: gpd.GeoDataFrame, mapping: dict[str, str], id_column: str | None) -> gpd.GeoDataFrame:
    """Return footprints with the columns of a version, and a key each.

    Raises
    ------
    ParameterError
        When a column does not exist, or a measure is no number.
    InputError
        When the id column holds a value twice, or none.
    """
    _require_columns(frame, mapping)
    rows = gpd.GeoDataFrame({"key": keys_of(frame, id_column)}, geometry=frame.geometry.to_numpy(), crs=frame.crs)
    rows = rows.assign(state="unsure", area_m2=frame.area.to_numpy(), **dict.fromkeys(MEASURED, None))
    if "height" in mapping:
        height = _numbers(frame, mapping.pop("height"))
        rows = rows.assign(h_max=height, h_p90=height)
    if "storeys" in mapping:
        rows["storeys"] = _numbers(frame, mapping.pop("storeys")).round().astype("Int64")
    names = {column: name for name, column in mapping.items()}
    return rows.assign(attributes=_attributes(frame.drop(columns="geometry"), names))


def keys_of(frame: gpd.GeoDataFrame, id_column: str | None) -> list[str]:
    """Return a unique key for each footprint: the file's own ids, or the places.

    Raises
    ------
    ParameterError
        When the id column does not exist.
    InputError
        When it holds a value twice, or none.
    """
    if id_column is not None:
        _require_columns(frame, {"id": id_column})
        ids = frame[id_column].astype("string")
        twice = ids[ids.duplicated() | ids.isna()]
        if len(twice):
            msg = (
                f"The column '{id_column}' is no id of the buildings: '{twice.iloc[0]}' is missing or twice. "
                "Choose another column."
            )
            raise InputError(msg)
        return [str(value) for value in ids]
    corners = np.round(shapely.bounds(frame.geometry.to_numpy()) * 1000).astype(np.int64)
    places = pd.Series([",".join(map(str, corner)) for corner in corners.tolist()])
    again = places.groupby(places).cumcount()
    return [f"{place};{count}" for place, count in zip(places, again, strict=True)]


def _require_columns(frame: gpd.GeoDataFrame, columns: Mapping[str, str]) -> None:
    """Refuse columns that do not exist."""
    for name, column in columns.items():
        if column not in frame.columns:
            there = ", ".join(str(c) for c in frame.columns if c != "geometry") or "none"
            msg = f"There is no column '{column}' to use as '{name}'; the columns are {there}."
            raise ParameterError(msg)


def _numbers(frame: gpd.GeoDataFrame, column: str) -> "pd.Series[float]":
    """Return a column of numbers, NaN for a missing one."""
    try:
        numbers: pd.Series[float] = pd.to_numeric(frame[column].reset_index(drop=True)).astype("float64")
    except (TypeError, ValueError) as error:
        msg = f"The column '{column}' holds a value that is no number: {error}. Correct it, or leave the column out."
        raise ParameterError(msg) from error
    return numbers


def _attributes(frame: pd.DataFrame, names: Mapping[str, str]) -> "pd.Series[Any]":
    """Return all columns as a dictionary a row, of values that JSON knows."""
    plain = pd.DataFrame(frame).rename(columns=dict(names))
    records = json.loads(plain.to_json(orient="records", date_format="iso", double_precision=15, default_handler=str))
    return pd.Series([record or None for record in records], dtype=object)


def digest_of(name: str, date: str, rows: gpd.GeoDataFrame, more: Sequence[str] = ()) -> str:
    """Return the digest of all that an import writes; ``more`` names the further columns that it has."""
    digest = hashlib.sha256(f"import\0{name}\0{date}\0".encode())
    for column in ("key", "h_p90", "storeys", "attributes", *more):
        digest.update(repr(rows[column].tolist()).encode())
    digest.update(b"".join(shapely.to_wkb(shapely.normalize(rows.geometry.to_numpy()), byte_order=1)))
    return digest.hexdigest()

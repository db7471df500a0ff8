"""Changes of the inventory as a GeoPackage, GeoJSON or CSV."""

import json
from pathlib import Path

import geopandas as gpd
import pandas as pd

from msbdb.errors import InputError
from msbdb.io.files import write_atomic
from msbdb.io.vector import write_layers

IDS = ("change_id", "uid_before", "uid_after", "version_before", "version_after")
"""Columns that GeoJSON writes as strings, as numbers above 2^53 are rounded in browsers."""

FORMATS = (".gpkg", ".geojson", ".json", ".csv")
"""The endings that are written."""


def write_changes(table: gpd.GeoDataFrame, path: Path) -> None:
    """Write changes in the format that the file's ending names.

    Parameters
    ----------
    table : GeoDataFrame
        As `msbdb.database.read_changes` or `msbdb.change.netchange.net_changes` gives it.
    path : Path
        Ends in .gpkg (layer ``change``), .geojson (longitude and latitude, ids as strings) or .csv (the coordinates of
        a point inside each footprint as ``easting`` and ``northing``). An existing file is replaced.

    Raises
    ------
    InputError
        For another ending.
    FileError
        When the file cannot be written.
    """
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        msg = f"Changes are written as {', '.join(FORMATS)}; got the name '{path.name}'."
        raise InputError(msg)
    frame = table.copy()
    for column in ("attributes_before", "attributes_after"):
        words = [None if value is None else json.dumps(value, sort_keys=True) for value in frame[column]]
        frame[column] = pd.Series(words, dtype=object, index=frame.index)
    if suffix == ".gpkg":
        write_layers(path, {"change": frame}, "GPKG", geometry_type="MultiPolygon")
    elif suffix == ".csv":
        _write_csv(frame, path)
    else:
        for column in frame.columns.intersection(list(IDS)):
            words = [None if pd.isna(value) else str(value) for value in frame[column]]
            frame[column] = pd.Series(words, dtype=object, index=frame.index)
        write_layers(path, {"change": frame}, "GeoJSON", geometry_type="MultiPolygon", RFC7946="YES")


def _write_csv(frame: gpd.GeoDataFrame, path: Path) -> None:
    """Write the rows without outlines."""
    inside = frame.geometry.representative_point()
    plain = pd.DataFrame(frame.drop(columns="geometry")).assign(easting=inside.x, northing=inside.y)
    with write_atomic(path) as temporary:
        plain.to_csv(temporary, index=False)

"""Changes of the inventory as a file; the ending of the name decides."""

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from msbdb.errors import InputError
from msbdb.io.files import write_atomic
from msbdb.io.layers import Layer, texts, write_layers

if TYPE_CHECKING:
    import geopandas as gpd

CHANGE_IDS = ("change_id", "uid_before", "uid_after", "version_before", "version_after")
"""Columns that GeoJSON writes as strings, as numbers above 2^53 are rounded in browsers."""

CHANGE_FORMATS = (".gpkg", ".geojson", ".json", ".csv")
"""The endings that are written."""


def write_changes(table: "gpd.GeoDataFrame", path: Path) -> None:
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
    if suffix not in CHANGE_FORMATS:
        msg = f"Changes are written as {', '.join(CHANGE_FORMATS)}; got the name '{path.name}'."
        raise InputError(msg)
    frame = table.copy()
    for column in ("attributes_before", "attributes_after"):
        words = [None if value is None else json.dumps(value, sort_keys=True) for value in frame[column]]
        frame[column] = np.array(words, dtype=object)
    if suffix == ".csv":
        _write_csv(frame, path)
        return
    layer = Layer.of(frame)
    if suffix == ".gpkg":
        write_layers(path, {"change": layer}, "GPKG")
    else:
        columns = {name: texts(values) if name in CHANGE_IDS else values for name, values in layer.columns.items()}
        write_layers(path, {"change": replace(layer, columns=columns)}, "GeoJSON", RFC7946="YES")


def _write_csv(frame: "gpd.GeoDataFrame", path: Path) -> None:
    """Write the rows without outlines."""
    inside = frame.geometry.representative_point()
    plain = frame.drop(columns="geometry").assign(easting=inside.x, northing=inside.y)
    with write_atomic(path) as temporary:
        plain.to_csv(temporary, index=False)

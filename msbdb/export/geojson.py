"""GeoJSON by RFC 7946: the parts in longitude and latitude, for the web."""

from collections.abc import Mapping
from pathlib import Path

import geopandas as gpd

from msbdb.io.vector import write_layers

IDS = ("part_id", "supid", "root_id")
"""Columns written as strings."""


def write(layers: Mapping[str, gpd.GeoDataFrame], path: Path) -> None:
    """Write the parts as one FeatureCollection; the footprints are those with ``supid`` "0" (V49).

    Parameters
    ----------
    layers : mapping of str to GeoDataFrame
        ``part``, the table ``PART`` with geometry and CRS. Other layers are not written: GeoJSON holds one, and the
        roots are in it.
    path : Path
        The file to write or replace.

    Notes
    -----
    Coordinates are WGS 84 longitude and latitude with 7 decimals (about 1 cm), shells counter-clockwise; all other
    columns keep their metric units. The ids are strings, and so is each feature's ``id``: they exceed 2^53, above
    which JSON numbers are rounded in browsers.
    """
    frame = layers["part"].copy()
    for column in IDS:
        frame[column] = frame[column].astype("str")
    frame["id"] = frame["part_id"]  # the driver takes the field of the id out of the properties
    write_layers(
        path,
        {path.stem: frame},
        "GeoJSON",
        geometry_type="MultiPolygon",
        RFC7946="YES",
        ID_FIELD="id",
        ID_TYPE="String",
    )

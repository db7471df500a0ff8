"""GeoJSON by RFC 7946: one layer in longitude and latitude."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from msbdb.export.content import Content
from msbdb.export.geopackage import ROOF_EDGES
from msbdb.io.layers import texts, write_layers

IDS = ("uid", "version_id", "building_id", "part_id", "supid", "root_id", "region_id", "candidate_id", "change_id",
       "uid_before", "uid_after", "version_before", "version_after")  # fmt: skip
"""Columns of ids, which may exceed 2^53, in the order of precedence for the id of a feature."""


def write_geojson(content: Content, path: Path, options: Mapping[str, str]) -> None:  # noqa: ARG001  (it has none)
    """Write the first layer as one FeatureCollection.

    Coordinates are WGS 84 longitude and latitude with 7 decimals (about 1 cm), shells counter-clockwise; all other
    columns keep their metric units. The ids are strings, and so is each feature's ``id``: they exceed 2^53, and
    browsers round larger JSON numbers.
    """
    layer = next(iter(content.layers.values()))
    columns = {name: texts(values) if name in IDS else values for name, values in layer.columns.items()}
    settings = {"RFC7946": "YES", "DESCRIPTION": ROOF_EDGES}
    key = next((name for name in ("part_id", *IDS) if name in columns), None)
    if key is not None:
        columns["id"] = columns[key]  # the driver takes the field of the id out of the properties
        settings |= {"ID_FIELD": "id", "ID_TYPE": "String"}
    write_layers(path, {path.stem: replace(layer, columns=columns)}, "GeoJSON", **settings)

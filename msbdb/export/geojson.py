"""GeoJSON: one layer, in longitude and latitude by RFC 7946 unless the user asks for another CRS."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from msbdb.export.content import IDS, ROOF_EDGES, Content
from msbdb.io.layers import write_layers


def write_geojson(content: Content, path: Path, options: Mapping[str, str]) -> None:  # noqa: ARG001  (it has none)
    """Write the first layer as one FeatureCollection.

    Coordinates are WGS 84 longitude and latitude with 7 decimals (about 1 cm), shells counter-clockwise; all other
    columns keep their metric units. With a CRS of the user's choice the file has its coordinates and names it in a
    member ``crs``, as before RFC 7946. The ids are strings, and so is each feature's ``id``: they exceed 2^53, and
    browsers round larger JSON numbers.
    """
    name = next(iter(content.layers))
    layer = content.textual(name)
    columns = dict(layer.columns)
    settings = {"DESCRIPTION": ROOF_EDGES} | ({} if content.chosen_crs else {"RFC7946": "YES"})
    key = next((own for own in IDS if own in columns), None)
    if key is not None:
        columns["id"] = columns[key]  # the driver takes the field of the id out of the properties
        settings |= {"ID_FIELD": "id", "ID_TYPE": "String"}
    write_layers(path, {path.stem: replace(layer, columns=columns)}, "GeoJSON", **settings)

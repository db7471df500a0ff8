"""Files of one layer: Shapefile, GeoJSON, GeoParquet, FlatGeobuf, CSV, KML and DXF."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray

from msbdb.errors import InputError
from msbdb.export.content import ROOF_EDGES, Content
from msbdb.export.fields import short_name
from msbdb.io.files import write_atomic
from msbdb.io.layers import Layer, write_layers
from msbdb.tables.aliases import LAYER_WORDS
from msbdb.tables.view_columns import IDS


def write_shapefile(content: Content, path: Path, options: Mapping[str, str]) -> None:  # noqa: ARG001  (it has none)
    """Write the first layer; of parts, the footprints are those with SUPID '0' (V49).

    Parameters
    ----------
    content : Content
        The layer.
    path : Path
        The .shp; .shx, .dbf, .prj and .cpg (UTF-8) lie beside it.
    options : mapping
        None.

    Notes
    -----
    The names are those of `msbdb.export.fields.short_name`. Ids are texts, because programs read long numbers of a DBF
    as floating point. The format cuts texts at 254 characters, and has no place for a description: the outlines are
    edges of roofs.
    """
    name = next(iter(content.layers))
    layer = content.textual(name)
    columns = {short_name(own): values for own, values in layer.columns.items()}
    write_layers(path, {path.stem: replace(layer, columns=columns)}, "ESRI Shapefile", encoding="UTF-8")


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


def write_parquet(content: Content, path: Path, options: Mapping[str, str]) -> None:  # noqa: ARG001  (it has none)
    """Write the first layer as GeoParquet 1.1: geometries as WKB, the column ``bbox`` named as their covering.

    Readers skip groups of rows by their bounds, so a window of a large file is read quickly. The CRS is in the file as
    PROJJSON. Ids are texts.
    """
    import geopandas as gpd

    name = next(iter(content.layers))
    frame: gpd.GeoDataFrame = content.textual(name).frame()
    with write_atomic(path) as temporary:
        frame.to_parquet(
            temporary, index=False, geometry_encoding="WKB", schema_version="1.1.0", write_covering_bbox=True
        )


def write_flatgeobuf(content: Content, path: Path, options: Mapping[str, str]) -> None:  # noqa: ARG001  (it has none)
    """Write the first layer with its spatial index; the file has its title and states what outlines are."""
    name, layer = _first(content)
    titles = {"TITLE": LAYER_WORDS[name], "DESCRIPTION": ROOF_EDGES}
    write_layers(path, {path.stem: layer}, "FlatGeobuf", **titles)


def write_csv(content: Content, path: Path, options: Mapping[str, str]) -> None:  # noqa: ARG001  (it has none)
    """Write the first layer as a table in UTF-8: the outline as WKT, and a point in it as easting and northing.

    A file of the same name and the ending .csvt has the types of the columns, by which GDAL and QGIS read the ids as
    text.
    """

    def without_prj(written: Path) -> None:
        written.with_suffix(".prj").unlink(missing_ok=True)  # a Shapefile of the same name has its own

    _, layer = _first(content)
    inside = shapely.point_on_surface(layer.geometry)
    columns = dict(layer.columns) | {"easting": shapely.get_x(inside), "northing": shapely.get_y(inside)}
    settings = {"GEOMETRY": "AS_WKT", "CREATE_CSVT": "YES", "STRING_QUOTING": "IF_NEEDED"}
    write_layers(path, {path.stem: replace(layer, columns=columns)}, "CSV", without_prj, **settings)


def write_kml(content: Content, path: Path, options: Mapping[str, str]) -> None:  # noqa: ARG001  (it has none)
    """Write the first layer as outlines on the ground, in longitude and latitude; the name of a placemark is its id.

    Raises
    ------
    InputError
        When the user asks for a CRS, as the format has one alone.
    """
    if content.chosen_crs and content.crs != "EPSG:4326":
        msg = f"A KML file is in longitude and latitude, EPSG:4326; got --crs {content.crs}. Leave out --crs."
        raise InputError(msg)
    name, layer = _first(content)
    key = next((own for own in IDS if own in layer.columns), None)
    columns = {"Name": layer.columns[key]} if key is not None else {}
    columns |= layer.columns
    write_layers(path, {LAYER_WORDS[name]: replace(layer, columns=columns)}, "KML")


def write_dxf(content: Content, path: Path, options: Mapping[str, str]) -> None:  # noqa: ARG001  (it has none)
    """Write the rings of the first layer as closed polylines, in layers by state, scale, kind or detector.

    The elevation of a ring is the level of the ground where the layer has it; otherwise it is 0. The format has no CRS
    and no attributes: coordinates are those of the layer's CRS.
    """
    name, layer = _first(content)
    by = next((own for own in ("state", "scale", "kind", "method") if own in layer.columns), None)
    words = np.full(len(layer), name.upper(), dtype=object)
    if by is not None:
        words = np.array([f"{name}_{value}".upper() for value in layer.columns[by].tolist()], dtype=object)
    level = np.nan_to_num(np.asarray(layer.columns.get("z_ground", np.zeros(len(layer))), dtype=np.float64))
    flat = shapely.get_parts(layer.geometry, return_index=True)
    if layer.kind == "Point":
        rings, owner, kind = flat[0], flat[1], "Point Z"
    else:
        found, ring_of = shapely.get_rings(flat[0], return_index=True)
        rings, owner, kind = _as_lines(found), flat[1][ring_of], "LineString Z"
    lifted = shapely.force_3d(rings, z=level[owner]) if len(rings) else rings
    write_layers(path, {"entities": Layer({"Layer": words[owner]}, lifted, layer.crs, kind)}, "DXF")


def _as_lines(rings: NDArray[np.object_]) -> NDArray[np.object_]:
    """Return rings as lines, which DXF has in place of them."""
    points, of_ring = shapely.get_coordinates(rings, return_index=True)
    lines: NDArray[np.object_] = shapely.linestrings(points, indices=of_ring) if len(rings) else rings
    return lines


def _first(content: Content) -> tuple[str, Layer]:
    """Return the name and the rows of the first layer, ids as text."""
    name = next(iter(content.layers))
    return name, content.textual(name)

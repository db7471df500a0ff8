"""Layers of a survey, and changes of the inventory, as files for other programs; the ending of the name decides."""

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from msbdb.errors import InputError
from msbdb.io.files import require_output, write_atomic
from msbdb.io.layers import Layer, texts, write_layers

if TYPE_CHECKING:
    import geopandas as gpd

IDS = ("part_id", "supid", "root_id", "building_id")
"""Columns that GeoJSON writes as strings."""

FIELDS = {
    "part_id": "ID",
    "supid": "SUPID",
    "supscale": "SUPSCALE",
    "scale": "SCALE",
    "hindex": "H",
    "xo": "XO",
    "yo": "YO",
    "xcen": "XCEN",
    "ycen": "YCEN",
    "area_m2": "AREA",
    "speindex": "SPE",
    "stddis": "STDDIS",
}
"""The paper's name of each column of ``PART`` that it has (V26); none is longer than the 10 characters of a DBF."""

ROOF_EDGES = (
    "Outlines are edges of roofs as seen from above, not walls at the ground: eaves are inside. 'fitted' outlines have "
    "straight walls, 'traced' ones follow cells (outline_source)."
)
"""The description that files carry, where their format has one."""

Layers = Mapping[str, Layer]

Writer = Callable[[Layers, Path], None]

CHANGE_IDS = ("change_id", "uid_before", "uid_after", "version_before", "version_after")
"""Columns that GeoJSON writes as strings, as numbers above 2^53 are rounded in browsers."""

CHANGE_FORMATS = (".gpkg", ".geojson", ".json", ".csv")
"""The endings that are written."""


def write_geojson(layers: Layers, path: Path) -> None:
    """Write the parts as one FeatureCollection; the footprints are those with ``supid`` "0" (V49).

    Parameters
    ----------
    layers : mapping of str to Layer
        ``part``, the table ``PART`` with geometry and CRS. Other layers are not written: GeoJSON holds one, and the
        roots are in it.
    path : Path
        The file to write or replace.

    Notes
    -----
    Coordinates are WGS 84 longitude and latitude with 7 decimals (about 1 cm), shells counter-clockwise; all other
    columns keep their metric units. The ids are strings, and so is each feature's ``id``: they exceed 2^53, and
    browsers round larger JSON numbers.
    """
    part = layers["part"]
    columns = {name: texts(values) if name in IDS else values for name, values in part.columns.items()}
    columns["id"] = columns["part_id"]  # the driver takes the field of the id out of the properties
    written = {path.stem: replace(part, columns=columns)}
    options = {"RFC7946": "YES", "ID_FIELD": "id", "ID_TYPE": "String", "DESCRIPTION": ROOF_EDGES}
    write_layers(path, written, "GeoJSON", **options)


def write_geopackage(layers: Layers, path: Path) -> None:
    """Write all layers under their names, all columns and the CRS kept; their description says what outlines are.

    Parameters
    ----------
    layers : mapping of str to Layer
        Declared tables of multipolygons with geometry and CRS.
    path : Path
        The file to write or replace.
    """
    write_layers(path, layers, "GPKG", DESCRIPTION=ROOF_EDGES)


def write_shapefile(layers: Layers, path: Path) -> None:
    """Write the parts; the footprints are those with SUPID = 0 (V49).

    Parameters
    ----------
    layers : mapping of str to Layer
        ``part``, the table ``PART`` with geometry and CRS, and ``survey`` where there are several. Other layers are
        not written: a Shapefile holds one, and the roots are in it.
    path : Path
        The .shp; .shx, .dbf, .prj and .cpg (UTF-8) lie beside it.

    Notes
    -----
    ID and SUPID take up to 18 digits and are written as N(18), exactly. A program that reads them as floating point
    numbers sees them rounded: join on the file's own values, or use the GeoPackage. The format has no place for a
    description: the outlines are edges of roofs.
    """
    part = layers["part"]
    columns = {field: part.columns[name] for name, field in FIELDS.items()}
    if "survey" in part.columns:
        columns["SURVEY"] = part.columns["survey"]
    write_layers(path, {path.stem: replace(part, columns=columns)}, "ESRI Shapefile", encoding="UTF-8")


FORMATS: dict[str, Writer] = {
    ".gpkg": write_geopackage,
    ".shp": write_shapefile,
    ".geojson": write_geojson,
    ".json": write_geojson,
}
"""The writer of each ending."""


def export(layers: Layers, path: Path, *, overwrite: bool = False) -> None:
    """Write the layers of a survey in the format that the ending names.

    Parameters
    ----------
    layers : mapping of str to Layer
        ``part``, and for a GeoPackage any others, such as ``footprint``, ``flat_region`` and ``candidate_region``: the
        declared tables with geometry and CRS; they may be empty.
    path : Path
        Ends in .gpkg (all layers), .shp (parts with the paper's names) or .geojson (parts).
    overwrite : bool
        Replace files that exist.

    Raises
    ------
    InputError
        For another ending.
    FileError
        When a file exists already, or cannot be written.
    """
    require_output(path, overwrite=overwrite, endings=tuple(FORMATS))
    FORMATS[path.suffix.lower()](layers, path)


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

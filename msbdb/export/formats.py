"""Layers of a survey as GeoPackage, Shapefile or GeoJSON; the ending of the file's name decides."""

from collections.abc import Callable, Mapping
from pathlib import Path

import geopandas as gpd

from msbdb.errors import FileError, InputError
from msbdb.io.vector import existing_files, write_layers

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

Layers = Mapping[str, gpd.GeoDataFrame]

Writer = Callable[[Layers, Path], None]


def write_geojson(layers: Mapping[str, gpd.GeoDataFrame], path: Path) -> None:
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
    columns keep their metric units. The ids are strings, and so is each feature's ``id``: they exceed 2^53, and
    browsers round larger JSON numbers.
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


def write_geopackage(layers: Mapping[str, gpd.GeoDataFrame], path: Path) -> None:
    """Write all layers under their names, all columns and the CRS kept.

    Parameters
    ----------
    layers : mapping of str to GeoDataFrame
        Declared tables of multipolygons with geometry and CRS.
    path : Path
        The file to write or replace.
    """
    write_layers(path, dict(layers), "GPKG", geometry_type="MultiPolygon")


def write_shapefile(layers: Mapping[str, gpd.GeoDataFrame], path: Path) -> None:
    """Write the parts; the footprints are those with SUPID = 0 (V49).

    Parameters
    ----------
    layers : mapping of str to GeoDataFrame
        ``part``, the table ``PART`` with geometry and CRS. Other layers are not written: a Shapefile holds one, and the
        roots are in it.
    path : Path
        The .shp; .shx, .dbf, .prj and .cpg (UTF-8) lie beside it.

    Notes
    -----
    ID and SUPID take up to 18 digits and are written as N(18), exactly. A program that reads them as floating point
    numbers sees them rounded: join on the file's own values, or use the GeoPackage.
    """
    frame = layers["part"][[*FIELDS, "geometry"]].rename(columns=FIELDS)
    write_layers(path, {path.stem: frame}, "ESRI Shapefile", geometry_type="MultiPolygon", encoding="UTF-8")


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
    layers : mapping of str to GeoDataFrame
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
    writer = FORMATS.get(path.suffix.lower())
    if writer is None:
        msg = f"The ending of the file's name decides the format: {', '.join(FORMATS)}. Got '{path.name}'."
        raise InputError(msg)
    found = existing_files(path)
    if found and not overwrite:
        msg = f"{', '.join(str(file) for file in found)} exists already. Delete it, or add --overwrite."
        raise FileError(msg)
    writer(layers, path)

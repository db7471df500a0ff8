"""Shapefile: the parts under the paper's names."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from msbdb.export.content import Content
from msbdb.io.layers import write_layers

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


def write_shapefile(content: Content, path: Path, options: Mapping[str, str]) -> None:  # noqa: ARG001  (it has none)
    """Write the parts; the footprints are those with SUPID = 0 (V49).

    Parameters
    ----------
    content : Content
        With the layer ``part``.
    path : Path
        The .shp; .shx, .dbf, .prj and .cpg (UTF-8) lie beside it.
    options : mapping
        None.

    Notes
    -----
    ID and SUPID take up to 18 digits and are written as N(18), exactly. A program that reads them as floating point
    numbers sees them rounded: join on the file's own values, or use the GeoPackage. The format has no place for a
    description: the outlines are edges of roofs.
    """
    part = content.layers["part"]
    columns = {field: part.columns[name] for name, field in FIELDS.items()}
    if "survey" in part.columns:
        columns["SURVEY"] = part.columns["survey"]
    write_layers(path, {path.stem: replace(part, columns=columns)}, "ESRI Shapefile", encoding="UTF-8")

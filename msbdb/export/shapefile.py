"""Shapefile: the parts with the attribute names of Vu et al. 2009."""

from collections.abc import Mapping
from pathlib import Path

import geopandas as gpd

from msbdb.io.vector import write_layers

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


def write(layers: Mapping[str, gpd.GeoDataFrame], path: Path) -> None:
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

"""GeoPackage: the footprints and the parts as layers of one file."""

from pathlib import Path

import geopandas as gpd

from msbdb.io.vectorwrite import write_layers


def write(parts: gpd.GeoDataFrame, buildings: gpd.GeoDataFrame, path: Path) -> None:
    """Write the layers ``footprint`` (table ``BUILDING``) and ``part`` (table ``PART``), all columns and the CRS kept.

    Parameters
    ----------
    parts, buildings : GeoDataFrame
        Tables ``PART`` and ``BUILDING`` with geometry and CRS.
    path : Path
        The file to write or replace.
    """
    write_layers(path, {"footprint": buildings, "part": parts}, "GPKG", geometry_type="MultiPolygon")

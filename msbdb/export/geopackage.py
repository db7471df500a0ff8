"""GeoPackage: the footprints, the parts and what other extractors found as layers of one file."""

from collections.abc import Mapping
from pathlib import Path

import geopandas as gpd

from msbdb.io.vector import write_layers


def write(layers: Mapping[str, gpd.GeoDataFrame], path: Path) -> None:
    """Write all layers under their names, all columns and the CRS kept.

    Parameters
    ----------
    layers : mapping of str to GeoDataFrame
        Declared tables of multipolygons with geometry and CRS.
    path : Path
        The file to write or replace.
    """
    write_layers(path, dict(layers), "GPKG", geometry_type="MultiPolygon")

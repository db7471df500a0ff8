"""The choice of the format by the file's suffix."""

from collections.abc import Callable, Mapping
from pathlib import Path

import geopandas as gpd

from msbdb.errors import FileError, InputError
from msbdb.export import geojson, geopackage, shapefile
from msbdb.io.vector import existing_files

Layers = Mapping[str, gpd.GeoDataFrame]
Writer = Callable[[Layers, Path], None]

FORMATS: dict[str, Writer] = {
    ".gpkg": geopackage.write,
    ".shp": shapefile.write,
    ".geojson": geojson.write,
    ".json": geojson.write,
}
"""The writer of each suffix."""


def export(layers: Layers, path: Path, *, overwrite: bool = False) -> None:
    """Write the layers of a survey in the format that the suffix names.

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
        For another suffix.
    FileError
        When a file is there already, or cannot be written.
    """
    writer = FORMATS.get(path.suffix.lower())
    if writer is None:
        msg = f"The format is told by the ending, one of {', '.join(FORMATS)}; got '{path.name}'."
        raise InputError(msg)
    found = existing_files(path)
    if found and not overwrite:
        msg = f"{', '.join(str(file) for file in found)} is there already. Remove it, or ask for it to be overwritten."
        raise FileError(msg)
    writer(layers, path)

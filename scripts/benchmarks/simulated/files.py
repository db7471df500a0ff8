"""Files of simulated scenes: what a user would hand to a build."""

from pathlib import Path

import laspy
import numpy as np
import rasterio
from numpy.typing import NDArray

from msbdb.grid import Grid, GridSpec
from msbdb.points.cloud import PointCloud

FORMATS = {(): 6, ("red", "green", "blue"): 7, ("red", "green", "blue", "nir"): 8}
"""Point formats of LAS 1.4 by the colours that they hold."""


def write_points(path: Path, cloud: PointCloud, *, metres: float = 1.0, crs: object = None) -> Path:
    """Write a cloud as LAS or LAZ 1.4; ``metres`` is the length of the file's unit, ``crs`` what its header says.

    Coordinates are whole thousandths of the unit from a round offset, so that parts of a cloud keep the very same
    coordinates as the whole.
    """
    header = laspy.LasHeader(version="1.4", point_format=FORMATS[cloud.colour_names])
    header.add_crs(crs or cloud.crs)
    x, y, z = cloud.x / metres, cloud.y / metres, cloud.z / metres
    header.scales, header.offsets = [0.001] * 3, [x.min() // 1e6 * 1e6, y.min() // 1e6 * 1e6, 0.0]
    las = laspy.LasData(header)
    las.x, las.y, las.z = x, y, z
    las.classification = np.ones(len(cloud), np.uint8) if cloud.classification is None else cloud.classification
    for name in ("return_number", "number_of_returns", "intensity"):
        if getattr(cloud, name) is not None:
            las[name] = getattr(cloud, name)
    for column, name in enumerate(cloud.colour_names):
        las[name] = cloud.colours[:, column]
    las.write(path)
    return path


def write_image(path: Path, bands: NDArray[np.number], spec: GridSpec, names: tuple[str, ...]) -> Path:
    """Write (B, H, W) bands as a GeoTIFF of 8 bits whose bands say what they are."""
    profile = {"driver": "GTiff", "count": len(bands), "dtype": "uint8", "crs": spec.crs, "transform": spec.transform}
    with rasterio.open(path, "w", height=spec.shape[0], width=spec.shape[1], **profile) as image:
        image.write(np.clip(np.round(bands), 0, 255).astype(np.uint8))
        for number, name in enumerate(names, 1):
            image.set_band_description(number, name)
    return path


def write_heights(path: Path, grid: Grid) -> Path:
    """Write heights as a GeoTIFF, with the nodata value -9999 where they are not valid."""
    spec, nodata = grid.spec, -9999.0
    profile = {"driver": "GTiff", "count": 1, "dtype": "float32", "crs": spec.crs.to_wkt(), "transform": spec.transform}
    with rasterio.open(path, "w", height=spec.shape[0], width=spec.shape[1], nodata=nodata, **profile) as image:
        image.write(np.where(grid.valid, grid.values, nodata).astype(np.float32), 1)
    return path

"""Sound input files of the simulated scenes, for tests that then spoil them or disturb the build."""

from pathlib import Path

import laspy
import numpy as np
import rasterio
from affine import Affine
from pyproj import CRS

from msbdb.grid import GridSpec
from msbdb.points.cloud import PointCloud

COLOURS = ("red", "green", "blue", "nir")


def write_points(path: Path, cloud: PointCloud, *, crs: CRS | None, **changes: np.ndarray) -> Path:
    """Write a cloud with echoes, intensity and colours as LAS or LAZ; ``changes`` replace single columns.

    The CRS goes into the header; None leaves it out.
    """
    header = laspy.LasHeader(point_format=8, version="1.4")
    header.scales, header.offsets = [0.001] * 3, np.floor([cloud.x.min(), cloud.y.min(), 0.0])
    if crs is not None:
        header.add_crs(crs)
    las = laspy.LasData(header)
    columns = {
        name: getattr(cloud, name) for name in ("x", "y", "z", "return_number", "number_of_returns", "intensity")
    }
    columns |= dict(zip(COLOURS, cloud.colours.T, strict=True))
    for name, values in {**columns, **changes}.items():
        setattr(las, name, values)
    las.write(path)
    return path


def write_raster(path: Path, values: np.ndarray, spec: GridSpec, *, crs: CRS | None = None, **profile: object) -> Path:
    """Write (H, W) or (B, H, W) values on a lattice as GeoTIFF; in the lattice's CRS unless another is given."""
    bands = values[None] if values.ndim == 2 else values
    options = {"transform": spec.transform, "crs": (crs or spec.crs).to_wkt(), "dtype": values.dtype.name, **profile}
    count, height, width = bands.shape
    with rasterio.open(path, "w", driver="GTiff", count=count, height=height, width=width, **options) as dataset:
        dataset.write(bands)
    return path


def moved(spec: GridSpec, east: float, north: float) -> GridSpec:
    """Return the lattice elsewhere."""
    t = spec.transform
    return GridSpec(spec.shape, Affine(t.a, 0.0, t.c + east, 0.0, t.e, t.f + north), spec.crs)

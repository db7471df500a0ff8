"""Opening rasters and moving their cells onto a lattice: what the readers of heights and of images share."""

import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import rasterio
from affine import Affine
from numpy.typing import NDArray
from pyproj import CRS
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.warp import Resampling, reproject

from msbdb.errors import FileError, InputError
from msbdb.grid import Bounds, GridSpec
from msbdb.io.crs import CrsLike, same_crs, settle


@contextmanager
def open_raster(path: str | os.PathLike[str]) -> Iterator[rasterio.DatasetReader]:
    """Open a raster, turning GDAL's failures, also those while reading, into ``FileError``."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            dataset = rasterio.open(path)
        with dataset:
            yield dataset
    except RasterioError as error:
        reason = "does not exist" if not Path(path).exists() else f"cannot be read as a raster ({error})"
        msg = f"{path} {reason}. Check the path, or fetch or export the file again."
        raise FileError(msg) from error


def raster_crs(dataset: rasterio.DatasetReader, stated: CrsLike | None) -> CRS:
    """Return a raster's CRS, settled with the stated one."""
    found = None if dataset.crs is None else CRS.from_wkt(dataset.crs.to_wkt())
    return settle(found, stated, Path(dataset.name).name)


def raster_bounds(dataset: rasterio.DatasetReader) -> Bounds:
    """Return west, south, east and north of a raster in its own units, also if it is rotated."""
    t, rows, cols = dataset.transform, dataset.height, dataset.width
    xs = [t.c + col * t.a + row * t.b for col in (0, cols) for row in (0, rows)]
    ys = [t.f + col * t.d + row * t.e for col in (0, cols) for row in (0, rows)]
    return (min(xs), min(ys), max(xs), max(ys))


def warp(source: NDArray[np.float32], transform: Affine, crs: CRS, onto: GridSpec, method: str) -> NDArray[np.float32]:
    """Resample (H, W) float32 values, NaN where there is none, onto a lattice; NaN where nothing falls."""
    methods = {"nearest": Resampling.nearest, "bilinear": Resampling.bilinear, "average": Resampling.average}
    if method not in methods:
        msg = f"The resampling must be one of {', '.join(methods)}; got {method!r}."
        raise InputError(msg)
    target = np.full(onto.shape, np.nan, dtype=np.float32)
    with rasterio.Env():
        there = rasterio.crs.CRS.from_wkt(onto.crs.to_wkt())
        here = there if same_crs(crs, onto.crs) else rasterio.crs.CRS.from_wkt(crs.to_wkt())
        reproject(
            source,
            target,
            src_transform=transform,
            src_crs=here,
            src_nodata=np.nan,
            dst_transform=onto.transform,
            dst_crs=there,
            dst_nodata=np.nan,
            resampling=methods[method],
        )
    return target

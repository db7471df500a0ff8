"""Reading heights from rasters: nodata and units end here, a ``Grid`` knows only validity and metres.

Images are opened and moved onto a lattice by the same functions; see ``msbdb.io.ortho``.
"""

import logging
import math
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
from rasterio.transform import rowcol
from rasterio.warp import Resampling, reproject, transform_bounds
from rasterio.windows import Window

from msbdb.errors import CRSError, FileError, GridMismatchError, InputError, NodataError, give_notice
from msbdb.grid import LATTICE_TOLERANCE, Bounds, Grid, GridSpec
from msbdb.io.crs import CrsLike, Reference, name_of, reference, same_crs, settle, split_crs

logger = logging.getLogger(__name__)

SENTINELS = (-9999.0, -99999.0, -999999.0, -32768.0, -32767.0)
"""Heights that mean 'no value' even where the file does not declare it; no place on earth is that low."""

LARGEST_HEIGHT_M = 1e5
"""Heights beyond it, such as float32's lowest number, mean 'no value' as well."""

BAND_UNITS = {
    "m": "m", "metre": "m", "meter": "m", "metres": "m", "meters": "m",
    "ft": "ft", "foot": "ft", "feet": "ft", "international foot": "ft",
    "us-ft": "us-ft", "ftus": "us-ft", "us survey foot": "us-ft", "us survey feet": "us-ft",
}  # fmt: skip
"""Names of units in a band's unit tag."""


def read_grid(
    path: str | os.PathLike[str],
    *,
    crs: CrsLike | None = None,
    role: str = "DSM",
    z_unit: str = "auto",
    over: GridSpec | None = None,
    within: Bounds | None = None,
) -> Grid:
    """Read a raster of heights, in metres.

    Parameters
    ----------
    path : path
        A raster of one band, north-up, of square cells, in a projected CRS.
    crs : int, str or CRS, optional
        The CRS of a file that has none; where the file has one, it must be the same.
    role : str
        What the heights are, for messages.
    z_unit : {'auto', 'm', 'ft', 'us-ft'}
        Unit of the heights. 'auto' takes that of the vertical CRS, else of the band, else that of a CRS in feet,
        else metres.
    over : GridSpec, optional
        Only the part of the raster around this lattice is read, with what it takes to interpolate. As it will be
        resampled, lengths may be wrong in its CRS.
    within : tuple of float, optional
        West, south, east and north, metres: only cells with their centre in these bounds are read.

    Returns
    -------
    Grid
        (H, W) float32, metres. A cell is not valid where the file masks it (nodata tag, mask or alpha band), where
        it is not finite, one of ``SENTINELS`` or beyond ``LARGEST_HEIGHT_M``.

    Raises
    ------
    FileError
        If the file cannot be read.
    InputError
        If it has several bands, is rotated, or its cells are not square.
    CRSError
        If the CRS is missing, in conflict with ``crs``, geographic, or one that scaling does not make metric.
    GridMismatchError
        If the raster lies beside the lattice.
    NodataError
        If no cell is valid, unless the part around a lattice is read.

    Warns
    -----
    MsbdbWarning
        If units were converted.
    """
    name = Path(path).name
    with open_raster(path) as dataset:
        whole, own, how = _described(dataset, crs=crs, role=role, z_unit=z_unit, resampled=over is not None)
        window = None if over is None else window_over(dataset, over, own)
        if over is not None and window is None:
            raise _apart(role, whole, over)
        if within is not None:
            rows, cols = whole.within(within)
            if rows.start == rows.stop:
                msg = f"The {role} {name} has no cell in {tuple(round(b, 1) for b in within)}."
                raise NodataError(msg)
            window = Window.from_slices(rows, cols)
        values, valid = _heights(dataset, window)
    for notice in how.notices:
        give_notice(f"{name}: {notice}")
    if over is None and not valid.any():
        where = f"has no valid cell in {tuple(round(b, 1) for b in within)}" if within else "has no valid cell"
        msg = f"The {role} {name} {where}. Check its nodata value."
        raise NodataError(msg)
    heights = values if how.z_factor == 1.0 else (values * how.z_factor).astype(np.float32)
    logger.info("Read %s of %s cells; %.1f %% have a value", name, valid.shape, 100 * valid.mean())
    return Grid(heights, valid, whole if window is None else whole.crop(*window.toslices()))


def lattice_of_raster(
    path: str | os.PathLike[str], *, crs: CrsLike | None = None, role: str = "DSM", z_unit: str = "auto"
) -> GridSpec:
    """Return the lattice of a raster of heights, in metres, without reading its cells; errors as `read_grid`."""
    with open_raster(path) as dataset:
        return _described(dataset, crs=crs, role=role, z_unit=z_unit)[0]


def _described(
    dataset: rasterio.DatasetReader, *, crs: CrsLike | None, role: str, z_unit: str, resampled: bool = False
) -> tuple[GridSpec, CRS, Reference]:
    """Return the lattice of a raster of heights in metres, its own horizontal CRS, and what leads to metres."""
    name = Path(dataset.name).name
    if dataset.count != 1:
        msg = (
            f"The {role} {name} has {dataset.count} bands; heights are one band. "
            "Take it out, for instance with 'gdal_translate -b 1'."
        )
        raise InputError(msg)
    own = raster_crs(dataset, crs)
    transform, shape, bounds = dataset.transform, dataset.shape, raster_bounds(dataset)
    _require_square(transform, f"The {role} {name}")
    unit = BAND_UNITS.get((dataset.units[0] or "").strip().lower())
    what = f"cells of the {role}"
    how = reference(own, bounds=bounds, where=name, z_unit=z_unit, z_hint=unit, what=what, resampled=resampled)
    if how.transformer is not None:
        msg = (
            f"The {role} {name} is in {name_of(how.source)}, which no scaling makes metric. "
            f"Warp it first: gdalwarp -t_srs EPSG:{how.crs.to_epsg()} -r bilinear {name} metric.tif"
        )
        raise CRSError(msg)
    side = (transform.a - transform.e) / 2 * how.xy_factor
    metric = Affine(side, 0.0, transform.c * how.xy_factor, 0.0, -side, transform.f * how.xy_factor)
    return GridSpec(shape, metric, how.crs), split_crs(own)[0], how


def _require_square(transform: Affine, what: str) -> None:
    """Refuse rotated or south-up rasters and cells that are not square."""
    side = max(abs(transform.a), abs(transform.e))
    if transform.b or transform.d or transform.a <= 0 or transform.e >= 0:
        msg = f"{what} is rotated, or not north-up. Warp it first, for instance with 'gdalwarp -r bilinear'."
        raise InputError(msg)
    if abs(transform.a + transform.e) > 1e-6 * side:
        msg = (
            f"{what} has cells of {transform.a:.6g} by {-transform.e:.6g}, which must be square. "
            f"Warp it first: gdalwarp -tr {transform.a:.6g} {transform.a:.6g} -r bilinear."
        )
        raise InputError(msg)


def _heights(dataset: rasterio.DatasetReader, window: Window | None) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return the band's values in a window, scaled by its own tags, and where they are valid."""
    raw = dataset.read(1, window=window)
    if np.iscomplexobj(raw):
        msg = f"{Path(dataset.name).name} holds complex numbers; heights are real."
        raise InputError(msg)
    valid = (dataset.read_masks(1, window=window) != 0) & np.isfinite(raw)
    values = np.where(valid, raw, 0).astype(np.float64)
    valid &= ~np.isin(values, SENTINELS) & (np.abs(values) < LARGEST_HEIGHT_M)
    values = values * dataset.scales[0] + dataset.offsets[0]
    return np.where(valid, values, 0.0).astype(np.float32), valid


def align_grid(grid: Grid, onto: GridSpec, *, role: str = "DTM", resampling: str = "bilinear") -> Grid:
    """Bring heights onto another lattice, for instance a DTM onto that of its DSM.

    Parameters
    ----------
    grid : Grid
        Heights on any lattice and CRS.
    onto : GridSpec
        The lattice wanted. A grid that is on it already is returned as it is; one whose cells hold all of its cells is
        cut.
    role : str
        What the heights are, for messages.
    resampling : {'bilinear', 'nearest', 'average'}
        Bilinear and average use valid cells alone; a cell without any stays invalid.

    Raises
    ------
    GridMismatchError
        If no valid cell falls onto the lattice.

    Warns
    -----
    MsbdbWarning
        If some of the lattice is not covered.
    """
    if grid.spec.same_lattice(onto):
        return grid
    cells = _same_cells(grid, onto)
    if cells is not None:
        return cells
    source = np.where(grid.valid, grid.values, np.nan).astype(np.float32)
    values = warp(source, grid.spec.transform, grid.spec.crs, onto, resampling)
    valid = np.isfinite(values)
    if not valid.any():
        raise _apart(role, grid.spec, onto)
    if not valid.all():
        missing = 100.0 * float(np.mean(~valid))
        give_notice(f"The {role} leaves {missing:.1f} % of the lattice without a value.")
    return Grid(np.where(valid, values, np.float32(0)), valid, onto)


def _same_cells(grid: Grid, onto: GridSpec) -> Grid | None:
    """Return the part of a grid that is a lattice, None where its cells are others or do not hold all of it."""
    spec = grid.spec
    if spec.crs != onto.crs or abs(spec.cell_m - onto.cell_m) > LATTICE_TOLERANCE * onto.cell_m / max(onto.shape):
        return None
    places = ((spec.transform.f - onto.transform.f) / onto.cell_m, (onto.transform.c - spec.transform.c) / onto.cell_m)
    first = [round(place) for place in places]
    last = [start + count for start, count in zip(first, onto.shape, strict=True)]
    beside = max(abs(place - start) for place, start in zip(places, first, strict=True))
    if beside > LATTICE_TOLERANCE or min(first) < 0 or last[0] > spec.shape[0] or last[1] > spec.shape[1]:
        return None
    part = grid.crop(slice(first[0], last[0]), slice(first[1], last[1]))
    return Grid(part.values, part.valid, onto) if part.valid.any() else None


def _apart(role: str, spec: GridSpec, onto: GridSpec) -> GridMismatchError:
    """Return the error of heights without a valid cell on a lattice."""
    return GridMismatchError(
        f"The {role} covers {tuple(round(b, 1) for b in spec.bounds)} in '{spec.crs.name}', and no valid "
        f"cell of it lies in {tuple(round(b, 1) for b in onto.bounds)} in '{onto.crs.name}'. Give a {role} of "
        "the same place."
    )


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


def raster_pieces(path: str | os.PathLike[str]) -> tuple[Path, ...]:
    """Return the files over which a virtual raster (VRT) lies, in its order; none for other rasters."""
    with open_raster(path) as dataset:
        if dataset.driver != "VRT":
            return ()
        own = Path(path).resolve()
        return tuple(Path(name) for name in dataset.files if Path(name).resolve() != own)


def raster_crs(dataset: rasterio.DatasetReader, stated: CrsLike | None) -> CRS:
    """Return a raster's CRS, settled with the stated one."""
    found = None if dataset.crs is None else CRS.from_wkt(dataset.crs.to_wkt())
    return settle(found, stated, Path(dataset.name).name)


def states_crs(path: str | os.PathLike[str]) -> bool:
    """Return whether a raster states a CRS."""
    with open_raster(path) as dataset:
        return dataset.crs is not None


def raster_bounds(dataset: rasterio.DatasetReader) -> Bounds:
    """Return west, south, east and north of a raster in its own units, also if it is rotated."""
    t, rows, cols = dataset.transform, dataset.height, dataset.width
    xs = [t.c + col * t.a + row * t.b for col in (0, cols) for row in (0, rows)]
    ys = [t.f + col * t.d + row * t.e for col in (0, cols) for row in (0, rows)]
    return (min(xs), min(ys), max(xs), max(ys))


def window_over(dataset: rasterio.DatasetReader, spec: GridSpec, crs: CRS) -> Window | None:
    """Return the part of a raster around a lattice, with what it takes to interpolate, or None if they are apart.

    ``crs`` is that of the raster. GDAL interpolates from two pixels on each side, or two cells where these are larger.
    """
    west, south, east, north = spec.bounds
    if not same_crs(crs, spec.crs):
        west, south, east, north = transform_bounds(spec.crs.to_wkt(), crs.to_wkt(), *spec.bounds)
    corners = [(x, y) for x in (west, east) for y in (south, north)]
    rows, cols = rowcol(dataset.transform, *zip(*corners, strict=True), op=np.asarray)
    per_cell = max(np.ptp(rows) / spec.shape[0], np.ptp(cols) / spec.shape[1], 1)
    margin = math.ceil(2 * per_cell)
    col0, col1 = max(math.floor(min(cols)) - margin, 0), min(math.ceil(max(cols)) + margin, dataset.width)
    row0, row1 = max(math.floor(min(rows)) - margin, 0), min(math.ceil(max(rows)) + margin, dataset.height)
    if col0 >= col1 or row0 >= row1:
        return None
    return Window(col0, row0, col1 - col0, row1 - row0)


def warp(source: NDArray[np.float32], transform: Affine, crs: CRS, onto: GridSpec, method: str) -> NDArray[np.float32]:
    """Resample (H, W) float32 values onto a lattice; NaN means no value, in the source and in the result."""
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

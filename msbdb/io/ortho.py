"""Reading image bands onto a lattice: any number of bands from any number of files, each on its own grid."""

import logging
import math
import os
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rasterio
from affine import Affine
from numpy.typing import NDArray
from pyproj import CRS
from rasterio.enums import ColorInterp
from rasterio.warp import transform_bounds
from rasterio.windows import Window

from msbdb.errors import GridMismatchError, InputError
from msbdb.grid import Bands, Bounds, GridSpec
from msbdb.io.crs import CrsLike, same_crs, split_crs
from msbdb.io.raster import open_raster, raster_bounds, raster_crs, warp, window_over

logger = logging.getLogger(__name__)

BAND_WORDS = {
    "red": "red", "rouge": "red", "green": "green", "vert": "green", "blue": "blue", "bleu": "blue",
    "nir": "nir", "near infrared": "nir", "infrared": "nir", "pir": "nir", "proche infrarouge": "nir",
    "intensity": "intensity",
}  # fmt: skip
"""Words for a band, in a description or a file's name."""

COMPOSITES = {
    "irc": ("nir", "red", "green"),
    "cir": ("nir", "red", "green"),
    "irrg": ("nir", "red", "green"),
    "nrg": ("nir", "red", "green"),
    "rgb": ("red", "green", "blue"),
    "rvb": ("red", "green", "blue"),
    "rgbn": ("red", "green", "blue", "nir"),
    "rgbi": ("red", "green", "blue", "nir"),
    "rgbnir": ("red", "green", "blue", "nir"),
}
"""Words in a file's name that give its bands in order; false-colour files are often declared as red, green and blue."""

ORDER = ("red", "green", "blue", "nir", "intensity")

INTERPRETED = {ColorInterp.red: "red", ColorInterp.green: "green", ColorInterp.blue: "blue"}


def read_bands(
    paths: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    spec: GridSpec,
    *,
    resampling: str = "auto",
    band_names: Sequence[str] | None = None,
    crs: CrsLike | None = None,
) -> Bands:
    """Read the bands of one or many images onto a lattice (V20).

    Bands of the same name are mosaicked, bands of other names are added: tiles of an RGB and of an infrared image
    can be given together. Where several files hold a cell of a band, the first by file name gives it.

    Parameters
    ----------
    paths : path or sequence of paths
        Images of any number of bands, grids and CRSs.
    spec : GridSpec
        The lattice, usually that of the DSM.
    resampling : {'auto', 'average', 'bilinear', 'nearest'}
        'auto' averages the pixels in a cell where the image is finer than the lattice, else interpolates.
    band_names : sequence of str, optional
        Names of every file's bands in order, with or without any alpha band. By default they come from, in order: the
        bands' descriptions, a word in the file's name (such as irc or rgb), the colour interpretation, the position.
    crs : int, str or CRS, optional
        The CRS of images that have none; where a file has one, it must be the same.

    Returns
    -------
    Bands
        (B, H, W) float32 in the source's units; red, green, blue, nir and intensity first, others by name. A cell is
        valid where every band has a value. A pixel has a value unless all bands of its file are nodata there, or its
        alpha is 0: where nodata is 255, a pixel needs to be white in every band to be lost.

    Raises
    ------
    FileError
        If a file cannot be read.
    InputError
        If the names do not fit the bands.
    CRSError
        If a CRS is missing, or in conflict with ``crs``.
    GridMismatchError
        If no pixel of any file, or of some band, falls onto the lattice.
    """
    chosen = [paths] if isinstance(paths, str | os.PathLike) else list(paths)
    if not chosen:
        msg = "No images were given. Give at least one by --ortho."
        raise InputError(msg)
    mosaic: dict[str, NDArray[np.float32]] = {}
    apart: list[str] = []
    for path in sorted((Path(p) for p in chosen), key=lambda p: (p.name, str(p))):
        with open_raster(path) as dataset:
            own = split_crs(raster_crs(dataset, crs))[0]
            of_band = _names(dataset, band_names)
            overlapping = _add(dataset, own, spec, resampling=resampling, names=of_band, mosaic=mosaic)
        if not overlapping:
            apart.append(f"{path.name} ({', '.join(f'{b:.1f}' for b in _bounds_on(dataset, own, spec))})")
    seen = {name: bool(np.isfinite(values).any()) for name, values in mosaic.items()}
    if not all(seen.values()) or len(apart) == len(chosen):
        empty = ", ".join(name for name, any_seen in seen.items() if not any_seen) or "any band"
        msg = (
            f"No pixel of {empty} falls onto the lattice {tuple(round(b, 1) for b in spec.bounds)} in "
            f"'{spec.crs.name}'; images outside of it: {'; '.join(apart) or 'none'}. Give images of the same place."
        )
        raise GridMismatchError(msg)
    names = tuple(sorted(mosaic, key=lambda name: (ORDER.index(name) if name in ORDER else len(ORDER), name)))
    values = np.stack([mosaic[name] for name in names])
    valid: NDArray[np.bool_] = np.asarray(np.isfinite(values).all(axis=0))
    logger.info("Read the bands %s; %.1f %% have a value", ", ".join(names), 100 * valid.mean())
    return Bands(np.where(valid, values, np.float32(0)), names, valid, spec)


def _add(
    dataset: rasterio.DatasetReader,
    own: CRS,
    spec: GridSpec,
    *,
    resampling: str,
    names: dict[int, str],
    mosaic: dict[str, NDArray[np.float32]],
) -> bool:
    """Resample a file's bands into the gaps of the mosaic; return whether the file overlaps the lattice."""
    for name in names.values():
        mosaic.setdefault(name, np.full(spec.shape, np.nan, dtype=np.float32))
    window = window_over(dataset, spec, own)
    if window is None:
        return False
    transform = dataset.transform @ Affine.translation(window.col_off, window.row_off)
    seen = _seen(dataset, window, list(names))
    side = math.sqrt(abs(transform.determinant)) * own.axis_info[0].unit_conversion_factor
    finer = not own.is_projected or side < spec.cell_m
    method = ("average" if finer else "bilinear") if resampling == "auto" else resampling
    for index, name in names.items():
        pixels = dataset.read(index, window=window).astype(np.float32)
        pixels[~(seen & np.isfinite(pixels))] = np.nan
        values = warp(pixels, transform, own, spec, method)
        gaps = np.isnan(mosaic[name])
        mosaic[name][gaps] = values[gaps]
    return True


def _seen(dataset: rasterio.DatasetReader, window: Window, indexes: list[int]) -> NDArray[np.bool_]:
    """Return which pixels of a window have a value: not nodata in every band, nor transparent."""
    if ColorInterp.alpha not in [dataset.colorinterp[i - 1] for i in indexes]:
        return np.asarray(dataset.dataset_mask(window=window) != 0)
    # A band that is only called alpha would mask all others; its name shows that it is an image band.
    seen = np.zeros((window.height, window.width), dtype=np.bool_)
    for i in indexes:
        nodata = dataset.nodatavals[i - 1]
        seen |= True if nodata is None else dataset.read(i, window=window) != nodata
    return seen


def _bounds_on(dataset: rasterio.DatasetReader, crs: CRS, spec: GridSpec) -> Bounds:
    """Return a raster's bounds in the lattice's CRS."""
    own = raster_bounds(dataset)
    if same_crs(crs, spec.crs):
        return own
    bounds: Bounds = transform_bounds(crs.to_wkt(), spec.crs.to_wkt(), *own)
    return bounds


def _names(dataset: rasterio.DatasetReader, given: Sequence[str] | None) -> dict[int, str]:
    """Return the name of every band by its number; alpha bands have none."""
    file = Path(dataset.name)
    words = re.split(r"[^a-z]+", file.stem.lower())
    colours = dataset.colorinterp
    described = [BAND_WORDS.get((text or "").strip().lower()) for text in dataset.descriptions]
    # GDAL calls a fourth band alpha unless the file states otherwise. So a name for every band, or the band's own,
    # takes precedence.
    all_named = len(given) == dataset.count if given is not None else _from_words(words, dataset.count) is not None
    named = [all_named or (given is None and text is not None) for text in described]
    indexes = [i for i in dataset.indexes if named[i - 1] or colours[i - 1] != ColorInterp.alpha]
    if given is not None:
        if len(given) != len(indexes):
            msg = f"{file.name} has {len(indexes)} bands, but {len(given)} names were given: {', '.join(given)}."
            raise InputError(msg)
        found: list[str | None] = list(given)
    else:
        found = [described[i - 1] for i in indexes]
        if None in found:
            found = _from_words(words, len(indexes)) or [INTERPRETED.get(colours[i - 1]) for i in indexes]
        if len(indexes) == 4 and found == ["red", "green", "blue", None]:
            found[3] = "nir"
        if len(indexes) == 1 and found == [None]:
            found = [file.stem]
    names = {i: name or f"band_{i}" for i, name in zip(indexes, found, strict=True)}
    if not names or len(set(names.values())) != len(names):
        msg = f"The bands of {file.name} need different names; got {', '.join(names.values())}. State them."
        raise InputError(msg)
    return names


def _from_words(words: Sequence[str], count: int) -> list[str | None] | None:
    """Return band names from the words of a file's name, or None."""
    for word in words:
        if len(COMPOSITES.get(word, ())) == count:
            return list(COMPOSITES[word])
        if count == 1 and word in BAND_WORDS:
            return [BAND_WORDS[word]]
    return None

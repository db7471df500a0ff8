"""The ground of a page as images: light and shadow, an orthophoto, and the reasons why there is no building."""

import base64
import io
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from pyproj import Transformer

from msbdb.grid import Bands, Bounds, Grid, GridSpec
from msbdb.tables import REASONS, Reason
from msbdb.view.buildingmap import shading
from msbdb.view.page import DEGREE, image_uri

LARGEST_IMAGE = 2000
"""Cells a side beyond which the ground is thinned."""

PHOTO_QUALITY = 75
"""Quality of an orthophoto in the page, of 100 (ours): 2000 by 2000 pixels are about 1 MB."""

COLOURS = (("red", "green", "blue"), ("nir", "red", "green"))
"""The bands that make a picture."""

REASON_COLOURS = {
    Reason.NO_DATA: "#c6dbef",
    Reason.LOW: "#d9d9d9",
    Reason.SMALL: "#f0e442",
    Reason.VEGETATION_BY_STRUCTURE: "#009e73",
    Reason.VEGETATION_BY_COLOUR: "#66c2a5",
    Reason.OTHER_CLASS: "#a6761d",
    Reason.UNSUPPORTED: "#cc79a7",
    Reason.HARDLY_SUPPORTED: "#e69f00",
    Reason.OUTVOTED: "#d55e00",
    Reason.SMALL_PART: "#56b4e9",
    Reason.UNLIKE_PART: "#0072b2",
    Reason.GAP: "#999999",
    Reason.NO_PARTS: "#666666",
}
"""Colours by Okabe and Ito; cells of buildings stay clear."""


def extent_of(relief: Grid) -> Bounds:
    """Return west, south, east and north of the images, metres: those of the grid, or a part of a cell more."""
    step = _step(relief)
    west, _, _, north = relief.spec.bounds
    rows, cols = (-(-side // step) for side in relief.spec.shape)
    return west, north - rows * step * relief.spec.cell_m, west + cols * step * relief.spec.cell_m, north


def origin_of(relief: Grid, to_degrees: Transformer) -> tuple[int, int]:
    """Return the south-western corner of all that is shown, steps of longitude and latitude."""
    west, south, east, north = relief.spec.bounds
    lon, lat = to_degrees.transform([west, east, west, east], [south, south, north, north])
    return round(min(lon) * DEGREE), round(min(lat) * DEGREE)


def place_of(relief: Grid, to_degrees: Transformer, origin: tuple[int, int]) -> dict[str, Any]:
    """Return where the images lie: corners in steps, from the north-west clockwise, and edges in centimetres."""
    bounds = extent_of(relief)
    return {"corners": _corners(bounds, to_degrees, origin), "bounds_cm": [round(100 * edge) for edge in bounds]}


def _corners(bounds: Bounds, to_degrees: Transformer, origin: tuple[int, int]) -> list[list[int]]:
    west, south, east, north = bounds
    lon, lat = to_degrees.transform([west, east, east, west], [north, north, south, south])
    return [[round(x * DEGREE) - origin[0], round(y * DEGREE) - origin[1]] for x, y in zip(lon, lat, strict=True)]


def photo_image(bands: Bands, to_degrees: Transformer, origin: tuple[int, int]) -> dict[str, Any]:
    """Return an orthophoto as a WebP in a URI, clear where it has no pixel, with its corners as in `place_of`.

    Red, green and blue are shown; near infrared in place of blue, first, where there is none; else the first band in
    grey. Values above 255 are stretched from their 2nd to their 98th percentile.
    """
    shown = next((own for own in COLOURS if set(own) <= set(bands.names)), (bands.names[0],) * 3)
    values = np.stack([bands.values[bands.names.index(name)] for name in shown], axis=-1)
    seen = values[bands.valid]
    if seen.max() > 255:
        low, high = np.percentile(seen, [2, 98])
        values = 255 * (values - low) / max(high - low, 1e-6)
    pixels = np.dstack([values.clip(0, 255), 255.0 * bands.valid]).round().astype(np.uint8)
    picture = io.BytesIO()
    Image.fromarray(pixels).save(picture, format="webp", quality=PHOTO_QUALITY)
    uri = f"data:image/webp;base64,{base64.b64encode(picture.getvalue()).decode('ascii')}"
    return {"image": uri, "corners": _corners(bands.spec.bounds, to_degrees, origin)}


def light_image(relief: Grid) -> str | None:
    """Return light and shadow of a surface as an image in a URI; None without heights."""
    step = _step(relief)
    heights = np.asarray(relief.values)[::step, ::step].astype(np.float32)
    valid = relief.valid[::step, ::step]
    if min(heights.shape) < 2 or not valid.any():
        return None
    light = shading(heights, valid, relief.spec.cell_m * step)
    levels = np.arange(64, dtype=np.uint8)
    palette = np.stack([levels // 32 * 255] * 3 + [levels % 32 * 8], axis=-1).astype(np.uint8)
    return image_uri((light[..., 0] // 255 * 32 + light[..., 3] // 8).astype(np.uint8), palette)


def reason_image(relief: Grid, rasters: Sequence[tuple[GridSpec, NDArray[np.uint8]]]) -> dict[str, Any] | None:
    """Return rasters of reasons as one image, the first one on top, and its legend; None without any.

    The legend has the number, the colour and the meaning of each reason that occurs; the colour is None where clear.
    """
    found = reasons_on(relief, rasters, _step(relief))
    if not found.any():
        return None
    colours = np.zeros((len(Reason), 4), dtype=np.uint8)
    for reason, colour in REASON_COLOURS.items():
        colours[reason] = [*bytes.fromhex(colour[1:]), 255]
    legend = [[int(own), REASON_COLOURS.get(own), REASONS[own]] for own in Reason if (found == own).any()]
    return {"image": image_uri(found, colours), "legend": legend}


def reasons_on(relief: Grid, rasters: Sequence[tuple[GridSpec, NDArray[np.uint8]]], step: int = 1) -> NDArray[np.uint8]:
    """Return the reason of each ``step``-th cell of a grid, by the first raster that has one there."""
    rows, cols = (np.arange(0, side, step) for side in relief.spec.shape)
    east, north = relief.spec.xy(*np.meshgrid(rows, cols, indexing="ij"))
    found = np.full(east.shape, Reason.NO_DATA, dtype=np.uint8)
    for spec, own in rasters:
        np.copyto(found, spec.sample(own, east, north, outside=0), where=(found == Reason.NO_DATA))
    return found


def _step(relief: Grid) -> int:
    """Return by how many cells the images are thinned."""
    return -(-max(relief.spec.shape) // LARGEST_IMAGE)

"""One page of HTML with a town in 3-D, which a browser opens without a network: template, data and MapLibre GL JS.

All that comes from a database is data: JSON in which no sign can end the script that holds it, and which the page's own
script shows as text. The page's policy (CSP) lets the browser run the two scripts of the page alone, and load nothing.
"""

import base64
import hashlib
import html
import io
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray
from PIL import Image

from msbdb.errors import MissingDependencyError
from msbdb.io.files import write_atomic
from msbdb.version import __version__

DEGREE = 10**7
"""Steps of a degree: longitudes and latitudes are whole numbers of 1.1 cm or less."""

_HERE = Path(__file__).parent

_LIBRARY = _HERE / "maplibre"

_FIELD = re.compile("@@([a-z]+)@@")
"""A field of the template."""

_IN_SCRIPT = str.maketrans({"<": "\\u003c", ">": "\\u003e", "&": "\\u0026", "\u2028": "\\u2028", "\u2029": "\\u2029"})
"""Signs of JSON texts that could end a script or a line of it, and how JSON writes them otherwise."""


@dataclass(frozen=True, slots=True)
class Library:
    """MapLibre GL JS: its script, its style and its licence; and pmtiles, which reads the tiles of a large town."""

    script: str
    style: str
    licence: str
    reader: str = ""


def read_library(folder: Path = _LIBRARY) -> Library:
    """Return MapLibre GL JS, which the wheel contains and `scripts/setup` fetches.

    Raises
    ------
    MissingDependencyError
        When this copy of msbdb lacks it.
    """
    try:
        names = ("maplibre-gl.js", "maplibre-gl.css", "LICENSE.txt", "pmtiles.js")
        script, look, licence, reader = ((folder / name).read_text(encoding="utf-8") for name in names)
    except FileNotFoundError as error:
        msg = (
            f"MapLibre GL JS, which the page contains, is missing in {folder}. In a folder with the source run "
            "scripts/fetch_maplibre; elsewhere install msbdb from its wheel, which has it."
        )
        raise MissingDependencyError(msg) from error
    return Library(script, look, f"{licence}\n\n{(_HERE / 'pmtiles_licence.txt').read_text(encoding='utf-8')}", reader)


def write_page(town: Mapping[str, Any], out: Path, library: Library, tiles: Sequence[bytes] = ()) -> None:
    """Write the page of a town, in one piece.

    Parameters
    ----------
    town : mapping
        What `page.js` reads, as values of JSON without fractions: `msbdb.run.townpage` makes it.
    out : Path
        The file.
    library : Library
        MapLibre GL JS.
    tiles : sequence of bytes
        The outlines of a large town as archives of vector tiles (PMTiles): from afar, and near. A small town has none.

    Raises
    ------
    FileError
        When it cannot be written.
    """
    with write_atomic(out) as temporary:
        temporary.write_text(page_of(town, library, tiles), encoding="utf-8", newline="\n")


def page_of(town: Mapping[str, Any], library: Library, tiles: Sequence[bytes] = ()) -> str:
    """Return the page of a town; the same town gives the same text."""
    script = (_HERE / "page.js").read_text(encoding="utf-8")
    scripts = [_closed(library.script), _closed(script)]
    more = ""
    if tiles:
        scripts.append(_closed(library.reader))
        for name, archive in zip(("far", "near"), tiles, strict=True):
            packed = base64.b64encode(archive).decode("ascii")
            more += f'<script id="{name}" type="application/octet-stream">{packed}</script>\n'
        more += f"<script>{scripts[2]}</script>\n"
    values = {
        "title": html.escape(str(town["title"])),
        "policy": _policy(scripts),
        "version": html.escape(__version__),
        "libstyle": library.style,
        "style": (_HERE / "page.css").read_text(encoding="utf-8"),
        "licence": html.escape(library.licence),
        "town": as_data(town),
        "tiles": more,
        "library": scripts[0],
        "script": scripts[1],
    }
    template = (_HERE / "page.html").read_text(encoding="utf-8")
    return _FIELD.sub(lambda found: values[found[1]], template)


def as_data(value: object) -> str:
    r"""Return a value as JSON that is safe in a script of HTML.

    Examples
    --------
    >>> print(as_data({"name": "</script><b>"}))
    {"name":"\u003c/script\u003e\u003cb\u003e"}
    """
    return json.dumps(value, ensure_ascii=False, separators=(",", ":"), allow_nan=False).translate(_IN_SCRIPT)


def shapes_of(geometry: NDArray[np.object_], origin: tuple[int, int]) -> list[list[list[list[int]]]]:
    """Return multipolygons in longitude and latitude as whole steps: of each ring the first vertex, then differences.

    Parameters
    ----------
    geometry : (N,) ndarray of MultiPolygon
        Longitudes and latitudes, degrees.
    origin : tuple of int
        What the first vertices are counted from, steps.

    Returns
    -------
    list
        For each geometry its polygons, of each its rings, the hole after the shell: x, y, dx, dy, dx, dy ... without
        the last vertex, which is the first.

    Examples
    --------
    >>> square = shapely.MultiPolygon([shapely.box(0, 0, 2e-7, 1e-7)])
    >>> shapes_of(np.array([square]), (0, 0))
    [[[[2, 0, 0, 1, -2, 0, 0, -1]]]]
    """
    polygons, owner = shapely.get_parts(geometry, return_index=True)
    rings, polygon = shapely.get_rings(polygons, return_index=True)
    xy, ring = shapely.get_coordinates(rings, return_index=True)
    steps = np.rint(xy * DEGREE).astype(np.int64) - np.array(origin)
    begins = np.flatnonzero(np.diff(ring, prepend=-1))
    moves = np.diff(steps, axis=0, prepend=0)
    moves[begins] = steps[begins]
    flat = moves.ravel().tolist()
    ends = np.append(begins[1:], len(ring))[: len(begins)].tolist()
    found: list[list[list[list[int]]]] = [[] for _ in range(len(geometry))]
    by_polygon: list[list[list[int]]] = [[] for _ in range(len(polygons))]
    for own, begin, end in zip(polygon.tolist(), begins.tolist(), ends, strict=True):
        by_polygon[own].append(flat[2 * begin : 2 * (end - 1)])
    for own, made in zip(owner.tolist(), by_polygon, strict=True):
        if made:
            found[own].append(made)
    return found


def whole_numbers(values: pd.Series, digits: int = 0) -> list[int | None]:
    """Return numbers as whole numbers of the last digit; None for null."""
    numbers = pd.to_numeric(values).to_numpy(dtype=np.float64, na_value=np.nan)
    return [None if np.isnan(number) else round(number * 10**digits) for number in numbers.tolist()]


def texts(values: pd.Series) -> list[str | None]:
    """Return values as texts, because ids exceed 2^53; imported attributes as lines; None for null."""
    return [_text(value) for value in values.tolist()]


def _text(value: object) -> str | None:
    if isinstance(value, Mapping):
        return "\n".join(f"{key}: {own}" for key, own in value.items())
    return None if value is None or value is pd.NA or value != value else str(value)  # noqa: PLR0124  (NaN)


def image_uri(cells: NDArray[np.uint8], palette: NDArray[np.uint8]) -> str:
    """Return an image as a PNG in a URI.

    Parameters
    ----------
    cells : (H, W) ndarray of uint8
        Numbers of colours.
    palette : (N, 4) ndarray of uint8
        The colours: red, green, blue, and 255 where opaque.
    """
    image = Image.fromarray(cells)
    image.putpalette(palette[:, :3].tobytes())
    picture = io.BytesIO()
    image.save(picture, format="png", transparency=palette[:, 3].tobytes())
    return f"data:image/png;base64,{base64.b64encode(picture.getvalue()).decode('ascii')}"


def _closed(script: str) -> str:
    """Return a script that the text of no string in it ends."""
    return script.replace("\r\n", "\n").replace("</script", "<\\/script").replace("<!--", "<\\!--")


def _policy(scripts: list[str]) -> str:
    """Return the content security policy: these scripts and their workers alone, and no network."""
    known = " ".join(
        f"'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode('ascii')}'" for script in scripts
    )
    return (
        f"default-src 'none'; script-src {known}; worker-src blob:; child-src blob:; style-src 'unsafe-inline'; "
        "img-src data: blob:; connect-src data: blob:; base-uri 'none'; form-action 'none'"
    )

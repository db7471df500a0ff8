"""The CRS in a LAS header: a WKT text, or GeoTIFF keys, which are read as those of a TIFF."""

import logging
import struct
from collections.abc import Mapping

import rasterio
from pyproj import CRS
from pyproj.exceptions import CRSError as ProjError
from rasterio.errors import RasterioError
from rasterio.io import MemoryFile

logger = logging.getLogger(__name__)

WKT, DIRECTORY, DOUBLES, TEXTS = 2112, 34735, 34736, 34737
"""Record numbers in LAS; those of the GeoTIFF keys are also the tags' numbers in TIFF."""

LINEAR_UNITS_KEY, VERTICAL_UNITS_KEY = 3076, 4099
"""A linear unit is an EPSG code from 9001 on; any other is damage, of which PROJ would complain on the terminal."""

UNITS = {9001: "m", 9002: "ft", 9003: "us-ft"}

SHORT, LONG, DOUBLE, ASCII = ("H", 3), ("I", 4), ("d", 12), ("s", 2)
"""struct's letter and TIFF's number of a field type."""


def header_crs(projection: Mapping[int, bytes]) -> CRS | None:
    """Return the CRS that the projection records of a LAS file state, or None.

    The WKT is preferred where it can be parsed, as LAS 1.4 demands; else the GeoTIFF keys are read.
    """
    text = projection.get(WKT, b"").split(b"\0")[0].decode("utf-8", "replace").strip()
    if text:
        try:
            return CRS.from_wkt(text)
        except ProjError:
            logger.info("A WKT record is not understood: %.80s", text)
    if DIRECTORY not in projection:
        return None
    return _crs_of_keys(projection)


def vertical_unit(projection: Mapping[int, bytes]) -> str | None:
    """Return the unit of height that the GeoTIFF keys state apart from any CRS: 'm', 'ft', 'us-ft' or None."""
    for key, place, _, value in _entries(projection.get(DIRECTORY, b"")):
        if key == VERTICAL_UNITS_KEY and place == 0:
            return UNITS.get(value)
    return None


def _entries(directory: bytes) -> list[tuple[int, int, int, int]]:
    """Return the keys of a directory as (key, place, count, value), without padding."""
    whole = len(directory) // 8 * 8
    head, *entries = list(struct.iter_unpack("<4H", directory[:whole])) or [(0, 0, 0, 0)]
    return sorted(entry for entry in entries[: head[3]] if entry[0] != 0)


def _crs_of_keys(projection: Mapping[int, bytes]) -> CRS | None:
    """Let GDAL read the GeoTIFF keys, by way of a TIFF of one cell that carries them."""
    entries = [e for e in _entries(projection[DIRECTORY]) if e[0] != LINEAR_UNITS_KEY or 9000 < e[3] < 10000]
    if not entries:
        return None
    directory = struct.pack("<4H", 1, 1, 0, len(entries)) + b"".join(struct.pack("<4H", *entry) for entry in entries)
    doubles = projection.get(DOUBLES, b"")
    texts = projection.get(TEXTS, b"")
    tags = [
        (256, SHORT, struct.pack("<H", 1)),  # width
        (257, SHORT, struct.pack("<H", 1)),  # height
        (258, SHORT, struct.pack("<H", 8)),  # bits
        (259, SHORT, struct.pack("<H", 1)),  # no compression
        (262, SHORT, struct.pack("<H", 1)),  # grey
        (273, LONG, struct.pack("<I", 8)),  # the cell's place
        (277, SHORT, struct.pack("<H", 1)),  # one band
        (278, SHORT, struct.pack("<H", 1)),  # one row a strip
        (279, LONG, struct.pack("<I", 1)),  # one byte a strip
        (33550, DOUBLE, struct.pack("<3d", 1, 1, 0)),  # size of the cell
        (33922, DOUBLE, struct.pack("<6d", 0, 0, 0, 0, 0, 0)),  # its position
        (DIRECTORY, SHORT, directory),
        (DOUBLES, DOUBLE, doubles[: len(doubles) // 8 * 8]),
        (TEXTS, ASCII, texts + b"\0" if texts else b""),
    ]
    try:
        with rasterio.Env(GTIFF_REPORT_COMPD_CS=True), MemoryFile(_tiff(tags)) as memory, memory.open() as dataset:
            return None if dataset.crs is None else CRS.from_wkt(dataset.crs.to_wkt())
    except (RasterioError, ProjError) as error:
        logger.info("The GeoTIFF keys are not understood: %s", error)
        return None


def _tiff(tags: list[tuple[int, tuple[str, int], bytes]]) -> bytes:
    """Return a little-endian TIFF of the tags (number, type, body), whose one cell lies at byte 8."""
    tags = [tag for tag in tags if tag[2]]
    directory_at = 10
    bodies_at = directory_at + 2 + 12 * len(tags) + 4
    entries, bodies = b"", b""
    for number, (letter, code), body in tags:
        place = body.ljust(4, b"\0") if len(body) <= 4 else struct.pack("<I", bodies_at + len(bodies))
        bodies += b"" if len(body) <= 4 else body + b"\0" * (len(body) % 2)
        entries += struct.pack("<HHI", number, code, len(body) // struct.calcsize(letter)) + place
    head = struct.pack("<2sHI", b"II", 42, directory_at) + b"\0\0"
    return head + struct.pack("<H", len(tags)) + entries + struct.pack("<I", 0) + bodies

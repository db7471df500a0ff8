"""The header of a LAS or LAZ file: checked before any library trusts it, and its CRS.

The libraries allocate and loop as a header promises. So every count and offset is first compared with the size of the
file. A file that passes is read in bounded time and memory.
"""

import io
import logging
import math
import os
import struct
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import BinaryIO

import laspy
import lazrs
import numpy as np
from pyproj import CRS
from pyproj.exceptions import CRSError as ProjError

from msbdb.errors import FileError, MsbdbError, NodataError
from msbdb.grid import Bounds
from msbdb.io.files import open_input, remote_version, shown, url_of

logger = logging.getLogger(__name__)

HEADER_SIZES = {0: 227, 1: 227, 2: 227, 3: 235, 4: 375}
"""Smallest header of LAS 1.0 to 1.4, bytes."""

RECORD_SIZES = (20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67)
"""Smallest record of the point formats 0 to 10, bytes."""

COLOURED_FORMATS = (2, 3, 5, 7, 8, 10)
INFRARED_FORMATS = (8, 10)

VLR_LAYOUT, EVLR_LAYOUT = "<2x16sHH32s", "<2x16sHQ32s"
"""Owner, number, length and description in the heads of variable length records, and of extended ones."""

PROJECTION, COMPRESSION, COPC = "LASF_Projection", "laszip encoded", "copc"
"""Owners of records: of the CRS, of how the points are compressed, of the octree that orders them."""

LAZ_RECORD = (COMPRESSION, 22204)
ANY_CHUNK_SIZE = 0xFFFFFFFF
"""A LAZ chunk size that means that every chunk has its own, as in COPC."""

WKT, DIRECTORY, DOUBLES, TEXTS = 2112, 34735, 34736, 34737
"""Record numbers in LAS; those of the GeoTIFF keys are also the tags' numbers in TIFF."""

LINEAR_UNITS_KEY, VERTICAL_UNITS_KEY = 3076, 4099
"""A linear unit is an EPSG code from 9001 on; any other is damage, and PROJ would print a complaint on the terminal."""

UNITS = {9001: "m", 9002: "ft", 9003: "us-ft"}


@dataclass(frozen=True, slots=True)
class LasInfo:
    """The header of a file that passed the checks.

    Attributes
    ----------
    points_end : int
        Byte at which the points end; in LAZ, at which the table of their chunks begins.
    bounds : tuple of float
        West, south, east and north in the file's units, as the header states them (which may be wrong).
    projection : dict
        Bodies of the 'LASF_Projection' records by record number (the last one of a number).
    header : bytes
        The header itself, without the records.
    records : tuple of laspy.VLR
        The variable length records before the points, their bodies as bytes.
    extended : tuple of laspy.VLR
        The extended records of the CRS; of a COPC file all but COPC's own.
    """

    path: Path
    version: tuple[int, int]
    point_format: int
    record_size: int
    points: int
    compressed: bool
    scales: tuple[float, float, float]
    offsets: tuple[float, float, float]
    bounds: Bounds
    points_end: int
    projection: dict[int, bytes] = field(repr=False)
    header: bytes = field(repr=False)
    records: tuple[laspy.VLR, ...] = field(repr=False)
    extended: tuple[laspy.VLR, ...] = field(repr=False)

    @property
    def is_copc(self) -> bool:
        """Whether the points are ordered in an octree that other records describe."""
        return any(record.user_id == COPC for record in self.records)


def read_las_header(path: str | os.PathLike[str]) -> LasInfo:
    """Return the header of a LAS, LAZ or COPC file, after checking it against the file.

    A remote file must be COPC. What its chunks hold is checked when they are read.

    Raises
    ------
    FileError
        If the file cannot be opened, is not LAS, or does not hold what its header promises.
    NodataError
        If it holds no points.
    """
    path = Path(path)
    try:
        return _read_header(path) if url_of(path) is None else _read_remote(path, remote_version(path))
    except FileNotFoundError as error:
        msg = f"{path} does not exist. Check the path."
        raise FileError(msg) from error
    except IsADirectoryError as error:
        msg = f"{path} is a folder; name the LAS or LAZ files in it, for instance {path}/*.laz."
        raise FileError(msg) from error
    except PermissionError as error:
        msg = f"{path} may not be read. Check its permissions."
        raise FileError(msg) from error


def _read_header(path: Path) -> LasInfo:
    """Check a file, and return its header."""
    with open_input(path) as file:
        return _Checker(path, file.seek(0, os.SEEK_END), file).run()


@lru_cache(maxsize=10_000)
def _read_remote(path: Path, version: str) -> LasInfo:  # noqa: ARG001  (another version is another header)
    """Return the header of a remote file, which a build asks for several times."""
    return _read_header(path)


@contextmanager
def decoding(path: Path) -> Iterator[None]:
    """Turn every failure of the LAS libraries into a ``FileError``.

    The decompressor's panics are no ``Exception``. Their module identifies them, so that an interrupt passes.
    """
    try:
        yield
    except MsbdbError:
        raise
    except BaseException as error:
        panic = type(error).__module__ == "pyo3_runtime"
        if not panic and not isinstance(error, lazrs.LazrsError | laspy.LaspyException | ValueError | OSError):
            raise
        msg = f"{shown(path)} cannot be decoded, it is damaged ({error}). Fetch or export it again."
        raise FileError(msg) from error


LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}
"""Layers of the items of LAZ 1.4: point, RGB, RGB with NIR, wave packet; extra bytes have one a byte."""


class _Checker:
    """The check of one file; every method raises ``FileError`` when its check fails."""

    def __init__(self, path: Path, size: int, file: BinaryIO) -> None:
        self.path, self.size, self.file = path, size, file

    def require(self, holds: bool, otherwise: str) -> None:
        """Raise for a damaged file unless the condition holds."""
        if not holds:
            msg = f"{shown(self.path)} is not a valid LAS or LAZ file: {otherwise}. Fetch or export it again."
            raise FileError(msg)

    def read(self, offset: int, count: int) -> bytes:
        """Return exactly ``count`` bytes from an offset."""
        inside = 0 <= offset <= offset + count <= self.size
        self.require(inside, f"bytes {offset} to {offset + count} are needed, but the file has {self.size}")
        self.file.seek(offset)
        return self.file.read(count)

    def run(self) -> LasInfo:
        """Check everything, and return the header."""
        self.require(self.size > 0, "it is empty, 0 bytes")
        las = self.size >= 4 and self.read(0, 4) == b"LASF"
        self.require(las, "it does not begin with 'LASF', so it is some other kind of file")
        major, minor = self.read(24, 2)
        self.require(major == 1 and minor in HEADER_SIZES, f"its version is {major}.{minor}; 1.0 to 1.4 are read")
        head = self.read(0, HEADER_SIZES[minor])
        header_size, start, vlrs = struct.unpack_from("<HII", head, 94)
        in_order = len(head) <= header_size <= start <= self.size
        self.require(in_order, f"the header has {header_size} bytes and the points begin at {start} of {self.size}")
        point_format, record_size, points = self._points(head, minor)
        records = tuple(self._records(header_size, vlrs, start))
        is_copc = any(record.user_id == COPC for record in records)
        if url_of(self.path) is not None and not is_copc:
            msg = f"{shown(self.path)} is not COPC; of URLs only COPC files are read. Download it, and give its path."
            raise FileError(msg)
        extended: tuple[laspy.VLR, ...] = ()
        evlr_start, evlrs = struct.unpack_from("<QI", head, 235) if minor == 4 else (0, 0)
        if evlrs:
            extended = tuple(self._extended_records(evlr_start, evlrs, of_all=is_copc))
        compressed = bool(head[104] & 0xC0)
        if points == 0:
            msg = f"{shown(self.path)} holds no points. Leave it out."
            raise NodataError(msg)
        if compressed:
            points_end = self._check_compressed(start, points, record_size, records)
        else:
            points_end = start + points * record_size
            there = (self.size - start) // record_size
            self.require(points <= there, f"the header promises {points} points, but {there} are there: truncated")
        scales, offsets, bounds = self._geometry(head)
        projection = {r.record_id: r.record_data for r in (*records, *extended) if r.user_id == PROJECTION}
        return LasInfo(
            path=self.path,
            version=(major, minor),
            point_format=point_format,
            record_size=record_size,
            points=points,
            compressed=compressed,
            scales=scales,
            offsets=offsets,
            bounds=bounds,
            points_end=points_end,
            projection=projection,
            header=self.read(0, header_size),
            records=records,
            extended=extended,
        )

    def _points(self, head: bytes, minor: int) -> tuple[int, int, int]:
        """Return point format, record size and number of points."""
        point_format, record_size, points = struct.unpack_from("<BHI", head, 104)
        point_format &= 0x3F
        known = point_format < len(RECORD_SIZES)
        self.require(known, f"its point format is {point_format}; 0 to 10 are read")
        needed = RECORD_SIZES[point_format]
        self.require(record_size >= needed, f"a point needs {needed} bytes or more, but the header says {record_size}")
        if minor == 4:
            legacy, points = points, struct.unpack_from("<Q", head, 247)[0]
            self.require(points != 0 or legacy == 0, f"the header counts both {legacy} points and none")
        return point_format, record_size, points

    def _geometry(
        self, head: bytes
    ) -> tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float, float]]:
        """Return scales, offsets and bounds."""
        numbers = struct.unpack_from("<12d", head, 131)
        scales, offsets = numbers[0:3], numbers[3:6]
        sound = all(map(math.isfinite, scales + offsets)) and 0.0 not in scales
        self.require(sound, f"the coordinates' scales {scales} and offsets {offsets} are not finite, or a scale is 0")
        east, west, north, south = numbers[6:10]
        return scales, offsets, (west, south, east, north)

    def _records(self, start: int, count: int, end: int) -> Iterator[laspy.VLR]:
        """Yield the variable length records before the points."""
        for owner, number, description, place, length in self._walk(start, count, end, VLR_LAYOUT):
            yield laspy.VLR(owner, number, description, self.read(place, length))

    def _extended_records(self, start: int, count: int, *, of_all: bool) -> Iterator[laspy.VLR]:
        """Yield the extended records of the CRS, or of all owners but COPC; the others may be as large as the file."""
        for owner, number, description, place, length in self._walk(start, count, self.size, EVLR_LAYOUT):
            if owner == PROJECTION or (of_all and owner != COPC):
                yield laspy.VLR(owner, number, description, self.read(place, length))

    def _walk(self, start: int, count: int, end: int, layout: str) -> Iterator[tuple[str, int, bytes, int, int]]:
        """Yield owner, number, description, place and length of each of the records in a range of bytes."""
        room, header_size = max(end - start, 0), struct.calcsize(layout)
        self.require(count * header_size <= room, f"{count} variable length records do not fit in {room} bytes")
        for _ in range(count):
            self.require(start + header_size <= end, f"the variable length records run past byte {end}")
            user, number, length, description = struct.unpack(layout, self.read(start, header_size))
            start += header_size
            self.require(start + length <= end, f"the variable length records run past byte {end}")
            owner = user.split(b"\0")[0].decode("ascii", "replace")
            yield owner, number, description.split(b"\0")[0], start, length
            start += length

    def _check_compressed(self, start: int, points: int, record_size: int, records: Iterable[laspy.VLR]) -> int:
        """Check the LAZ record and the table of chunks against the points and the file; return where the table is."""
        laz = next((r.record_data for r in records if (r.user_id, r.record_id) == LAZ_RECORD), b"")
        self.require(len(laz) >= 34, "the points are compressed, but the record that says how is missing")
        compressor, coder = struct.unpack_from("<HH", laz, 0)
        chunk_size, items = struct.unpack_from("<I", laz, 12)[0], struct.unpack_from("<H", laz, 32)[0]
        if compressor not in (2, 3) or coder != 0:
            what = f"it was compressed by a LASzip before 2.0 or after 3 (compressor {compressor}, coder {coder})"
            msg = f"{self.path} cannot be read: {what}. Write it again with a current LASzip, for instance laszip64."
            raise FileError(msg)
        self.require(len(laz) >= 34 + 6 * items, f"its LAZ record is too short for {items} items")
        packed = sum(size for _, size, _ in struct.iter_unpack("<HHH", laz[34 : 34 + 6 * items]))
        self.require(packed == record_size, f"a compressed point has {packed} bytes, but the header says {record_size}")
        table = struct.unpack("<q", self.read(start, 8))[0]
        if table == -1:
            table = struct.unpack("<q", self.read(self.size - 8, 8))[0]
        inside = start + 8 <= table <= self.size - 8
        self.require(inside, f"the table of chunks should be at byte {table} of {self.size}: truncated")
        chunks = struct.unpack("<I", self.read(table + 4, 4))[0]
        # A chunk begins with one whole point, so the number of chunks is bounded by the bytes that there are.
        possible = 1 <= chunks <= (table - start - 8) // record_size
        self.require(possible, f"{chunks} chunks of points cannot be in {table - start - 8} bytes")
        lengths = self._check_chunks(start, table, points, chunk_size, laz)
        if compressor == 3 and url_of(self.path) is None:
            self._check_layers(start + 8, lengths, record_size, count_layers(laz))
        return int(table)

    def _check_chunks(self, start: int, table: int, points: int, chunk_size: int, laz: bytes) -> list[int]:
        """Check that the chunks hold all points and fill the space before their table; return their lengths."""
        self.file.seek(start)
        with decoding(self.path):
            chunks = lazrs.read_chunk_table(self.file, lazrs.LazVlr(laz))
        room, stored = sum(count for count, _ in chunks), sum(length for _, length in chunks)
        missing = room - points
        self.require(stored == table - start - 8, f"its chunks should have {stored} bytes: truncated or damaged")
        full = missing == 0 if chunk_size == ANY_CHUNK_SIZE else 0 <= missing < chunk_size
        self.require(full, f"the header promises {points} points, but the chunks hold {room}")
        return [length for _, length in chunks]

    def _check_layers(self, offset: int, lengths: list[int], record_size: int, layers: int) -> None:
        """Check that every chunk's layers fill the chunk, as the decompressor allocates what they claim."""
        for length in lengths:
            whole = is_whole(self.read(offset, record_size + 4 + 4 * layers), length, record_size, layers)
            self.require(whole, f"the layers of the chunk at byte {offset} do not fill its {length} bytes")
            offset += length


def is_whole(chunk: bytes, length: int, record_size: int, layers: int) -> bool:
    """Return whether the layers of a chunk fill it, by its beginning: one point, the number of points, and sizes."""
    head = record_size + 4 + 4 * layers
    return len(chunk) >= head and head + sum(struct.unpack_from(f"<{layers}I", chunk, record_size + 4)) == length


def count_layers(laz: bytes) -> int:
    """Return the number of layers in a chunk, of a LAZ record that was checked."""
    kinds = struct.iter_unpack("<HHH", laz[34 : 34 + 6 * struct.unpack_from("<H", laz, 32)[0]])
    return sum(LAYERS.get(kind, size) for kind, size, _ in kinds)


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
    return _crs_of_keys(projection) if DIRECTORY in projection else None


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
    """Let GDAL read the GeoTIFF keys, by way of a TIFF of one cell that carries them.

    laspy reads the EPSG codes of the horizontal CRS alone: neither projections that the keys define, nor the vertical
    CRS, nor units and names.
    """
    import rasterio
    import tifffile

    entries = [e for e in _entries(projection[DIRECTORY]) if e[0] != LINEAR_UNITS_KEY or 9000 < e[3] < 10000]
    if not entries:
        return None
    directory = np.array([(1, 1, 0, len(entries)), *entries], dtype=np.uint16).ravel()
    doubles, texts = projection.get(DOUBLES, b""), projection.get(TEXTS, b"")
    tags: list[tuple[int, str, int, object, bool]] = [
        (33550, "d", 3, (1.0, 1.0, 0.0), True),  # size of the cell
        (33922, "d", 6, (0.0,) * 6, True),  # its position
        (DIRECTORY, "H", directory.size, directory, True),
    ]
    if len(doubles) >= 8:
        tags.append((DOUBLES, "d", len(doubles) // 8, np.frombuffer(doubles, "<f8", len(doubles) // 8), True))
    if texts:
        tags.append((TEXTS, "s", 0, texts, True))
    cell = io.BytesIO()
    tifffile.imwrite(cell, np.zeros((1, 1), np.uint8), photometric="minisblack", metadata=None, extratags=tags)
    try:
        with (
            rasterio.Env(GTIFF_REPORT_COMPD_CS=True),
            rasterio.MemoryFile(cell.getvalue()) as memory,
            memory.open() as dataset,
        ):
            return None if dataset.crs is None else CRS.from_wkt(dataset.crs.to_wkt())
    except (rasterio.errors.RasterioError, ProjError) as error:
        logger.info("The GeoTIFF keys are not understood: %s", error)
        return None

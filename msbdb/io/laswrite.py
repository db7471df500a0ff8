"""Writing a LAS or LAZ file that is another one but for the classes of some points.

The file is not made anew: its header, records and points are copied as bytes, and one byte of a point is changed. So
nothing is lost that a library does not know: creation date, GUID, software, flags, private header fields, records of
any owner, extra bytes, padding, wave packets.
"""

import os
import shutil
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import lazrs
import numpy as np
from numpy.typing import NDArray

from msbdb.errors import FileError, InputError
from msbdb.io.atomic import write_atomic
from msbdb.io.las import Progress
from msbdb.io.lasheader import EVLR_HEADER, RECORD_SIZES, VLR_HEADER, LasInfo, decoding, read_las_header

CHUNK_BYTES = 32_000_000
"""Points in memory at a time, uncompressed."""

WAVE_FORMATS = (4, 5, 9, 10)
"""Point formats with wave packets, which the compressor does not write."""

LAZ_RECORD = ("laszip encoded", 22204)
"""Owner and number of the record that says how points are compressed."""

COPC_OWNER = "copc"

COMPRESSED_BIT = 0x80
"""Of the point format's byte in the header."""

WAVE_START, EVLR_START = 227, 235
"""Where the header holds the offsets of the wave packets (from LAS 1.3) and of the extended records (LAS 1.4)."""

Bytes = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Written:
    """What was written: the points, how many have another class than before, and what could not be kept."""

    points: int
    changed: int
    notices: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Record:
    """A variable length record: owner and number, and its bytes with its own header."""

    owner: str
    number: int
    whole: bytes


@dataclass(frozen=True, slots=True)
class _Layout:
    """The pieces of a source, as bytes.

    ``points_start`` and ``tail_start`` are where its points begin, and where what comes after them does;
    ``extended`` is empty where there are no extended records.
    """

    header: bytes
    records: tuple[_Record, ...]
    padding: bytes
    points_start: int
    tail_start: int
    wave_start: int
    extended_start: int
    extended: tuple[_Record, ...]

    @property
    def compression(self) -> bytes:
        """The body of the record that says how the points are compressed."""
        return next(r.whole[VLR_HEADER:] for r in self.records if (r.owner, r.number) == LAZ_RECORD)

    @property
    def is_copc(self) -> bool:
        """Whether the points are ordered in an octree that other records describe."""
        return any(record.owner == COPC_OWNER for record in self.records)


def write_classes(
    source: str | os.PathLike[str],
    out: str | os.PathLike[str],
    classes: NDArray[np.uint8],
    *,
    where: NDArray[np.bool_] | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Written:
    """Copy a LAS, LAZ or COPC file with other classes of some points and everything else as it is.

    Parameters
    ----------
    source : path
        LAS 1.0 to 1.4, LAZ or COPC, of point formats 0 to 10.
    out : path
        Ends in .las or .laz, whichever the source is; appears whole or not at all.
    classes : (N,) ndarray of uint8
        The class of each point of the file, in its order.
    where : (N,) ndarray of bool, optional
        Only these points get their class, the others keep theirs; all of them by default.
    overwrite : bool
        Replace a file that exists. The source itself is never replaced.
    progress : callable, optional
        Called with ('write', points done, points in all).

    Returns
    -------
    Written

    Raises
    ------
    InputError
        If ``out`` is the source, has another ending, or would hold compressed wave packets; or the arrays do not fit
        the points, or a class does not fit the format (31 is the highest of the formats 0 to 5).
    FileError
        If ``out`` exists and may not be replaced, or cannot be written; or the source is missing or damaged.
    NodataError
        If the source holds no points.

    Notes
    -----
    The class of formats 0 to 5 shares its byte with the flags synthetic, key-point and withheld, which stay. The
    ending of ``out`` says whether it is compressed; the record of the compression comes, goes or changes with it, and
    records after the points move to where the points end. COPC counts the bytes of its compressed chunks, so that
    points compressed anew are plain LAZ: its own records are left out, and its points keep their order.
    """
    source, out = Path(source), Path(out)
    check_output(source, out, overwrite=overwrite)
    info = read_las_header(source)
    chosen = np.ones(info.points, dtype=np.bool_) if where is None else where
    _check_classes(info, classes, chosen)
    packed = out.suffix.lower() == ".laz"
    compression = _new_compression(info) if packed else b""
    with source.open("rb") as file, write_atomic(out) as partial, partial.open("wb") as target:
        layout = _read_layout(file, info)
        target.write(_head(layout, info, compression))
        changed = done = 0
        with _pointwise(target, compression, out) as write:
            for points in _chunks(file, info, layout):
                part = slice(done, done + len(points))
                changed += _set_classes(points, info.point_format, classes[part], chosen[part])
                write(points)
                done += len(points)
                if progress is not None:
                    progress("write", done, info.points)
        _write_tail(file, target, layout)
    octree = f"{source.name} is COPC; {out.name} has its points in the same order, but not its octree."
    return Written(info.points, changed, (octree,) if layout.is_copc else ())


def check_output(source: Path, out: Path, *, overwrite: bool) -> None:
    """Refuse an output that is the source, has another ending, is there already, or has no folder.

    Raises
    ------
    InputError, FileError
        As `write_classes` does.
    """
    if out.suffix.lower() not in (".las", ".laz") or out.name.lower().endswith(".copc.laz"):
        msg = f"Points are written as .las or .laz, and not as COPC; got '{out.name}'. Name it so, without '.copc'."
        raise InputError(msg)
    if not out.parent.is_dir():
        msg = f"{out} cannot be written: there is no folder {out.parent}. Name a folder that exists and is yours."
        raise FileError(msg)
    if not out.exists():
        return
    if source.exists() and out.samefile(source):
        msg = f"{out} is the source itself, which is never overwritten. Name another file."
        raise InputError(msg)
    if not overwrite:
        msg = f"{out} is there already. Remove it, or ask for it to be overwritten."
        raise FileError(msg)


def _check_classes(info: LasInfo, classes: NDArray[np.uint8], chosen: NDArray[np.bool_]) -> None:
    """Refuse classes that are not those of the file's points."""
    if classes.shape != (info.points,) or chosen.shape != (info.points,) or classes.dtype != np.uint8:
        msg = (
            f"{info.path} has {info.points} points; got classes of shape {classes.shape} and dtype {classes.dtype}, "
            f"and a choice of shape {chosen.shape}. Give one uint8 and one bool for each point."
        )
        raise InputError(msg)
    highest = int(classes[chosen].max(initial=0))
    if info.point_format <= 5 and highest > 31:
        msg = f"Point format {info.point_format} of {info.path} holds classes up to 31; got {highest}."
        raise InputError(msg)


def _new_compression(info: LasInfo) -> bytes:
    """Return the body of the record that says how the points will be compressed."""
    if info.point_format in WAVE_FORMATS:
        msg = (
            f"{info.path} has point format {info.point_format} with wave packets, which cannot be compressed here. "
            "Name an output that ends in .las."
        )
        raise InputError(msg)
    extra = info.record_size - RECORD_SIZES[info.point_format]
    return bytes(lazrs.LazVlr.new_for_compression(info.point_format, extra).record_data())


def _read_layout(file: BinaryIO, info: LasInfo) -> _Layout:
    """Take a file apart that ``read_las_header`` found sound."""
    size = file.seek(0, os.SEEK_END)
    header_size, start, count = struct.unpack("<HII", _bytes(file, 94, 10))
    header = _bytes(file, 0, header_size)
    records = tuple(_records(file, header_size, count, VLR_HEADER))
    after_records = header_size + sum(len(record.whole) for record in records)
    wave = struct.unpack_from("<Q", header, WAVE_START)[0] if info.version >= (1, 3) else 0
    extended_start, extended_count = struct.unpack_from("<QI", header, EVLR_START) if info.version >= (1, 4) else (0, 0)
    points_end = _points_end(file, info, start, size)
    wave_start = wave if points_end <= wave < size else 0
    if extended_count and extended_start < points_end:
        msg = f"{info.path} is not a sound LAS or LAZ file: its extended records begin before its points end."
        raise FileError(msg)
    extended = tuple(_records(file, extended_start, extended_count, EVLR_HEADER))
    # What follows the points of LAS is theirs to the byte; in LAZ, a table of unknown length comes between.
    after = [place for place in (wave_start, extended_start if extended else 0) if place]
    tail_start = min([size, *after]) if info.compressed else points_end
    padding = _bytes(file, after_records, start - after_records)
    return _Layout(header, records, padding, start, tail_start, wave_start, extended_start, extended)


def _bytes(file: BinaryIO, start: int, count: int) -> bytes:
    """Return bytes from an offset."""
    file.seek(start)
    return file.read(count)


def _records(file: BinaryIO, start: int, count: int, header_size: int) -> Iterator[_Record]:
    """Yield the variable length records from an offset on."""
    layout = "<16sHQ" if header_size == EVLR_HEADER else "<16sHH"
    for _ in range(count):
        user, number, length = struct.unpack_from(layout, _bytes(file, start, header_size), 2)
        whole = _bytes(file, start, header_size + length)
        yield _Record(user.split(b"\0")[0].decode("ascii", "replace"), number, whole)
        start += len(whole)


def _points_end(file: BinaryIO, info: LasInfo, start: int, size: int) -> int:
    """Return where the points end; in LAZ, where the table of their chunks begins."""
    if not info.compressed:
        return start + info.points * info.record_size
    table: int = struct.unpack("<q", _bytes(file, start, 8))[0]
    return table if table != -1 else int(struct.unpack("<q", _bytes(file, size - 8, 8))[0])


def _head(layout: _Layout, info: LasInfo, compression: bytes) -> bytes:
    """Return all that comes before the points, with or without a record of their compression."""
    kept: list[bytes] = []
    for record in layout.records:
        if (record.owner, record.number) == LAZ_RECORD:
            kept += [_laz_record(record.whole, compression)] * bool(compression)
        elif not (layout.is_copc and record.owner == COPC_OWNER):
            kept.append(record.whole)
    if compression and not info.compressed:
        owner, number = LAZ_RECORD
        blank = struct.pack("<H16sHH32s", 0, owner.encode(), number, 0, b"compressed by laz-rs")
        kept.append(_laz_record(blank, compression))
    body = b"".join(kept) + layout.padding
    header = bytearray(layout.header)
    struct.pack_into("<II", header, 96, len(header) + len(body), len(kept))
    header[104] = info.point_format | (COMPRESSED_BIT if compression else 0)
    return bytes(header) + body


def _laz_record(whole: bytes, compression: bytes) -> bytes:
    """Return a record with another body."""
    return whole[:20] + struct.pack("<H", len(compression)) + whole[22:VLR_HEADER] + compression


@contextmanager
def _pointwise(target: BinaryIO, compression: bytes, out: Path) -> Iterator["_Writer"]:
    """Give what writes points, and close their table of chunks after them."""
    writer = _Writer(target, compression, out)
    yield writer
    writer.close()


class _Writer:
    """Writes points, compressed where a body of a LAZ record is given."""

    def __init__(self, target: BinaryIO, compression: bytes, out: Path) -> None:
        self.target, self.out = target, out
        self.compressor = lazrs.ParLasZipCompressor(target, lazrs.LazVlr(compression)) if compression else None

    def __call__(self, points: Bytes) -> None:
        """Write (N, record size) bytes."""
        if self.compressor is None:
            self.target.write(points.data)
            return
        with self._told():
            self.compressor.compress_many(points.reshape(-1))

    def close(self) -> None:
        """Write what belongs behind the points."""
        if self.compressor is not None:
            with self._told():
                self.compressor.done()
            self.target.seek(0, os.SEEK_END)

    @contextmanager
    def _told(self) -> Iterator[None]:
        """Say which file could not be written, not that the source is damaged."""
        try:
            yield
        except lazrs.LazrsError as error:
            msg = f"{self.out} cannot be written: {error}. Name another file, or free some space."
            raise FileError(msg) from error


def _chunks(file: BinaryIO, info: LasInfo, layout: _Layout) -> Iterator[Bytes]:
    """Yield the points in their order as writable (N, record size) bytes."""
    file.seek(layout.points_start)
    with decoding(info.path):
        reader = lazrs.ParLasZipDecompressor(file, layout.compression) if info.compressed else None
    at_once = max(1, CHUNK_BYTES // info.record_size)
    for first in range(0, info.points, at_once):
        body = bytearray(min(at_once, info.points - first) * info.record_size)
        with decoding(info.path):
            if reader is not None:
                reader.decompress_many(body)
            elif file.readinto(body) != len(body):  # type: ignore[attr-defined]  # BinaryIO of a file has it
                msg = "it ends before its points do"
                raise OSError(msg)
        yield np.frombuffer(body, dtype=np.uint8).reshape(-1, info.record_size)


def _set_classes(points: Bytes, point_format: int, classes: NDArray[np.uint8], chosen: NDArray[np.bool_]) -> int:
    """Set the classes of the chosen points in place; return how many had another one."""
    place, flags = (15, 0xE0) if point_format <= 5 else (16, 0x00)
    old = points[:, place]
    new = np.where(chosen, (old & np.uint8(flags)) | classes, old)
    changed = int(np.count_nonzero(new != old))
    points[:, place] = new
    return changed


def _write_tail(file: BinaryIO, target: BinaryIO, layout: _Layout) -> None:
    """Write what comes after the points, and where it is into the header."""
    end = target.tell()
    if layout.is_copc:
        extended = [record.whole for record in layout.extended if record.owner != COPC_OWNER]
        target.write(b"".join(extended))
        target.seek(EVLR_START)
        target.write(struct.pack("<QI", end if extended else 0, len(extended)))
        return
    file.seek(layout.tail_start)
    shutil.copyfileobj(file, target)
    extended_start = layout.extended_start if layout.extended else 0
    for place, start in ((WAVE_START, layout.wave_start), (EVLR_START, extended_start)):
        if start:
            target.seek(place)
            target.write(struct.pack("<Q", start + end - layout.tail_start))

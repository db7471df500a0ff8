"""Writing a copy of a LAS or LAZ file with other classes of some points.

laspy writes the points. It would also change other bytes: counts, bounds, the date, legacy counts, the records that it
knows, and wave packets. These are given to it, or written again after it, as the bytes of the source.
"""

import os
import shutil
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import laspy
import lazrs
import numpy as np
from laspy.header import Version
from laspy.vlrs.vlrlist import VLRList
from numpy.typing import NDArray

from msbdb.errors import FileError, InputError, give_notice
from msbdb.io.files import require_output, write_atomic
from msbdb.io.las import Progress
from msbdb.io.lasheader import COMPRESSION, COPC, LasInfo, decoding, read_las_header
from msbdb.io.laspoints import read_chunks

CHUNK_BYTES = 32_000_000
"""Points in memory at a time, uncompressed."""

WAVE_FORMATS = (4, 5, 9, 10)
"""Point formats with wave packets, which the compressor does not write."""

LEAST_VERSION = Version(1, 2)
"""The oldest that laspy writes in all point formats of its time; the headers of 1.0 and 1.1 have the same layout."""

LAYOUT_FIELDS = slice(96, 105)
"""Where the header says where the points begin, how many records there are, and whether the points are compressed."""

WAVE_START, EXTENDED_START = 227, 235
"""Where the header holds the offsets of the wave packets (from LAS 1.3) and of the extended records (LAS 1.4)."""

KEEP_BYTES = "surrogateescape"
"""How laspy is to write texts that are not ASCII."""


@dataclass(frozen=True, slots=True)
class Written:
    """What was written: the number of points, and how many of them have another class than before."""

    points: int
    changed: int


def write_classes(
    source: str | os.PathLike[str],
    out: str | os.PathLike[str],
    classes: NDArray[np.uint8],
    *,
    where: NDArray[np.bool_] | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Written:
    """Copy a LAS, LAZ or COPC file with other classes of some points, and everything else unchanged.

    Parameters
    ----------
    source : path
        LAS 1.0 to 1.4, LAZ or COPC, of point formats 0 to 10.
    out : path
        Ends in .las or .laz, whatever the source is; appears complete or not at all.
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

    Warns
    -----
    MsbdbWarning
        If the source is COPC, whose octree is not written.

    Notes
    -----
    The class of formats 0 to 5 shares its byte with the flags synthetic, key-point and withheld, which stay. The
    ending of ``out`` decides whether it is compressed. The record of the compression is added, removed or changed to
    fit, and records after the points move to where the points end. COPC counts the bytes of its compressed chunks.
    Points that are compressed again are therefore plain LAZ: the records of COPC are left out, the order is kept.

    In the heads of records before the points, some bytes are not kept: the reserved ones, those behind the end of a
    text, and the last of 32 characters of a description.
    """
    source, out = Path(source), Path(out)
    check_output(source, out, overwrite=overwrite)
    info = read_las_header(source)
    chosen = np.ones(info.points, dtype=np.bool_) if where is None else where
    _check_classes(info, classes, chosen)
    header = _header_to_write(info)
    packed = out.suffix.lower() == ".laz"
    if packed and info.point_format in WAVE_FORMATS:
        msg = (
            f"{info.path} has point format {info.point_format} with wave packets, which cannot be compressed here. "
            "Name an output that ends in .las."
        )
        raise InputError(msg)
    changed = done = 0
    with write_atomic(out) as partial, partial.open("w+b") as target:
        with _writer(target, header, out, packed=packed) as writer:
            for points in read_chunks(info, max(1, CHUNK_BYTES // info.record_size)):
                part = slice(done, done + len(points))
                changed += _set_classes(points, classes[part], chosen[part])
                writer.write_points(points)
                done += len(points)
                if progress is not None:
                    progress("write", done, info.points)
        _finish(target, info, header)
    if info.is_copc:
        msg = f"{source.name} is COPC; {out.name} has its points in the same order, but not its octree."
        give_notice(msg)
    return Written(info.points, changed)


def check_output(source: Path, out: Path, *, overwrite: bool) -> None:
    """Refuse an output that is the source, has another ending, exists already, or has no folder.

    Raises
    ------
    InputError, FileError
        As `write_classes` does.
    """
    if out.suffix.lower() not in (".las", ".laz") or out.name.lower().endswith(".copc.laz"):
        msg = f"Points are written as .las or .laz, not as COPC; got '{out.name}'. Choose such a name, without '.copc'."
        raise InputError(msg)
    require_output(out, overwrite=overwrite, sources=[source])


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


def _header_to_write(info: LasInfo) -> laspy.LasHeader:
    """Return the header that laspy is to write, whose records are bytes that laspy does not interpret."""
    with decoding(info.path), info.path.open("rb") as file:
        header = laspy.LasHeader.read_from(file)
        header.version = max(header.version, LEAST_VERSION)
    if header.number_of_evlrs and header.start_of_first_evlr < info.points_end:
        msg = f"{info.path} is not a valid LAS or LAZ file: its extended records begin before its points end."
        raise FileError(msg)
    header.vlrs[:] = [record for record in info.records if record.user_id not in (COMPRESSION, COPC)]
    return header


@contextmanager
def _writer(target: BinaryIO, header: laspy.LasHeader, out: Path, *, packed: bool) -> Iterator[laspy.LasWriter]:
    """Give what writes points; a failure is one of the output, not of the source."""
    backend = laspy.LazBackend.LazrsParallel
    how = {"do_compress": packed, "laz_backend": backend, "closefd": False, "encoding_errors": KEEP_BYTES}
    try:
        # The bounds that laspy computes are not used, so that they may overflow.
        with np.errstate(over="ignore", invalid="ignore"), laspy.LasWriter(target, header, **how) as writer:
            yield writer
    except (lazrs.LazrsError, laspy.LaspyException, ValueError) as error:
        msg = f"{out} cannot be written: {error}. Choose another file, or free some space."
        raise FileError(msg) from error


def _set_classes(points: laspy.ScaleAwarePointRecord, classes: NDArray[np.uint8], chosen: NDArray[np.bool_]) -> int:
    """Set the classes of the chosen points in place; return how many had another one."""
    old = np.asarray(points.classification)
    changed = int(np.count_nonzero(chosen & (old != classes)))
    points.classification = np.where(chosen, classes, old)
    return changed


def _finish(target: BinaryIO, info: LasInfo, header: laspy.LasHeader) -> None:
    """Write what comes after the points, and put the header of the source back, with the places of the new file."""
    end = target.seek(0, os.SEEK_END)
    written = bytearray(info.header)
    if info.is_copc:
        VLRList(info.extended).write_to(target, as_extended=True, encoding_errors=KEEP_BYTES)
        struct.pack_into("<QI", written, EXTENDED_START, end if info.extended else 0, len(info.extended))
    else:
        with info.path.open("rb") as file:
            size = file.seek(0, os.SEEK_END)
            extended_start = header.start_of_first_evlr if header.number_of_evlrs else 0
            places = {WAVE_START: header.start_of_waveform_data_packet_record, EXTENDED_START: extended_start}
            places = {field: start for field, start in places.items() if info.points_end <= start < size}
            # Between compressed points and what follows them there is a table of unknown length.
            tail = min([size, *places.values()]) if info.compressed else info.points_end
            file.seek(tail)
            shutil.copyfileobj(file, target)
        for field, start in places.items():
            struct.pack_into("<Q", written, field, start + end - tail)
    target.seek(LAYOUT_FIELDS.start)
    written[LAYOUT_FIELDS] = target.read(LAYOUT_FIELDS.stop - LAYOUT_FIELDS.start)
    target.seek(0)
    target.write(written)

"""A writer of small COPC files: an octree of two levels, whose pages may be two."""

import io
import struct
from pathlib import Path

import laspy
import lazrs
import numpy as np


def write_copc(path: Path, las: laspy.LasData, *, pages: int = 1) -> None:
    """Write points as COPC: every tenth in the root, the others in its eight children.

    Parameters
    ----------
    path : Path
        The file to be written.
    las : LasData
        Points of format 6, 7 or 8, in LAS 1.4.
    pages : int
        1, or 2 where the first child is on a page of its own.
    """
    points = np.column_stack((las.x, las.y, las.z))
    low, high = points.min(axis=0), points.max(axis=0)
    middle, half = (low + high) / 2, float((high - low).max() / 2 + 1)
    octant = (points >= middle) @ [1, 2, 4]
    root = np.arange(len(las.points)) % 10 == 0
    nodes = [((0, 0, 0, 0), root)]
    children = [((1, n & 1, n >> 1 & 1, n >> 2), ~root & (octant == n)) for n in range(8)]
    nodes += [(key, own) for key, own in children if own.any()]
    laz = lazrs.LazVlr.new_for_compression(las.point_format.id, las.point_format.num_extra_bytes, True)
    header = laspy.LasHeader(version="1.4", point_format=las.point_format.id)
    header.offsets, header.scales = las.header.offsets, las.header.scales
    header.vlrs = [laspy.VLR("copc", 1, "", bytes(160)), *las.header.vlrs]
    header.vlrs.append(laspy.VLR("laszip encoded", 22204, "", laz.record_data()))
    plain = io.BytesIO()
    writer = laspy.LasWriter(plain, header, do_compress=False, closefd=False)
    writer.write_points(las.points)
    writer.close()
    start = struct.unpack_from("<I", plain.getvalue(), 96)[0]
    body = io.BytesIO()
    body.write(plain.getvalue()[:start])
    compressor = lazrs.LasZipCompressor(body, laz)
    begins = [start + 8]
    for number, (_, own) in enumerate(nodes):
        if number:
            compressor.finish_current_chunk()
            begins.append(body.tell())
        compressor.compress_many(np.frombuffer(las.points[own].array.tobytes(), np.uint8))
    compressor.done()
    begins.append(struct.unpack_from("<q", body.getvalue(), start)[0])
    sizes = np.diff(begins).tolist()
    entries = [
        (*key, begin, size, int(own.sum())) for (key, own), begin, size in zip(nodes, begins, sizes, strict=False)
    ]
    body.seek(0, io.SEEK_END)
    evlr = body.tell()
    packed = [struct.pack("<4iQ2i", *entry) for entry in entries]
    first = 32 * len(packed)
    if pages == 2:
        # The second page holds the first child; on the first page stands where.
        packed = [packed[0], struct.pack("<4iQ2i", *entries[1][:4], evlr + 60 + first, 32, -1), *packed[2:], packed[1]]
    body.write(struct.pack("<H16sHQ32s", 0, b"copc", 1000, 32 * len(packed), b"EPT hierarchy") + b"".join(packed))
    data = bytearray(body.getvalue())
    data[104] |= 0x80
    struct.pack_into("<QI", data, 235, evlr, 1)
    info = struct.pack("<5d2Q2d", *middle, half, half / 64, evlr + 60, first, 0.0, 0.0)
    data[375 + 54 : 375 + 54 + len(info)] = info
    path.write_bytes(data)

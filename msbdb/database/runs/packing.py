"""Packing of rasters: the cells of a raster as compressed bytes, and back."""

import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

LEVEL = 4
"""Compression level; the next level takes four times as long for files smaller by a twentieth."""

PLAIN, PLANES, ROWS = 0, 1, 2
"""The cells as they are; all low bytes, then all high bytes; the differences of each row from the one above."""

MARKED = (PLANES, ROWS)
"""These are named by a byte before the compressed ones. It is never the first byte of a zlib stream, which is 0x78."""


def pack(cells: NDArray[Any]) -> bytes:
    """Return the compressed cells of a raster of whole numbers.

    Parameters
    ----------
    cells : (..., H, W) ndarray of int
        Little-endian, in C order.

    Notes
    -----
    Heights have noise in their low bytes and little change in their high bytes, so they are packed by bytes. The level
    of a terrain changes little from row to row. The way is chosen by the middle rows. Of Autzen, the terrain
    takes 4.1 MB by differences, 5.7 MB by bytes and 6.8 MB as it is, and the heights take 7.9 in place of 8.5 MB.

    Examples
    --------
    >>> slope = np.add.outer(np.arange(300), np.arange(200)).astype("<i2")
    >>> packed = pack(slope)
    >>> packed[0] == ROWS, bool((unpack(packed, "<i2", (300, 200)) == slope).all())
    (True, True)
    """
    if cells.itemsize == 1 or cells.ndim < 2:
        return zlib.compress(cells.tobytes(), LEVEL)
    rows = cells.shape[-2]
    middle = cells[..., rows * 7 // 16 : rows * 9 // 16 + 1, :]
    way = min((PLAIN, *MARKED), key=lambda way: len(zlib.compress(_turned(middle, way), 1)))
    packed = zlib.compress(_turned(cells, way), LEVEL)
    return packed if way == PLAIN else bytes([way]) + packed


def unpack(data: bytes, dtype: str, shape: Sequence[int]) -> NDArray[Any]:
    """Return the raster of this dtype and shape from its compressed cells.

    Raises
    ------
    ValueError
        When the bytes are not as many as the cells need.
    zlib.error
        When the bytes are not what `pack` returns.
    """
    way = data[0] if data and data[0] in MARKED else PLAIN
    kind = np.dtype(dtype)
    whole = zlib.decompress(data if way == PLAIN else memoryview(data)[1:])
    if way == PLANES:
        planes = np.frombuffer(whole, dtype=np.uint8).reshape(kind.itemsize, -1)
        return np.ascontiguousarray(planes.T).view(kind).reshape(shape)
    cells = np.frombuffer(whole, dtype=kind).reshape(shape)
    return cells if way == PLAIN else np.cumsum(cells, axis=-2, dtype=kind)


def _turned(cells: NDArray[Any], way: int) -> bytes:
    """Return the bytes of cells in the way in which they are compressed."""
    if way == PLANES:
        by_cell = np.ascontiguousarray(cells).view(np.uint8).reshape(-1, cells.itemsize)
        return by_cell.T.tobytes()
    if way == ROWS:
        # Differences wrap around like the sums by which they are undone.
        return np.diff(cells, axis=-2, prepend=cells.dtype.type(0)).tobytes()
    return cells.tobytes()

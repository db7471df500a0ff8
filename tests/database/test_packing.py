"""Rasters are packed and unpacked without loss, in the way that takes the least space."""

import zlib

import numpy as np
import pytest

from msbdb.database.runs.packing import MARKED, PLANES, SLOPE_PLANES, _compressed, pack, unpack

RANDOM = np.random.default_rng(8)

NOISY = RANDOM.normal(500, 90, (90, 70)).astype("<i2")
SLOPE = (np.add.outer(40 * np.arange(90), 7 * np.arange(70)) + RANDOM.integers(0, 2, (90, 70))).astype("<i2")


@pytest.mark.parametrize(
    "cells",
    [
        NOISY,
        SLOPE,
        SLOPE.astype("<i4") * 90_000,
        RANDOM.choice(np.array([-(2**15), 2**15 - 1], dtype="<i2"), (60, 40)),
        RANDOM.choice(np.array([0, 2**16 - 1], dtype="<u2"), (60, 40)),
        np.zeros((5, 3), dtype="<u2"),
        np.arange(6, dtype="<u2").reshape(1, 6),
        RANDOM.integers(0, 256, (30, 20)).astype("|u1"),
        np.arange(120, dtype="<u2").reshape(2, 10, 6),
    ],
)
def test_a_raster_comes_back_as_it_was(cells):
    """In each way, also at the ends of the range, where differences wrap around, and with few rows."""
    packed = [pack(cells)]
    if cells.itemsize > 1:
        packed += [bytes([way]) + _compressed(cells, way) for way in MARKED]
    for data in packed:
        found = unpack(data, cells.dtype.str, cells.shape)
        assert found.dtype == cells.dtype
        np.testing.assert_array_equal(found, cells)


def test_a_slope_is_packed_by_differences_and_noise_by_bytes():
    """Each takes less space than the cells as they are."""
    for cells, way in ((SLOPE, SLOPE_PLANES), (NOISY, PLANES)):
        packed = pack(cells)
        assert packed[0] == way
        assert len(packed) < 0.98 * len(zlib.compress(cells.tobytes(), 4))


def test_rasters_of_older_databases_are_read():
    """They are zlib streams of the cells as they are."""
    old = zlib.compress(SLOPE.tobytes())
    np.testing.assert_array_equal(unpack(old, "<i2", SLOPE.shape), SLOPE)


@pytest.mark.parametrize(("data", "error"), [(b"", zlib.error), (b"\x02x", zlib.error), (b"\x07", zlib.error)])
def test_what_is_no_packed_raster_is_refused(data, error):
    """A damaged row is an error, never other cells."""
    with pytest.raises(error):
        unpack(data, "<i2", (2, 2))


def test_too_few_cells_are_refused():
    """The shape decides how many cells there are."""
    with pytest.raises(ValueError, match="reshape"):
        unpack(pack(SLOPE), "<i2", (91, 70))

"""Hostile files end in an error of ours, or in right points, soon."""

import os
import struct
import time
from pathlib import Path

import laspy
import numpy as np
import pytest
from support.notices import with_notices

from msbdb.errors import FileError, MsbdbError, NodataError
from msbdb.io.las import read_points
from msbdb.io.lasheader import read_las_header
from msbdb.points.cloud import PointCloud

COUNT = 3000
SECONDS = 60.0
"""What hangs takes longer; what does not takes seconds, also where a loaded machine loads libraries."""
SOUND = {"append-bug.laz": 37_805, "utm15.las": 1, "test_utm16.las": 10, "bad-geotiff-keys.las": 10}


@pytest.fixture(scope="module")
def bodies(tmp_path_factory):
    """Return the bytes of a sound LAS file and of sound LAZ files, pointwise and layered."""
    folder = tmp_path_factory.mktemp("sound")
    found = {}
    for name, point_format in (("flat.las", 3), ("points.laz", 3), ("layers.laz", 7)):
        las = laspy.LasData(laspy.LasHeader(point_format=point_format, version="1.4"))
        las.header.scales = [0.01] * 3
        rng = np.random.default_rng(1)
        las.x, las.y, las.z = (rng.uniform(0, 100, COUNT) for _ in range(3))
        las.write(folder / name)
        found[name] = (folder / name).read_bytes()
    return found


def patched(body, layout, *changes):
    """Return bytes with numbers of one layout written at offsets."""
    body = bytearray(body)
    for offset, value in changes:
        struct.pack_into(layout, body, offset, value)
    return bytes(body)


def points_start(body):
    """Return where the points begin."""
    return struct.unpack_from("<I", body, 96)[0]


def laz_record(body):
    """Return where the LAZ record's content begins."""
    return body.find(b"laszip encoded") - 2 + 54


def table_start(body):
    """Return where the table of chunks begins."""
    return struct.unpack_from("<q", body, points_start(body))[0]


HOSTILE = {
    "no bytes": ("flat.las", lambda _: b"", "empty"),
    "three bytes": ("flat.las", lambda b: b[:3], "LASF"),
    "a text": ("flat.las", lambda _: b"x,y,z\n1,2,3\n" * 100, "LASF"),
    "a torn header": ("flat.las", lambda b: b[:200], "bytes"),
    "version 2.0": ("flat.las", lambda b: patched(b, "<B", (24, 2)), "version"),
    "version 1.9": ("flat.las", lambda b: patched(b, "<B", (25, 9)), "version"),
    "a short header size": ("flat.las", lambda b: patched(b, "<H", (94, 100)), "header has 100"),
    "points beyond the end": ("flat.las", lambda b: patched(b, "<I", (96, 2**31)), "begin at"),
    "a billion records": ("flat.las", lambda b: patched(b, "<I", (100, 1_069_128_089)), "variable length"),
    "a record too long": ("points.laz", lambda b: patched(b, "<H", (375 + 20, 65535)), "run past"),
    "a quadrillion points": ("flat.las", lambda b: patched(b, "<Q", (247, 10**15)), "truncated"),
    "points missing": ("flat.las", lambda b: b[:-1000], "truncated"),
    "point format 11": ("flat.las", lambda b: patched(b, "<B", (104, 11)), "point format"),
    "short points": ("flat.las", lambda b: patched(b, "<H", (105, 4)), "bytes or more"),
    "an infinite scale": ("flat.las", lambda b: patched(b, "<d", (131, float("inf"))), "scale"),
    "a zero scale": ("flat.las", lambda b: patched(b, "<d", (139, 0.0)), "scale"),
    "an offset that is no number": ("flat.las", lambda b: patched(b, "<d", (155, float("nan"))), "offsets"),
    "both some points and none": (
        "flat.las",
        lambda b: patched(patched(b, "<Q", (247, 0)), "<I", (107, 5)),
        "and none",
    ),
    "extended records beyond the end": (
        "flat.las",
        lambda b: patched(patched(b, "<Q", (235, 10**9)), "<I", (243, 7)),
        "variable length",
    ),
    "compressed by its flag alone": ("flat.las", lambda b: patched(b, "<B", (104, 131)), "says how is missing"),
    "a truncated LAZ": ("points.laz", lambda b: b[: len(b) // 2], "truncated"),
    "a LAZ without its last bytes": ("layers.laz", lambda b: b[:-30], "truncated"),
    "a LAZ of before 2.0": ("points.laz", lambda b: patched(b, "<H", (laz_record(b), 1)), "LASzip"),
    "an unknown coder": ("points.laz", lambda b: patched(b, "<H", (laz_record(b) + 2, 5)), "LASzip"),
    "more items than there are": ("points.laz", lambda b: patched(b, "<H", (laz_record(b) + 32, 999)), "items"),
    "other items than the points": ("points.laz", lambda b: patched(b, "<H", (laz_record(b) + 36, 99)), "compressed"),
    "no table of chunks": ("points.laz", lambda b: patched(b, "<q", (points_start(b), 5)), "table of chunks"),
    "a billion chunks": ("points.laz", lambda b: patched(b, "<I", (table_start(b) + 4, 10**9)), "chunks of points"),
    "too many points for the chunks": ("points.laz", lambda b: patched(b, "<Q", (247, 10**12)), "chunks hold"),
    "layers larger than their chunk": (
        "layers.laz",
        lambda b: patched(b, "<I", (points_start(b) + 8 + 36 + 4, 2**32 - 1)),
        "layers",
    ),
}


@pytest.mark.parametrize("kind", HOSTILE)
def test_a_false_header_is_a_clear_error(tmp_path, bodies, kind):
    """Each kind of damage is told from the others, before a library sees the file, and names the file."""
    source, damage, expected = HOSTILE[kind]
    path = tmp_path / f"hostile{Path(source).suffix}"
    path.write_bytes(damage(bodies[source]))
    start = time.monotonic()
    with pytest.raises(FileError, match=expected) as caught:
        with_notices(read_points, path, crs=2154)
    assert time.monotonic() - start < SECONDS
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("source", ["flat.las", "points.laz", "layers.laz"])
def test_the_sound_files_behind_the_damage_are_read(tmp_path, bodies, source):
    """Otherwise the tests above would show nothing."""
    path = tmp_path / source
    path.write_bytes(bodies[source])
    assert len(with_notices(read_points, path, crs=2154)[0]) == COUNT


def test_no_points_is_an_error_of_its_own(tmp_path):
    """An empty tile says so."""
    laspy.LasData(laspy.LasHeader(point_format=6, version="1.4")).write(tmp_path / "empty.las")
    with pytest.raises(NodataError, match="no points"):
        with_notices(read_points, tmp_path / "empty.las", crs=2154)


def test_missing_files_and_folders_are_told(tmp_path):
    """The path is in the message."""
    with pytest.raises(FileError, match=r"none\.laz does not exist"):
        with_notices(read_points, tmp_path / "none.laz")
    with pytest.raises(FileError, match="is a folder"):
        with_notices(read_points, tmp_path)


def test_a_panic_of_the_decompressor_is_an_error_of_ours(tmp_path, bodies, monkeypatch):
    """A panic is no Exception, but still ends as a FileError; an interrupt passes as it is."""
    path = tmp_path / "tile.laz"
    path.write_bytes(bodies["points.laz"])
    panic = type("PanicException", (BaseException,), {"__module__": "pyo3_runtime"})

    def fail(error):
        def read_points_of(*_):
            raise error

        monkeypatch.setattr("laspy.LasReader.read_points", read_points_of)

    fail(panic("no chunk table"))
    with pytest.raises(FileError, match="no chunk table"):
        with_notices(read_points, path, crs=2154)
    fail(KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        with_notices(read_points, path, crs=2154)


@pytest.mark.parametrize("source", ["points.laz", "layers.laz"])
def test_random_damage_never_escapes(tmp_path, bodies, source):
    """Whatever bytes change, there are points or an error of ours, soon."""
    rng = np.random.default_rng(11)
    path = tmp_path / source
    start = time.monotonic()
    for _ in range(40):
        body = bytearray(bodies[source])
        region = len(body) if rng.random() < 0.5 else points_start(body) + 100
        for place in rng.integers(0, region, 3):
            body[place] = rng.integers(256)
        path.write_bytes(body)
        try:
            cloud, _ = with_notices(read_points, path, crs=2154)
        except MsbdbError:
            continue
        assert len(cloud) <= COUNT
    assert time.monotonic() - start < SECONDS


def _hostile_files():
    """Return the real hostile files, where they are at hand."""
    folder = Path(os.environ.get("MSBDB_DATA", "none"), "hostile")
    return sorted(folder.glob("*.la[sz]"))


@pytest.mark.data
@pytest.mark.parametrize("path", _hostile_files(), ids=lambda path: path.name)
@pytest.mark.parametrize("crs", [None, 2154], ids=["own", "stated"])
def test_real_hostile_files_end_well(path, crs):
    """In reasonable time there are points, all finite and as many as promised or noticed, or an error of ours."""
    start = time.monotonic()
    cloud, notices, refusal = None, [], ""
    try:
        cloud, notices = with_notices(read_points, path, crs=crs)
    except MsbdbError as error:
        refusal = str(error)
    assert time.monotonic() - start < SECONDS
    if cloud is None:
        assert path.name in refusal
        assert path.name not in SOUND or crs is not None
    else:
        assert isinstance(cloud, PointCloud)
        assert all(np.isfinite(values).all() for values in (cloud.x, cloud.y, cloud.z))
        promised = read_las_header(path).points
        told = any("dropped" in notice or "Each place counts once" in notice for notice in notices)
        assert len(cloud) == promised or told
        assert len(cloud) == SOUND.get(path.name, len(cloud))

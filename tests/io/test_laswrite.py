"""Files with other classes: everything else is the same to the byte, and a file is whole or not there."""

import datetime
import os
import resource
import signal
import struct
import subprocess
import sys
import uuid
from pathlib import Path

import laspy
import numpy as np
import pytest
from pyproj import CRS
from support.notices import with_notices
from support.processes import environment
from support.sizes import sample

from msbdb.errors import FileError, InputError, MsbdbError, MsbdbWarning, NodataError
from msbdb.io.las import read_points, read_points_indexed
from msbdb.io.lasheader import read_las_header
from msbdb.io.laswrite import write_classes

COUNT = 700
WAVES = (4, 5, 9, 10)


def version_of(point_format):
    """Return the oldest version that has a point format."""
    return "1.4" if point_format > 5 else "1.3" if point_format > 3 else "1.2"


def write(path, point_format=6, *, records=True, seed=5):
    """Write a file of random bytes in every field, with extra bytes, records and a filled header; return its path."""
    rng = np.random.default_rng(seed)
    header = laspy.LasHeader(point_format=point_format, version=version_of(point_format))
    header.scales, header.offsets = [0.01, 0.001, 0.1], [700_000.0, 6_600_000.0, -5.0]
    header.add_crs(CRS.from_epsg(2154))
    header.add_extra_dim(laspy.ExtraBytesParams("amplitude", "f4", "of the echo"))
    header.add_extra_dim(laspy.ExtraBytesParams("plane", "3u2", offsets=[1.0] * 3, scales=[0.5] * 3))
    header.creation_date = datetime.date(2011, 2, 3)
    header.uuid = uuid.UUID(int=0x1234567890)
    header.system_identifier, header.generating_software = "a scanner", "a program of 2011"
    las = laspy.LasData(header, laspy.ScaleAwarePointRecord.zeros(COUNT, header=header))
    raw = las.points.array.view(np.uint8).reshape(COUNT, -1)
    raw[:] = rng.integers(0, 256, raw.shape, dtype=np.uint8)
    if records:
        header.vlrs.append(laspy.VLR("someone", 77, "a private record", rng.bytes(300)))
        if point_format > 5:
            las.evlrs = laspy.vlrs.vlrlist.VLRList([laspy.VLR("someone", 78, "an extended one", rng.bytes(70_000))])
    with path.open("wb") as file:
        las.write(file, do_compress=path.suffix == ".laz", laz_backend=laspy.LazBackend.Lazrs)
    return path


def classes_for(point_format, seed=9):
    """Return random classes that a format can hold."""
    return np.random.default_rng(seed).integers(0, 32 if point_format < 6 else 256, COUNT, dtype=np.uint8)


def raw_points(path):
    """Return a file's points as bytes, decompressed."""
    array = laspy.read(path).points.array
    return array.view(np.uint8).reshape(len(array), -1)


def expected_bytes(path, point_format, classes):
    """Return what a LAS file becomes, written down by hand."""
    body = bytearray(path.read_bytes())
    start, size = struct.unpack_from("<I", body, 96)[0], struct.unpack_from("<H", body, 105)[0]
    for number, value in enumerate(classes):
        if point_format < 6:
            place = start + number * size + 15
            body[place] = body[place] & 0b11100000 | value
        else:
            body[start + number * size + 16] = value
    return bytes(body)


@pytest.mark.parametrize("point_format", range(11))
def test_only_the_classes_of_las_change(tmp_path, point_format):
    """Every other byte of the file is the source's, whatever it means."""
    source, classes = write(tmp_path / "in.las", point_format), classes_for(point_format)
    written = write_classes(source, tmp_path / "out.las", classes)
    expected = expected_bytes(source, point_format, classes)
    assert (tmp_path / "out.las").read_bytes() == expected
    before = np.asarray(laspy.read(source).classification)
    assert (written.points, written.changed) == (COUNT, np.count_nonzero(before != classes))


@pytest.mark.parametrize("point_format", sorted(set(range(11)) - set(WAVES)))
def test_las_through_laz_is_the_same_to_the_byte(tmp_path, point_format):
    """Compressed and taken apart again, the file is what it would have been without."""
    source, classes = write(tmp_path / "in.las", point_format), classes_for(point_format)
    write_classes(source, tmp_path / "packed.laz", classes)
    write_classes(tmp_path / "packed.laz", tmp_path / "again.laz", classes)
    write_classes(tmp_path / "again.laz", tmp_path / "out.las", classes)
    assert (tmp_path / "out.las").read_bytes() == expected_bytes(source, point_format, classes)
    assert (tmp_path / "again.laz").read_bytes() == (tmp_path / "packed.laz").read_bytes()
    assert (tmp_path / "packed.laz").stat().st_size < source.stat().st_size + 2000


@pytest.mark.parametrize("point_format", sorted(set(range(11)) - set(WAVES)))
def test_laz_keeps_fields_records_and_header(tmp_path, point_format):
    """As laspy reads them: each dimension, each record, each field of the header."""
    source, classes = write(tmp_path / "in.laz", point_format), classes_for(point_format)
    write_classes(source, tmp_path / "out.laz", classes)
    old, new = laspy.read(source), laspy.read(tmp_path / "out.laz")
    for name in old.point_format.dimension_names:
        if name != "classification":
            np.testing.assert_array_equal(old[name], new[name], err_msg=name)
    np.testing.assert_array_equal(new.classification, classes)
    told = [[(r.user_id, r.record_id, r.description, r.record_data_bytes()) for r in las.vlrs] for las in (old, new)]
    assert told[0] == told[1]
    assert "someone" in {user for user, *_ in told[0]}
    if point_format > 5:
        assert [r.record_data_bytes() for r in new.evlrs] == [r.record_data_bytes() for r in old.evlrs] != []
    texts = ("uuid", "creation_date", "system_identifier", "generating_software")
    for name in (*texts, "file_source_id", "point_count", "version"):
        assert getattr(old.header, name) == getattr(new.header, name)
    for name in ("scales", "offsets", "mins", "maxs", "number_of_points_by_return"):
        np.testing.assert_array_equal(getattr(old.header, name), getattr(new.header, name))
    assert old.header.global_encoding.value == new.header.global_encoding.value


@pytest.mark.parametrize("point_format", [1, 6])
def test_flags_beside_the_class_stay(tmp_path, point_format):
    """Synthetic, key-point, withheld, and overlap where there is one; chosen points alone change."""
    source = write(tmp_path / "in.laz", point_format)
    old, chosen = laspy.read(source), np.arange(COUNT) % 3 == 0
    written = write_classes(source, tmp_path / "out.laz", np.full(COUNT, 6, np.uint8), where=chosen)
    new = laspy.read(tmp_path / "out.laz")
    for name in ("synthetic", "key_point", "withheld", *(["overlap"] if point_format > 5 else [])):
        assert np.asarray(old[name]).any()
        np.testing.assert_array_equal(old[name], new[name])
    np.testing.assert_array_equal(new.classification, np.where(chosen, 6, old.classification))
    assert written.changed == np.count_nonzero(chosen & (np.asarray(old.classification) != 6))


@pytest.mark.parametrize("ending", ["las", "laz"])
def test_many_chunks_write_as_one(tmp_path, monkeypatch, ending):
    """The number of points in memory changes no byte, and progress ends at the number of points."""
    source, classes = write(tmp_path / "in.laz", 7), classes_for(7)
    write_classes(source, tmp_path / f"whole.{ending}", classes)
    monkeypatch.setattr("msbdb.io.laswrite.CHUNK_BYTES", 5000)
    steps = []
    write_classes(source, tmp_path / f"parts.{ending}", classes, progress=lambda *step: steps.append(step))
    assert (tmp_path / f"parts.{ending}").read_bytes() == (tmp_path / f"whole.{ending}").read_bytes()
    assert steps[-1] == ("write", COUNT, COUNT)
    assert len(steps) > 5


def test_offsets_of_what_follows_the_points_move_with_them(tmp_path):
    """Wave packets and extended records are found where the header says, in LAZ as in LAS, padding kept."""
    source = write(tmp_path / "in.las", 6)
    body = bytearray(source.read_bytes())
    first = struct.unpack_from("<Q", body, 235)[0]
    struct.pack_into("<Q", body, 227, first)
    start = struct.unpack_from("<I", body, 96)[0]
    struct.pack_into("<I", body, 96, start + 7)
    body[start:start] = b"padding"
    struct.pack_into("<QQ", body, 227, first + 7, first + 7)
    source.write_bytes(body)
    write_classes(source, tmp_path / "out.laz", classes_for(6))
    packed = (tmp_path / "out.laz").read_bytes()
    wave, extended = struct.unpack_from("<QQ", packed, 227)
    assert wave == extended
    assert packed[wave:] == bytes(body[first + 7 :])
    assert b"padding" in packed
    write_classes(tmp_path / "out.laz", tmp_path / "out.las", classes_for(6))
    assert (tmp_path / "out.las").read_bytes() == expected_bytes(source, 6, classes_for(6))


def test_what_points_into_the_points_is_no_record(tmp_path):
    """An offset of wave packets that makes no sense stays as it is; extended records before the points are an error."""
    source = write(tmp_path / "in.las", 6)
    body = bytearray(source.read_bytes())
    struct.pack_into("<Q", body, 227, 5)
    source.write_bytes(body)
    write_classes(source, tmp_path / "out.laz", classes_for(6))
    assert struct.unpack_from("<Q", (tmp_path / "out.laz").read_bytes(), 227)[0] == 5
    start = struct.unpack_from("<I", body, 96)[0]
    body[start : start + 60] = bytes(60)
    struct.pack_into("<QI", body, 235, start, 1)
    source.write_bytes(body)
    with pytest.raises(FileError, match="extended records begin before"):
        write_classes(source, tmp_path / "other.laz", classes_for(6))


@pytest.mark.parametrize("point_format", [1, 4, 6])
def test_what_laspy_would_rewrite_is_as_in_the_source(tmp_path, point_format):
    """No date, old or wrong counts, wrong bounds, texts that are not ASCII, remains behind texts, wave packets."""
    source = write(tmp_path / "in.las", point_format)
    body = bytearray(source.read_bytes())
    body[26:58], body[58:90] = b"scanner\0 of old".ljust(32, b"x"), "Pöint Cleaner".encode("latin-1").ljust(32, b"\0")
    struct.pack_into("<2H", body, 90, 0, 0)
    if point_format == 6:
        struct.pack_into("<I", body, 107, COUNT)
        struct.pack_into("<15Q", body, 255, *range(15))
    struct.pack_into("<5I", body, 111, *range(5))
    struct.pack_into("<6d", body, 179, *range(6))
    place = body.find(b"someone\0")
    body[place + 20 : place + 52] = "Größe".encode("latin-1").ljust(32, b"\0")
    if point_format == 4:
        struct.pack_into("<Q", body, 227, len(body))
        body += np.random.default_rng(3).bytes(50_000)
    source.write_bytes(body)
    classes = classes_for(point_format)
    write_classes(source, tmp_path / "out.las", classes)
    assert (tmp_path / "out.las").read_bytes() == expected_bytes(source, point_format, classes)


@pytest.mark.parametrize("minor", [0, 1])
def test_the_oldest_versions_stay(tmp_path, minor):
    """LAS 1.0 and 1.1, which laspy does not write in point format 3, compressed and not."""
    source, classes = write(tmp_path / "in.las", 3), classes_for(3)
    body = bytearray(source.read_bytes())
    body[25] = minor
    source.write_bytes(body)
    write_classes(source, tmp_path / "packed.laz", classes)
    write_classes(tmp_path / "packed.laz", tmp_path / "out.las", classes)
    assert (tmp_path / "out.las").read_bytes() == expected_bytes(source, 3, classes)


def test_a_point_format_that_its_version_does_not_have_is_refused(tmp_path):
    """The message says so, and nothing is written."""
    source = write(tmp_path / "in.las", 4)
    body = bytearray(source.read_bytes())
    body[104] = 6
    source.write_bytes(body)
    with pytest.raises(FileError, match=r"in\.las .*not compatible"):
        write_classes(source, tmp_path / "out.las", classes_for(6))
    assert list(tmp_path.iterdir()) == [source]


def test_what_is_lost_of_the_heads_of_records(tmp_path):
    """Reserved bytes, the remains behind an owner's name and a description, and the last of 32 characters."""
    source, classes = write(tmp_path / "in.las", 6), classes_for(6)
    lossless = bytearray(source.read_bytes())
    full = lossless.copy()
    place = full.find(b"someone\0")
    full[place - 2 : place], lossless[place - 2 : place] = b"\xbb\xaa", b"\0\0"
    full[place + 8 : place + 16] = b"remains!"
    full[place + 20 : place + 52], lossless[place + 20 : place + 52] = b"d" * 32, b"d" * 31 + b"\0"
    place = full.find(b"LASF_Projection\0")
    full[place + 20 : place + 52], lossless[place + 20 : place + 52] = b"wkt\0" * 8, b"wkt".ljust(32, b"\0")
    source.write_bytes(full)
    write_classes(source, tmp_path / "out.las", classes)
    source.write_bytes(lossless)
    assert (tmp_path / "out.las").read_bytes() == expected_bytes(source, 6, classes)


def test_copc_becomes_plain_laz_and_says_so(tmp_path):
    """Its own records go, all others and the points' order stay."""
    path = write(tmp_path / "in.copc.laz", 6)
    las = laspy.read(path)
    las.evlrs.append(laspy.VLR("LASF_Spec", 0, "", b"\x07Low point(bird)"))
    las.header.vlrs.insert(0, laspy.VLR("copc", 1, "", bytes(160)))
    las.evlrs.append(laspy.VLR("copc", 1000, "EPT Hierarchy", bytes(64)))
    las.write(path)
    for name in ("out.laz", "out.las"):
        with pytest.warns(MsbdbWarning, match=r"in\.copc\.laz is COPC"):
            write_classes(path, tmp_path / name, classes_for(6))
        new = laspy.read(tmp_path / name)
        np.testing.assert_array_equal(raw_points(path)[:, :16], raw_points(tmp_path / name)[:, :16])
        assert "copc" not in {r.user_id for r in [*new.header.vlrs, *new.evlrs]}
        assert new.evlrs[0].record_data_bytes() == las.evlrs[0].record_data_bytes()
        assert b"\x07Low point(bird)" in (tmp_path / name).read_bytes()
        read_las_header(tmp_path / name)
    with pytest.raises(InputError, match="not as COPC"):
        write_classes(path, tmp_path / "out.copc.laz", classes_for(6))


@pytest.mark.parametrize("point_format", WAVES)
def test_wave_packets_are_not_compressed(tmp_path, point_format):
    """The refusal names the way out, and leaves nothing."""
    source = write(tmp_path / "in.las", point_format)
    with pytest.raises(InputError, match=r"ends in \.las"):
        write_classes(source, tmp_path / "out.laz", classes_for(point_format))
    assert list(tmp_path.iterdir()) == [source]


def test_refusals(tmp_path):
    """The source itself, a file that is there, another ending, no folder, wrong arrays, too high a class."""
    source, classes = write(tmp_path / "in.laz", 3), classes_for(3)
    link = tmp_path / "link.laz"
    link.hardlink_to(source)
    there = tmp_path / "there.laz"
    there.write_text("mine")
    before = source.read_bytes()
    for path in (source, link, tmp_path / "." / "in.laz"):
        with pytest.raises(InputError, match="source itself"):
            write_classes(source, path, classes, overwrite=True)
    with pytest.raises(FileError, match="exists already"):
        write_classes(source, there, classes)
    with pytest.raises(InputError, match=r"\.las or \.laz"):
        write_classes(source, tmp_path / "out.txt", classes)
    with pytest.raises(FileError, match="does not exist"):
        write_classes(source, tmp_path / "none" / "out.laz", classes)
    for wrong in (classes[:-1], classes.astype(np.int64)):
        with pytest.raises(InputError, match="700 points"):
            write_classes(source, tmp_path / "out.laz", wrong)
    with pytest.raises(InputError, match="up to 31; got 32"):
        write_classes(source, tmp_path / "out.laz", np.full(COUNT, 32, np.uint8))
    with pytest.raises(FileError, match="does not exist"):
        write_classes(tmp_path / "none.laz", tmp_path / "out.laz", classes)
    assert there.read_text() == "mine"
    assert source.read_bytes() == before
    assert sorted(tmp_path.iterdir()) == sorted([source, link, there])
    write_classes(source, there, classes, overwrite=True)
    np.testing.assert_array_equal(laspy.read(there).classification, classes)


def test_a_source_without_points_or_with_damage_leaves_nothing(tmp_path, monkeypatch):
    """Each is the error that the reader gives, also where the damage shows only when half is written."""
    laspy.LasData(laspy.LasHeader(point_format=6, version="1.4")).write(tmp_path / "empty.las")
    with pytest.raises(NodataError, match="no points"):
        write_classes(tmp_path / "empty.las", tmp_path / "out.laz", np.empty(0, np.uint8))
    source = write(tmp_path / "in.laz", 3)
    body = source.read_bytes()
    source.write_bytes(body[: struct.unpack_from("<I", body, 96)[0] + 100])
    with pytest.raises(FileError, match="truncated"):
        write_classes(source, tmp_path / "out.laz", classes_for(3))
    source.write_bytes(body)

    panic = type("PanicException", (BaseException,), {"__module__": "pyo3_runtime"})

    class Failing:
        calls = 0

        def __init__(self, *_):
            """Take whatever the decompressor takes."""

        def decompress_many(self, _):
            """Fail at the second chunk, as no Exception."""
            Failing.calls += 1
            if Failing.calls == 2:
                raise panic

    monkeypatch.setattr("msbdb.io.laswrite.CHUNK_BYTES", 5000)
    monkeypatch.setattr("lazrs.ParLasZipDecompressor", Failing)
    with pytest.raises(FileError, match=r"in\.laz cannot be decoded"):
        write_classes(source, tmp_path / "out.laz", classes_for(3))
    assert Failing.calls == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["empty.las", "in.laz"]


STOPPED = """
import sys, numpy as np
from disturbance import forks
from msbdb.io import laswrite
laswrite.CHUNK_BYTES = 5000
forks.stop_in("msbdb.io.laswrite:_set_classes", 3, int(sys.argv[3]))
laswrite.write_classes(sys.argv[1], sys.argv[2], np.full(700, 6, np.uint8), overwrite=True)
"""


@pytest.mark.parametrize("ending", sample(["laz", "las"], 2))
@pytest.mark.parametrize("number", sample([signal.SIGINT, signal.SIGKILL], 2))
def test_a_stop_in_the_middle_leaves_no_output(tmp_path, ending, number):
    """Neither half a file where there was none, nor a change of the one that was there; no stray after Ctrl-C."""
    source, there = write(tmp_path / f"in.{ending}", 6), tmp_path / f"there.{ending}"
    there.write_text("the former file")
    for out in (there, tmp_path / f"new.{ending}"):
        command = [sys.executable, "-c", STOPPED, source, out, str(int(number))]
        done = subprocess.run(command, env=environment(), capture_output=True, check=False)
        assert done.returncode == -number
    assert there.read_text() == "the former file"
    seen = {path.name for path in tmp_path.iterdir() if not path.name.startswith(".")}
    assert seen == {source.name, there.name}
    if number == signal.SIGINT:
        assert len(list(tmp_path.iterdir())) == 2


FULL = """
import resource, signal, sys, numpy as np
from msbdb.errors import FileError
from msbdb.io.laswrite import write_classes
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
sys.dont_write_bytecode = True
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, resource.RLIM_INFINITY))
try:
    write_classes(sys.argv[1], sys.argv[2], np.full(700, 6, np.uint8))
except FileError as error:
    sys.exit(str(error))
"""


@pytest.mark.skipif(not hasattr(resource, "RLIMIT_FSIZE"), reason="no limit of the size of files here")
@pytest.mark.parametrize("ending", sample(["laz", "las"], 2))
def test_no_room_is_told_of_the_output(tmp_path, ending):
    """The message names the file that could not be written, and nothing is left of it."""
    source, out = write(tmp_path / "in.las", 7), tmp_path / f"out.{ending}"
    command = [sys.executable, "-c", FULL, source, out]
    done = subprocess.run(command, env=environment(), capture_output=True, check=False, text=True)
    assert done.returncode == 1
    assert f"{out} cannot be written" in done.stderr
    assert list(tmp_path.iterdir()) == [source]


def test_the_index_tells_which_points_are_left(tmp_path):
    """Over chunks and files, without noise, withheld and lone points; with noise, all of them come."""
    paths = []
    for number in (0, 1):
        las = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
        las.header.add_crs(CRS.from_epsg(2154))
        las.header.scales, las.header.offsets = [0.01] * 3, [700_000.0, 6_600_000.0, 0.0]
        las.x, las.y = 700_000.0 + np.arange(100) + number, np.full(100, 6_600_000.0)
        las.z = np.arange(100.0)
        las.classification = np.where(np.arange(100) % 10 == 3, 7, 2)
        las.withheld = np.arange(100) % 10 == 5
        las.z[50] = 9000.0 + 3000.0 * number
        paths.append(tmp_path / f"{number}.laz")
        las.write(paths[-1])
    expected = np.array([i for i in range(200) if i % 10 not in (3, 5) and i % 100 != 50])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("msbdb.io.las.CHUNK_POINTS", 17)
        (cloud, index), notices = with_notices(read_points_indexed, paths)
    np.testing.assert_array_equal(index, expected)
    plain, plain_notices = with_notices(read_points, paths)
    assert notices == plain_notices
    for name, values in plain.arrays().items():
        np.testing.assert_array_equal(values, cloud.arrays()[name])
    (every, places), notices = with_notices(read_points_indexed, paths, noise=True)
    np.testing.assert_array_equal(places, np.arange(200))
    np.testing.assert_array_equal(every.z[index], cloud.z)
    assert not any("dropped" in notice for notice in notices)


def _hostile_files():
    """Return the real hostile files, where they are at hand."""
    return sorted(Path(os.environ.get("MSBDB_DATA", "none"), "hostile").glob("*.la[sz]"))


@pytest.mark.data
@pytest.mark.filterwarnings("ignore:.*is COPC:msbdb.errors.MsbdbWarning")
@pytest.mark.parametrize("path", _hostile_files(), ids=lambda path: path.name)
@pytest.mark.parametrize("ending", ["las", "laz"])
def test_real_hostile_files_end_well(tmp_path, path, ending):
    """All bytes of all points but those of the classes are the same, or there is an error of ours and no file."""
    out = tmp_path / f"out.{ending}"
    refusal = ""
    try:
        info = read_las_header(path)
        write_classes(path, out, np.full(info.points, 6, np.uint8))
    except MsbdbError as error:
        refusal = str(error)
    if refusal:
        assert path.name in refusal
        assert list(tmp_path.iterdir()) == []
        return
    place = 15 if info.point_format <= 5 else 16
    old, new = raw_points(path), raw_points(out)
    np.testing.assert_array_equal(np.delete(old, place, axis=1), np.delete(new, place, axis=1))
    assert (np.asarray(laspy.read(out).classification) == 6).all()
    again = read_las_header(out)
    assert (again.projection, again.bounds, again.version) == (info.projection, info.bounds, info.version)

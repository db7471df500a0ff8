"""Points from LAS and LAZ: formats, units, drops, and what counts as absent."""

import os
from pathlib import Path

import laspy
import numpy as np
import pytest
from pyproj import CRS, Transformer
from support.notices import with_notices

from msbdb.errors import CRSError, InputError, NodataError
from msbdb.io.las import read_points, read_points_indexed

LAMBERT = CRS.from_epsg(2154)
COUNT = 400


def write(
    path, *, crs=LAMBERT, point_format=6, version="1.4", count=COUNT, origin=(700000.0, 6600000.0), side=100.0, **fields
):
    """Write a file of random points with the given fields, and return its path."""
    rng = np.random.default_rng(7)
    header = laspy.LasHeader(point_format=point_format, version=version)
    header.scales, header.offsets = [0.01] * 3, [*origin, 0.0]
    if crs is not None:
        header.add_crs(crs)
    extra = {name: values for name, values in fields.items() if name.isupper()}
    for name, values in extra.items():
        header.add_extra_dim(laspy.ExtraBytesParams(name=name, type=values.dtype))
    las = laspy.LasData(header)
    las.x, las.y = origin[0] + rng.uniform(0, side, count), origin[1] + rng.uniform(0, side, count)
    las.z = rng.uniform(10, 30, count)
    for name, values in fields.items():
        las[name] = values
    las.write(path)
    return path


def ramp(low, high, count=COUNT, dtype=np.uint16):
    """Return whole numbers from low to high."""
    return np.linspace(low, high, count).astype(dtype)


@pytest.mark.parametrize(
    ("point_format", "ending"),
    # The compressor at hand writes no wave packets, so that 4, 5, 9 and 10 are tested uncompressed.
    [(number, "las") for number in range(11)] + [(number, "laz") for number in (0, 1, 2, 3, 6, 7, 8)],
)
def test_every_point_format_reads_alike(tmp_path, point_format, ending):
    """Coordinates, classes, echoes and intensity are the written ones, whatever the format and compression."""
    classes, echoes = ramp(1, 6, dtype=np.uint8), np.arange(COUNT, dtype=np.uint8) % 3 + 1
    path = write(
        tmp_path / f"tile.{ending}",
        point_format=point_format,
        version="1.4" if point_format > 5 else "1.3" if point_format > 3 else "1.2",
        classification=classes,
        return_number=echoes,
        number_of_returns=np.full(COUNT, 3, dtype=np.uint8),
        intensity=ramp(5, 900),
        crs=LAMBERT,
    )
    cloud, notices = with_notices(read_points, path)
    expected = laspy.read(path)
    np.testing.assert_array_equal(cloud.x, np.asarray(expected.x))
    np.testing.assert_array_equal(cloud.z, np.asarray(expected.z))
    np.testing.assert_array_equal(cloud.classification, classes)
    np.testing.assert_array_equal(cloud.return_number, echoes)
    np.testing.assert_array_equal(cloud.intensity, ramp(5, 900))
    assert cloud.crs == LAMBERT
    assert all("colours" in notice for notice in notices), notices


def test_many_chunks_read_as_one(tmp_path, monkeypatch):
    """The size of a chunk changes nothing, and progress ends at the number of points."""
    path = write(tmp_path / "tile.laz", intensity=ramp(0, 500))
    whole, _ = with_notices(read_points, path)
    monkeypatch.setattr("msbdb.io.las.CHUNK_POINTS", 37)
    steps = []
    parts, _ = with_notices(read_points, [path], progress=lambda *step: steps.append(step))
    for name, values in whole.arrays().items():
        np.testing.assert_array_equal(values, parts.arrays()[name])
    assert steps[-1] == ("read", COUNT, COUNT)
    assert len(steps) == 11


@pytest.mark.parametrize("point_format", [1, 6])
def test_noise_and_withheld_points_are_dropped_and_counted(tmp_path, point_format):
    """Classes 7 and 18 and the withheld flag go; class 17 stays."""
    classes = np.repeat(np.array([2, 7, 17, 18], dtype=np.uint8), COUNT // 4)
    withheld = (np.arange(COUNT) % 10 == 0).astype(np.uint8)
    path = write(tmp_path / "tile.laz", point_format=point_format, classification=classes, withheld=withheld)
    cloud, notices = with_notices(read_points, path)
    assert set(np.unique(cloud.classification)) == {2, 17}
    assert len(cloud) == 180
    assert "40 points flagged as withheld were dropped." in notices
    assert "180 points of the noise classes 7 and 18 were dropped." in notices


def test_lone_and_absurd_points_are_dropped_and_counted(tmp_path):
    """A bird, a cloud and a zeroed coordinate go; a tower that returns all the way up stays."""
    path = write(tmp_path / "tile.las")
    las = laspy.read(path)
    las.z[:41] = np.linspace(30, 830, 41)
    las.z[100], las.z[101] = 4000.0, 1e6
    las.x[102] = 0.0
    las.write(path)
    cloud, notices = with_notices(read_points, path)
    assert len(cloud) == COUNT - 3
    assert cloud.z.max() == pytest.approx(830)
    assert "1 point of absurd coordinates was dropped." in notices
    assert "2 points far from all others were dropped." in notices


def test_coordinates_outside_of_the_headers_bounds_are_noticed(tmp_path):
    """The points are trusted, the header is not."""
    path = write(tmp_path / "tile.las")
    body = bytearray(path.read_bytes())
    body[179:187] = np.float64(700050.0).tobytes()  # largest easting
    path.write_bytes(body)
    cloud, notices = with_notices(read_points, path)
    assert len(cloud) == COUNT
    assert any("outside of the bounds in the header" in notice for notice in notices)


def test_what_says_nothing_is_none(tmp_path):
    """No echo numbers, no classes, constant intensity and black colours are absent attributes."""
    path = write(tmp_path / "tile.laz", point_format=7, intensity=np.full(COUNT, 9, dtype=np.uint16))
    cloud, notices = with_notices(read_points, path)
    assert set(cloud.arrays()) == {"x", "y", "z"}
    assert cloud.colour_names == ()
    assert cloud.first_echo.all()
    assert any("red, green, blue" in notice for notice in notices)


def test_eight_bit_colours_are_widened(tmp_path):
    """None above 255 means 8 bits: 255 becomes 65535; a file with one larger value stays as it is."""
    colours = {"red": ramp(0, 255), "green": ramp(10, 20), "blue": ramp(20, 10)}
    narrow, notices = with_notices(read_points, write(tmp_path / "a.laz", point_format=7, **colours))
    np.testing.assert_array_equal(narrow.colours[:, 0], ramp(0, 255) * 257)
    assert any("multiplied by 257" in notice for notice in notices)
    colours["blue"] = ramp(0, 256)
    wide, _ = with_notices(read_points, write(tmp_path / "b.laz", point_format=7, **colours))
    np.testing.assert_array_equal(wide.colours[:, 2], ramp(0, 256))


def test_infrared_and_extra_byte_colours_are_read(tmp_path):
    """Format 8 has NIR; extra bytes named as colours serve formats without any."""
    bands = {"red": ramp(0, 60000), "green": ramp(1, 50000), "blue": ramp(2, 40000)}
    native, _ = with_notices(read_points, write(tmp_path / "a.laz", point_format=8, **bands, nir=ramp(3, 30000)))
    assert native.colour_names == ("red", "green", "blue", "nir")
    np.testing.assert_array_equal(native.colours[:, 3], ramp(3, 30000))
    named = {name.upper(): values for name, values in bands.items()}
    extra, _ = with_notices(read_points, write(tmp_path / "b.laz", point_format=6, **named))
    assert extra.colour_names == ("red", "green", "blue")
    np.testing.assert_array_equal(extra.colours, native.colours[:, :3])


def test_tiles_are_joined_in_order(tmp_path):
    """Attributes that one tile lacks: colours go, echoes become single ones, both with a notice."""
    rich = write(
        tmp_path / "a.laz",
        point_format=7,
        red=ramp(0, 999),
        green=ramp(0, 999),
        blue=ramp(0, 999),
        return_number=np.full(COUNT, 2, dtype=np.uint8),
        number_of_returns=np.full(COUNT, 2, dtype=np.uint8),
    )
    poor = write(tmp_path / "b.las", point_format=6, origin=(700100.0, 6600000.0))
    cloud, notices = with_notices(read_points, [rich, poor])
    assert len(cloud) == 2 * COUNT
    assert cloud.x[:COUNT].max() <= 700100 <= cloud.x[COUNT:].min()
    assert cloud.colours is None
    np.testing.assert_array_equal(cloud.first_echo, np.arange(2 * COUNT) >= COUNT)
    assert any("blue, green, red" in notice for notice in notices)
    assert "b.las: no echo information, so that every point counts as a first echo." in notices


def test_points_of_two_files_count_once(tmp_path):
    """Points that a second file has too are left out, with a notice of their number; other echoes of a place stay."""
    one = write(tmp_path / "one.laz", return_number=ramp(1, 1), number_of_returns=ramp(1, 1))
    alone, notices = with_notices(read_points, one)
    assert not any("another one" in notice for notice in notices)
    las = laspy.read(one)
    part = laspy.LasData(las.header, las.points[100:250].copy())
    part.return_number[:30], part.number_of_returns[:] = 2, 2
    part.change_scaling(offsets=[690_000.0, 6_500_000.0, 10.0])
    part.write(tmp_path / "two.las")
    for order in (1, -1):
        both, notices = with_notices(read_points, [one, tmp_path / "two.las"][::order])
        assert "120 points repeat another one in place and echo number. Each place counts once." in notices
        assert len(both) == COUNT + 30
        assert np.count_nonzero(both.return_number == 2) == 30
        np.testing.assert_allclose(np.sort(both.x[both.first_echo]), np.sort(alone.x), rtol=0, atol=1e-6)
        # Of equal points that of the pulse with fewer echoes stays.
        assert set(both.number_of_returns[both.first_echo]) == {1}


def test_the_same_notice_of_many_files_is_told_once(tmp_path):
    """With the first file and the number of others."""
    paths = [write(tmp_path / f"{name}.las", origin=(7e5 + i * 100, 6.6e6)) for i, name in enumerate("abc")]
    _, notices = with_notices(read_points, paths)
    assert notices == ["a.las (and 2 more): no echo information, so that every point counts as a first echo."]


def test_feet_become_metres(tmp_path):
    """US survey feet in x, y and z turn into the metric twin."""
    path = write(tmp_path / "tile.laz", crs=CRS.from_epsg(3089), origin=(5208000.0, 3902000.0))
    cloud, notices = with_notices(read_points, path)
    foot = 1200 / 3937
    expected = laspy.read(path)
    assert cloud.crs == CRS.from_epsg(3088)
    np.testing.assert_allclose(cloud.x, np.asarray(expected.x) * foot, rtol=1e-14)
    np.testing.assert_allclose(cloud.z, np.asarray(expected.z) * foot, rtol=1e-14)
    assert any("heights were multiplied by 0.3048006096" in notice for notice in notices)
    assert any("scaled to metres, 'NAD83 / Kentucky Single Zone' (EPSG:3088)" in notice for notice in notices)
    metric, _ = with_notices(read_points, path, z_unit="m")
    np.testing.assert_array_equal(metric.z, np.asarray(expected.z))


@pytest.mark.parametrize(
    ("place", "centre", "alone", "together"),
    [((12.01, 50.0), (11.9, 50.0), 32633, 32632), ((5.0, 8.3), (5.0, 7.0), 32631, 3857)],
)
def test_a_part_of_a_survey_is_read_in_the_crs_of_the_whole(tmp_path, place, centre, alone, together):
    """Files of one survey beyond the border of a UTM zone, or where a web map is just good enough, get one CRS."""
    to_web = Transformer.from_crs(4326, 3857, always_xy=True)
    path = write(tmp_path / "tile.laz", crs=CRS.from_epsg(3857), origin=to_web.transform(*place))
    x, y = to_web.transform(*centre)
    assert with_notices(read_points, path)[0].crs == CRS.from_epsg(alone)
    part, _ = with_notices(read_points, path, bounds=(x - 1e5, y - 1e5, x + 1e5, y + 1e5))
    assert part.crs == CRS.from_epsg(together)


def test_a_stated_crs_serves_files_without_one(tmp_path):
    """A number, a text or an object; without it, the file is refused."""
    path = write(tmp_path / "tile.las", crs=None)
    for stated in (2154, "EPSG:2154", LAMBERT):
        assert with_notices(read_points, path, crs=stated)[0].crs == LAMBERT
    with pytest.raises(CRSError, match="--crs"):
        with_notices(read_points, path)


def test_tiles_of_different_crs_are_refused_by_name(tmp_path):
    """The message names both files and both CRSs."""
    paths = [write(tmp_path / "a.las"), write(tmp_path / "b.las", crs=CRS.from_epsg(32631))]
    with pytest.raises(CRSError, match=r"a\.las.*EPSG:2154.*b\.las.*EPSG:32631"):
        with_notices(read_points, paths)


def test_degrees_are_refused(tmp_path):
    """With the UTM zone to reproject to."""
    path = write(tmp_path / "tile.las", crs=CRS.from_epsg(4326), origin=(3.0, 43.0), side=0.5)
    with pytest.raises(CRSError, match="UTM zone 31N"):
        with_notices(read_points, path, crs=4326)


def test_nothing_left_is_an_error(tmp_path):
    """All noise leaves no points; no files are no survey."""
    path = write(tmp_path / "tile.las", classification=np.full(COUNT, 7, dtype=np.uint8))
    with pytest.raises(NodataError, match="400 points of the noise classes"):
        with_notices(read_points, path)
    with pytest.raises(InputError, match="at least one"):
        with_notices(read_points, [])


@pytest.mark.data
@pytest.mark.skipif("MSBDB_DATA" not in os.environ, reason="MSBDB_DATA is not set")
@pytest.mark.parametrize(
    ("tile", "crs", "points", "epsg"),
    [("montpellier", None, 405_937, 2154), ("nimes", 2154, 404_500, 2154), ("woodford", None, 4_695_461, 3088)],
)
def test_real_tiles_read_whole(tile, crs, points, epsg):
    """Every point of the real tiles is sound, and hardly any is there twice."""
    (cloud, _), _ = with_notices(read_points_indexed, Path(os.environ["MSBDB_DATA"], tile, "points.laz"), crs=crs)
    assert len(cloud) == points
    once, _ = with_notices(read_points, Path(os.environ["MSBDB_DATA"], tile, "points.laz"), crs=crs)
    assert 0.999 * points < len(once) <= points
    assert cloud.crs.to_epsg() == epsg

"""COPC by its nodes: what lies in a box alone, from a file or from a server; and files that lie about their nodes."""

import struct

import geopandas as gpd
import laspy
import numpy as np
import pytest
from pyproj import CRS
from support.copcfile import write_copc
from support.rangeserver import serving

from msbdb.errors import FileError, MsbdbWarning
from msbdb.io.crs import reference
from msbdb.io.files import describe_source, open_input
from msbdb.io.las import read_points
from msbdb.io.lasheader import read_las_header
from msbdb.io.laspoints import is_believed, read_chunks
from msbdb.io.pointfiles import point_files, sound_files
from msbdb.io.vector import Area

LAMBERT = CRS.from_epsg(2154)
BOX = (800_010.0, 6_300_010.0, 800_030.0, 6_300_025.0)


@pytest.fixture(params=[1, 2])
def copc(tmp_path, request):
    """Return a COPC file of 40,000 points on 100 x 80 m, whose nodes are on one page or on two."""
    dice, count = np.random.default_rng(1), 40_000
    header = laspy.LasHeader(version="1.4", point_format=7)
    header.offsets, header.scales = [800_000, 6_300_000, 0], [0.01] * 3
    header.add_crs(LAMBERT)
    las = laspy.LasData(header)
    las.x, las.y = 800_000 + dice.uniform(0, 100, count), 6_300_000 + dice.uniform(0, 80, count)
    las.z, las.intensity = dice.uniform(0, 20, count), dice.integers(0, 900, count)
    las.red, las.green, las.blue = dice.integers(0, 65_536, (3, count))
    las.return_number = las.number_of_returns = np.ones(count, dtype=np.uint8)
    path = tmp_path / "town.copc.laz"
    write_copc(path, las, pages=request.param)
    return path


def content(cloud):
    """Return a cloud's columns as one array."""
    return np.column_stack((cloud.x, cloud.y, cloud.z, cloud.intensity))


def test_the_nodes_hold_all_points_of_a_box(copc):
    """The same points in the same order as of the whole file, from fewer than half of them."""
    whole = content(read_points(copc))
    west, south, east, north = BOX
    inside = (whole[:, 0] >= west) & (whole[:, 0] <= east) & (whole[:, 1] >= south) & (whole[:, 1] <= north)
    assert np.array_equal(content(read_points(copc, area=Area.of_box(BOX, LAMBERT))), whole[inside])
    read = sum(map(len, read_chunks(read_las_header(copc), 10, None, BOX)))
    assert inside.sum() <= read < len(whole) / 2


def test_the_nodes_of_a_web_map_are_found_too(tmp_path):
    """Of a file in Pseudo-Mercator the nodes that meet a box in UTM hold all points of it, and others are not read."""
    dice, count = np.random.default_rng(2), 20_000
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.offsets, header.scales = [485_000, 6_801_000, 0], [0.01] * 3
    header.add_crs(CRS.from_epsg(3857))
    las = laspy.LasData(header)
    las.x, las.y = 485_000 + dice.uniform(0, 200, count), 6_801_000 + dice.uniform(0, 160, count)
    las.z, las.intensity = dice.uniform(0, 20, count), dice.integers(0, 900, count)
    las.return_number = las.number_of_returns = np.ones(count, dtype=np.uint8)
    path = tmp_path / "town.copc.laz"
    write_copc(path, las)
    with pytest.warns(MsbdbWarning, match="were reprojected to 'WGS 84 / UTM zone 31N'"):
        cloud = read_points(path)
    assert np.ptp(cloud.x) == pytest.approx(200 * np.cos(np.radians(52)), rel=0.02), "metres on the ground"
    west, south = cloud.x.min() + 20, cloud.y.min() + 20
    box = (west, south, west + 25, south + 20)
    inside = (cloud.x >= box[0]) & (cloud.x <= box[2]) & (cloud.y >= box[1]) & (cloud.y <= box[3])
    with pytest.warns(MsbdbWarning, match="reprojected"):
        near = read_points(path, area=Area.of_box(box, cloud.crs))
    assert np.array_equal(content(near), content(cloud)[inside])
    how = reference(CRS.from_epsg(3857), bounds=read_las_header(path).bounds, where="town")
    read = sum(map(len, read_chunks(read_las_header(path), 10, None, how.box_in_units(box))))
    assert inside.sum() <= read < count / 2


def test_laspy_finds_the_same(copc):
    """Its reader of COPC, which cuts the nodes to the box."""
    with laspy.CopcReader.open(str(copc)) as reader:
        found = reader.query(laspy.copc.Bounds(np.array(BOX[:2]), np.array(BOX[2:])))
    ours = read_points(copc, area=Area.of_box(BOX, LAMBERT))
    assert np.array_equal(np.sort(np.asarray(found.x)), np.sort(ours.x))


def test_a_server_sends_the_nodes_of_a_box_alone(copc):
    """All of the file without a box; the content is that of the file."""
    with serving(copc.parent) as sent:
        url = f"{sent.url}/town.copc.laz?key=secret"
        assert np.array_equal(content(read_points(url)), content(read_points(copc)))
        everything = sum(sent.answers)
        sent.answers.clear()
        near = read_points(url, area=Area.of_box(BOX, LAMBERT))
        assert np.array_equal(content(near), content(read_points(copc, area=Area.of_box(BOX, LAMBERT))))
        assert sum(sent.answers) < 0.75 * everything
        assert is_believed(read_las_header(url))
        source = describe_source(url, "points")
    assert source.name == "town.copc.laz"
    with serving(copc.parent) as sent:
        assert describe_source(f"{sent.url}/town.copc.laz", "points") == source, "of another address"


def test_what_a_server_cannot_give_is_said(copc, tmp_path):
    """No ranges, no file, no COPC, no server; never the key in the address."""
    plain = laspy.LasData(laspy.LasHeader(version="1.4", point_format=7))
    plain.points = laspy.read(copc).points
    plain.write(tmp_path / "plain.laz")
    with serving(tmp_path) as sent:
        for name, words in (("gone.copc.laz", "answers 404"), ("plain.laz", "is not COPC"), ("a.laz", "404")):
            with pytest.raises(FileError, match=words) as caught:
                read_points(f"{sent.url}/{name}?key=secret")
            assert "secret" not in str(caught.value)
            assert f"{sent.url}/{name}" in str(caught.value)
        sent.ranges = False
        with pytest.raises(FileError, match=r"gives no ranges.*Download it"):
            read_points(f"{sent.url}/town.copc.laz")
        address = sent.url
    with pytest.raises(FileError, match=r"cannot be read: ConnectionError"):
        read_points(f"{address}/town.copc.laz")
    with pytest.raises(FileError, match=r"does not exist"):
        read_points("s3://bucket/town.copc.laz")


def test_a_header_is_fetched_once_for_each_version(copc):
    """The server is asked for the version; a file that was written again has another header."""
    with serving(copc.parent) as sent:
        url = f"{sent.url}/town.copc.laz"
        first = read_las_header(url)
        asked = len(sent.answers)
        assert read_las_header(url) is first
        assert len(sent.answers) == asked + 1
        las = laspy.read(copc)
        plain = laspy.LasData(laspy.LasHeader(version="1.4", point_format=7))
        plain.header.offsets, plain.header.scales = las.header.offsets, las.header.scales
        plain.points = las.points[:20_000]
        write_copc(copc, plain)
        assert (first.points, read_las_header(url).points) == (40_000, 20_000)


def test_a_file_that_changes_is_refused(copc):
    """Its size is another one than at first."""
    with serving(copc.parent) as sent, open_input(f"{sent.url}/town.copc.laz") as file:
        copc.write_bytes(copc.read_bytes() + b"more")
        file.seek(100_000)
        with pytest.raises(FileError, match=r"changed while it was read"):
            file.read(10)


def damaged(copc, entry, layout, place, *values):
    """Write other values into an entry of the first page."""
    data = bytearray(copc.read_bytes())
    first = struct.unpack_from("<Q", data, 375 + 54 + 40)[0]
    struct.pack_into(layout, data, first + 32 * entry + place, *values)
    copc.write_bytes(data)
    return first


@pytest.mark.parametrize(
    ("layout", "place", "values", "words"),
    [
        ("<Q", 16, (2**40,), "beyond the points"),
        ("<i", 28, (2**31 - 1,), "too large"),
        ("<i", 28, (9_000_000,), "nodes hold 90"),
        ("<i", 24, (-5,), "lie over each other"),
        ("<i", 24, (0,), "lie over each other"),
    ],
)
def test_nodes_that_cannot_be_are_refused(copc, layout, place, values, words):
    """Before anything is allocated for them."""
    damaged(copc, 0, layout, place, *values)
    with pytest.raises(FileError, match=words):
        read_points(copc, area=Area.of_box(BOX, LAMBERT))


def test_a_page_that_names_itself_is_refused(copc):
    """A reader that follows it would never end."""
    first = damaged(copc, 0, "<i", 28, -1)
    damaged(copc, 0, "<Qi", 16, first, 32)
    with pytest.raises(FileError, match=r"a page of its nodes cannot be at byte"):
        read_points(copc, area=Area.of_box(BOX, LAMBERT))


def test_layers_that_do_not_fill_a_node_are_refused(copc):
    """The decompressor would allocate what they claim."""
    with serving(copc.parent) as sent:
        info = read_las_header(copc)
        data = bytearray(copc.read_bytes())
        start = struct.unpack_from("<I", data, 96)[0]
        struct.pack_into("<I", data, start + 8 + info.record_size + 4, 2**31)
        copc.write_bytes(data)
        with pytest.raises(FileError, match=r"layers of a node do not fill it"):
            read_points(f"{sent.url}/town.copc.laz")


@pytest.mark.parametrize("name", ["tiles.gpkg", "tiles.geojson", "tiles.shp"])
def test_a_tile_index_stands_for_its_files(copc, name):
    """As pdal tindex writes it: relative to the index, or to the folder of the command, or a URL."""
    names = ["town.copc.laz", "elsewhere/b.laz", "https://example.org/c.copc.laz"]
    shapes = gpd.GeoSeries.from_wkt(["POLYGON ((0 0, 1 0, 1 1, 0 0))"] * 3, crs=LAMBERT)
    index = copc.parent / name
    gpd.GeoDataFrame({"Location": names}, geometry=shapes).to_file(index)
    assert [str(path) for path in point_files([index])] == [str(copc), names[1], "https:/example.org/c.copc.laz"]
    gpd.GeoDataFrame({"tile": names}, geometry=shapes).to_file(index)
    with pytest.raises(FileError, match=r"no column with the place of the files.*it has tile"):
        point_files([index])


def test_remote_files_that_do_not_fit_are_named(copc):
    """And left out on request, like others."""
    with serving(copc.parent) as sent:
        files = point_files([copc, f"{sent.url}/gone.copc.laz"])
        with pytest.raises(FileError, match=rf"1 of 2 files of points cannot be used: {sent.url}/gone.copc.laz"):
            sound_files(files, skip_bad=False)
        with pytest.warns(match=r"1 of 2 files of points are left out"):
            assert sound_files(files, skip_bad=True) == (copc,)

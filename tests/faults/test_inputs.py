"""Bad input, from the command line to the database: each case ends in one clear line, or in a right result."""

import datetime
import json
import os
import struct
import time
from dataclasses import replace
from pathlib import Path

import geopandas as gpd
import numpy as np
import pytest
import shapely
from click.testing import CliRunner
from pyproj import CRS, Transformer
from simulated.builds import EPSG, small_build
from simulated.scenes import SCENES
from support.faultfiles import moved, write_points, write_raster
from support.sizes import sample

import msbdb
import msbdb.run.store  # the libraries are loaded before a clock starts
from msbdb.cli.main import cli
from msbdb.database import open_database, write_build
from msbdb.errors import InputError, MsbdbWarning
from msbdb.grid import lattice
from msbdb.io.las import read_points
from msbdb.io.raster import align_grid, read_grid
from msbdb.run.inputs import Inputs
from msbdb.run.preparation.drafts import make_surface
from msbdb.run.preparation.prepare import Label

SECONDS = 60.0
"""What hangs takes longer; what does not takes seconds, also where a loaded machine loads libraries."""
OREGON_M, OREGON_FT = CRS.from_epsg(2993), CRS.from_epsg(2994)
FOOT_M = 0.3048


def run(*args):
    """Run the program inside of this process."""
    return CliRunner().invoke(cli, [str(arg) for arg in args])


def refuses(folder, args, *expected):
    """Run a command that must fail: in one line that says what is expected, leaving the folder as it was."""
    before = sorted(folder.rglob("*"))
    result = run(*args)
    assert isinstance(result.exception, SystemExit), result.exception
    assert result.exit_code == 1, result.output
    assert result.stdout == ""
    told = result.stderr.strip().splitlines()
    assert len(told) == 1, result.stderr
    assert told[0].startswith("Error: ")
    assert told[0].endswith(".")
    assert "bug in msbdb" not in told[0]
    for words in expected:
        assert words in told[0]
    assert sorted(folder.rglob("*")) == before
    return told[0]


def succeeds(*args):
    """Run a build that must succeed, and return its report."""
    result = run(*args, "--json")
    assert result.exit_code == 0, result.stderr
    return json.loads(result.stdout)


@pytest.fixture(scope="module")
def podium():
    """Return the scene of one building with three parts."""
    return SCENES["podium_tower"](density=2.0)


@pytest.fixture
def tile(tmp_path, podium):
    """Return a sound tile of that scene."""
    return write_points(tmp_path / "tile.laz", podium.points, crs=podium.points.crs)


@pytest.fixture
def heights(tmp_path, podium):
    """Return a sound DSM and DTM of that scene, and its true heights above ground."""
    row, col = np.indices(podium.spec.shape)
    ground = podium.ground(*podium.spec.xy(row, col)).astype(np.float32)
    dsm = write_raster(tmp_path / "dsm.tif", ground + podium.heights, podium.spec)
    return dsm, write_raster(tmp_path / "dtm.tif", ground, podium.spec), ground + podium.heights


def patched(body, layout, offset, value):
    """Return bytes with one number written at an offset."""
    body = bytearray(body)
    struct.pack_into(layout, body, offset, value)
    return bytes(body)


DAMAGE = {
    "empty": (lambda _: b"", "it is empty"),
    "text": (lambda _: b"x y z\n1.0 2.0 3.0\n" * 50, "does not begin with 'LASF'"),
    "truncated": (lambda body: body[: len(body) // 2], "truncated"),
    "a header that hangs": (lambda body: patched(body, "<I", 100, 1_069_128_089), "variable length records"),
    "a LAZ that panics": (
        lambda body: patched(body, "<H", body.find(b"laszip encoded") + 52, 1),
        "Write it again with a current LASzip",
    ),
    "a billion points": (lambda body: patched(body, "<Q", 247, 10**9), "promises 1000000000 points"),
    "heights that are no numbers": (lambda body: patched(body, "<d", 171, float("nan")), "not finite"),
    "infinite heights": (lambda body: patched(body, "<d", 147, float("inf")), "not finite"),
}


@pytest.mark.parametrize("kind", DAMAGE)
def test_damaged_tiles_are_refused(tmp_path, tile, kind):
    """At once, with the file's name and the reason, and no database."""
    damage, expected = DAMAGE[kind]
    tile.write_bytes(damage(tile.read_bytes()))
    start = time.monotonic()
    refuses(tmp_path, ["build", "--points", tile, "--db", tmp_path / "town.sqlite"], "tile.laz", expected)
    assert time.monotonic() - start < SECONDS


def test_a_sound_tile_is_built(tmp_path, tile):
    """Otherwise the tests of damaged ones would show nothing."""
    report = succeeds("build", "--points", tile, "--db", tmp_path / "town.sqlite")
    assert (report["buildings"], report["parts"]) == (1, 3)


def test_one_damaged_tile_of_many_stops_the_build(tmp_path, tile):
    """A survey is built whole or not at all."""
    second = tmp_path / "second.laz"
    second.write_bytes(tile.read_bytes()[:-500])
    refuses(tmp_path, ["build", "--points", tile, second, "--db", tmp_path / "town.sqlite"], "second.laz", "truncated")


@pytest.mark.parametrize(
    ("epsg", "stated", "expected"),
    [
        (None, None, ("states no CRS", "--crs EPSG:")),
        (4326, None, ("in degrees", "Reproject them first")),
        (None, "EPSG:4326", ("in degrees", "Reproject them first")),
        (32633, "EPSG:28992", ("UTM zone 33N", "Amersfoort", "Leave --crs out")),
        (32633, "EPSG:999999", ("999999",)),
        (32633, "moon", ("moon",)),
    ],
)
def test_unsuitable_crs_are_refused(tmp_path, podium, epsg, stated, expected):
    """None, degrees, a contradiction and nonsense: each says what to do."""
    tile = write_points(tmp_path / "tile.las", podium.points, crs=epsg and CRS.from_epsg(epsg))
    stating = ["--crs", stated] if stated else []
    refuses(tmp_path, ["build", "--points", tile, *stating, "--db", tmp_path / "town.sqlite"], *expected)


def test_tiles_of_two_crs_are_refused(tmp_path, tile, podium):
    """Both files and both CRSs are named."""
    other = write_points(tmp_path / "other.laz", podium.points, crs=CRS.from_epsg(32632))
    told = ("tile.laz", "zone 33N", "other.laz", "zone 32N", "Reproject one")
    refuses(tmp_path, ["build", "--points", tile, other, "--db", tmp_path / "town.sqlite"], *told)


def test_feet_give_the_same_buildings_as_metres(tmp_path, podium):
    """A tile in feet is scaled, heights too: areas, heights and places agree with its metric twin."""
    p, found = podium.points, {}
    for crs, unit in ((OREGON_M, 1.0), (OREGON_FT, FOOT_M)):
        cloud = replace(p, x=(p.x - 2e4) / unit, y=(p.y - 5.6e6) / unit, z=p.z / unit, crs=OREGON_M)
        tile = write_points(tmp_path / f"{crs.to_epsg()}.laz", cloud, crs=crs)
        db = tmp_path / f"{crs.to_epsg()}.sqlite"
        report = succeeds("build", "--points", tile, "--db", db)
        assert any("scaled to metres" in notice for notice in report["notices"]) == (crs == OREGON_FT)
        with msbdb.open(db) as inventory:
            found[crs.to_epsg()] = inventory.parts().sort_values(["scale", "area_m2"]).reset_index(drop=True)
    metres, feet = found[2993], found[2994]
    assert metres["hindex"].tolist() == feet["hindex"].tolist()
    for column in ("area_m2", "h_p50", "xcen", "ycen"):
        np.testing.assert_allclose(feet[column], metres[column], rtol=0.02 if column == "area_m2" else 0, atol=0.5)
    assert feet.crs.axis_info[0].unit_name == "metre"


def test_an_ortho_that_does_not_overlap_is_refused(tmp_path, tile, podium):
    """It is named, with both extents; one that overlaps in part is used."""
    pixels = podium.ortho(podium.spec)[:3].astype(np.uint8)
    apart = write_raster(tmp_path / "apart.tif", pixels, moved(podium.spec, 5000.0, 0.0))
    part = write_raster(tmp_path / "part.tif", pixels, moved(podium.spec, 20.0, 0.0))
    build = ["build", "--points", tile, "--db", tmp_path / "town.sqlite", "--ortho"]
    refuses(tmp_path, [*build, apart], "apart.tif")
    assert succeeds(*build, part)["buildings"] == 1


def test_heights_that_are_no_numbers_are_no_data(tmp_path, heights, podium):
    """NaN, infinities and a nodata value in the middle of a roof: no part covers them, the building stands."""
    _, dtm, values = heights
    values[90:94, 70:75] = np.nan
    values[100:104, 70:75] = np.inf
    values[110:114, 70:75] = -np.inf
    values[80:84, 70:75] = -9999.0
    dsm = write_raster(tmp_path / "holes.tif", values, podium.spec, nodata=-9999.0)
    db = tmp_path / "town.sqlite"
    report = succeeds("build", "--dsm", dsm, "--dtm", dtm, "--db", db)
    assert report["buildings"] == 1
    with msbdb.open(db) as inventory:
        [building] = inventory.buildings().itertuples()
        parts = inventory.parts()
    assert np.isfinite(parts.drop(columns=["geometry", "stddis"]).select_dtypes("number").to_numpy()).all()
    assert building.h_max == pytest.approx(36.5, abs=0.1)
    assert building.area_m2 == pytest.approx(1200, abs=80 * 0.25 + 1)


@pytest.mark.parametrize("kind", ["nan", "nodata"])
def test_heights_without_any_number_are_refused(tmp_path, heights, podium, kind):
    """The file and its role are told."""
    _, dtm, values = heights
    values[:] = np.nan if kind == "nan" else -9999.0
    dsm = write_raster(tmp_path / "void.tif", values, podium.spec)
    args = ["build", "--dsm", dsm, "--dtm", dtm, "--db", tmp_path / "town.sqlite"]
    refuses(tmp_path, args, "DSM", "void.tif", "no valid cell")


RASTERS = {
    "text": (lambda path, *_: path.write_text("0 0 0\n1 1 1\n"), ("cannot be read as a raster",)),
    "empty": (lambda path, *_: path.write_bytes(b""), ("cannot be read as a raster",)),
    "three bands": (lambda path, values, spec: write_raster(path, np.stack([values] * 3), spec), ("3 bands",)),
    "degrees": (
        lambda path, values, spec: write_raster(path, values, spec, crs=CRS.from_epsg(4326)),
        ("degrees",),
    ),
    "elsewhere": (lambda path, values, spec: write_raster(path, values, moved(spec, 0.0, 9e3)), ("same place",)),
}


@pytest.mark.parametrize("kind", RASTERS)
def test_unsuitable_terrain_is_refused(tmp_path, heights, podium, kind):
    """A DTM that is no raster, no heights, in degrees, or of another place."""
    dsm, dtm, values = heights
    spoil, expected = RASTERS[kind]
    dtm.unlink()
    spoil(dtm, values, podium.spec)
    args = ["build", "--dsm", dsm, "--dtm", dtm, "--db", tmp_path / "town.sqlite"]
    refuses(tmp_path, args, "dtm.tif" if kind != "elsewhere" else "DTM", *expected)


def test_a_torn_raster_is_refused(tmp_path, heights):
    """Also where its header is whole."""
    dsm, dtm, _ = heights
    dsm.write_bytes(dsm.read_bytes()[:60_000])
    refuses(tmp_path, ["build", "--dsm", dsm, "--dtm", dtm, "--db", tmp_path / "town.sqlite"], "dsm.tif")


def test_absurd_coordinates_are_dropped_and_told(tmp_path, podium):
    """A few points on the moon change nothing but the notices."""
    p, far = podium.points, np.zeros(len(podium.points), dtype=bool)
    far[[5, 500, 5000]] = True
    sound = write_points(tmp_path / "sound.laz", p.take(~far), crs=p.crs)
    moon = {"x": np.where(far, p.x + 1.5e6, p.x), "y": np.where(far, p.y - 1.5e6, p.y), "z": np.where(far, 9e5, p.z)}
    # With the offsets of the sound file, all other coordinates are the same to the last bit.
    spoilt = write_points(tmp_path / "spoilt.laz", p, crs=p.crs, **moon)
    reports = [
        succeeds("build", "--points", path, "--survey", "town", "--db", path.with_suffix(".sqlite"))
        for path in (sound, spoilt)
    ]
    assert any("3 points of absurd coordinates were dropped" in notice for notice in reports[1]["notices"])
    assert _buildings(sound).equals(_buildings(spoilt))


def _buildings(tile):
    """Return the buildings of a tile's database."""
    with msbdb.open(tile.with_suffix(".sqlite")) as inventory:
        return inventory.buildings()


def test_points_that_are_absurd_altogether_are_refused(tmp_path, podium):
    """Nothing is left to build from."""
    z = np.full(len(podium.points), 1e6)
    tile = write_points(tmp_path / "tile.laz", podium.points, crs=podium.points.crs, z=z)
    refuses(tmp_path, ["build", "--points", tile, "--db", tmp_path / "town.sqlite"], "No points are left", "absurd")


def test_no_first_echo_is_refused(tmp_path, podium):
    """Without first echoes there is no surface (V15)."""
    second = np.full(len(podium.points), 2, dtype=np.uint8)
    echoes = {"return_number": second, "number_of_returns": second}
    tile = write_points(tmp_path / "tile.laz", podium.points, crs=podium.points.crs, **echoes)
    refuses(tmp_path, ["build", "--points", tile, "--db", tmp_path / "town.sqlite"], "first echo", "return numbers")


def test_no_echo_information_is_told(tmp_path, podium):
    """Return numbers of zero everywhere count as first echoes, with a notice."""
    none = np.zeros(len(podium.points), dtype=np.uint8)
    echoes = {"return_number": none, "number_of_returns": none}
    tile = write_points(tmp_path / "tile.laz", podium.points, crs=podium.points.crs, **echoes)
    report = succeeds("build", "--points", tile, "--db", tmp_path / "town.sqlite")
    assert report["buildings"] == 1
    assert any("height texture alone" in notice for notice in report["notices"])


@pytest.mark.parametrize("scene", sample(["one point", "flat field"], 2))
def test_nothing_to_find_is_an_empty_valid_database(tmp_path, podium, scene):
    """Every command works on it: there is a survey, and no building."""
    points = podium.points.take(np.arange(len(podium.points)) == 7)
    if scene == "flat field":
        points = SCENES["flat_field"](density=1.0).points
    tile = write_points(tmp_path / "tile.laz", points, crs=points.crs)
    db = tmp_path / "town.sqlite"
    picture = tmp_path / "town.png"
    report = succeeds("build", "--points", tile, "--db", db, "--figure", picture)
    assert (report["buildings"], report["parts"], report["changed"]) == (0, 0, True)
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert not succeeds("build", "--points", tile, "--db", db)["changed"]
    assert json.loads(run("info", db, "--json").stdout)["runs"][0]["buildings"] == 0
    assert run("classes", db).exit_code == 0
    for ending in ("gpkg", "shp", "geojson"):
        result = run("export", db, tmp_path / f"town.{ending}")
        assert result.exit_code == 0, result.stderr
    place = podium.spec.bounds
    truth = gpd.GeoDataFrame(geometry=[shapely.box(place[0], place[1], place[0] + 30, place[1] + 30)], crs=points.crs)
    truth.to_file(tmp_path / "truth.gpkg")
    result = run("evaluate", db, "--reference", tmp_path / "truth.gpkg", "--json")
    assert result.exit_code == 0, result.stderr


@pytest.mark.parametrize("missing", ["--points", "--ortho", "--dsm", "--ndsm"])
def test_missing_files_are_refused(tmp_path, tile, missing):
    """By the command line, before anything is read."""
    sound = ["--points", tile] if missing == "--ortho" else []
    result = run("build", *sound, missing, tmp_path / "none.tif", "--db", tmp_path / "town.sqlite")
    assert result.exit_code == 2
    assert "none.tif' does not exist" in result.stderr
    assert not (tmp_path / "town.sqlite").exists()


def test_a_traceback_is_shown_on_demand(tmp_path, tile):
    """Above the one line, which stays the last."""
    tile.write_bytes(b"")
    result = run("build", "--points", tile, "--db", tmp_path / "town.sqlite", "--debug")
    assert result.exit_code == 1
    assert "Traceback (most recent call last)" in result.stderr
    assert result.stderr.strip().splitlines()[-1].startswith("Error: ")


def _hostile_files():
    """Return the real hostile files, where they are at hand."""
    return sorted(Path(os.environ.get("MSBDB_DATA", "none"), "hostile").glob("*.la[sz]"))


@pytest.mark.data
@pytest.mark.parametrize("path", _hostile_files(), ids=lambda path: path.name)
@pytest.mark.parametrize("crs", [None, "EPSG:2154"], ids=["own", "stated"])
def test_real_hostile_files_end_well(tmp_path, path, crs):
    """In reasonable time there is a database that holds what was reported, or one clear line and no file."""
    args = ["build", "--points", path, "--db", tmp_path / "town.sqlite", *(["--crs", crs] if crs else [])]
    start = time.monotonic()
    result = run(*args, "--json")
    assert time.monotonic() - start < SECONDS
    if result.exit_code != 0:
        refuses(tmp_path, args)
        return
    report = json.loads(result.stdout)
    with msbdb.open(tmp_path / "town.sqlite") as inventory:
        buildings, parts = inventory.buildings(), inventory.parts()
    assert (len(buildings), len(parts)) == (report["buildings"], report["parts"])
    assert (parts["supid"] == 0).sum() == buildings["trees"].sum()
    assert parts.geometry.is_valid.all()


def test_a_user_gives_files_of_another_place(tmp_path, tile, podium, monkeypatch):
    """A DTM, an image or parcels that lie apart are refused by the headers, before any point is read."""
    spec, db = podium.spec, tmp_path / "town.sqlite"
    write_raster(tmp_path / "far.tif", np.zeros(spec.shape), moved(spec, 0.0, 9e3))
    write_raster(tmp_path / "near.tif", np.zeros(spec.shape), spec)
    west, south = spec.bounds[:2]
    gpd.GeoDataFrame(geometry=[shapely.box(west, south + 9e3, west + 9, south + 9.1e3)], crs=spec.crs).to_crs(
        4326
    ).to_file(tmp_path / "far.gpkg")
    monkeypatch.setattr("msbdb.io.las._read", lambda *_, **__: pytest.fail("points were read"))
    for option, name in (("--dtm", "far.tif"), ("--ortho", "far.tif"), ("--parcels", "far.gpkg")):
        args = ["build", "--points", tile, option, tmp_path / name, "--db", db]
        refuses(tmp_path, args, name, "not of the same place", "has (", "the points have")
    args = ["measure", tmp_path / "far.gpkg", "--layer", "far", "--points", tile, "--db", db]
    refuses(tmp_path, args, "far.gpkg", "not of the same place")
    out = tmp_path / "out.laz"
    refuses(tmp_path, ["classify", tile, out, "--dtm", tmp_path / "far.tif"], "far.tif", "not of the same place")
    Inputs.of(tile, dtm=tmp_path / "near.tif", ortho=[tmp_path / "near.tif", tmp_path / "far.tif"]).require_one_place()


def test_a_wrong_header_refuses_no_terrain(tmp_path, tile, podium):
    """Bounds that do not hold the first points of the file are not believed."""
    terrain = write_raster(tmp_path / "dtm.tif", np.zeros(podium.spec.shape), podium.spec)
    data = bytearray(tile.read_bytes())
    bounds = struct.unpack_from("<4d", data, 179)
    struct.pack_into("<4d", data, 179, *(value + 9e3 for value in bounds))
    tile.write_bytes(data)
    Inputs.of(tile, dtm=terrain).require_one_place()


def test_a_user_gives_the_same_points_in_another_order(tmp_path, tile, podium):
    """A tile and the COPC made from it have other bytes; their headers show it. Halves of a tile are no such files."""
    points = podium.points
    order = np.random.default_rng(1).permutation(len(points))
    other = write_points(tmp_path / "tile.copc.laz", points.take(order), crs=points.crs)
    args = ["build", "--points", tile, other, "--db", tmp_path / "town.sqlite"]
    refuses(tmp_path, args, "same points", "tile.copc.laz", f"{len(points)} points", "Leave one out")
    half = np.arange(len(points)) < len(points) // 2
    parts = [points.take(half), points.take(np.roll(half, len(points) // 2))]
    assert len(parts[0]) == len(parts[1])
    halves = [write_points(tmp_path / f"{n}.laz", part, crs=points.crs) for n, part in enumerate(parts)]
    Inputs.of(halves).require_one_place()


def test_a_user_gives_the_same_file_twice(tmp_path, tile, heights):
    """By another path, as a copy, or as surface and ground: refused before any work; a user of Python, too."""
    (tmp_path / "copy.laz").write_bytes(tile.read_bytes())
    (tmp_path / "link.laz").symlink_to(tile)
    dsm, _, _ = heights
    db = tmp_path / "town.sqlite"
    for other in (tile, "copy.laz", "link.laz"):
        refuses(tmp_path, ["build", "--points", tile, tmp_path / other, "--db", db], "points twice", "Leave one out")
    refuses(tmp_path, ["build", "--dsm", dsm, "--dtm", dsm, "--db", db], "given as dsm and dtm")
    with pytest.raises(InputError, match="points twice"):
        msbdb.build([tile, tmp_path / "copy.laz"], db=db)


def test_a_user_forgets_the_file_behind_an_option(tmp_path):
    """The next option is no file."""
    result = run("build", "--points", "--db", tmp_path / "town.sqlite")
    assert result.exit_code == 2
    assert "a file is expected; got the option --db" in result.stderr


@pytest.mark.parametrize("option", ["--ortho", "--dtm", "--parcels", "--aoi"])
def test_a_user_gives_a_file_of_another_kind(tmp_path, tile, option, monkeypatch):
    """A raster or vector file that is none is refused before the points are read."""
    monkeypatch.delattr("msbdb.run.preparation.drafts.read_points")
    wrong = tmp_path / "wrong.txt"
    wrong.write_text("no map")
    args = ["--points", tile, option, wrong, "--db", tmp_path / "town.sqlite"]
    refuses(tmp_path, ["update", *args, "--survey", "spring", "--date", "2021"], "wrong.txt", "cannot be read")


def test_a_user_gives_a_date_in_the_future(tmp_path, tile):
    """A survey of tomorrow may be of today in the east; a later one is mistyped, and so is no date at all."""
    args = ["build", "--points", tile, "--db", tmp_path / "town.sqlite", "--date"]
    refuses(tmp_path, [*args, "2999-05-31"], "2999-05-31, is in the future")
    refuses(tmp_path, ["update", *args[1:], "2999", "--survey", "spring"], "2999, is in the future")
    gpd.GeoDataFrame(geometry=[shapely.box(0, 0, 9, 9)], crs=EPSG).to_file(tmp_path / "ours.gpkg")
    words = ["import", tmp_path / "ours.gpkg", "--as", "inventory", "--db", tmp_path / "town.sqlite"]
    refuses(tmp_path, [*words, "--date", "2999"], "footprints of ours.gpkg, 2999, is in the future")
    with pytest.raises(InputError, match="written as 2021-05-31"):
        msbdb.build([tile], db=tmp_path / "town.sqlite", date="31.5.2021")
    now = datetime.datetime.now(datetime.UTC).date()
    assert Label("spring", str(now + datetime.timedelta(days=1))).date > str(now)
    assert Label("spring", str(now.year)).date == str(now.year)


def test_a_user_gives_a_dtm_from_elsewhere(tmp_path, podium, tile, heights):
    """With points and with a DSM: one that does not overlap is refused; one far above the surface is noticed."""
    dsm, _, values = heights
    far = write_raster(tmp_path / "far.tif", values, moved(podium.spec, 1e5, 0))
    for other in (["--points", tile], ["--dsm", dsm]):
        refuses(
            tmp_path,
            ["build", *other, "--dtm", far, "--db", tmp_path / "town.sqlite"],
            "of the same place",
            "the DTM far.tif",
        )
    high = write_raster(tmp_path / "high.tif", values + np.float32(50), podium.spec)
    with pytest.warns(MsbdbWarning, match="5 % are 50 m or more below the given DTM"):
        make_surface(Inputs(dsm=dsm, dtm=high), None, msbdb.Params())


def test_a_user_gives_points_too_far_apart(tmp_path, podium):
    """A density of 0 with cells of 5 m has no buildings, and a notice of it."""
    few = podium.points.take(np.arange(len(podium.points)) % 400 == 7)
    tile = write_points(tmp_path / "tile.laz", few, crs=few.crs)
    cloud = read_points([tile])
    with pytest.warns(MsbdbWarning, match="too far for buildings.* Check the CRS and the unit"):
        make_surface(Inputs((tile,)), cloud, msbdb.Params())


def test_a_user_gives_points_with_a_dtm(tmp_path, podium, tile, heights):
    """The given DTM is the ground, in any CRS: 2 m lower, all is 2 m higher; no ground is detected."""
    _, dtm, _ = heights
    row, col = np.indices(podium.spec.shape)
    ground = podium.ground(*podium.spec.xy(row, col)).astype(np.float32)
    low = write_raster(tmp_path / "low.tif", ground - 2, podium.spec)
    cloud, params = read_points([tile]), msbdb.Params()
    own, given, lower = (make_surface(Inputs((tile,), dtm=file), cloud, params) for file in (None, dtm, low))
    assert (own.ground_filter, given.ground_filter) == ("walls", "given")
    both = given.ndsm.valid & lower.ndsm.valid
    np.testing.assert_allclose(np.asarray(lower.ndsm.values)[both] - np.asarray(given.ndsm.values)[both], 2, atol=0.02)
    db = tmp_path / "town.sqlite"
    report = succeeds("build", "--points", tile, "--dtm", dtm, "--db", db, "--extract", "multiscale")
    assert report["buildings"] == 1
    run_ = json.loads(run("info", db, "--json").stdout)["runs"][0]
    assert run_["chosen"]["ground_filter"] == "given"
    assert [source["role"] for source in run_["survey_record"]["sources"]] == ["dtm", "points"]


@pytest.mark.filterwarnings("ignore::msbdb.errors.MsbdbWarning")  # the warped raster lacks the corners
def test_a_user_states_the_crs_of_points_beside_a_dtm_of_another(tmp_path, podium, heights):
    """--crs is of the points that state none; the raster has its own."""
    _, dtm, _ = heights
    bare = write_points(tmp_path / "bare.laz", podium.points, crs=None)
    there = CRS.from_epsg(25832)
    bounds = Transformer.from_crs(podium.spec.crs, there, always_xy=True).transform_bounds(*podium.spec.bounds)
    warped = align_grid(read_grid(dtm), lattice(bounds, podium.spec.cell_m, there))
    raster = write_raster(tmp_path / "other.tif", np.where(warped.valid, warped.values, -9999), warped.spec)
    inputs = Inputs((bare,), dtm=raster, crs=f"EPSG:{podium.points.crs.to_epsg()}")
    cloud = read_points([bare], crs=inputs.crs)
    other, same = (make_surface(one, cloud, msbdb.Params()) for one in (inputs, replace(inputs, dtm=dtm)))
    difference = np.asarray(other.dtm.values) - np.asarray(same.dtm.values)
    assert np.abs(difference[1:-1, 1:-1]).max() < 0.1


def test_a_user_writes_where_nothing_can_be_written(tmp_path):
    """Maps, exports, changes and dumps: no folder is made, nothing is replaced unasked, and never the database."""
    db = tmp_path / "town.sqlite"
    write_build(open_database(db, create=True, srid=EPSG), small_build())
    for name, words in {
        "town.png": ["view", db, "--out"],
        "town.gpkg": ["export", db],
        "changes.csv": ["changes", db, "--out"],
        "dump.txt": ["db", "dump", db, "--out"],
    }.items():
        refuses(tmp_path, [*words, tmp_path / "none" / name], "none does not exist")
        (tmp_path / name).write_text("mine")
        refuses(tmp_path, [*words, tmp_path / name], "exists already", "--overwrite")
        assert (tmp_path / name).read_text() == "mine"
        result = run(*words, tmp_path / name, "--overwrite")
        assert result.exit_code == 0, result.stderr
        assert (tmp_path / name).read_bytes() != b"mine"
    before = db.read_bytes()
    refuses(tmp_path, ["db", "dump", db, "--out", db, "--overwrite"], "is the source itself")
    assert db.read_bytes() == before

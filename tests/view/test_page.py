"""The page of a town: one file that holds all it needs, in which the words of a database stay data."""

import base64
import hashlib
import html.parser
import io
import json
import re

import geopandas as gpd
import numpy as np
import pytest
import rasterio
import shapely
from affine import Affine
from click.testing import CliRunner
from matplotlib.image import imread
from PIL import Image
from rasterio.enums import ColorInterp
from support.notices import with_notices
from support.towns import EPSG, ROW, footprints, town_build

from msbdb import api
from msbdb.cli.main import cli
from msbdb.database import open_database, write_build
from msbdb.errors import FileError, InputError, MissingDependencyError
from msbdb.run import townpage as made
from msbdb.run.contents import MAPS
from msbdb.view.blocks import blocks_of
from msbdb.view.page import DEGREE, Library, as_data, image_uri, page_of, read_library, shapes_of

HOSTILE = "</script><script>alert(1)</script><!-- \u2028 & ${x} @@title@@ 'north'"
LIBRARY = Library("var maplibregl = '</script>';", ".map {}", "BSD <3>")

BEFORE = [*ROW, (20, 60, 40, 80, 8)]
AFTER = [*ROW[1:7], (150, 10, 162, 22, 18), (20, 60, 40, 80, 8), (100, 60, 115, 75, 9)]


class Scripts(html.parser.HTMLParser):
    """Collects the elements of a page, and the text of its scripts."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict]] = []
        self.scripts: list[str] = []
        self.inside = False

    def handle_starttag(self, tag, attrs):
        """Remember an element."""
        self.tags.append((tag, dict(attrs)))
        self.inside = tag == "script"
        if self.inside:
            self.scripts.append("")

    def handle_endtag(self, tag):
        """Leave a script."""
        self.inside = False

    def handle_data(self, data):
        """Collect the text of a script."""
        if self.inside:
            self.scripts[-1] += data


def parsed(text):
    """Return a page's elements and scripts."""
    found = Scripts()
    found.feed(text)
    return found


@pytest.fixture(scope="module")
def town(tmp_path_factory):
    """Return a database with an inventory of two surveys, whose second one has a hostile name."""
    place = tmp_path_factory.mktemp("page") / "town.sqlite"
    engine = open_database(place, create=True, srid=EPSG)
    for name, date, houses in (("first", "2020-05-01", BEFORE), (HOSTILE, "2022-05-01", AFTER)):
        write_build(engine, town_build(name, date, houses))
        api.advance(engine.url, name)
    engine.dispose()
    return place


@pytest.fixture
def library(monkeypatch):
    """Let pages contain a short text in place of MapLibre GL JS, which need not be there."""
    monkeypatch.setattr(made, "read_library", lambda: LIBRARY)


def view(db, out, **options):
    """Write a page, and return its text and data."""
    with_notices(api.view, db, out, **options)
    text = out.read_text(encoding="utf-8")
    return text, json.loads(parsed(text).scripts[0])


def test_the_page_is_one_file_that_loads_nothing(town, tmp_path, library):
    """No element names another file, and the policy lets the browser run the two scripts of the page alone."""
    text, _ = view(town, tmp_path / "town.html")
    found = parsed(text)
    assert not [attrs for _, attrs in found.tags if {"src", "href"} & set(attrs)]
    assert not re.search(r"https?://", re.sub(r"<pre.*?</pre>", "", text, flags=re.DOTALL))
    policy = next(attrs["content"] for _, attrs in found.tags if attrs.get("http-equiv") == "Content-Security-Policy")
    assert policy.startswith("default-src 'none';")
    _, *scripts = found.scripts
    assert len(scripts) == 2
    for script in scripts:
        assert base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() in policy
    assert "BSD &lt;3&gt;" in text


def test_hostile_names_stay_data(town, tmp_path, library):
    """A survey whose name would end the script, or fill a field of the template, is a text of the data."""
    text, data = view(town, tmp_path / "town.html", survey=HOSTILE)
    assert data["title"] == HOSTILE
    assert [tag for tag, _ in parsed(text).tags].count("script") == 3
    assert "alert(1)</script>" not in text.replace(html.escape(HOSTILE), "")
    assert "\u2028" not in text.split("</title>")[1]
    assert json.loads(as_data(HOSTILE)) == HOSTILE
    assert not set("<>&\u2028\u2029") & set(as_data(HOSTILE))


def test_the_same_database_gives_the_same_bytes(town, tmp_path, library):
    """Nothing of the clock, the order of sets or the machine is in the page."""
    one, two = tmp_path / "one.html", tmp_path / "two.html"
    with_notices(api.view, town, one)
    with_notices(api.view, town, two)
    assert one.read_bytes() == two.read_bytes()


def test_a_page_is_written_as_other_files(town, tmp_path, library):
    """An existing file, the database, and a detector that the page does not show are refused; nothing changes."""
    out = tmp_path / "town.html"
    out.write_text("mine", encoding="utf-8")
    with pytest.raises(FileError, match="overwrite"):
        api.view(town, out)
    assert out.read_text(encoding="utf-8") == "mine"
    with pytest.raises(InputError, match="leave out --what area3d"):
        api.view(town, tmp_path / "other.html", what="area3d")
    with pytest.raises(InputError, match=r"\.html"):
        api.view(town, tmp_path / "town.txt")
    with_notices(api.view, town, out, overwrite=True)
    assert "<!DOCTYPE html>" in out.read_text(encoding="utf-8")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["town.html"]


def test_without_the_library_the_message_says_what_to_do(town, tmp_path, monkeypatch):
    """It names the script that fetches it; nothing is written."""
    with pytest.raises(MissingDependencyError, match="scripts/fetch_maplibre"):
        read_library(tmp_path)
    monkeypatch.setattr(made, "read_library", lambda: read_library(tmp_path))
    done = CliRunner().invoke(cli, ["view", str(town), "--out", str(tmp_path / "town.html")])
    assert done.exit_code == 1
    assert "scripts/fetch_maplibre" in done.stderr
    assert not list(tmp_path.iterdir())


def test_a_town_that_is_too_large_is_refused(town, tmp_path, library, monkeypatch):
    """The message has the number of rows and the limit."""
    monkeypatch.setattr(made, "MOST_PARTS", 10)
    with pytest.raises(InputError, match=r"slow with more than 10\. .*--survey"):
        with_notices(api.view, town, tmp_path / "town.html")


def test_a_large_town_has_its_outlines_in_tiles(town, tmp_path, library, monkeypatch):
    """Near, the archive has each building and block once, with the values and the place that a small page has."""
    _, small = view(town, tmp_path / "small.html")
    monkeypatch.setattr(made, "FEW_PARTS", 10)
    text, data = view(town, tmp_path / "town.html")
    scripts = parsed(text).scripts
    assert len(scripts) == 6
    policy = next(attrs["content"] for _, attrs in parsed(text).tags if attrs.get("http-equiv"))
    assert base64.b64encode(hashlib.sha256(scripts[3].encode()).digest()).decode() in policy
    found = tiles_in(scripts[2], tmp_path, 15)
    rows, blocks = len(small["buildings"]["id"]), small["blocks"]
    assert {*found["n"]} == set(range(rows + len(blocks["part"])))
    assert ("shape" in data["buildings"], "shape" in data["blocks"]) == (False, False)
    assert data["parts"] == small["parts"]
    assert data["changes"] == small["changes"]
    states = ["confirmed", "unsure", "refuted"]
    for own in found.to_dict("records"):
        row, block = own["row"], own["n"] - rows
        assert own["first"] == small["buildings"]["first"][row]
        assert own["after"] == small["buildings"]["after"][row]
        assert states[own["state"]] == small["buildings"]["values"]["state"][row]
        if block < 0:
            assert (own["n"], own["part"], own["low"]) == (row, -1, 0)
            assert own["height"] == small["buildings"]["height"][row] / 100
            west, south, east, north = (np.array(data["buildings"]["box"][row]) + np.tile(data["origin"], 2)) / DEGREE
            assert own["geometry"].within(shapely.box(west, south, east, north).buffer(1e-5))
        else:
            part = blocks["part"][block]
            assert (own["part"], own["row"]) == (part, small["parts"]["building"][part])
            assert (own["low"], own["high"]) == (blocks["low"][block], blocks["high"][block])
            assert own["height"] == blocks["height"][block] / 100
            assert [own[name] for name in ("scale", "kind", "storeys")] == [
                small["parts"][name][part] for name in ("scale", "kind", "storeys")
            ]


def test_from_afar_a_large_town_has_its_buildings_alone(town, tmp_path, library, monkeypatch):
    """Each is there for scale 0, and once more from the scale of its first block to the finest, with its own height."""
    _, small = view(town, tmp_path / "small.html")
    monkeypatch.setattr(made, "FEW_PARTS", 10)
    text, _ = view(town, tmp_path / "town.html")
    found = tiles_in(parsed(text).scripts[1], tmp_path, 14)
    rows, finest = len(small["buildings"]["id"]), len(small["scales"])
    single, others = found[found["n"] < rows], found[found["n"] >= rows].set_index("row")
    assert {*single["n"]} == {*others.index} == set(range(rows))
    assert len(found) == 2 * rows
    fathers, scales = small["parts"]["father"], small["parts"]["scale"]
    for own in single.to_dict("records"):
        second = others.loc[own["row"]]
        assert (own["part"], own["low"], own["high"], second["high"]) == (-1, 0, 0, finest)
        assert (fathers[second["part"]], scales[second["part"]]) == (-1, second["low"])
        assert small["blocks"]["part"][second["n"] - rows] == second["part"]
        assert second["height"] == own["height"] == small["buildings"]["height"][own["row"]] / 100
        assert second["geometry"].equals(own["geometry"])


def tiles_in(script, folder, zoom):
    """Return the features that an archive in a page has on one zoom, in degrees."""
    (folder / "town.pmtiles").write_bytes(base64.b64decode(script))
    return gpd.read_file(folder / "town.pmtiles", ZOOM_LEVEL=str(zoom)).to_crs(4326)


def test_the_page_has_what_the_database_has(town, tmp_path, library):
    """Buildings by date, their parts with fathers, shares of the detectors, ids as texts."""
    _, data = view(town, tmp_path / "town.html")
    assert [found["date"] for found in data["views"]] == ["2020-05-01", "2022-05-01"]
    buildings, parts = data["buildings"], data["parts"]
    now = [row for row, after in enumerate(buildings["after"]) if after == 2]
    assert len(now) == len(AFTER)
    assert all(isinstance(key, str) for key in (*buildings["id"], *parts["id"]))
    assert set(parts["building"]) == set(range(len(buildings["id"])))
    for father, building in zip(parts["father"], parts["building"], strict=True):
        assert father == -1 or parts["building"][father] == building
    assert buildings["values"]["area_m2"][0] == pytest.approx(1440, rel=0.1)
    assert {column for _, column in data["detectors"]} == set(buildings["shares"])
    assert data["ground"].startswith("data:image/png;base64,")


def test_the_changes_between_two_dates_are_those_of_the_inventory(town, tmp_path, library):
    """Each kind has as many rows as `msbdb changes` counts; a building that is gone has no row after."""
    _, data = view(town, tmp_path / "town.html")
    names = [name for name, _ in data["kinds"]]
    rows = data["changes"]["0-1"]
    counts = {name: sum(names[row[0]] == name for row in rows) for name in {names[row[0]] for row in rows}}
    expected = api.changes(town, since="2020-05-01", until="2022-05-01").counts
    assert counts == {kind: count for kind, count in expected.items() if kind != "unchanged"}
    assert counts
    for kind, before, after, *_ in rows:
        assert (before == -1, after == -1) == (names[kind] == "new", names[kind] == "demolished") or "unsure" in names
        for row, at in ((before, 0), (after, 1)):
            assert row == -1 or data["buildings"]["first"][row] <= at < data["buildings"]["after"][row]


def test_a_survey_alone_and_an_empty_database_are_shown(town, tmp_path, library):
    """One survey has no changes; without any survey the page is empty."""
    _, data = view(town, tmp_path / "one.html", survey="first")
    assert (data["inventory"], len(data["buildings"]["id"])) == (False, len(BEFORE))
    open_database(tmp_path / "empty.sqlite", create=True, srid=EPSG).dispose()
    _, data = view(tmp_path / "empty.sqlite", tmp_path / "empty.html")
    assert data["buildings"]["id"] == data["views"] == data["scales"] == []


def test_several_surveys_without_an_inventory_are_views(tmp_path, library):
    """Each survey can be shown alone; neighbours are shown together."""
    engine = open_database(tmp_path / "town.sqlite", create=True, srid=EPSG)
    for name, date in (("old", "2020-05-01"), ("new", "2022-05-01")):
        write_build(engine, town_build(name, date, BEFORE))
    engine.dispose()
    _, data = view(tmp_path / "town.sqlite", tmp_path / "town.html")
    assert [found["name"] for found in data["views"]] == ["new", "old"]
    assert set(zip(data["buildings"]["first"], data["buildings"]["after"], strict=True)) == {(0, 1), (1, 2)}


def test_an_imported_inventory_without_surveys_is_shown(tmp_path, library):
    """Its buildings have no parts; their attributes are lines of text."""
    cadastre = footprints(ROW).assign(owner=HOSTILE)
    cadastre.to_file(tmp_path / "cadastre.gpkg")
    api.import_inventory(tmp_path / "town.sqlite", tmp_path / "cadastre.gpkg", date="2015-01-01")
    _, data = view(tmp_path / "town.sqlite", tmp_path / "town.html")
    assert len(data["buildings"]["id"]) == len(ROW)
    assert data["parts"]["id"] == []
    assert all(f"owner: {HOSTILE}" in own for own in data["buildings"]["values"]["attributes"])


def test_blocks_of_a_scale_neither_overlap_nor_change_the_volume():
    """On each scale the blocks of a tree cover its root once, and A h adds up to the root's."""
    boxes = [shapely.box(0, 0, 12, 10), shapely.box(0, 0, 5, 10), shapely.box(6, 0, 12, 4), shapely.box(1, 1, 3, 3)]
    area = np.array([box.area for box in boxes])
    height = np.array([9.0, 12.0, 6.0, 15.0])
    found = blocks_of(
        np.array([1, 2, 4, 5]), np.array([-1, 0, 0, 1]), area, height, np.array(boxes, dtype=object), finest=6
    )
    for scale in range(1, 7):
        here = (found.low <= scale) & (found.high >= scale)
        shapes = found.geometry[here]
        assert shapely.union_all(shapes).area == pytest.approx(shapely.area(shapes).sum())
        assert shapely.area(shapes).sum() == pytest.approx(120.0)
        assert (shapely.area(shapes) * found.height_m[here]).sum() == pytest.approx(9.0 * 120.0)


def test_shapes_come_back_to_a_centimetre():
    """From the differences of whole steps one gets each vertex of shells and holes again."""
    hole = shapely.Polygon([(2, 2), (2, 3), (3, 3)])
    shape = shapely.MultiPolygon([shapely.box(0, 0, 9, 9) - hole, shapely.box(20, 0, 21.5, 1)])
    small = shapely.transform(shape, lambda xy: xy * 1e-5 + (4.3, 52.0))
    [polygons] = shapes_of(np.array([small]), (43_000_000, 520_000_000))
    assert [len(rings) for rings in polygons] == [2, 1]
    back = shapely.MultiPolygon(
        [
            shapely.Polygon(rings[0], rings[1:])
            for rings in (
                [np.cumsum(np.reshape(ring, (-1, 2)), axis=0) / DEGREE + (4.3, 52.0) for ring in own]
                for own in polygons
            )
        ]
    )
    assert shapely.hausdorff_distance(back, small) < 1e-7
    assert shapes_of(np.array([shapely.MultiPolygon()]), (0, 0)) == [[]]


def test_an_image_keeps_its_colours():
    """Each cell has the colour and opacity of its number."""
    palette = np.array([[255, 0, 0, 255], [0, 255, 0, 128], [9, 8, 7, 0]], dtype=np.uint8)
    cells = np.array([[0, 1], [2, 0]], dtype=np.uint8)
    packed = base64.b64decode(image_uri(cells, palette).split(",")[1])
    assert (np.round(255 * imread(io.BytesIO(packed))).astype(int) == palette[cells]).all()


def test_a_script_in_the_library_cannot_end_the_page():
    """A text of MapLibre that would end its element is written otherwise."""
    text = page_of({"title": "x"}, LIBRARY)
    assert len(parsed(text).scripts) == 3


def test_an_area_limits_pages_and_maps(town, tmp_path, library):
    """Of an area, the buildings that meet it with their parts and changes; the ground ends with its bounds."""
    engine = open_database(town)
    choice = made.Choice((HOSTILE, "first"), present=True)
    whole = made.town_of(town, engine, choice)
    west, south = 500_000, 4_000_000
    area = gpd.GeoSeries([shapely.box(west + 5, south + 5, west + 60, south + 30)], crs=EPSG).to_crs(4326)
    area.to_file(tmp_path / "area.gpkg")
    cut = made.town_of(town, engine, choice, tmp_path / "area.gpkg")
    engine.dispose()
    inside = {house for house in (*BEFORE, *AFTER) if house[0] < 60 and house[1] < 30}
    assert {*cut["buildings"]["id"]} < {*whole["buildings"]["id"]}
    assert len({*cut["buildings"]["id"]}) == len(inside)
    assert 0 < len(cut["parts"]["id"]) < len(whole["parts"]["id"])
    assert max(cut["parts"]["building"]) < len(cut["buildings"]["id"])
    assert {row for rows in cut["changes"].values() for _, *sides, _, _ in rows for row in sides} <= {
        -1, *range(len(cut["buildings"]["id"])),
    }  # fmt: skip
    assert 0 < sum(map(len, cut["changes"].values())) < sum(map(len, whole["changes"].values()))
    edges = cut["place"]["bounds_cm"]
    assert edges[2] - edges[0] < 6000 < whole["place"]["bounds_cm"][2] - whole["place"]["bounds_cm"][0]


@pytest.mark.parametrize("what", [*MAPS])
def test_every_map_is_drawn_of_a_database(what, town, tmp_path, library):
    """Each value of --what gives a picture, smaller for an area; the area must meet the surveys."""
    gpd.GeoSeries([shapely.box(500_005, 4_000_005, 500_060, 4_000_030)], crs=EPSG).to_file(tmp_path / "area.gpkg")
    gpd.GeoSeries([shapely.box(510_000, 4_000_005, 510_060, 4_000_030)], crs=EPSG).to_file(tmp_path / "away.gpkg")
    sizes = []
    for name, more in (("whole", {}), ("cut", {"aoi": tmp_path / "area.gpkg"})):
        with_notices(api.view, town, tmp_path / f"{name}.png", what=what, **more)
        sizes.append(imread(tmp_path / f"{name}.png").shape)
    if what != "change":  # whose map keeps the surveys' extent
        assert sizes[0] != sizes[1]
    with pytest.raises(InputError, match=r"beside the surveys|No building can be drawn"):
        with_notices(api.view, town, tmp_path / "away.png", what=what, aoi=tmp_path / "away.gpkg")


def test_an_unknown_map_is_refused(town, tmp_path):
    """The message names the maps, which the command line offers, too."""
    with pytest.raises(InputError, match="one of parts, footprints"):
        api.view(town, tmp_path / "town.png", what="trees")
    [option] = [own for own in cli.commands["view"].params if own.name == "what"]
    assert tuple(option.type.choices) == MAPS


def orthophoto(path, shift=0.0, scale=1.0):
    """Write an orthophoto of the western half of the town: red in the south, blue in the north, 0.5 m a pixel."""
    pixels = np.zeros((3, 240, 200), dtype=np.uint16)
    pixels[2, :120], pixels[0, 120:] = 200 * scale, 200 * scale
    transform = Affine(0.5, 0, 500_000 + shift, 0, -0.5, 4_000_120)
    with rasterio.open(
        path, "w", driver="GTiff", width=200, height=240, count=3, dtype="uint16", crs=EPSG, transform=transform
    ) as made_file:
        made_file.write(pixels)
        made_file.colorinterp = (ColorInterp.red, ColorInterp.green, ColorInterp.blue)
    return path


@pytest.mark.parametrize("scale", [1.0, 20.0])
def test_an_orthophoto_is_a_layer_of_the_ground(scale, town, tmp_path, library):
    """Its colours are at their places, it is clear where it has no pixel, and its corners are those of the heights."""
    photo = orthophoto(tmp_path / "rgb.tif", scale=scale)
    engine = open_database(town)
    shown = made.town_of(town, engine, made.Choice((HOSTILE, "first"), present=True), None, photo)
    engine.dispose()
    kind, _, data = shown["photo"]["image"].partition(";base64,")
    assert kind == "data:image/webp"
    picture = np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGBA")).astype(int)
    rows, cols, _ = picture.shape
    south, north, east = (
        picture[3 * rows // 4, cols // 4],
        picture[rows // 4, cols // 4],
        picture[rows // 2, -cols // 4],
    )
    assert south[0] > south[2] + 100
    assert north[2] > north[0] + 100
    assert (south[3], north[3], east[3]) == (255, 255, 0)
    for own, other in zip(shown["photo"]["corners"], shown["place"]["corners"], strict=True):
        assert np.abs(np.subtract(own, other)).max() < 100  # a metre
    with_notices(api.view, town, tmp_path / "town.html", ortho=photo)
    assert "data:image/webp" in (tmp_path / "town.html").read_text(encoding="utf-8")


def test_an_orthophoto_of_another_place_or_in_a_map_is_refused(town, tmp_path, library):
    """Both before anything is written."""
    with pytest.raises(InputError, match="same place"):
        with_notices(api.view, town, tmp_path / "town.html", ortho=orthophoto(tmp_path / "far.tif", shift=9000))
    with pytest.raises(InputError, match="Leave out --ortho"):
        api.view(town, tmp_path / "town.png", ortho=orthophoto(tmp_path / "rgb.tif"))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["far.tif", "rgb.tif"]

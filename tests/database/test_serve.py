"""The server: what clients read is what the database holds, nothing is written, and what they send stays data."""

import csv
import hashlib
import io
import json
import math
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from urllib.parse import quote

import numpy as np
import pyogrio
import pytest
import shapely
from axe_playwright_python.sync_playwright import Axe
from click.testing import CliRunner
from owslib.ogcapi.features import Features
from pyproj import CRS, Transformer
from sqlalchemy import text
from sqlalchemy.exc import DBAPIError
from support.browser import PATIENCE_MS, browser
from support.processes import environment
from support.qgis import opened_by_qgis, painted_by_qgis
from support.towns import EPSG, ROW, SOUTH, WEST, town_build

from msbdb import api
from msbdb.cli.main import cli
from msbdb.database import LAYERS, database_crs_of, open_database, open_to_read, read_state, write_build
from msbdb.errors import InputError, MissingDependencyError
from msbdb.io.vector import WORLD_M
from msbdb.run import townpage
from msbdb.serve import tileprovider
from msbdb.serve.httpserver import address_of, listening_socket, run_server, trusted_names
from msbdb.serve.webapp import CRS84, HEADERS, ServedTown, make_app
from msbdb.tables.view_columns import IDS
from msbdb.view.page import Library, read_library

HOSTILE = "</script><script>alert(1)</script>'; DROP TABLE survey; -- {{ 7 * 7 }} ../"

BEFORE = [*ROW, (20, 60, 40, 80, 8)]
AFTER = [*ROW[1:7], (150, 10, 162, 22, 18), (20, 60, 40, 80, 8), (100, 60, 115, 75, 9)]

ADDRESS = "http://127.0.0.1:8080"

STORED = f"http://www.opengis.net/def/crs/EPSG/0/{EPSG}"

ITEMS = "/collections/footprint_current/items"

QGIS_PAGE = 7
"""Features a page, as ``scripts/check_qgis`` asks for them."""


def filled(place):
    """Fill a new database with an inventory of two surveys, whose second one has a hostile name."""
    engine = open_database(place, create=True, srid=EPSG)
    for name, date, houses in (("first", "2020-05-01", BEFORE), (HOSTILE, "2022-05-01", AFTER)):
        write_build(engine, town_build(name, date, houses))
        api.advance(engine.url, name)
    engine.dispose()
    return place


@pytest.fixture(scope="module", params=["spatialite", pytest.param("postgis", marks=pytest.mark.postgis)])
def place(request, tmp_path_factory):
    """Return a database, on each dialect."""
    if request.param == "spatialite":
        yield filled(str(tmp_path_factory.mktemp("serve") / "a town.sqlite"))
        return
    databases = request.getfixturevalue("databases")
    url = databases.acquire()
    yield filled(url)
    databases.release([url])


@pytest.fixture(autouse=True)
def library(monkeypatch):
    """Let the page contain a short text in place of MapLibre GL JS, which need not be there."""
    monkeypatch.setattr(townpage, "read_library", lambda: Library("var maplibregl = {};", "", ""))


@pytest.fixture
def client(place):
    """Return a client of the app of a database, without a network."""
    engine = open_to_read(place)
    yield make_app(ServedTown(place, engine, ADDRESS), ["127.0.0.1", "localhost"]).test_client()
    engine.dispose()


def read(client, path, **query):
    """Return the document at a path."""
    answer = client.get(path, query_string=query, headers={"Host": "127.0.0.1"})
    assert answer.status_code == 200, answer.text
    return answer.get_json()


def refused(client, path, **query):
    """Return the words of a refusal."""
    answer = client.get(path, query_string=query, headers={"Host": "127.0.0.1"})
    assert answer.status_code == 400, answer.text
    return answer.get_json()["description"]


def rows_of(place, layer):
    """Return the rows of a view or table, and their geometries by key."""
    own = LAYERS[layer]
    engine = open_database(place)
    with engine.connect() as connection:
        names = ", ".join(column.name for column in own.columns if own.is_view or column.name != "survey")
        rows = connection.execute(text(f"SELECT {names}, ST_AsBinary(geometry) AS wkb FROM {layer}")).mappings().all()
    engine.dispose()
    return {str(row[own.key]): dict(row) for row in rows}


@contextmanager
def started(place) -> Iterator[str]:
    """Start the server as a program on a free port, and end it as Ctrl-C does; yield its address."""
    command = [sys.executable, "-m", "msbdb.cli.main", "serve", str(place), "--port", "0"]
    program = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment())
    try:
        lines = [program.stdout.readline(), program.stdout.readline()]
        yield re.search(r"http://127\.0\.0\.1:\d+", lines[1])[0]
    finally:
        with program.stdout:
            program.send_signal(2)
            assert program.wait(60) == 0


def test_gdal_and_owslib_read_what_the_database_holds(place):
    """Two clients of others find all collections, and the rows and outlines of the inventory, over several pages."""
    expected = rows_of(place, "footprint_current")
    with started(place) as address:
        service = Features(f"{address}/")
        assert {own["id"] for own in service.collections()["collections"]} == set(LAYERS)
        assert service.collection_items("footprint_current", limit=2)["numberMatched"] == len(expected)
        key = min(expected)
        assert service.collection_item("footprint_current", key)["properties"]["h_max"] == expected[key]["h_max"]
        assert service.collection_queryables("footprint_current")["properties"]["h_max"]["type"] == "number"
        found = pyogrio.read_dataframe(f"OAPIF:{address}/", layer="footprint_current", PAGE_SIZE="4")
        listed = pyogrio.list_layers(f"OAPIF:{address}/")
    assert {*listed[:, 0]} == set(LAYERS)
    assert {*found["uid"]} == set(expected)
    assert found.crs == EPSG
    for uid, shape, h_max in zip(found["uid"], found.geometry, found["h_max"], strict=True):
        own = shapely.from_wkb(bytes(expected[uid]["wkb"]))
        assert shape.symmetric_difference(own).area < 0.01
        assert h_max == expected[uid]["h_max"]


def test_qgis_reads_every_collection(place):
    """Page by page, all rows and those of a window, ids as text and measures as numbers; nothing is complained of."""
    with started(place) as address:
        [found] = opened_by_qgis(f"{address}/")
    counts = {name: len(rows_of(place, name)) for name in LAYERS}
    assert {name: row["features"] for name, row in found.items()} == counts
    assert counts["part"] > QGIS_PAGE
    current = found["footprint_current"]
    assert current["crs"] == "EPSG:4326"
    fields = ("uid", "storeys", "h_max", "valid_from", "state")
    assert [current["fields"][name] for name in fields] == ["String", "Integer", "Real", "Date", "String"]


def test_qgis_draws_the_tiles(place):
    """A map by QGIS's vector tile layer has colour where the buildings are, and nowhere else."""
    to_map = Transformer.from_crs(EPSG, 3857, always_xy=True).transform
    shapes = [shapely.from_wkb(bytes(row["wkb"])) for row in rows_of(place, "footprint_current").values()]
    town = shapely.transform(shapely.union_all(shapes), to_map, interleaved=False)
    west, south, _, north = town.bounds
    with started(place) as address:
        tiles = f"{address}/collections/footprint_current/tiles/WebMercatorQuad/{{z}}/{{y}}/{{x}}"
        first, last, share = painted_by_qgis(tiles, (west, south, west + (north - south), north))
        assert painted_by_qgis(tiles, (west, north + 50, west + 200, north + 250)) == (12, 22, 0)
    window = shapely.box(west, south, west + (north - south), north)
    assert (first, last) == (12, 22)
    assert share == pytest.approx(town.intersection(window).area / window.area, abs=0.02)


def test_each_collection_has_the_rows_of_its_layer(client, place):
    """Of every layer all rows come, with the columns of the declaration, ids as text, on pages without a gap."""
    for name, layer in LAYERS.items():
        expected = rows_of(place, name)
        seen = []
        for offset in range(0, max(len(expected), 1), 4):
            page = read(client, f"/collections/{name}/items", limit=4, offset=offset)
            assert page["numberMatched"] == len(expected)
            assert page["numberReturned"] == len(page["features"])
            seen += page["features"]
        assert [own["id"] for own in seen] == sorted(expected, key=int)
        for own in seen:
            assert list(own["properties"]) == [column.name for column in layer.columns]
            assert own["properties"][layer.key] == own["id"]
    assert len(rows_of(place, "building_history")) > len(rows_of(place, "footprint_current")) > 0


def test_an_item_is_the_row_of_its_key(client, place):
    """One feature by its key; another key is not found."""
    key, row = next(iter(rows_of(place, "building_summary").items()))
    found = read(client, f"/collections/building_summary/items/{key}")
    assert found["id"] == key
    assert found["properties"]["survey"] == row["survey"]
    for wrong in ("1", "-1", "9" * 40, "1' OR '1'='1", "²", "a"):
        answer = client.get(f"/collections/building_summary/items/{quote(wrong)}", headers={"Host": "127.0.0.1"})
        assert answer.status_code == 404


def shape_of(feature):
    """Return the outline of a feature."""
    return shapely.geometry.shape(feature["geometry"])


def test_coordinates_are_in_the_order_of_the_axes(client, place):
    """The database's CRS gives its coordinates; EPSG:4326 has latitude first, CRS84 longitude."""
    key, row = next(iter(rows_of(place, "footprint_current").items()))
    own = shapely.from_wkb(bytes(row["wkb"]))
    stored = shape_of(read(client, f"{ITEMS}/{key}", crs=STORED))
    assert stored.equals(shapely.set_precision(own, 0.001, mode="pointwise"))
    lon, lat = shape_of(read(client, f"{ITEMS}/{key}")).centroid.coords[0]
    turned = shape_of(read(client, f"{ITEMS}/{key}", crs="http://www.opengis.net/def/crs/EPSG/0/4326"))
    assert turned.centroid.coords[0] == pytest.approx((lat, lon))
    assert Transformer.from_crs(4326, EPSG, always_xy=True).transform(lon, lat) == pytest.approx(
        own.centroid.coords[0], abs=0.01
    )
    collection = read(client, "/collections/footprint_current")
    assert collection["storageCrs"] == STORED
    assert collection["crs"][0] == CRS84


@pytest.mark.parametrize("uri", [CRS84, STORED, "http://www.opengis.net/def/crs/EPSG/0/4326"])
def test_a_window_finds_what_meets_it(client, place, uri):
    """Of windows in three CRSs, the buildings whose outline meets the window's own box, and no others."""
    code = EPSG if uri == STORED else 4326
    to_window = Transformer.from_crs(EPSG, code, always_xy=True)
    shapes = {key: shapely.from_wkb(bytes(row["wkb"])) for key, row in rows_of(place, "footprint_current").items()}
    moved = {key: shapely.transform(own, to_window.transform, interleaved=False) for key, own in shapes.items()}
    rng = np.random.default_rng(7)
    hits = 0
    for _ in range(12):
        x, y = WEST + rng.uniform(0, 180), SOUTH + rng.uniform(0, 100)
        corners = to_window.transform([x, x + rng.uniform(5, 60)], [y, y + rng.uniform(5, 60)])
        box = shapely.box(corners[0][0], corners[1][0], corners[0][1], corners[1][1])
        expected = {key for key, own in moved.items() if own.intersects(box)}
        edges = box.bounds
        words = [edges[1], edges[0], edges[3], edges[2]] if uri.endswith("4326") else edges
        page = read(client, ITEMS, bbox=",".join(map(str, words)), **{"bbox-crs": uri})
        assert {own["id"] for own in page["features"]} == expected
        hits += len(expected)
    assert hits > 0


def test_a_window_of_the_world_and_one_elsewhere(client, place):
    """The whole world has all buildings, another country none."""
    assert read(client, ITEMS, bbox="-180,-90,180,90")["numberMatched"] == len(rows_of(place, "footprint_current"))
    assert read(client, ITEMS, bbox="100,10,101,11")["numberMatched"] == 0


def test_a_time_finds_what_is_valid_then(client, place):
    """An instant, an interval and open ends, against the dates of the versions."""
    history = rows_of(place, "building_history").values()
    for words, first, last in (
        ("2021-01-01T12:00:00Z", "2021-01-01", "2021-01-01"),
        ("2022-05-01/..", "2022-05-01", "9"),
        ("../2020-04-30", "0", "2020-04-30"),
        ("2019-01-01/2030-01-01", "2019-01-01", "2030-01-01"),
    ):
        expected = [
            row for row in history if row["valid_from"] <= last and (row["valid_to"] is None or row["valid_to"] > first)
        ]
        assert read(client, "/collections/building_history/items", datetime=words)["numberMatched"] == len(expected)
    assert read(client, "/collections/building_summary/items", datetime="2020-05-01")["numberMatched"] == len(BEFORE)
    extent = read(client, "/collections/building_history")["extent"]
    assert extent["temporal"]["interval"][0][0].startswith("2020-05-01")


def test_properties_filters_and_order(client, place):
    """Values, filters in CQL and several columns to order by agree with the same choice of the rows."""
    rows = rows_of(place, "footprint_current")
    state = read(client, ITEMS, state="confirmed", storeys="3")
    assert {own["id"] for own in state["features"]} == {
        key for key, row in rows.items() if row["state"] == "confirmed" and row["storeys"] == 3
    }
    page = read(client, ITEMS, filter="h_max > 9 AND survey LIKE '%DROP TABLE%'", sortby="-h_max,uid")
    expected = [key for key, row in rows.items() if row["h_max"] > 9 and row["survey"] == HOSTILE]
    assert [own["id"] for own in page["features"]] == sorted(expected, key=lambda key: (-rows[key]["h_max"], int(key)))
    key = min(rows)
    for words in (f"uid = '{key}'", f"uid = {key}"):
        assert [own["id"] for own in read(client, ITEMS, filter=words)["features"]] == [key]
    assert read(client, ITEMS, uid=key, properties="h_max", skipGeometry="true")["features"] == [
        {"type": "Feature", "id": key, "geometry": None, "properties": {"uid": key, "h_max": rows[key]["h_max"]}}
    ]
    assert read(client, ITEMS, survey=HOSTILE)["numberMatched"] > 0
    assert read(client, ITEMS, resulttype="hits") | {"links": [], "timeStamp": ""} == {
        "type": "FeatureCollection", "features": [], "numberMatched": len(rows), "numberReturned": 0, "links": [],
        "timeStamp": "",
    }  # fmt: skip


def test_schema_and_queryables_have_the_descriptions_of_the_columns(client):
    """Titles, meanings and units come from the one declaration."""
    for name, layer in LAYERS.items():
        for what in ("schema", "queryables"):
            properties = read(client, f"/collections/{name}/{what}")["properties"]
            assert list(properties) == ["geometry", *(column.name for column in layer.columns)]
            for column in layer.columns:
                assert properties[column.name]["description"] == column.doc
    height = read(client, "/collections/part/schema")["properties"]["h_max"]
    assert height["x-ogc-unit"] == "m"
    assert height["title"] != "h_max"


def test_links_lead_to_what_is_served(client):
    """Every link of every kind of document is answered, as JSON and as a page."""
    seen, waiting = set(), ["/", "/collections", f"{ITEMS}?limit=2&offset=2", "/conformance", "/openapi"]
    while waiting:
        path = waiting.pop()
        if path in seen or (path.count("offset=") and "limit=2" not in path):
            continue
        seen.add(path)
        answer = client.get(path, headers={"Host": "127.0.0.1"})
        assert answer.status_code == 200, path
        if answer.is_json or answer.mimetype.endswith("json"):
            document = json.loads(answer.text)
            links = [link for own in (document, *document.get("collections", ())) for link in own.get("links", ())]
            hrefs = [link["href"].removeprefix(ADDRESS) for link in links if not link.get("templated")]
            waiting += [href if href.startswith("/") else f"/{href}" for href in hrefs]
    assert {"/page", f"{ITEMS}?f=html"} <= seen
    assert len(seen) > 50


def test_conformance_claims_nothing_that_writes(client):
    """The classes name features and CRSs, and none for writers."""
    classes = read(client, "/conformance")["conformsTo"]
    assert any(name.endswith("ogcapi-features-1/1.0/conf/core") for name in classes)
    assert any(name.endswith("ogcapi-features-2/1.0/conf/crs") for name in classes)
    assert not any("create" in name for name in classes)


@pytest.mark.parametrize(
    ("query", "words"),
    [
        ({"bbox": "1,2,3"}, "four numbers"),
        ({"bbox": "1,2,3,x"}, "four numbers"),
        ({"bbox": "nan,0,1,1"}, "four numbers"),
        ({"bbox": "inf,0,inf,1"}, "four numbers"),
        ({"bbox": "5,5,1,1"}, "lower one"),
        ({"bbox": "0,0,1,1", "bbox-crs": "EPSG:'; DROP TABLE survey"}, "bbox-crs must be one of"),
        ({"crs": "http://www.opengis.net/def/crs/EPSG/0/1"}, "not supported"),
        ({"datetime": "yesterday"}, "is no time"),
        ({"datetime": "2020-13-01"}, "is no time"),
        ({"datetime": "2022-01-01/2020-01-01"}, "is no time"),
        ({"datetime": "'; DROP TABLE survey; --"}, "is no time"),
        ({"limit": "0"}, "strictly positive"),
        ({"limit": "many"}, "integer"),
        ({"offset": "-1"}, "positive"),
        ({"storeys": "1; DROP TABLE survey"}, "has values of the type"),
        ({"storeys": "9" * 30}, "has values of the type"),
        ({"h_max": "nan"}, "has values of the type"),
        ({"attributes": "1"}, "no column 'attributes'"),
        ({"sortby": "h_max; DROP TABLE survey"}, "bad sort property"),
        ({"sortby": ""}, "empty name"),
        ({"properties": "nothing"}, "unknown properties"),
        ({"filter": "h_max >"}, "Bad CQL"),
        ({"filter": "nothing = 1"}, "not supported"),
        ({"filter": "load_extension(state) = 1"}, "not supported"),
        ({"filter": "BBOX(geometry, 0, 0, 1, 1)"}, "not supported"),
        ({"filter": "storeys = 99999999999999999999999"}, "does not fit"),
        ({"filter": "uid = 'a'"}, "does not fit"),
        ({"f": "../../etc/passwd"}, "is not offered"),
        ({"f": "jsonld"}, "is not offered"),
        ({"f": "csv", "skipGeometry": "true"}, "Leave out skipGeometry"),
        ({"filter": "NOT " * 2000 + "h_max > 1"}, "Bad CQL"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused_in_plain_words(client, query, words):
    """Wrong bounds, times, numbers, columns and filters end with 400 and a sentence."""
    assert words in refused(client, ITEMS, **query)


def tile_at(lon, lat, zoom):
    """Return row and column of the tile of WebMercatorQuad at a place, by the formulas of its standard."""
    turned = math.asinh(math.tan(math.radians(lat)))
    return math.floor((1 - turned / math.pi) / 2 * 2**zoom), math.floor((lon + 180) / 360 * 2**zoom)


TOWN = 3.0009, 36.1448
"""Longitude and latitude of the middle of the town."""

SHARP = 17
"""A zoom on which one tile has the whole town, in steps of 7 cm."""


def read_tile(client, layer, zoom, row, column, **query):
    """Return the features of a tile as GDAL reads them, in EPSG:3857; None for an empty one."""
    path = f"/collections/{layer}/tiles/WebMercatorQuad/{zoom}/{row}/{column}"
    answer = client.get(path, query_string=query, headers={"Host": "127.0.0.1"})
    if answer.status_code == 204:
        assert answer.data == b""
        return None
    assert (answer.status_code, answer.mimetype) == (200, "application/vnd.mapbox-vector-tile"), answer.text
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "tile.pbf"
        file.write_bytes(answer.data)
        return pyogrio.read_dataframe(file, X=str(column), Y=str(row), Z=str(zoom))


def in_mercator(row):
    """Return the outline of a row in EPSG:3857."""
    to_mercator = Transformer.from_crs(EPSG, 3857, always_xy=True)
    return shapely.transform(shapely.from_wkb(bytes(row["wkb"])), to_mercator.transform, interleaved=False)


def test_tiles_have_the_rows_of_their_layer(client, place):
    """GDAL reads the tiles of every layer: all rows, each value as the database has it, and the places to a step."""
    row, column = tile_at(*TOWN, SHARP)
    step = 2 * WORLD_M / 2**SHARP / 4096
    seen = 0
    for name, layer in LAYERS.items():
        expected = rows_of(place, name)
        tiles = [read_tile(client, name, SHARP, row, column + east) for east in (-1, 0, 1)]
        known = {}
        for found in tiles:
            if found is None:
                continue
            for own in found.astype(object).where(found.notna(), None).to_dict("records"):
                known.setdefault(own[layer.key], []).append(own)
        assert sorted(known) == sorted(expected)
        for key, pieces in known.items():
            for own in pieces:
                for named in layer.columns:
                    if named.dtype != "json" and named.name in expected[key]:
                        value = expected[key][named.name]
                        is_id = named.name in IDS and value is not None
                        assert own.get(named.name) == (str(value) if is_id else value), named.name
            whole = shapely.union_all([own["geometry"] for own in pieces])
            shape = in_mercator(expected[key])
            assert whole.symmetric_difference(shape).area < 2 * step * shape.length
            seen += 1
    assert seen > 4 * len(AFTER)


def test_a_tile_far_away_is_empty_and_a_day_chooses(client, place):
    """No content beside the town; of the history the versions of a day; the largest come first where there are many."""
    row, column = tile_at(*TOWN, 14)
    assert read_tile(client, "part", 14, row + 1, column) is None
    assert read_tile(client, "part", 14, 0, 2**14 - 1) is None
    found = read_tile(client, "building_history", 14, row, column, datetime="2021-01-01")
    history = rows_of(place, "building_history").values()
    assert {*found["version_id"]} == {str(own["version_id"]) for own in history if own["valid_from"] == "2020-05-01"}


def test_a_tile_keeps_the_largest(client, place, monkeypatch):
    """Where a tile would have too many features, those of the largest area stay."""
    monkeypatch.setattr(tileprovider, "MOST_FEATURES", 3)
    found = read_tile(client, "part", 14, *tile_at(*TOWN, 14))
    areas = sorted((own["area_m2"] for own in rows_of(place, "part").values()), reverse=True)
    assert sorted(found["area_m2"], reverse=True) == areas[:3]


@pytest.mark.parametrize(
    ("path", "status", "words"),
    [
        ("part/tiles/WebMercatorQuad/14/a/1", 400, "three whole numbers"),
        ("part/tiles/WebMercatorQuad/14/-1/1", 400, "three whole numbers"),
        ("part/tiles/WebMercatorQuad/14/1.5/1", 400, "three whole numbers"),
        ("part/tiles/WebMercatorQuad/²/1/1", 400, "three whole numbers"),
        (f"part/tiles/WebMercatorQuad/14/{'9' * 400}/1", 400, "three whole numbers"),
        ("part/tiles/WebMercatorQuad/14/1;DROP TABLE part/1", 400, "three whole numbers"),
        ("part/tiles/WebMercatorQuad/14/16384/1", 404, "none beside the world"),
        ("part/tiles/WebMercatorQuad/11/1/1", 404, "zooms 12 to 22"),
        ("part/tiles/WebMercatorQuad/23/1/1", 404, "zooms 12 to 22"),
        ("part/tiles/WorldCRS84Quad/14/1/1", 404, "WebMercatorQuad alone"),
        ("part/tiles/..%2f..%2fetc", 404, ""),
        ("survey/tiles/WebMercatorQuad/14/1/1", 404, "Collection not found"),
        ("part/tiles/WebMercatorQuad/14/1/1?f=json", 400, "ask for f=mvt"),
        ("part/tiles/WebMercatorQuad/14/TOWN?datetime=2020-01-01", 400, "have no day"),
        ("building_history/tiles/WebMercatorQuad/14/TOWN?datetime=';DROP TABLE part", 400, "is no time"),
    ],
)
def test_hostile_addresses_of_tiles_are_refused(client, path, status, words):
    """Words in place of numbers, numbers beside the world and unknown schemes end with 400 or 404, and a sentence."""
    row, column = tile_at(*TOWN, 14)
    answer = client.get(f"/collections/{path.replace('TOWN', f'{row}/{column}')}", headers={"Host": "127.0.0.1"})
    assert answer.status_code == status
    assert words in answer.get_json()["description"]


def test_sets_of_tiles_are_described(client):
    """From the collection a client finds scheme, limits, properties and address of the tiles, all of one scheme."""
    links = read(client, "/collections/part")["links"]
    [path] = {own["href"] for own in links if own["rel"].endswith("tilesets-vector") and own["type"].endswith("json")}
    [listed] = read(client, path.removeprefix(ADDRESS).removesuffix("?f=json"))["tilesets"]
    own = next(link["href"] for link in listed["links"] if link["rel"] == "self")
    found = read(client, own.removeprefix(ADDRESS).removesuffix("?f=json"))
    scheme = next(link["href"] for link in found["links"] if link["rel"].endswith("tiling-scheme"))
    matrices = {
        own["id"]: own for own in read(client, scheme.removeprefix(ADDRESS).removesuffix("?f=json"))["tileMatrices"]
    }
    assert [own["id"] for own in read(client, "/TileMatrixSets")["tileMatrixSets"]] == ["WebMercatorQuad"]
    template = next(link["href"] for link in found["links"] if link["rel"] == "item")
    for limits in found["tileMatrixSetLimits"]:
        zoom = limits["tileMatrix"]
        assert matrices[zoom]["matrixWidth"] == 2 ** int(zoom)
        row, column = tile_at(*TOWN, int(zoom))
        assert limits["minTileRow"] <= row <= limits["maxTileRow"]
        assert limits["minTileCol"] <= column <= limits["maxTileCol"]
    words = {"{tileMatrix}": zoom, "{tileRow}": str(row), "{tileCol}": str(column)}
    for field, value in words.items():
        template = template.replace(field, value)
    assert client.get(template.removeprefix(ADDRESS), headers={"Host": "127.0.0.1"}).status_code in (200, 204)
    [layer] = found["layers"]
    assert layer["propertiesSchema"]["properties"]["h_max"]["x-ogc-unit"] == "m"
    assert client.get("/TileMatrixSets/x", headers={"Host": "127.0.0.1"}).status_code == 404
    classes = read(client, "/conformance")["conformsTo"]
    assert any(name.endswith("ogcapi-tiles-1/1.0/conf/mvt") for name in classes)


def test_csv_has_the_rows(client, place):
    """A table of the same features, with their outlines."""
    expected = rows_of(place, "footprint_current")
    answer = client.get(ITEMS, query_string={"f": "csv"}, headers={"Host": "127.0.0.1"})
    assert answer.mimetype == "text/csv"
    rows = list(csv.DictReader(io.StringIO(answer.text)))
    assert {row["uid"] for row in rows} == set(expected)
    assert all(float(row["h_max"]) == expected[row["uid"]]["h_max"] for row in rows)
    assert HOSTILE in {row["survey"] for row in rows}


def test_hostile_values_stay_data(client, place):
    """Text that looks like SQL finds nothing, large numbers are cut, and all tables are still there."""
    before = {name: len(rows_of(place, name)) for name in LAYERS}
    assert read(client, ITEMS, state="' OR '1'='1")["numberMatched"] == 0
    assert read(client, ITEMS, filter="state = '; DROP TABLE survey; --'")["numberMatched"] == 0
    assert read(client, ITEMS, limit="9" * 30)["numberReturned"] == before["footprint_current"]
    assert read(client, ITEMS, offset="9" * 30)["numberReturned"] == 0
    for path in ("/collections/survey/items", "/collections/..%2f..%2fetc/items", "/static/../../etc/passwd", "/admin"):
        assert client.get(path, headers={"Host": "127.0.0.1"}).status_code == 404
    for method in ("post", "put", "patch", "delete"):
        assert getattr(client, method)(ITEMS, headers={"Host": "127.0.0.1"}).status_code == 405
    assert before == {name: len(rows_of(place, name)) for name in LAYERS}


def test_pages_show_names_as_text(client):
    """A survey whose name is a script is text in every page, which also forbids scripts and loads nothing."""
    for path in ("/", "/collections", "/collections/part/schema", ITEMS, "/openapi", "/conformance"):
        answer = client.get(path, headers={"Host": "127.0.0.1", "Accept": "text/html"})
        assert answer.mimetype == "text/html"
        assert "<script" not in answer.text
        assert "49" not in re.findall(r"-- (\S+)", answer.text)
        assert not re.findall(r"(?:src|href)=\"(?!http://127\.0\.0\.1:8080|data:,)", answer.text)
        assert answer.headers["Content-Security-Policy"] == HEADERS["Content-Security-Policy"]
    assert "&lt;/script&gt;" in client.get(ITEMS, headers={"Host": "127.0.0.1", "Accept": "text/html"}).text


def test_a_foreign_name_is_refused(client):
    """A page of another site cannot reach the loopback by a name of its own."""
    assert client.get("/", headers={"Host": "town.evil.example"}).status_code == 400
    assert client.get("/", headers={"Host": "localhost:8080"}).status_code == 200


def test_nothing_can_be_written(place, request):
    """The engine of the server refuses to write, on both dialects."""
    engine = open_to_read(place)
    for statement in ("DELETE FROM rejection", "CREATE TABLE mine (a INTEGER)", "UPDATE survey SET name = 'x'"):
        with engine.connect() as connection, pytest.raises(DBAPIError, match=r"readonly|read-only"):
            connection.execute(text(statement))
    engine.dispose()


def test_a_file_is_unchanged_by_all_that_is_read(tmp_path):
    """The bytes of the file before and after requests of every kind, the page in 3-D among them."""
    place = filled(tmp_path / "town.sqlite")
    before = hashlib.sha256(place.read_bytes()).digest()
    engine = open_to_read(place)
    client = make_app(ServedTown(str(place), engine, ADDRESS), None).test_client()
    for path in ("/", "/collections", ITEMS, f"{ITEMS}?bbox=3,36,4,37", "/openapi", "/page"):
        assert client.get(path).status_code == 200
    engine.dispose()
    assert hashlib.sha256(place.read_bytes()).digest() == before
    assert [path.name for path in tmp_path.iterdir()] == ["town.sqlite"]


def test_a_change_of_the_database_is_served_at_once(tmp_path):
    """A second survey is in the collections and in the page without a restart; the page is made once a state."""
    place = tmp_path / "town.sqlite"
    write_build(open_database(place, create=True, srid=EPSG), town_build("first", "2020-05-01", BEFORE))
    engine = open_to_read(place)
    town = ServedTown(str(place), engine, ADDRESS)
    client = make_app(town, None).test_client()
    page, state = town.page(), read_state(engine)
    assert town.page() is page
    assert client.get(ITEMS).get_json()["numberMatched"] == 0
    api.advance(place, "first")
    assert client.get(ITEMS).get_json()["numberMatched"] == len(BEFORE)
    assert read_state(engine) != state
    assert town.page() is not page
    engine.dispose()


def test_an_empty_database_is_served(tmp_path):
    """All collections are there and empty, and a window finds nothing."""
    place = tmp_path / "town.sqlite"
    open_database(place, create=True, srid=EPSG).dispose()
    engine = open_to_read(place)
    client = make_app(ServedTown(str(place), engine, ADDRESS), None).test_client()
    assert client.get(ITEMS, query_string={"bbox": "0,0,1,1"}).get_json()["numberMatched"] == 0
    assert len(client.get("/collections").get_json()["collections"]) == len(LAYERS)
    engine.dispose()


def test_a_database_without_a_code_is_served_in_degrees(tmp_path):
    """A CRS that has no EPSG code is not offered; longitude and latitude are right, also for windows."""
    own = CRS.from_proj4("+proj=tmerc +lat_0=36.1 +lon_0=3 +x_0=500000 +y_0=4000000 +ellps=WGS84 +units=m")
    place = tmp_path / "town.sqlite"
    made = town_build("first", "2020-05-01", BEFORE)
    words = own.to_wkt()
    survey = replace(made.survey, epsg=0, crs_wkt=words)
    frames = {
        name: frame.set_crs(own, allow_override=True) if "geometry" in frame else frame
        for name, frame in made.frames.items()
    }
    made = replace(made, survey=survey, frames=frames)
    write_build(open_database(place, create=True, srid=0, crs_wkt=words), made)
    engine = open_to_read(place)
    assert database_crs_of(engine).to_authority() is None
    client = make_app(ServedTown(str(place), engine, ADDRESS), None).test_client()
    page = client.get("/collections/building_summary/items", query_string={"bbox": "2.9,36,3.1,36.2"}).get_json()
    assert page["numberMatched"] == len(BEFORE)
    lon, lat = shape_of(page["features"][0]).centroid.coords[0]
    assert (lon, lat) == pytest.approx((3.001, 36.101), abs=0.002)
    engine.dispose()


def test_the_address_is_the_loopback_unless_it_is_given():
    """The default address is 127.0.0.1 with its own names; a taken port and a foreign address are refused."""
    with listening_socket("127.0.0.1", 0) as place:
        port = place.getsockname()[1]
        assert address_of(place) == f"http://127.0.0.1:{port}"
        assert "localhost" in trusted_names(place, address_of(place))
        with pytest.raises(InputError, match=f"port {port}"):
            listening_socket("127.0.0.1", port)
    with pytest.raises(InputError, match="Choose another --host"):
        listening_socket("203.0.113.7", 0)
    with listening_socket("0.0.0.0", 0) as place:
        assert "0.0.0.0" not in address_of(place)
        assert trusted_names(place, "http://town.example.org") is None


def test_an_interrupt_ends_the_server_as_soon_as_its_address_is_known(place):
    """Before the first request is waited for, too; the port is free again."""
    told = []

    def interrupted(address):
        told.append(address)
        raise KeyboardInterrupt

    run_server(str(place), host="127.0.0.1", port=0, url=None, started=interrupted)
    listening_socket("127.0.0.1", int(told[0].rpartition(":")[2])).close()


def test_a_missing_library_names_the_extra(tmp_path, monkeypatch):
    """Without pygeoapi the command says what to install, and ends with 1."""
    monkeypatch.setitem(sys.modules, "msbdb.serve.httpserver", None)
    for name in [name for name in sys.modules if name.startswith("msbdb.serve")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "waitress", None)
    done = CliRunner().invoke(cli, ["serve", str(tmp_path / "town.sqlite")])
    assert done.exit_code == 1
    assert 'pip install "msbdb[serve]"' in done.output


def test_a_missing_database_is_an_error(tmp_path):
    """The command does not start without a database."""
    done = CliRunner().invoke(cli, ["serve", str(tmp_path / "none.sqlite")])
    assert done.exit_code == 1
    assert "no msbdb database" in done.output


@pytest.mark.long
def test_a_browser_shows_the_pages(tmp_path):
    """Chromium opens every kind of page and the town in 3-D: no message, no request elsewhere, nothing for axe."""
    try:
        read_library()
    except MissingDependencyError as error:
        pytest.skip(str(error))
    filled(tmp_path / "town.sqlite")
    with started(tmp_path / "town.sqlite") as address, browser() as chromium:
        sheet = chromium.new_page(bypass_csp=True)  # axe is a script; the policy is on the page of the town
        complaints = []
        sheet.on("console", lambda message: complaints.append(message.text))
        own = (address, "data:", "blob:")
        sheet.on("request", lambda asked: asked.url.startswith(own) or complaints.append(asked.url))
        for path in ("/", "/collections", "/collections/part/schema", f"{ITEMS}?limit=5", "/conformance", "/openapi"):
            sheet.goto(address + path)
            assert Axe().run(sheet).violations_count == 0, path
        sheet.goto(f"{address}{ITEMS}?limit=5")
        sheet.click("text=Items (next)")
        assert sheet.locator("table tr").count() == 1 + len(rows_of(tmp_path / "town.sqlite", "footprint_current")) - 5
        sheet.close()
        sheet = chromium.new_page()
        sheet.on("console", lambda message: complaints.append(message.text))
        sheet.goto(address)
        sheet.click("text=The town in 3-D")
        sheet.wait_for_selector("html[data-ready]", timeout=PATIENCE_MS)
        sheet.close()
    assert complaints == []

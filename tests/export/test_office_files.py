"""What an office takes away: each file is written by the command, and opened by another program."""

import csv
import json
import re
import shutil
import sqlite3
import subprocess
import zipfile
from contextlib import closing
from pathlib import Path
from xml.etree import ElementTree

import geopandas as gpd
import geopandas.testing
import numpy as np
import pyarrow.parquet as pq
import pytest
import shapely
from support.offices import run
from support.towns import EPSG, UTM, footprints

from msbdb import api
from msbdb.database.history import shownlayers
from msbdb.errors import InputError
from msbdb.export.fields import FIELDS, short_name
from msbdb.export.qgis.symbology import STYLES
from msbdb.io import layers
from msbdb.run.export import LAYERS_OF
from msbdb.tables.aliases import COLUMN_WORDS, LAYER_WORDS, words_of

needs_ogrinfo = pytest.mark.skipif(shutil.which("ogrinfo") is None, reason="ogrinfo (gdal-bin) is not installed")


def gpkg(path: Path, query: str) -> list[tuple]:
    """Ask a GeoPackage as SQLite does."""
    with closing(sqlite3.connect(path)) as file:
        return file.execute(query).fetchall()


def test_a_geopackage_has_names_styles_and_the_relation_of_parts(town: Path, tmp_path: Path) -> None:
    """As sqlite3 sees it: every column has words and a meaning, every layer a style, parts refer to buildings."""
    path = tmp_path / "town.gpkg"
    told = run("export", town, path)
    assert "town.gpkg: footprint 4, part 3, flat_region 0, candidate_region 0." in told
    named = {(layer, column): (title, words) for layer, column, title, words in gpkg(
        path, "SELECT table_name, column_name, title, description FROM gpkg_data_columns")}  # fmt: skip
    for layer in LAYERS_OF["current"]:
        columns = {row[1] for row in gpkg(path, f"PRAGMA table_info({layer})")} - {"fid", "geom"}
        assert columns == {column for own, column in named if own == layer}
    assert named["footprint", "ridge"][0] == "Ridge above ground [m]"
    assert named["footprint", "z_ground"][1].startswith("median level of the ground")
    titles = dict(gpkg(path, "SELECT table_name, identifier FROM gpkg_contents WHERE data_type = 'features'"))
    assert titles == {layer: LAYER_WORDS[layer] for layer in LAYERS_OF["current"]}
    styles = gpkg(path, "SELECT f_table_name, styleName, styleQML, useAsDefault FROM layer_styles")
    assert [(layer, name) for layer, name, _, default in styles if default] == [
        ("footprint", "Buildings by height"), ("part", "Parts of buildings by scale"),
        ("flat_region", "Flat regions outlined"), ("candidate_region", "Candidate regions by detector"),
    ]  # fmt: skip
    for layer, _, qml, _ in styles:
        tree = ElementTree.fromstring(qml)
        columns = {row[1] for row in gpkg(path, f"PRAGMA table_info({layer})")}
        used = {found for rule in tree.iter("rule") for found in re.findall(r'"(\w+)"', rule.get("filter", ""))}
        assert used <= columns
        assert {alias.get("field") for alias in tree.iter("alias")} == columns - {"fid", "geom"}
    [(_, _, referred, own, other, *_)] = gpkg(path, "PRAGMA foreign_key_list(part)")
    assert (referred, own, other) == ("footprint", "building_id", "building_id")
    assert gpkg(path, "PRAGMA foreign_key_check") == []
    assert gpkg(path, "PRAGMA integrity_check") == [("ok",)]
    joined = "SELECT count(*) FROM part JOIN footprint USING (building_id) WHERE footprint.uid IS NOT NULL"
    assert gpkg(path, joined) == [(3,)]


@needs_ogrinfo
@pytest.mark.parametrize("ending", ["gpkg", "geojson", "fgb", "shp", "csv", "kml", "dxf"])
def test_gdal_opens_every_format(town: Path, tmp_path: Path, ending: str) -> None:
    """Debian's own GDAL sees the four buildings of the inventory and their place; the parts in a Shapefile."""
    path = tmp_path / f"town.{ending}"
    run("export", town, path)
    layer = ["footprint"] if ending == "gpkg" else []
    done = subprocess.run(["ogrinfo", "-ro", "-al", path, *layer], capture_output=True, text=True, check=True)
    assert "Warning" not in done.stderr
    assert f"Feature Count: {3 if ending == 'shp' else 4}\n" in done.stdout
    inside = "(3.0000" if ending in ("geojson", "kml") else "(500008"
    assert f"Extent: {inside}" in done.stdout
    ids = [str(uid) for uid in gpd.read_file(town, layer="footprint_current")["uid"]]
    if ending not in ("shp", "dxf"):
        assert all(f" = {uid}\n" in done.stdout for uid in ids)
    if ending == "dxf":
        assert done.stdout.count("Layer (String) = FOOTPRINT_") == 4


def test_parquet_has_crs_bounds_and_ids_as_text(town: Path, tmp_path: Path) -> None:
    """As pyarrow reads it: GeoParquet 1.1 with the CRS, a covering by bounds, and text in place of long numbers."""
    path = tmp_path / "town.parquet"
    run("export", town, path)
    table = pq.read_table(path)
    about = json.loads(table.schema.metadata[b"geo"])
    geometry = about["columns"]["geometry"]
    assert about["version"] == "1.1.0"
    assert geometry["crs"]["id"] == {"authority": "EPSG", "code": EPSG}
    assert geometry["encoding"] == "WKB"
    assert geometry["covering"]["bbox"]["xmin"] == ["bbox", "xmin"]
    assert {str(table.schema.field(name).type) for name in ("uid", "building_id", "version_id")} <= {
        "string",
        "large_string",
    }
    boxes = np.array([[box[side] for side in ("xmin", "ymin", "xmax", "ymax")] for box in table["bbox"].to_pylist()])
    shapes = shapely.from_wkb(table["geometry"].to_pylist())
    assert np.allclose(boxes, shapely.bounds(shapes))
    assert sorted(shapely.area(shapes).round(-1).tolist()) == [140.0] * 4


def test_a_spreadsheet_reads_the_csv(town: Path, tmp_path: Path) -> None:
    """The outline is WKT, a point in it is there as numbers, ids have all their digits, and types are beside it."""
    path = tmp_path / "town.csv"
    run("export", town, path)
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert sorted(row["uid"] for row in rows) == sorted(map(str, current(town)["uid"]))
    for row in rows:
        shape = shapely.from_wkt(row["WKT"])
        assert shape.contains(shapely.Point(float(row["easting"]), float(row["northing"])))
    kinds = path.with_suffix(".csvt").read_text().strip().replace('"', "").split(",")
    assert dict(zip(rows[0], kinds, strict=True))["uid"] == "String"
    assert not path.with_suffix(".prj").exists()
    path.unlink()
    assert "town.csvt exists already" in run("export", town, path, code=1)


def current(town: Path, date: str | None = None) -> gpd.GeoDataFrame:
    """Return the inventory as the database has it."""
    from msbdb.database import LAST_DAY, footprint_at, opened

    with opened(town) as engine:
        return footprint_at(engine, date or LAST_DAY)


def test_the_inventory_is_taken_as_it_was_on_a_day(town: Path, tmp_path: Path) -> None:
    """Before the surveys the cadastre alone; later what stood then, with the parts of those buildings."""
    for date, buildings, parts in (("2016", 3, 0), ("2020-12-31", 3, 2), ("2023", 4, 3)):
        path = tmp_path / f"{date}.gpkg"
        run("export", town, path, "--at", date)
        footprint, part = (gpd.read_file(path, layer=name) for name in ("footprint", "part"))
        assert (len(footprint), len(part)) == (buildings, parts)
        assert footprint["uid"].tolist() == current(town, date)["uid"].astype(str).tolist()
        assert part["building_id"].isin(footprint["building_id"]).all()


def test_a_district_is_taken_with_whole_buildings(town: Path, tmp_path: Path) -> None:
    """What meets the polygons, uncut, with its parts; the polygons may be in another CRS."""
    area = footprints([(10, 10, 14, 14, 0)]).to_crs(4326)
    area.to_file(tmp_path / "district.geojson")
    path = tmp_path / "district.gpkg"
    run("export", town, path, "--aoi", tmp_path / "district.geojson")
    footprint, part = (gpd.read_file(path, layer=name) for name in ("footprint", "part"))
    assert (len(footprint), len(part)) == (1, 1)
    assert footprint.area.iloc[0] == pytest.approx(144, abs=10)
    run("export", town, tmp_path / "parts.shp", "--what", "parts", "--aoi", tmp_path / "district.geojson")
    assert gpd.read_file(tmp_path / "parts.shp")["BLDG_ID"].tolist() == footprint["building_id"].tolist()


def test_another_crs_moves_outlines_and_places(town: Path, tmp_path: Path) -> None:
    """Also for GeoJSON, which is longitude and latitude otherwise; areas stay square metres."""
    run("export", town, tmp_path / "town.gpkg", "--crs", 25831)
    back = gpd.read_file(tmp_path / "town.gpkg", layer="part")
    assert back.crs.to_epsg() == 25831
    assert shapely.contains_xy(back.geometry, back["xin"], back["yin"]).all()
    run("export", town, tmp_path / "lonlat.gpkg", "--crs", "EPSG:4326")
    back = gpd.read_file(tmp_path / "lonlat.gpkg", layer="part")
    assert back["xin"].between(2.9, 3.1).all()
    assert (back["area_m2"] > 100).all()
    run("export", town, tmp_path / "utm.geojson", "--crs", EPSG)
    back = gpd.read_file(tmp_path / "utm.geojson")
    assert (back.crs, back.total_bounds[0] > 400_000) == (UTM, True)
    assert "longitude and latitude" in run("export", town, tmp_path / "utm.kml", "--crs", EPSG, code=1)


def test_changes_and_evidence_are_taken(town: Path, tmp_path: Path) -> None:
    """The changes are those of msbdb changes; evidence has a layer for buildings, parts and regions."""
    run("export", town, tmp_path / "changes.gpkg", "--what", "changes")
    run("changes", town, "--out", tmp_path / "same.gpkg")
    found, same = (gpd.read_file(tmp_path / name, layer="change") for name in ("changes.gpkg", "same.gpkg"))
    assert found.equals(same)
    assert {"demolished", "new"} <= set(found["kind"])
    run("export", town, tmp_path / "evidence.gpkg", "--what", "evidence", "--survey", "here")
    for layer in LAYERS_OF["evidence"]:
        back = gpd.read_file(tmp_path / "evidence.gpkg", layer=layer)
        assert set(back["survey"]) <= {"here"}
    assert len(gpd.read_file(tmp_path / "evidence.gpkg", layer="building_evidence")) == 2
    run("export", town, tmp_path / "dropped.shp", "--what", "evidence", "--layer", "rejection")
    assert all(len(column) <= 10 for column in gpd.read_file(tmp_path / "dropped.shp").columns)


def test_what_cannot_be_is_refused_before_the_work(town: Path, tmp_path: Path) -> None:
    """Each message names the option or the next step, and nothing is written."""
    cases = {
        "classify IN OUT": [tmp_path / "town.laz"],
        "There is no layer 'roofs'": [tmp_path / "town.gpkg", "--layer", "roofs"],
        "holds one layer": [tmp_path / "town.fgb", "--layer", "part", "--layer", "footprint"],
        "--at names a day of the inventory": [tmp_path / "town.gpkg", "--at", "2020", "--survey", "here"],
        "no meaning for --what current": [tmp_path / "town.gpkg", "--what", "current", "--survey", "here"],
        "There is no format 'shape'": [tmp_path / "town.shp", "--format", "shape"],
        "has no option 'speed'": [tmp_path / "town.gpkg", "--option", "speed=9"],
        "by the ending of the name": [tmp_path / "town.shp", "--format", "geopackage"],
        "no survey 'spring'": [tmp_path / "town.gpkg", "--survey", "spring"],
        "is the source itself": [town, "--overwrite", "--format", "geopackage"],
    }
    for words, given in cases.items():
        told = run("export", town, *given, code=1)
        assert words in told or ("by the ending" in told and given[0] == town), told
    assert list(tmp_path.iterdir()) == []
    empty = tmp_path / "empty.sqlite"
    run("db", "create", empty, "--crs", EPSG)
    with pytest.raises(InputError, match="has no inventory"):
        api.export(empty, tmp_path / "empty.gpkg", at="2020")


def test_every_column_has_words_and_a_short_name() -> None:
    """Of all layers: words without the raw name, short names of at most ten characters that do not clash, a style."""
    hidden = {"run_id", "father_id", "class_id", "survey_id", "closed_by", "rejection_id", "row_digest"}
    for layer, columns in FIELDS.items():
        shown = [column for name, column in columns.items() if name not in hidden]
        assert all(column.name in COLUMN_WORDS for column in shown), layer
        short = [short_name(column.name) for column in shown]
        assert len(set(short)) == len(short), layer
        assert max(map(len, short)) <= 10
        assert len({words_of(column) for column in shown}) == len(shown), layer
        assert STYLES[layer]
    assert set(FIELDS) == {name for names in LAYERS_OF.values() for name in names}


def qgs(path: Path) -> ElementTree.Element:
    """Return the project inside of a .qgz."""
    with zipfile.ZipFile(path) as archive:
        return ElementTree.fromstring(archive.read(f"{path.stem}.qgs"))


def test_a_project_shows_the_database(town: Path, tmp_path: Path) -> None:
    """Layers by height, state, scale and evidence, with sources beside the project and relations between them."""
    shutil.copy(town, tmp_path / "town.sqlite")
    told = run("qgis", tmp_path / "town.sqlite", "--out", tmp_path / "town.qgz")
    for title in ("Changes by kind", "Buildings by height", "Buildings by state", "Parts of buildings by scale"):
        assert title in told
    tree = qgs(tmp_path / "town.qgz")
    layers = {layer.findtext("id"): layer for layer in tree.iter("maplayer")}
    assert {layer.findtext("datasource").split()[0] for layer in layers.values()} == {"dbname='./town.sqlite'"}
    assert [leaf.get("id") for leaf in tree.iter("layer-tree-layer") if leaf.get("checked") == "Qt::Checked"] == [
        "footprint_by_height"
    ]
    for relation in tree.iter("relation"):
        assert {relation.get("referencingLayer"), relation.get("referencedLayer")} <= set(layers)
    used = {item.get("relation") for item in tree.iter("attributeEditorRelation")}
    assert used == {relation.get("id") for relation in tree.iter("relation")}
    before = (tmp_path / "town.qgz").read_bytes()
    assert "exists already" in run("qgis", town, "--out", tmp_path / "town.qgz", code=1)
    run("qgis", tmp_path / "town.sqlite", "--out", tmp_path / "town.qgz", "--overwrite")
    assert (tmp_path / "town.qgz").read_bytes() == before


@pytest.mark.parametrize("given", [{}, {"survey": "here"}, {"what": "evidence"}], ids=["current", "survey", "evidence"])
@pytest.mark.filterwarnings("ignore::msbdb.errors.MsbdbWarning")
def test_a_file_by_pieces_is_the_file_in_one(town, tmp_path, monkeypatch, given) -> None:
    """Rows are read and written one by one, with the same values, types and order; also by way of geometries."""
    api.export(town, tmp_path / "whole.gpkg", **given)
    monkeypatch.setattr(shownlayers, "ROWS_AT_A_TIME", 1)
    monkeypatch.setattr(layers, "ROWS_AT_A_TIME", 1)
    api.export(town, tmp_path / "pieces.gpkg", **given)
    api.export(town, tmp_path / "decoded.gpkg", crs=f"EPSG:{EPSG}", **given)
    names = [name for (name,) in gpkg(tmp_path / "whole.gpkg", "SELECT table_name FROM gpkg_geometry_columns")]
    assert len(names) > 3
    for name in names:
        whole, *others = (
            gpd.read_file(tmp_path / f"{file}.gpkg", layer=name) for file in ("whole", "pieces", "decoded")
        )
        for other in others:
            gpd.testing.assert_geodataframe_equal(other, whole)
        assert len(whole) > 1 or name not in ("footprint", "part", "building_evidence")

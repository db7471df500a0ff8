"""Exports are read back by other programs as they were written."""

import json
import shutil
import sqlite3
import subprocess
from contextlib import closing

import geopandas as gpd
import numpy as np
import pandas as pd
import pyogrio
import pytest
import shapely
from pyproj import CRS

from msbdb import tables
from msbdb.errors import CRSError, FileError, InputError
from msbdb.export import Content
from msbdb.export import export as export_content
from msbdb.export.content import IDS, ROOF_EDGES
from msbdb.io.layers import Layer, write_layers

BIG = 2**59 - 1  # more than a float holds exactly
needs_ogrinfo = pytest.mark.skipif(shutil.which("ogrinfo") is None, reason="ogrinfo (gdal-bin) is not installed")


def filled(table, rows, crs, geometry):
    """Return a frame of a declared table with distinct plausible values."""
    columns = {}
    for number, column in enumerate(table.columns):
        values = [number + 10 * row for row in range(rows)]
        columns[column.name] = pd.Series([f"é{v}" for v in values] if column.dtype == "str" else values).astype(
            column.dtype
        )
    return gpd.GeoDataFrame(columns, geometry=geometry, crs=crs)


@pytest.fixture
def scene():
    """Return a root with a courtyard and its child in the Dutch grid, their building, and what others found of it."""
    ring = shapely.box(85_000, 447_000, 85_020, 447_020) - shapely.box(85_005, 447_005, 85_010, 447_010)
    child = shapely.MultiPolygon([shapely.box(85_011, 447_011, 85_015, 447_015)])
    crs = CRS.from_epsg(28992)
    parts = filled(tables.PART, 2, crs, [shapely.MultiPolygon([ring]), child])
    parts["part_id"], parts["supid"] = [BIG, BIG - 1], [0, BIG]
    parts["root_id"], parts["supscale"], parts["scale"] = BIG, [0, 1], [1, 3]
    parts["stddis"] = [1.25, np.nan]
    buildings = filled(tables.BUILDING, 1, crs, [shapely.MultiPolygon([ring])])
    buildings["building_id"] = parts["building_id"] = BIG
    tables.validate(parts, tables.PART)
    tables.validate(buildings, tables.BUILDING)
    regions = filled(tables.FLAT_REGION, 1, crs, [child])
    candidates = filled(tables.CANDIDATE_REGION, 2, crs, [child, child])
    candidates["candidate_id"], candidates["height_scale_m"] = [BIG, BIG - 1], [2.5, np.nan]
    return {"footprint": buildings, "part": parts, "flat_region": regions, "candidate_region": candidates}


def export(frames, path, **options):
    """Export frames as the layers that they are."""
    content = Content("survey", {name: Layer.of(frame) for name, frame in frames.items()})
    export_content(content if path.suffix == ".gpkg" else content.only("part"), path, **options)


def ogrinfo(path, *layers):
    """Return what Debian's ogrinfo says about the file."""
    return subprocess.run(["ogrinfo", "-ro", "-al", path, *layers], check=True, capture_output=True, text=True).stdout


def test_geopackage_holds_all_layers_unchanged(scene, tmp_path):
    """Every column, dtype, geometry and the CRS come back."""
    export(scene, tmp_path / "town.gpkg")
    listed = pyogrio.list_layers(tmp_path / "town.gpkg")
    assert sorted(name for name, kind in listed if kind) == sorted(scene)
    for name, frame in scene.items():
        back = gpd.read_file(tmp_path / "town.gpkg", layer=name)
        ids = {column: frame[column].astype(str) for column in IDS if column in frame}
        pd.testing.assert_frame_equal(pd.DataFrame(back), pd.DataFrame(frame.assign(**ids)), check_dtype=False)
        assert back.crs == frame.crs


@pytest.mark.parametrize("suffix", [".gpkg", ".geojson"])
def test_files_say_that_outlines_are_edges_of_roofs(scene, tmp_path, suffix):
    """The description of the layers, where the format has one."""
    path = tmp_path / f"town{suffix}"
    export(scene, path)
    if suffix == ".gpkg":
        with closing(sqlite3.connect(path)) as file:
            words = file.execute(
                "SELECT DISTINCT description FROM gpkg_contents WHERE data_type = 'features'"
            ).fetchall()
    else:
        words = [(json.loads(path.read_text())["description"],)]
    assert words == [(ROOF_EDGES,)]


def test_shapefile_has_the_papers_names_and_exact_ids(scene, tmp_path):
    """The fields are the paper's, in its spelling, beside heights and the building; ids are text; a null stays null."""
    parts = scene["part"]
    export(scene, tmp_path / "town.shp")
    back = gpd.read_file(tmp_path / "town.shp")
    names = ["ID", "SUPID", "SUPSCALE", "SCALE", "H", "XO", "YO", "XCEN", "YCEN", "AREA", "SPE", "STDDIS"]
    assert {*names, "BLDG_ID", "HMAX_M", "HMEAN_M", "HP90_M"} <= set(back.columns)
    assert len(back.columns) == len(tables.PART.columns) + 1
    assert back["ID"].tolist() == [str(BIG), str(BIG - 1)]
    assert back["SUPID"].tolist() == ["0", str(BIG)]
    assert back["H"].tolist() == parts["hindex"].tolist()
    assert np.array_equal(back["STDDIS"], [1.25, np.nan], equal_nan=True)
    assert back.crs.to_epsg() == 28992
    assert (tmp_path / "town.cpg").read_text() == "UTF-8"
    assert shapely.equals(back.geometry.to_numpy(), parts.geometry.to_numpy()).all()


def test_geojson_is_rfc_7946(scene, tmp_path):
    """Longitude and latitude, no crs member, counter-clockwise shells, ids as strings, null for a missing value."""
    parts = scene["part"]
    export(scene, tmp_path / "town.geojson")
    collection = json.loads((tmp_path / "town.geojson").read_text(encoding="utf-8"))
    assert collection["type"] == "FeatureCollection"
    assert "crs" not in collection
    root, child = collection["features"]
    assert (root["id"], root["properties"]["part_id"], root["properties"]["supid"]) == (str(BIG), str(BIG), "0")
    assert child["properties"]["supid"] == str(BIG)
    assert child["properties"]["stddis"] is None
    shape = shapely.geometry.shape(root["geometry"])
    assert shape.geom_type == "MultiPolygon"
    assert shape.is_valid
    assert shape.geoms[0].exterior.is_ccw
    assert len(shape.geoms[0].interiors) == 1
    assert shape.centroid.distance(shapely.Point(4.3753, 52.0085)) < 0.01
    assert gpd.GeoSeries([shape], crs=4326).to_crs(parts.crs).area[0] == pytest.approx(375, rel=0.01)


@needs_ogrinfo
@pytest.mark.parametrize("suffix", ["gpkg", "shp", "geojson"])
def test_ogrinfo_reads_every_format(scene, tmp_path, suffix):
    """GDAL's own tool sees the features, the CRS and the ids with all their digits."""
    path = tmp_path / f"town.{suffix}"
    export(scene, path)
    said = ogrinfo(path)
    assert "Feature Count: 2" in said
    assert str(BIG) in said
    assert ("WGS 84" if suffix == "geojson" else "Amersfoort / RD New") in said.replace("_", " ")
    if suffix == "shp":
        assert "ID: String" in said
        assert "AREA: Real" in said
    if suffix == "gpkg":
        assert all(f"Layer name: {name}" in said for name in scene)
        assert "Geometry: Multi Polygon" in said
        assert "é" in said


@pytest.mark.parametrize("suffix", ["gpkg", "shp", "geojson"])
def test_no_buildings_make_a_valid_empty_file(scene, tmp_path, suffix):
    """An empty result is written with its columns and no features."""
    export({name: frame[:0] for name, frame in scene.items()}, tmp_path / f"none.{suffix}")
    back = gpd.read_file(tmp_path / f"none.{suffix}", layer="part" if suffix == "gpkg" else None)
    assert len(back) == 0
    assert suffix == "geojson" or len(back.columns) > 12


@pytest.mark.parametrize("suffix", ["gpkg", "shp"])
def test_a_compound_crs_keeps_its_horizontal_part_at_least(scene, tmp_path, suffix):
    """A CRS with heights is written so that the horizontal one is read back."""
    export(
        {name: frame.set_crs(7415, allow_override=True) for name, frame in scene.items()}, tmp_path / f"nap.{suffix}"
    )
    crs = gpd.read_file(tmp_path / f"nap.{suffix}", layer="part" if suffix == "gpkg" else None).crs
    horizontal = crs.sub_crs_list[0] if crs.is_compound else crs
    assert horizontal.to_epsg() == 28992
    assert suffix != "gpkg" or crs.to_epsg() == 7415


@pytest.mark.parametrize("suffix", ["gpkg", "shp", "geojson"])
def test_existing_files_are_kept_unless_told(scene, tmp_path, suffix):
    """A file or a sidecar that is there is refused and kept; with overwrite it is replaced as a whole."""
    path = tmp_path / f"town.{suffix}"
    export(scene, path)
    one = scene | {"part": scene["part"][:1]}
    before = path.read_bytes()
    with pytest.raises(FileError, match="exists already"):
        export(one, path)
    assert path.read_bytes() == before
    (tmp_path / "town.qix").write_bytes(b"index of the old file")
    export(one, path, overwrite=True)
    layer = "part" if suffix == "gpkg" else None
    assert len(gpd.read_file(path, layer=layer)) == 1
    assert (tmp_path / "town.qix").exists() == (suffix != "shp")
    assert not [file for file in tmp_path.iterdir() if file.name.startswith(".")]


def test_a_lone_sidecar_is_refused(scene, tmp_path):
    """A table of the same name that is not ours is not overwritten."""
    (tmp_path / "town.dbf").write_bytes(b"mine")
    with pytest.raises(FileError, match=r"town\.dbf"):
        export(scene, tmp_path / "town.shp")


def test_unknown_suffixes_and_unwritable_places_are_errors(scene, tmp_path):
    """The message names the endings, or the path."""
    with pytest.raises(InputError, match=r"\.gpkg, \.geojson, .*\.shp"):
        export(scene, tmp_path / "town.pdf")
    with pytest.raises(FileError, match=r"missing.town\.gpkg cannot be written: No such file"):
        export(scene, tmp_path / "missing" / "town.gpkg")


def test_a_failed_write_leaves_the_old_file(scene, tmp_path):
    """When the driver refuses, what was there before is untouched and nothing else is left."""
    parts, buildings = scene["part"], scene["footprint"]
    path = tmp_path / "town.gpkg"
    export(scene, path)
    before = path.read_bytes()
    with pytest.raises(FileError, match="cannot be written"):
        write_layers(path, {"part": Layer.of(parts), "other": Layer.of(buildings)}, "No such driver")
    with pytest.raises(CRSError, match="Layer part has no CRS"):
        write_layers(path, {"part": Layer.of(parts.set_crs(None, allow_override=True))}, "GPKG")
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["town.gpkg"]

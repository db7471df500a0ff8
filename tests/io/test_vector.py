"""Polygons in, of any format."""

import json
import os
from pathlib import Path

import geopandas as gpd
import pytest
from pyproj import CRS
from shapely import GeometryCollection, LineString, MultiPolygon, Point, Polygon, box

from msbdb.errors import CRSError, FileError, InputError, MsbdbWarning, NodataError
from msbdb.io.vector import read_polygons

LAMBERT = CRS.from_epsg(2154)
BOWTIE = Polygon([(0, 0), (2, 2), (2, 0), (0, 2)])
HOUSE = box(10, 10, 20, 20)


def write(path, geometries, *, crs=LAMBERT, driver="GPKG", layer=None):
    """Write geometries with a running number, and return the path."""
    frame = gpd.GeoDataFrame({"number": range(len(geometries))}, geometry=geometries, crs=crs)
    frame.to_file(path, driver=driver, layer=layer, engine="pyogrio")
    return path


@pytest.mark.parametrize(("ending", "driver"), [("gpkg", "GPKG"), ("geojson", "GeoJSON"), ("shp", "ESRI Shapefile")])
def test_polygons_read_from_any_format(tmp_path, ending, driver):
    """Geometry, attributes and CRS are those of the file."""
    frame = read_polygons(write(tmp_path / f"houses.{ending}", [HOUSE, box(30, 30, 40, 40)], driver=driver))
    assert list(frame["number"]) == [0, 1]
    assert frame.crs == LAMBERT
    assert frame.geometry.iloc[0].normalize().equals_exact(HOUSE.normalize(), 1e-6)


def test_invalid_polygons_are_repaired_and_others_left_out(tmp_path):
    """A bow tie becomes two triangles; lines, points and empty rows go; heights above the plane are flattened."""
    solid = Polygon([(50, 0, 9), (60, 0, 9), (60, 10, 9)])
    mixed = GeometryCollection([box(70, 0, 71, 1), LineString([(0, 0), (1, 1)])])
    rows = [BOWTIE, LineString([(0, 0), (1, 1)]), solid, None, Point(1, 1), mixed, MultiPolygon([HOUSE])]
    with pytest.warns(MsbdbWarning) as notices:
        frame = read_polygons(write(tmp_path / "mixed.gpkg", rows))
    assert list(frame["number"]) == [0, 2, 5, 6]
    assert list(frame.index) == [0, 1, 2, 3]
    assert frame.is_valid.all()
    assert list(frame.area) == pytest.approx([2.0, 50.0, 1.0, 100.0])
    assert not frame.has_z.any()
    assert sorted(str(notice.message) for notice in notices) == [
        "mixed.gpkg: 1 geometries were repaired.",
        "mixed.gpkg: 3 geometries were left out, because they are no polygons.",
    ]


def test_polygons_are_reprojected_on_demand(tmp_path):
    """From degrees to the survey's metres."""
    path = write(
        tmp_path / "houses.geojson", [box(3.0, 46.5, 3.001, 46.501)], crs=CRS.from_epsg(4326), driver="GeoJSON"
    )
    frame = read_polygons(path, to=2154)
    assert frame.crs == LAMBERT
    assert frame.total_bounds[:2] == pytest.approx([700000, 6600000], abs=1)


def test_a_layer_must_be_named_where_there_are_several(tmp_path):
    """The message lists them."""
    path = write(tmp_path / "city.gpkg", [HOUSE], layer="houses")
    write(path, [box(0, 0, 1, 1)], layer="sheds")
    with pytest.raises(InputError, match="houses, sheds"):
        read_polygons(path)
    assert read_polygons(path, layer="sheds").area.sum() == pytest.approx(1)
    with pytest.raises(FileError, match="layer's name"):
        read_polygons(path, layer="barns")


@pytest.mark.filterwarnings("ignore:'crs' was not provided")
def test_a_missing_crs_must_be_stated(tmp_path):
    """And must not contradict the file's."""
    path = write(tmp_path / "houses.fgb", [HOUSE], crs=None, driver="FlatGeobuf")
    with pytest.raises(CRSError, match="--crs"):
        read_polygons(path)
    assert read_polygons(path, crs=2154).crs == LAMBERT
    with pytest.raises(CRSError, match="28992"):
        read_polygons(write(tmp_path / "b.gpkg", [HOUSE]), crs=28992)


def test_files_without_polygons_are_refused(tmp_path):
    """Missing, no vector file, without geometries, with lines alone."""
    with pytest.raises(FileError, match="does not exist"):
        read_polygons(tmp_path / "none.gpkg")
    (tmp_path / "text.gpkg").write_text("no layers")
    with pytest.raises(FileError, match="vector file"):
        read_polygons(tmp_path / "text.gpkg")
    (tmp_path / "table.csv").write_text("a,b\n1,2\n")
    with pytest.raises(NodataError, match="no geometries"):
        read_polygons(tmp_path / "table.csv")
    (tmp_path / "empty.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": []}))
    with pytest.raises(NodataError):
        read_polygons(tmp_path / "empty.geojson")
    with pytest.warns(MsbdbWarning), pytest.raises(NodataError, match="no polygons"):
        read_polygons(write(tmp_path / "lines.gpkg", [LineString([(0, 0), (1, 1)])]))


@pytest.mark.data
@pytest.mark.skipif("MSBDB_DATA" not in os.environ, reason="MSBDB_DATA is not set")
@pytest.mark.parametrize(
    ("file", "count"),
    [("delft/footprints.gpkg", 160), ("alexandria/footprints.geojson", 84), ("goteborg/footprints.gpkg", 137)],
)
@pytest.mark.filterwarnings("default::msbdb.errors.MsbdbWarning")
def test_real_footprints_read(file, count):
    """All of the reference polygons, valid."""
    frame = read_polygons(Path(os.environ["MSBDB_DATA"], file))
    assert len(frame) == count
    assert frame.is_valid.all()

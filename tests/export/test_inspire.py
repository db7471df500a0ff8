"""INSPIRE Buildings as GeoPackage: columns of the flattened types, code lists, and why values are missing."""

import re
import shutil
import sqlite3
import subprocess
from contextlib import closing

import geopandas as gpd
import pyogrio
import pytest
from support.exported import GROUND_M, town_content

from msbdb.errors import CRSError
from msbdb.export import export
from msbdb.export.standards.inspire import UNKNOWN, UNPOPULATED
from msbdb.io.layers import Layer

CODES = "http://inspire.ec.europa.eu/codelist"


@pytest.fixture(scope="module")
def town(tmp_path_factory):
    """Return the town and its file."""
    path, content = tmp_path_factory.mktemp("inspire") / "town.inspire.gpkg", town_content()
    export(content, path, options={"namespace": "https://example.org/bu"})
    return content, path


def test_buildings_have_the_columns_of_the_flattened_type(town):
    """Ids, heights with their references, storeys, and roof edges everywhere; the rest is null."""
    content, path = town
    rows = gpd.read_file(path, layer="Building").set_index("inspireId_localId")
    frame = content.frame("footprint").set_index("building_id")
    assert rows.crs == frame.crs
    for key, own in frame.iterrows():
        row = rows.loc[str(key)]
        assert row["heightAboveGround_value"] == pytest.approx(own["ridge"])
        assert row["heightAboveGround_heightReference"] == "topOfConstruction"
        assert row["elevation_elevationValue"] == GROUND_M
        assert row["numberOfFloorsAboveGround"] == own["storeys"]
        assert row.geometry.equals(own.geometry)
    assert set(rows["inspireId_namespace"]) == {"https://example.org/bu"}
    assert set(rows["geometry2D_horizontalGeometryReference"]) == {"roofEdge"}
    href = f"{CODES}/HorizontalGeometryReferenceValue/roofEdge"
    assert set(rows["geometry2D_horizontalGeometryReference_href"]) == {href}
    assert rows["geometry2D_referenceGeometry"].all()
    assert rows[list(UNPOPULATED)].isna().all(axis=None)
    assert set(rows["beginLifespanVersion"].astype(str).str[:10]) == {"2024-05-31"}


def test_parts_name_their_building_and_stand_side_by_side(town):
    """With their own heights."""
    path = town[1]
    buildings = gpd.read_file(path, layer="Building").set_index("inspireId_localId")
    parts = gpd.read_file(path, layer="BuildingPart")
    assert sorted(parts["heightAboveGround_value"].round(1)) == [6.0, 15.0]
    [key] = parts["building_inspireId_localId"].unique()
    assert parts.union_all().equals(buildings.geometry[key])
    assert set(parts["geometry2D_horizontalGeometryReference"]) == {"roofEdge"}


def test_missing_values_have_a_reason(town):
    """By column, in the tables of metadata of the format."""
    with closing(sqlite3.connect(town[1])) as file:
        found = file.execute(
            "SELECT r.table_name, r.column_name, m.metadata FROM gpkg_metadata_reference r "
            "JOIN gpkg_metadata m ON m.id = r.md_file_id"
        ).fetchall()
    for table in ("Building", "BuildingPart"):
        reasons = {column: reason for own, column, reason in found if own == table}
        assert {column for column, reason in reasons.items() if reason.endswith("/Unpopulated")} == set(UNPOPULATED)
        assert {column for column, reason in reasons.items() if reason.endswith("/Unknown")} == set(UNKNOWN)
        assert set(reasons) < set(pyogrio.read_info(town[1], layer=table)["fields"])


def test_all_heights_are_rows_of_a_table(town):
    """To the eaves and to the ridge."""
    content, path = town
    rows = pyogrio.read_dataframe(path, layer="Building_heightAboveGround")
    frame = content.frame("footprint").set_index("building_id")
    assert len(rows) == 2 * len(frame)
    for row in rows.itertuples():
        column = {"generalEave": "eaves", "topOfConstruction": "ridge"}[row.heightReference]
        assert row.value == pytest.approx(frame.loc[int(row.building_inspireId_localId), column])


@pytest.mark.skipif(shutil.which("ogrinfo") is None, reason="ogrinfo (gdal-bin) is not installed")
def test_gdal_lists_the_layers_without_a_complaint(town, tmp_path):
    """Also of an empty town, with the same columns."""
    empty = tmp_path / "town.gpkg"
    export(town_content(empty=True), empty, name="inspire")
    for path, count in ((town[1], 3), (empty, 0)):
        done = subprocess.run(["ogrinfo", "-ro", "-so", "-al", path], check=True, capture_output=True, text=True)
        assert done.stderr == ""
        found = re.search(r"Layer name: Building\n(.*\n)*?Geometry: Multi Polygon\nFeature Count: (\d+)\n", done.stdout)
        assert found is not None
        assert int(found[2]) == count
    names = pyogrio.read_info(town[1], layer="BuildingPart")["fields"]
    assert list(names) == list(pyogrio.read_info(empty, layer="BuildingPart")["fields"])


def test_degrees_are_refused(tmp_path):
    """As lengths and levels are in metres."""
    content = town_content()
    content.layers["footprint"] = Layer.of(content.frame("footprint").to_crs(4326))
    with pytest.raises(CRSError, match=r"needs a CRS in metres; got EPSG:4326\. Leave out --crs"):
        export(content, tmp_path / "town.inspire.gpkg")
    assert not list(tmp_path.iterdir())

"""Overture's own models accept every row, and other programs read the files as GeoParquet."""

import json

import geopandas as gpd
import pyarrow.parquet as pq
import pytest
import shapely
from overture.schema.buildings import Building, BuildingPart
from pydantic import ValidationError
from support.exported import town_content

from msbdb.export import export

MODELS = {"building": Building, "building_part": BuildingPart}

NOT_PROPERTIES = ("id", "geometry", "bbox")


def feature_of(row):
    """Return a row as the GeoJSON feature that Overture's models read."""
    properties = {name: value for name, value in row.items() if name not in NOT_PROPERTIES and value is not None}
    box = row["bbox"]
    bounds = [box["xmin"], box["ymin"], box["xmax"], box["ymax"]]
    shape = json.loads(shapely.to_geojson(shapely.from_wkb(row["geometry"])))
    return {"type": "Feature", "id": row["id"], "geometry": shape, "bbox": bounds, "properties": properties}


def rows_of(path):
    """Return the rows of a file as plain values."""
    return pq.read_table(path).to_pylist()


@pytest.fixture(scope="module")
def town(tmp_path_factory):
    """Return the town, and the files of its buildings and parts by their type."""
    folder = tmp_path_factory.mktemp("overture")
    paths = {kind: folder / f"town.{kind}.parquet" for kind in MODELS}
    content = town_content()
    for path in paths.values():
        export(content, path)
    return content, paths


@pytest.mark.parametrize("kind", MODELS)
def test_the_published_models_accept_each_row(town, kind):
    """As GeoJSON; and refuse a row with another type."""
    rows = rows_of(town[1][kind])
    assert rows
    for row in rows:
        assert MODELS[kind].model_validate_json(json.dumps(feature_of(row))).id == row["id"]
    with pytest.raises(ValidationError):
        MODELS[kind].model_validate_json(json.dumps(feature_of(rows[0] | {"type": "place"})))


def test_buildings_have_what_was_measured(town):
    """Heights to the ridge, storeys, and the date; the use is null."""
    content, paths = town
    frame = content.frame("footprint").set_index("building_id")
    rows = {row["id"]: row for row in rows_of(paths["building"])}
    assert set(rows) == {f"building-{key}" for key in frame.index}
    for key, own in frame.iterrows():
        row = rows[f"building-{key}"]
        assert row["height"] == pytest.approx(own["ridge"])
        assert (row["num_floors"], row["subtype"], row["class"]) == (own["storeys"], None, None)
        assert row["has_parts"] == (own["parts"] > 1)
        [source] = row["sources"]
        assert (source["dataset"], source["update_time"]) == ("msbdb spring", "2024-05-31T00:00:00Z")


def test_parts_divide_their_buildings(town):
    """The tower and the podium around it, side by side, with their own heights."""
    paths = town[1]
    buildings = gpd.read_parquet(paths["building"]).set_index("id")
    parts = gpd.read_parquet(paths["building_part"])
    assert buildings.crs.to_epsg() in (4326, None)
    assert buildings.crs.name.startswith("WGS 84")
    assert sorted(parts["height"].round(1)) == [6.0, 15.0]
    [key] = parts["building_id"].unique()
    whole = buildings.geometry[key]
    assert parts.union_all().symmetric_difference(whole).area < 1e-6 * whole.area
    assert shapely.relate_pattern(*parts.geometry, "F***1****")


def test_readers_skip_rows_by_their_bounds(town):
    """A window on one building reads it alone."""
    path = town[1]["building"]
    everything = gpd.read_parquet(path)
    west, south, east, north = everything.geometry.iloc[0].bounds
    inner = (west + 1e-6, south + 1e-6, east - 1e-6, north - 1e-6)
    assert gpd.read_parquet(path, bbox=inner)["id"].tolist() == [everything["id"].iloc[0]]


@pytest.mark.parametrize("kind", MODELS)
def test_an_empty_town_has_the_same_columns(town, tmp_path, kind):
    """And no rows."""
    path = tmp_path / f"town.{kind}.parquet"
    export(town_content(empty=True), path)
    assert gpd.read_parquet(path).empty
    assert pq.read_schema(path).names == pq.read_schema(town[1][kind]).names

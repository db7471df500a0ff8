"""What an office hands on in the schemas of others: written by the command, and read by another program."""

import csv
import json
from pathlib import Path

import geopandas as gpd
import pytest
from support.cjioreader import cityjson
from support.offices import run

from msbdb.database import open_database


@pytest.mark.long
def test_an_inventory_becomes_a_city_model(town: Path, tmp_path: Path) -> None:
    """With the inventory's ids and the office's columns; heights alone give no level, which is reported."""
    said = run("export", town, tmp_path / "town.city.json")
    assert "4 buildings without a level of the ground or a height: written without a block." in said
    with (tmp_path / "town.city.json").open(encoding="utf-8") as file:
        model = cityjson.CityJSON(file=file)
    assert model.get_epsg() == 32631
    found = [own["attributes"] for own in model.j["CityObjects"].values() if own["type"] == "Building"]
    assert len({own["id"] for own in found}) == model.number_city_objects_level1() == 4
    assert [own["imported"] for own in found if "imported" in own]
    run("export", town, tmp_path / "town.city.jsonl", "--at", "2021-06-01")
    lines = [json.loads(line) for line in (tmp_path / "town.city.jsonl").read_text(encoding="utf-8").splitlines()]
    assert [line["type"] for line in lines] == ["CityJSON", *["CityJSONFeature"] * (len(lines) - 1)]
    assert lines[0]["metadata"]["referenceDate"] == "2021-06-01"


@pytest.mark.long
def test_a_register_gives_the_exposure_its_occupancy(town: Path, tmp_path: Path) -> None:
    """A table of the office's is joined by the ids of a first file."""
    run("export", town, tmp_path / "plain.csv")
    with (tmp_path / "plain.csv").open(encoding="utf-8") as file:
        ids = [row["uid"] for row in csv.DictReader(file)]
    (tmp_path / "register.csv").write_text("nr,use\n" + "".join(f"{key},RES\n" for key in ids), encoding="utf-8")
    options = [f"join={tmp_path / 'register.csv'}", "on=nr", "occupancy=use"]
    run("export", town, tmp_path / "town.xml", *(word for option in options for word in ("--option", option)))
    with (tmp_path / "town.csv").open(encoding="utf-8") as file:
        assets = list(csv.DictReader(file))
    assert sorted(row["id"] for row in assets) == sorted(ids)
    assert all(row["taxonomy"].endswith("/RES") for row in assets)
    assert "--overwrite" in run("export", town, tmp_path / "town.xml", code=1)
    assert "has no option 'joint'" in run("export", town, tmp_path / "x.xml", "--option", "joint=x", code=1)


@pytest.mark.long
def test_buildings_go_to_overture_and_inspire(town: Path, tmp_path: Path) -> None:
    """Each by its ending, or by the name of the format."""
    run("export", town, tmp_path / "town.building.parquet")
    run("export", town, tmp_path / "bu.gpkg", "--format", "inspire", "--option", "namespace=https://example.org")
    rows = gpd.read_parquet(tmp_path / "town.building.parquet")
    buildings = gpd.read_file(tmp_path / "bu.gpkg", layer="Building")
    assert sorted(rows["id"]) == sorted(f"building-{key}" for key in buildings["inspireId_localId"])
    assert set(buildings["geometry2D_horizontalGeometryReference"]) == {"roofEdge"}
    assert set(buildings["inspireId_versionId"].str.len()) != {0}


def test_degrees_are_refused_and_an_empty_database_gives_empty_files(tmp_path: Path) -> None:
    """With the option to leave out, and with a notice."""
    db = tmp_path / "empty.sqlite"
    open_database(db, create=True, srid=32631).dispose()
    endings = ("city.json", "city.jsonl", "xml", "building.parquet", "building_part.parquet", "inspire.gpkg")
    for ending in endings:
        assert "the output is empty" in run("export", db, tmp_path / f"town.{ending}")
        assert (tmp_path / f"town.{ending}").stat().st_size > 0
    said = run("export", db, tmp_path / "degrees.city.json", "--crs", "EPSG:4326", code=1)
    assert "needs a CRS in metres; got EPSG:4326. Leave out --crs" in said
    assert not list(tmp_path.glob("degrees*"))

"""The commands of the living inventory from end to end, on a small town of rasters."""

import json
import re
import sqlite3
from contextlib import closing
from pathlib import Path

import geopandas as gpd
import pandas as pd
import pytest
from click.testing import CliRunner
from matplotlib.image import imread
from shapely import Point, box
from simulated.files import write_heights
from support.towns import ROW, SOUTH, UTM, WEST, House, footprints, town_heights

from msbdb.cli.main import cli
from msbdb.database import canonical_dump, footprint_at, open_database, read_changes

LATER: list[House] = [*ROW[1:7], (150, 10, 162, 28, 13), (60, 60, 75, 75, 9)]


def run(*words: object, code: int = 0) -> str:
    """Run a command and return what it printed."""
    done = CliRunner().invoke(cli, [str(word) for word in words])
    assert done.exit_code == code, done.output
    return done.output


@pytest.fixture(scope="module")
def rasters(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Return heights above ground of two epochs, as files."""
    folder = tmp_path_factory.mktemp("rasters")
    paths = {}
    for name, houses in (("first", ROW), ("second", LATER)):
        paths[name] = folder / f"{name}.tif"
        write_heights(paths[name], town_heights(houses))
    return paths


@pytest.fixture(scope="module")
def town(rasters: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a database with an imported inventory and two surveys."""
    folder = tmp_path_factory.mktemp("town")
    db = folder / "town.sqlite"
    office = footprints(ROW).assign(number=range(8), since=pd.Timestamp("1950-06-01"))
    office.to_file(folder / "cadastre.gpkg")
    run("import", folder / "cadastre.gpkg", "--as", "inventory", "--db", db, "--id", "number", "--map", "house=number")
    for name, date in (("first", "2020"), ("second", "2021-05-01")):
        run("update", "--ndsm", rasters[name], "--db", db, "--survey", name, "--date", date)
    return db


def test_an_inventory_is_imported_updated_and_told(town: Path) -> None:
    """The office's numbers live on, the changes are those of the town, and 'info' has both."""
    said = [" ".join(line.split()) for line in run("info", town).splitlines()]
    assert any(line.startswith("current buildings 8: ") for line in said)
    assert any(re.match(r"2021-05-01 second update .*", line) for line in said)
    engine = open_database(town)
    now = footprint_at(engine, "2021-05-01")
    attributes = [value for value in now["attributes"] if value is not None]
    assert sorted(value["house"] for value in attributes) == [1, 2, 3, 4, 5, 6, 7]
    assert {value["since"][:10] for value in attributes} == {"1950-06-01"}
    told = json.loads(run("changes", town, "--json"))
    assert told["counts"] == {"demolished": 1, "modified": 1, "new": 1, "unchanged": 6}
    told = json.loads(run("changes", town, "--each", "--json"))
    assert told["counts"] == {"demolished": 1, "modified": 1, "new": 1, "unchanged": 14}
    told = json.loads(run("changes", town, "--from", "2020", "--to", "2021-05-01", "--json"))
    assert {(row["kind"], row["survey"]) for row in told["changes"]} == {
        ("demolished", "second"),
        ("modified", "second"),
        ("new", "second"),
    }
    assert "demolished" in run("changes", town)
    assert "No survey of the period" in run("changes", town, "--from", "2022")


@pytest.mark.long
def test_a_building_that_the_first_import_lacks_is_new(rasters: dict[str, Path], tmp_path: Path) -> None:
    """With an import of the place, the first survey finds changes; without one, it is the first state."""
    footprints(ROW[:7]).to_file(tmp_path / "cadastre.gpkg")
    # The last house of the row lies beside the others, within the import's bounds.
    footprints([*ROW[:6], ROW[7]]).to_file(tmp_path / "gap.gpkg")
    counts = {}
    for name in ("cadastre", "gap"):
        db = tmp_path / f"{name}.sqlite"
        run("import", tmp_path / f"{name}.gpkg", "--as", "inventory", "--db", db)
        run("update", "--ndsm", rasters["first"], "--db", db, "--survey", "first", "--date", "2020")
        counts[name] = json.loads(run("changes", db, "--json"))["counts"]
    assert counts == {"cadastre": {"unchanged": 8}, "gap": {"new": 1, "unchanged": 7}}


def test_a_repeat_builds_nothing_and_changes_nothing(town: Path, rasters: dict[str, Path]) -> None:
    """The same files and values are known by the survey's record."""
    engine = open_database(town)
    before = list(canonical_dump(engine, provenance=True))
    words = run(
        "update", "--ndsm", rasters["second"], "--db", town, "--survey", "second", "--date", "2021-05-01", "--json"
    )
    told = json.loads(words)
    assert told["build"] is None
    assert told["inventory"]["status"] == "unchanged"
    assert told["inventory"]["counts"] == {"demolished": 1, "modified": 1, "new": 1, "unchanged": 6, "versions": 2}
    assert list(canonical_dump(engine, provenance=True)) == before


def test_changes_are_written_in_every_format(town: Path, tmp_path: Path) -> None:
    """All rows with exact ids, and a map that shows colours."""
    engine = open_database(town)
    now, uids = set(footprint_at(engine, "2021-05-01")["uid"]), set(read_changes(engine)["uid_after"].dropna())
    assert now < uids
    run("changes", town, "--out", tmp_path / "changes.gpkg")
    assert len(gpd.read_file(tmp_path / "changes.gpkg", layer="change")) == 9
    run("changes", town, "--each", "--out", tmp_path / "changes.gpkg", "--overwrite")
    layer = gpd.read_file(tmp_path / "changes.gpkg", layer="change")
    assert len(layer) == 17
    with closing(sqlite3.connect(tmp_path / "changes.gpkg")) as file:
        found = {int(uid) for (uid,) in file.execute("SELECT uid_after FROM change WHERE uid_after IS NOT NULL")}
    assert found == uids
    assert layer.crs == UTM
    run("changes", town, "--out", tmp_path / "changes.geojson")
    web = json.loads((tmp_path / "changes.geojson").read_text())["features"]
    assert {int(f["properties"]["uid_after"]) for f in web if f["properties"]["uid_after"]} == now
    assert -180 <= web[0]["geometry"]["coordinates"][0][0][0][0] <= 180
    run("changes", town, "--out", tmp_path / "changes.csv", "--figure", tmp_path / "changes.png")
    table = pd.read_csv(tmp_path / "changes.csv", dtype={"uid_after": "string"})
    assert {int(uid) for uid in table["uid_after"].dropna()} == now
    assert table["easting"].between(WEST, WEST + 200).all()
    picture = imread(tmp_path / "changes.png")[..., :3]
    green = abs(picture - (0, 0x9E / 255, 0x73 / 255)).max(axis=2) < 0.1
    assert green.sum() > 500
    assert "are written as" in run("changes", town, "--out", tmp_path / "changes.doc", code=1)


def test_an_area_of_interest_limits_updates_and_reports(town: Path, rasters: dict[str, Path], tmp_path: Path) -> None:
    """Buildings outside take no part, and are told as not surveyed within an area that holds them."""
    west = gpd.GeoDataFrame(geometry=[box(WEST, SOUTH, WEST + 48, SOUTH + 120)], crs=UTM)
    west.to_crs(4326).to_file(tmp_path / "west.geojson")
    whole = gpd.GeoDataFrame(geometry=[box(WEST, SOUTH, WEST + 200, SOUTH + 120)], crs=UTM)
    whole.to_file(tmp_path / "whole.gpkg")
    db = tmp_path / "town.sqlite"
    run("update", "--ndsm", rasters["first"], "--db", db, "--survey", "first", "--date", "2020")
    words = ("--ndsm", rasters["second"], "--db", db, "--survey", "second", "--date", "2021")
    told = json.loads(run("update", *words, "--aoi", tmp_path / "west.geojson", "--json"))
    assert told["inventory"]["counts"] == {"demolished": 1, "unchanged": 1, "versions": 0}
    told = json.loads(run("changes", db, "--from", "2020", "--aoi", tmp_path / "whole.gpkg", "--json"))
    assert told["counts"] == {"demolished": 1, "not surveyed": 6, "unchanged": 1}
    assert "does not overlap" in run("update", *words, "--aoi", far_away(tmp_path), code=1)


def far_away(folder: Path) -> Path:
    """Return an area somewhere else."""
    gpd.GeoDataFrame(geometry=[box(0, 0, 1, 1)], crs=UTM).to_file(folder / "far.gpkg")
    return folder / "far.gpkg"


def test_states_by_hand_are_written_and_taken_back(town: Path) -> None:
    """The operator's word wins in the present state."""
    engine = open_database(town)
    uid = int(footprint_at(engine, "2021-05-01")["uid"].iloc[0])
    run("state", town, uid, "refuted", "--note", "a crane; DROP TABLE part", "--operator", "ann")
    row = footprint_at(engine, "2021-05-01").set_index("uid").loc[uid]
    assert (row["state"], row["operator"], row["note"]) == ("refuted", "ann", "a crane; DROP TABLE part")
    told = run("state", town, uid, "auto", "--operator", "ben")
    assert "decided by the detectors" in told
    assert "Before: refuted by ann, 20" in told
    assert "(a crane; DROP TABLE part)" in told
    assert "Before" not in run("state", town, uid, "auto")
    assert footprint_at(engine, "2021-05-01")["operator"].isna().all()
    assert "no building 5" in run("state", town, 5, "confirmed", code=1)


def test_roof_samples_are_imported(town: Path, tmp_path: Path) -> None:
    """A column is mapped, all others stay as attributes."""
    points = [Point(WEST + 36, SOUTH + 16), Point(WEST + 56, SOUTH + 16)]
    frame = gpd.GeoDataFrame({"ROOF": ["metal", "tile"], "year": [2001, 2002]}, geometry=points, crs=UTM)
    frame.to_file(tmp_path / "roofs.gpkg")
    told = json.loads(
        run("import", tmp_path / "roofs.gpkg", "--as", "roof-samples", "--db", town, "--map", "material=ROOF", "--json")
    )
    assert (told["rows"], told["status"]) == (2, "created")
    assert "no column 'material'" in run(
        "import", tmp_path / "roofs.gpkg", "--as", "roof-samples", "--db", town, code=1
    )


def test_wrong_imports_are_refused_by_name(tmp_path: Path) -> None:
    """Nothing is written, and the message says what to do."""
    office = footprints(ROW).assign(number=1, name="x")
    office.to_file(tmp_path / "office.gpkg")
    words = ("import", tmp_path / "office.gpkg", "--as", "inventory", "--db", tmp_path / "town.sqlite")
    assert "is no id of the buildings" in run(*words, "--id", "number", code=1)
    assert "no column 'H'" in run(*words, "--map", "height=H", code=1)
    assert "no number" in run(*words, "--map", "height=name", code=1)
    run(*words, "--map", "height=HGT", "--map", "storeys=number")
    found = footprint_at(open_database(tmp_path / "town.sqlite"), "2000")
    assert sorted(found["h_p90"]) == sorted(house[4] for house in ROW)
    assert found["storeys"].tolist() == [1] * 8
    assert found["valid_from"].tolist() == ["0001-01-01"] * 8
    run(*words, "--map", "height=HGT", "--map", "storeys=number")
    assert "cannot be imported" in run(*words, "--name", "other", code=1)

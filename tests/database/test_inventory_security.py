"""Whatever a layer, column, survey, operator or value is called: to the inventory it is data, from file to file."""

import json
from pathlib import Path
from typing import Any

import geopandas as gpd
import pandas as pd
import pytest
from click.testing import CliRunner
from simulated.builds import HOSTILE
from simulated.files import write_heights
from sqlalchemy import inspect, text
from support.sizes import sample
from support.towns import EPSG, ROW, UTM, House, footprints, town_build, town_heights

from msbdb.cli.main import cli
from msbdb.database import check_database, footprint_at, open_database, read_changes, read_states, write_build

LATER: list[House] = ROW[1:]
NAMES = [HOSTILE, '"quoted"; a\\\'b', "%s %(x)s :name {0} $1^{$ 🏠 [/red]"]


def run(*words: object) -> str:
    """Run a command and return what it printed."""
    done = CliRunner().invoke(cli, [str(word) for word in words])
    assert done.exit_code == 0, done.output
    return done.stdout


@pytest.mark.parametrize("name", sample(NAMES, 3))
def test_hostile_words_stay_data_through_import_update_state_and_changes(
    target: str, tmp_path: Path, name: str
) -> None:
    """They come back letter by letter, in JSON and in every format; all tables are there, and the check is content."""
    office = footprints(ROW).assign(**{name: [f"{name}{n}" for n in range(8)]})
    office.to_file(tmp_path / "office.geojson", layer=name)
    words = ("import", tmp_path / "office.geojson", "--as", "inventory", "--db", target, "--date", "2015")
    assert json.loads(run(*words, "--layer", name, "--name", name, "--id", name, "--json"))["name"] == name
    write_heights(tmp_path / "later.tif", town_heights(LATER))
    words = ("update", "--ndsm", tmp_path / "later.tif", "--db", target, "--survey", name, "--date", "2021")
    assert json.loads(run(*words, "--json"))["inventory"]["counts"]["demolished"] == 1
    engine = open_database(target)
    now = footprint_at(engine, "2022")
    uid = int(now["uid"].iloc[0])
    run("state", target, uid, "refuted", "--operator", name, "--note", name)
    assert read_states(engine)[["operator", "note"]].to_numpy().tolist() == [[name, name]]
    assert {value[name] for value in now["attributes"]} == {f"{name}{n}" for n in range(1, 8)}
    assert_told(target, tmp_path, name)
    assert set(read_changes(engine)["survey"]) == {name}
    assert {"part", "building_version"} <= set(inspect(engine).get_table_names())
    assert check_database(engine) == []


def assert_told(target: str, folder: Path, name: str) -> None:
    """Hold the outputs of ``changes`` to the words."""
    told = json.loads(run("changes", target, "--survey", name, "--json"))["changes"]
    assert [(row["survey"], row["attributes_before"][name]) for row in told] == [(name, f"{name}0")]
    assert "demolished" in run("changes", target)
    for ending in ("gpkg", "geojson", "csv"):
        run("changes", target, "--out", folder / f"changes.{ending}")
        path = folder / f"changes.{ending}"
        layer = {"layer": "change"} if ending == "gpkg" else {}
        frame: Any = pd.read_csv(path) if ending == "csv" else gpd.read_file(path, **layer)
        assert set(frame["survey"]) == {name}
        [attributes] = frame.loc[frame["kind"] == "demolished", "attributes_before"]
        # GDAL reads JSON in GeoJSON as what it says.
        attributes = attributes if isinstance(attributes, dict) else json.loads(attributes)
        assert attributes[name] == f"{name}0"
    run("changes", target, "--survey", name, "--figure", folder / "changes.png")


@pytest.mark.parametrize("name", sample(NAMES, 3))
def test_hostile_samples_stay_data(target: str, tmp_path: Path, name: str) -> None:
    """Materials, notes and further columns of roof samples."""
    engine = open_database(target, create=True, srid=EPSG)
    write_build(engine, town_build(name, "2020", ROW))
    points = footprints(ROW[:2]).geometry.centroid
    frame = gpd.GeoDataFrame({"material": name, "why": name, name: [name, None]}, geometry=points, crs=UTM)
    frame.to_file(tmp_path / "roofs.geojson", layer=name)
    run(
        "import",
        tmp_path / "roofs.geojson",
        "--as",
        "roof-samples",
        "--db",
        target,
        "--layer",
        name,
        "--map",
        "note=why",
    )
    with engine.connect() as connection:
        rows = connection.execute(text("SELECT material, note FROM roof_sample")).all()
        told = connection.execute(text("SELECT survey, material, samples FROM roof_material_by_class")).all()
    assert [tuple(row) for row in rows] == [(name, name)] * 2
    assert [tuple(row) for row in told] == [(name, name, 2)]
    assert check_database(engine) == []

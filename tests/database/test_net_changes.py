"""The net change between two dates, from the database to the files, on both dialects."""

import json
from collections.abc import Iterator
from pathlib import Path

import geopandas as gpd
import pandas as pd
import pytest
from click.testing import CliRunner
from sqlalchemy import Engine
from support.towns import EPSG, ROW, SOUTH, UTM, WEST, House, town_build

from msbdb import api
from msbdb.cli.main import cli
from msbdb.database import footprint_at, open_database, write_build

APART: list[House] = [(20, 60, 40, 80, 8), (46, 60, 60, 80, 8)]
JOINED: list[House] = [(20, 60, 60, 80, 8)]
RAISED: list[House] = [*ROW[:7], (150, 10, 162, 22, 18)]
LONGER: list[House] = [*ROW[:7], (150, 10, 162, 28, 18)]
SHED: House = (100, 60, 115, 75, 9)

SURVEYS: dict[str, list[House]] = {
    "2020": [*ROW, *APART],
    "2021": [*RAISED, *JOINED, SHED],
    "2022": [*LONGER[1:], *JOINED, SHED],
    "2023": [*LONGER[1:], *APART],
}
"""The last house of the row is raised and then made longer, the first one pulled down; a shed comes and goes; a pair is
joined and parted again."""


@pytest.fixture(scope="module", params=["spatialite", pytest.param("postgis", marks=pytest.mark.postgis)])
def engine(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Engine]:
    """Return the inventory after four surveys, for tests that only read."""
    if request.param == "spatialite":
        place = str(tmp_path_factory.mktemp("net") / "town.sqlite")
    else:
        place = request.getfixturevalue("databases").acquire()
    engine = open_database(place, create=True, srid=EPSG)
    for date, houses in SURVEYS.items():
        write_build(engine, town_build(f"s{date}", date, houses))
        api.advance(engine.url, f"s{date}")
    yield engine
    if request.param == "postgis":
        request.getfixturevalue("databases").release([place])


def run(*words: object) -> str:
    """Run a command and return what it printed."""
    done = CliRunner().invoke(cli, [str(word) for word in words])
    assert done.exit_code == 0, done.output
    return done.output


def place(engine: Engine) -> str:
    """Return a database as the command line takes it."""
    return engine.url.render_as_string(hide_password=False)


def test_many_surveys_are_told_as_one_change(engine: Engine) -> None:
    """What was joined and parted again has the ground of before; the shed is only counted."""
    found = api.changes(place(engine), since="2020", until="2023")
    assert found.counts == {"demolished": 1, "modified": 3, "unchanged": 6}
    assert found.in_between == 1
    table = found.table.set_index("kind")
    raised = table[table["height"]].iloc[0]
    assert raised[["outline", "times", "survey"]].tolist() == [True, 2, "s2022"]
    assert (raised["dh_m"], raised["darea_m2"]) == (pytest.approx(5.0), pytest.approx(72.0))
    assert table.loc["demolished", "h_p90_before"] == pytest.approx(6.0)
    pair = table[table["outline"] & ~table["height"]]
    assert pair["times"].tolist() == [2, 2]
    assert sorted(pair["area_m2_before"]) == pytest.approx([280, 400])
    assert pair["darea_m2"].tolist() == pytest.approx([0, 0])


def test_changes_without_a_first_day_begin_with_the_first_survey(engine: Engine, tmp_path: Path) -> None:
    """The first state is no change: what is gone since is demolished, and the rest is as after the first survey."""
    found, after = api.changes(place(engine)), api.changes(place(engine), since="2020")
    assert (found.counts, found.in_between) == (after.counts, 1)
    columns = ["kind", "uid_before", "uid_after", "version_before", "version_after", "times", "note"]
    assert found.table[columns].equals(after.table[columns])
    assert set(api.changes(place(engine), since="2019", until="2020").counts) == {"new"}
    first = json.loads(run("changes", place(engine), "--survey", "s2020", "--json"))
    assert (first["counts"], first["changes"]) == ({"first seen": 10}, [])
    run("changes", place(engine), "--survey", "s2020", "--figure", tmp_path / "first.png")


def test_the_states_at_both_dates_are_those_of_the_inventory(engine: Engine) -> None:
    """Versions before and after are the ones that were valid then, whatever the period."""
    days = ["2019", "2020", "2021", "2022", "2023", "2024"]
    at = {day: set(footprint_at(engine, day)["version_id"].astype(int)) for day in days}
    for since in days:
        for until in days[days.index(since) + 1 :]:
            table = api.changes(place(engine), since=since, until=until).table
            sides = [set(table[f"version_{side}"].dropna().astype(int)) for side in ("before", "after")]
            if until != "2024" or since != "2023":
                assert sides == [at[since], at[until]]
            else:
                assert table.empty


def test_the_net_change_is_written_and_printed(engine: Engine, tmp_path: Path) -> None:
    """Every format has every row, JSON has what came and went, and --each has the rows of the surveys."""
    db = place(engine)
    period = ("--from", "2020", "--to", "2023")
    told = json.loads(run("changes", db, *period, "--json"))
    assert (told["counts"]["modified"], told["in_between"], len(told["changes"])) == (3, 1, 4)
    assert {row["times"] for row in told["changes"]} == {1, 2}
    assert "new and demolished in between" in run("changes", db, *period)
    for ending in ("gpkg", "geojson", "csv"):
        run("changes", db, *period, "--out", tmp_path / f"net.{ending}")
    assert len(gpd.read_file(tmp_path / "net.gpkg", layer="change")) == len(pd.read_csv(tmp_path / "net.csv")) == 10
    web = json.loads((tmp_path / "net.geojson").read_text())["features"]
    assert {type(feature["properties"]["uid_before"]) for feature in web} == {str}
    run("changes", db, *period, "--figure", tmp_path / "net.png")
    assert (tmp_path / "net.png").stat().st_size > 10_000
    each = json.loads(run("changes", db, *period, "--each", "--json"))
    assert each["in_between"] == 0
    assert each["counts"] == {"demolished": 2, "merged": 2, "modified": 2, "new": 1, "split": 2, "unchanged": 22}
    single = json.loads(run("changes", db, "--survey", "s2021", "--json"))
    assert single["counts"] == {"merged": 2, "modified": 1, "new": 1, "unchanged": 7}


def test_an_area_limits_what_is_counted(engine: Engine, tmp_path: Path) -> None:
    """Buildings that came and went elsewhere are not counted."""
    west, east = WEST + 95, WEST + 120
    for name, north in (("shed", SOUTH + 80), ("nowhere", SOUTH + 58)):
        area = gpd.GeoDataFrame(geometry=gpd.GeoSeries.from_wkt([wkt(west, SOUTH + 55, east, north)]), crs=UTM)
        area.to_file(tmp_path / f"{name}.gpkg")
    found = [api.changes(place(engine), aoi=tmp_path / f"{name}.gpkg") for name in ("shed", "nowhere")]
    assert [(f.counts, f.in_between) for f in found] == [({}, 1), ({}, 0)]


def wkt(west: float, south: float, east: float, north: float) -> str:
    """Return a rectangle."""
    return f"POLYGON(({west} {south}, {east} {south}, {east} {north}, {west} {north}, {west} {south}))"

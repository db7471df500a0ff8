"""What a user does every day with one database: build again, build another place, ask without naming a survey."""

import json
from dataclasses import replace
from pathlib import Path

import geopandas as gpd
import pytest
import rasterio
from click.testing import CliRunner
from simulated import scenes
from simulated.files import write_heights, write_points
from support.towns import EPSG, UTM, House, footprints, town_build, town_heights

import msbdb
from msbdb import api
from msbdb.cli.main import cli
from msbdb.database import BuildBasis, canonical_dump, open_database, store_build
from msbdb.errors import InputError
from msbdb.kept import KeptRun

HERE: list[House] = [(8, 8, 20, 20, 6)]
THERE: list[House] = [(68, 8, 80, 20, 7)]
LATER: list[House] = [(8, 24, 20, 36, 9)]
PLACES = {"here": (HERE, (0, 0, 40, 40)), "there": (THERE, (60, 0, 100, 40)), "later": (LATER, (0, 0, 40, 40))}
"""The houses and the extent of each file: two places side by side, and one of them years later."""

TWO = ("--extract", "multiscale,flatregions")


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Return files of the same name in three folders: two places, and one of them years later."""
    paths = {}
    for place, (houses, bounds) in PLACES.items():
        folder = tmp_path_factory.mktemp("surveys") / place
        folder.mkdir()
        paths[place] = write_heights(folder / "ndsm.tif", town_heights(houses, bounds=bounds))
    return paths


def run(*words: object, code: int = 0) -> str:
    """Run a command and return all that it printed."""
    done = CliRunner().invoke(cli, [str(word) for word in words])
    assert done.exit_code == code, done.output
    return done.output


def surveys(target: str) -> list[str]:
    """Return the names of a database's surveys."""
    return [record["survey"] for record in api.info(target)["runs"]]


def content(target: str) -> list[str]:
    """Return all that a database holds."""
    engine = open_database(target)
    lines = list(canonical_dump(engine, provenance=True))
    engine.dispose()
    return lines


def test_files_of_one_name_from_two_places_are_two_surveys(target: str, files: dict[str, Path]) -> None:
    """A name like ndsm holds for any place, so that the folder's is added; the same build again changes nothing."""
    for place in ("here", "there"):
        run("build", "--ndsm", files[place], "--db", target, *TWO)
    assert surveys(target) == ["here-ndsm", "there-ndsm"]
    before = content(target)
    assert "unchanged: it has this build already" in run("build", "--ndsm", files["here"], "--db", target, *TWO)
    assert content(target) == before


def test_another_file_under_a_name_that_is_taken_is_refused(
    target: str, files: dict[str, Path], tmp_path: Path
) -> None:
    """The message names both ways out; --replace replaces, and says what."""
    words = ("--db", target, "--survey", "town", *TWO)
    run("build", "--ndsm", files["here"], *words)
    before = content(target)
    told = run("build", "--ndsm", files["there"], *words, code=1)
    assert "is of other files: it has ndsm.tif, and this build ndsm.tif with another content. Nothing was" in told
    assert "--survey there-ndsm, or replace the survey by --replace" in told
    assert content(target) == before
    with pytest.raises(InputError, match="--replace"):
        api.update(ndsm=files["there"], db=target, survey="town", date="2020", extract=["multiscale", "flatregions"])
    assert content(target) == before
    parcels = tmp_path / "parcels.gpkg"
    footprints(HERE).to_file(parcels)
    assert "this build adds parcels.gpkg" in run("build", "--ndsm", files["here"], "--parcels", parcels, *words, code=1)
    told = run("build", "--ndsm", files["there"], *words, "--replace")
    assert "'town' was there and is replaced: other files (was ndsm.tif)" in told
    assert surveys(target) == ["town"]


def test_an_update_with_corrected_files_asks_for_replace(target: str, files: dict[str, Path]) -> None:
    """The survey of a delivery that was corrected is replaced, and so is its place in the inventory."""
    words = ("--db", target, "--survey", "town", "--date", "2020", "--extract", "multiscale")
    run("update", "--ndsm", files["here"], *words)
    before = content(target)
    assert "--replace" in run("update", "--ndsm", files["later"], *words, code=1)
    assert content(target) == before
    report = json.loads(run("update", "--ndsm", files["later"], *words, "--replace", "--json"))
    assert report["inventory"]["status"] == "replaced"


def test_the_same_files_with_other_values_replace_with_a_notice(target: str, files: dict[str, Path]) -> None:
    """The notice lists what is other than before."""
    words = ("build", "--ndsm", files["here"], "--db", target, "--survey", "town", "--extract", "multiscale")
    run(*words, "--date", "2020")
    told = run(*words, "--set", "surface.mask_m=2.5")
    assert "'town' was there and is replaced: date none (was 2020), surface.mask_m 2.5 (was 2.0)." in told


def test_fewer_detectors_are_refused_with_what_they_would_delete(target: str, files: dict[str, Path]) -> None:
    """With --replace they are deleted; more detectors need no option."""
    words = ("build", "--ndsm", files["here"], "--db", target, "--survey", "town")
    run(*words, "--extract", "multiscale")
    run(*words, *TWO)
    before = content(target)
    told = run(*words, "--extract", "multiscale", code=1)
    assert "results that a build with multiscale deletes: 1 flat region of flatregions. Nothing was changed" in told
    assert "--replace" in told
    assert content(target) == before
    told = run(*words, "--extract", "multiscale", "--replace")
    assert "detectors multiscale (was flatregions, multiscale)" in told
    assert " 0 flat regions" in told


def test_what_another_user_wrote_meanwhile_is_not_replaced(target: str) -> None:
    """The transaction checks again: other files, and the same files in another place."""
    first = town_build("town", "2020", HERE, bounds=PLACES["here"][1])
    moved = town_build("town", "2020", THERE, bounds=PLACES["there"][1])
    sources = tuple(replace(source, sha256="cd" * 32) for source in first.survey.sources)
    other = replace(first, survey=replace(first.survey, sources=sources))
    store_build(target, first)
    before = content(target)
    for build, expected in ((moved, "in 500000.0 to 500040.0 east"), (other, "of other files")):
        with pytest.raises(InputError, match=expected):
            store_build(target, build, basis=BuildBasis(replace=False))
        assert content(target) == before
    assert store_build(target, first, basis=BuildBasis(replace=False)).status == "unchanged"


def test_a_file_without_a_crs_takes_that_of_the_database(target: str, tmp_path: Path) -> None:
    """Made by 'db create --crs': a build, an import and samples need none, and a notice names what was assumed."""
    bare = write_heights(tmp_path / "bare.tif", town_heights(HERE, bounds=PLACES["here"][1]))
    with rasterio.open(bare, "r+") as image:
        image.crs = rasterio.crs.CRS()
    words = ("build", "--ndsm", bare, "--db", target, "--extract", "multiscale")
    assert "bare.tif states no CRS. State it with --crs" in run(*words, code=1)
    run("db", "create", target, "--crs", EPSG)
    notice = f"bare.tif states no CRS; that of the database is used, '{UTM.name}' (EPSG:{EPSG}). State another with"
    assert notice in run(*words)
    record = api.info(target)["runs"][0]
    assert record["survey_record"]["epsg"] == EPSG
    assert any(notice in kept for kept in record["notices"])
    assert "unchanged" in run(*words)
    footprints(HERE).to_file(tmp_path / "cadastre.shp")
    (tmp_path / "cadastre.prj").unlink()
    told = run("import", tmp_path / "cadastre.shp", "--as", "inventory", "--db", target)
    assert "cadastre.shp states no CRS; that of the database is used" in told


def test_a_single_path_serves_where_a_list_is_expected(target: str, tmp_path: Path) -> None:
    """As a path or as text, for points and images; one detector may be named without a list, too."""
    cloud = scenes.podium_tower(density=1.0).points
    points = write_points(tmp_path / "town.laz", cloud)
    report = msbdb.build(str(points), db=target, extract="multiscale")
    assert (report.survey, report.changed) == ("town", True)
    assert not msbdb.build([points], db=target, extract=["multiscale"]).changed
    again = api.update(points, db=target, survey="town", date="2020", extract="multiscale")
    assert again.inventory.status == "created"
    assert api.update([points], db=target, survey="town", date="2020", extract=["multiscale"]).build is None


def test_completion_shows_the_public_functions_and_nothing_else() -> None:
    """What dir() lists is what the documentation has."""
    assert dir(msbdb) == sorted(msbdb.__all__)
    assert {"advance", "build", "changes", "import_inventory", "open", "set_state", "update", "why"} <= set(dir(msbdb))
    own = {name for name in api.__all__ if name not in ("evaluate", "export", "view")}
    assert {name for name in own if name[0].islower()} <= set(dir(msbdb))


@pytest.fixture(scope="module")
def towns() -> dict[str, KeptRun]:
    """Return two surveys side by side, and a later one of the first place."""
    dates = {"here": "2020", "there": "2021-05", "later": "2022"}
    return {name: town_build(name, dates[name], houses, bounds=bounds) for name, (houses, bounds) in PLACES.items()}


def layers(path: Path) -> dict[str, gpd.GeoDataFrame]:
    """Return the layers of a GeoPackage by name."""
    listed = gpd.list_layers(path).dropna()  # the tables of styles and projects have no geometry
    return {name: gpd.read_file(path, layer=name) for name in listed["name"]}


def test_several_surveys_are_exported_and_drawn_without_a_name(
    target: str, towns: dict[str, KeptRun], tmp_path: Path
) -> None:
    """Without an inventory all of them, the newest first, with the survey of each row, in every format."""
    for name in ("here", "there"):
        store_build(target, towns[name])
    told = run("export", target, tmp_path / "town.gpkg")
    assert "2 surveys: there, here. All are taken, the newest first; --survey NAME takes one" in told.replace("\n", " ")
    found = layers(tmp_path / "town.gpkg")
    assert list(found) == ["footprint", "part", "flat_region", "candidate_region"]
    assert found["footprint"]["survey"].tolist() == found["part"]["survey"].tolist() == ["there", "here"]
    run("export", target, tmp_path / "one.gpkg", "--survey", "here")
    assert layers(tmp_path / "one.gpkg")["footprint"]["survey"].tolist() == ["here"]
    for ending, column in (("shp", "SURVEY"), ("geojson", "survey")):
        run("export", target, tmp_path / f"town.{ending}")
        assert gpd.read_file(tmp_path / f"town.{ending}")[column].tolist() == ["there", "here"]
    assert "Too far" not in run("view", target, "--out", tmp_path / "near.png")
    assert (tmp_path / "near.png").stat().st_size > 10_000
    far = town_build("far", "2019", [(5008, 8, 5020, 20, 7)], bounds=(5000, 0, 5040, 40))
    store_build(target, far)
    told = run("view", target, "--out", tmp_path / "far.png", "--what", "area3d").replace("\n", " ")
    assert "Too far away for this map, and not drawn: far. --survey NAME draws one" in told


@pytest.mark.long
def test_the_current_inventory_is_exported_where_there_is_one(
    target: str, towns: dict[str, KeptRun], tmp_path: Path
) -> None:
    """What was demolished is left out, imported buildings and operators' decisions are in, and parts fit."""
    office = footprints([HERE[0], (100, 8, 112, 20, 5)])
    office.to_file(tmp_path / "cadastre.gpkg")
    run("db", "create", target, "--crs", EPSG)
    run("import", tmp_path / "cadastre.gpkg", "--as", "inventory", "--db", target, "--date", "2015-01-01")
    run("export", target, tmp_path / "imported.gpkg")
    run("view", target, "--out", tmp_path / "imported.png")
    assert [len(rows) for rows in layers(tmp_path / "imported.gpkg").values()] == [2, 0, 0, 0]
    for name in ("here", "there", "later"):
        store_build(target, towns[name])
        api.advance(target, name)
    told = run("export", target, tmp_path / "town.gpkg")
    assert "those of the current inventory" in told
    found = layers(tmp_path / "town.gpkg")
    assert sorted(found["footprint"]["survey"].fillna("")) == ["", "later", "there"]
    assert found["footprint"]["uid"].is_unique
    assert sorted(found["part"]["survey"]) == ["later", "there"]
    assert found["part"]["building_id"].isin(found["footprint"]["building_id"]).all()
    imported = found["footprint"].loc[found["footprint"]["survey"].isna()]
    assert json.loads(imported["attributes"].iloc[0]) == {"HGT": 5.0}
    run("state", target, int(imported["uid"].iloc[0]), "refuted", "--operator", "ann")
    told = run("export", target, tmp_path / "town.shp")
    assert "1 building of the inventory has no parts" in told.replace("\n", " ")
    run("export", target, tmp_path / "again.gpkg")
    states = layers(tmp_path / "again.gpkg")["footprint"].set_index("uid")["state"]
    assert states[imported["uid"].iloc[0]] == "refuted"
    run("view", target, "--out", tmp_path / "town.png")


@pytest.mark.parametrize("ending", ["gpkg", "shp", "geojson"])
def test_an_empty_database_gives_an_empty_valid_file(target: str, tmp_path: Path, ending: str) -> None:
    """With the columns, the CRS and a notice; the map is empty, too."""
    run("db", "create", target, "--crs", EPSG)
    out = tmp_path / f"none.{ending}"
    assert "no survey and no inventory yet; the output is empty" in run("export", target, out).replace("\n", " ")
    back = gpd.read_file(out, layer="part" if ending == "gpkg" else None)
    assert len(back) == 0
    assert back.crs is not None
    if ending == "gpkg":
        assert list(layers(out)) == ["footprint", "part", "flat_region", "candidate_region"]
        run("view", target, "--out", tmp_path / "none.png")
        assert (tmp_path / "none.png").stat().st_size > 1_000

"""Footprints that an office has, measured on a survey: a row each, whatever stands there, on both dialects."""

import json
import re
import shlex
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import shapely
from click.testing import CliRunner
from shapely import box
from simulated import scenes
from simulated.files import write_points
from sqlalchemy import Engine
from support.tiledtown import TILE_M, write_town
from support.towns import EPSG, ROW, SOUTH, WEST, House, footprints, town_build

import msbdb
from msbdb import api
from msbdb.api import advance
from msbdb.cli.main import cli
from msbdb.database import (
    BuildBasis,
    check_database,
    footprint_at,
    opened,
    read_buildings,
    read_survey,
    write_build,
)
from msbdb.errors import DatabaseError, InputError, MsbdbWarning
from msbdb.labels import Box
from msbdb.run.inventory import footprintcells
from msbdb.run.inventory.footprintfile import FORMATS, write_footprints
from msbdb.run.inventory.measure import check_footprints, measure_footprints, take_measures

README = Path(__file__).resolve().parents[2] / "README.md"

SHED: House = (60, 60, 62.5, 63, 3)
EMPTY: House = (60, 80, 75, 95, 0)
AWAY: House = (900, 80, 915, 95, 0)
LARGE: House = (29, 9, 43, 23, 7)
GIVEN: list[House] = [*ROW[:7], EMPTY, AWAY, SHED, LARGE]
"""What the office has: seven houses of the row of eight, an empty lot, one far away, a shed, and one drawn again."""


@pytest.fixture(scope="module")
def srid() -> int:
    """Return the town's."""
    return EPSG


@pytest.fixture(scope="module")
def cadastre(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the office's footprints as a file, with columns of its own."""
    path = tmp_path_factory.mktemp("office") / "cadastre.gpkg"
    frame = footprints(GIVEN)
    frame.assign(number=[f"H{n}" for n in range(len(GIVEN))], storeys=9).to_file(path)
    return path


def take(engine: Engine, cadastre: Path, out: Path | None = None, name: str = "cadastre"):
    """Measure the office's footprints on the first survey."""
    target = engine.url.render_as_string(hide_password=False)
    return take_measures(
        target, cadastre, "s1", name=name, layer=None, id_column="number", crs=None, out=out, built=None
    )


@pytest.mark.filterwarnings("ignore::msbdb.errors.MsbdbWarning")
def test_every_footprint_has_its_row_and_later_surveys_update_it(
    engine: Engine, cadastre: Path, tmp_path: Path
) -> None:
    """Known heights come back; states say what stands there; own columns are kept; the missed house is listed."""
    write_build(engine, town_build("s1", "2020-01-01", [*ROW, SHED]))
    with pytest.warns(MsbdbWarning, match="1 footprint is mostly outside"):
        report = take(engine, cadastre, tmp_path / "measured.gpkg")
    assert (report.status, report.footprints, report.others, report.unseen) == ("created", 11, 1, 1)
    assert sum(report.states.values()) == 11
    now = footprint_at(engine, "2020-01-01")
    own = now[now["attributes"].notna()]
    own = own.set_index(own["attributes"].map(lambda value: value["number"])).sort_index()
    assert set(own.index) == {f"H{n}" for n in range(11)}
    assert {value["storeys"] for value in own["attributes"]} == {9}
    houses = own.loc[[f"H{n}" for n in range(7)]]
    assert houses["eaves"].tolist() == pytest.approx([house[4] for house in ROW[:7]], abs=0.01)
    assert houses["ridge"].tolist() == pytest.approx([house[4] for house in ROW[:7]], abs=0.01)
    assert houses["storeys"].tolist() == [2, 2, 3, 3, 3, 4, 4]
    assert houses["area_m2"].tolist() == pytest.approx([144] * 7)
    assert houses["volume_m3"].tolist() == pytest.approx([144 * house[4] for house in ROW[:7]], rel=0.01)
    assert (houses["state"] == read_buildings(engine, "s1")["state"].iloc[0]).all()
    assert (houses["parts"] >= 1).all()
    assert own.loc[["H7", "H8", "H9"], "state"].tolist() == ["refuted", "unsure", "unsure"]
    assert own.loc[["H7", "H8", "H9"], "storeys"].isna().all()
    assert own.loc["H9", "h_p90"] == pytest.approx(3)
    assert np.isnan(own.loc["H8", "h_p90"])
    assert own.loc["H10", "eaves"] == pytest.approx(7, abs=0.01), "a footprint over another one has its own row"
    assert own.loc["H10", "attributes"]["msbdb"]["building_share"] == pytest.approx(144 / 196, abs=0.02)
    [missed] = now[now["attributes"].isna()].itertuples()
    assert missed.geometry.intersects(box(WEST + 151, SOUTH + 11, WEST + 161, SOUTH + 21))
    assert missed.eaves == pytest.approx(13, abs=0.01)
    written = gpd.read_file(tmp_path / "measured.gpkg", layer="footprint")
    assert written["number"].tolist() == [f"H{n}" for n in range(11)]
    assert set(written["storeys_given"]) == {9}
    assert written["storeys"].tolist()[:3] == [2, 2, 3]
    assert len(gpd.read_file(tmp_path / "measured.gpkg", layer="without_footprint")) == 1
    assert take(engine, cadastre).status == "unchanged"
    assert not [finding for finding in check_database(engine) if finding.check not in ("overlap", "overlaps")]
    raised = [*ROW[:3], (*ROW[3][:4], 15.0), *ROW[4:], SHED]
    write_build(engine, town_build("s2", "2022-01-01", raised))
    counts = advance(engine.url, "s2").counts
    assert counts["modified"] == 1
    assert counts["demolished"] == 1, "the empty lot"
    left = footprint_at(engine, "2022-01-01")
    assert set(now["uid"]) - set(left["uid"]) == set(own.loc[["H7"], "uid"])


@pytest.mark.filterwarnings("ignore::msbdb.errors.MsbdbWarning")
def test_footprints_are_refused_where_the_inventory_has_others(engine: Engine, cadastre: Path) -> None:
    """Before the survey is built, and with both ways out."""
    write_build(engine, town_build("s1", "2020-01-01", [*ROW, SHED]))
    target, how = engine.url.render_as_string(hide_password=False), {"layer": None, "id_column": "number", "crs": None}
    check_footprints(target, cadastre, name="cadastre", **how)
    take(engine, cadastre)
    check_footprints(target, cadastre, name="cadastre", **how)
    with pytest.raises(InputError, match="'msbdb update'"):
        check_footprints(target, cadastre, name="other", **how)


@pytest.mark.filterwarnings("ignore::msbdb.errors.MsbdbWarning")
def test_all_of_the_survey_may_have_footprints(engine: Engine, tmp_path: Path) -> None:
    """Then no other building is listed, and none of the columns is lost."""
    write_build(engine, town_build("s1", "2020-01-01", ROW))
    found = measure_footprints(engine, "s1", footprints(ROW))
    assert len(found.others) == 0
    assert set(found.footprints.columns) >= {"eaves", "storeys", "state", "point_share", "building_share"}
    assert found.footprints["building_share"].min() == pytest.approx(1)
    footprints([AWAY]).assign(number=1).to_file(tmp_path / "away.gpkg")
    with pytest.raises(InputError, match="within the survey"):
        take(engine, tmp_path / "away.gpkg")


@pytest.mark.parametrize("ending", FORMATS)
def test_a_user_has_columns_of_the_same_names(tmp_path: Path, ending: str) -> None:
    """Names of measures in any case, of the file itself, and those that stand in for them: each column is kept."""
    given = footprints(ROW[:2]).assign(storeys=9, storeys_given=8, State="x", fid=[7, 7], geom="g", Number=["a", "b"])
    measures = footprints(ROW[:2]).assign(state="refuted", storeys=2, ridge=6.49999, building_id=2**62)
    write_footprints(measures, measures[:0], given, tmp_path / f"measured{ending}")
    written = gpd.read_file(tmp_path / f"measured{ending}", **({"layer": "footprint"} if ending == ".gpkg" else {}))
    own = {"storeys_given_given": 9, "storeys_given": 8, "State_given": "x", "fid_given": 7, "geom_given": "g"}
    for name, value in {**own, "storeys": 2, "state": "refuted", "building_id": 2**62}.items():
        assert set(written[name].astype(str)) == {str(value)}, name
    assert written["Number"].tolist() == ["a", "b"]
    assert set(written["ridge"].astype(float)) == {6.5}


def test_the_command_of_the_readme_measures_a_cadastre(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From points: heights of a row of houses to a decimetre, the share of points, and the one that the file lacks."""
    monkeypatch.chdir(tmp_path)
    scene = scenes.row_houses(density=2.0, gap_m=4.0)
    write_points(tmp_path / "town.laz", replace(scene.points, colours=None, colour_names=()))
    east, north = scene.world.origin
    given = scene.world.blocks[1:]
    shapes = [box(east + b.west, north + b.south, east + b.west + b.width, north + b.south + b.depth) for b in given]
    frame = gpd.GeoDataFrame({"number": [b.name for b in given]}, geometry=shapes, crs=scene.points.crs)
    frame.to_crs(4326).to_file("cadastre.gpkg")
    section = README.read_text(encoding="utf-8").split("\n## Measure your own footprints\n")[1]
    words = [*shlex.split(section.split("```")[1].removeprefix("sh"))[1:], "--json"]
    words += ["--extract", "multiscale,flatregions"]
    done = CliRunner().invoke(cli, words)
    assert done.exit_code == 0, done.output
    report = json.loads(done.stdout)
    assert (report["footprints"], report["others"], report["unseen"]) == (11, 1, 0)
    assert report["states"] == {"confirmed": 11}
    own = gpd.read_file("measured.gpkg", layer="footprint")
    assert own["number"].tolist() == [b.name for b in given]
    assert np.abs(own["eaves"] - 6.5).max() < 0.15
    assert np.abs(own["z_ground"] - scenes.DATUM_M).max() < 0.15
    assert own["storeys"].tolist() == [2] * 11
    assert own["point_share"].min() > 0.9
    assert own["points"].min() > 100
    named = set(re.findall(r"`(\w+)`", section.split("\n## ")[0])) - {"confirmed", "unsure", "refuted"}
    assert named <= set(own.columns)
    assert len(named) >= 7
    again = CliRunner().invoke(cli, [*words, "--overwrite"])
    assert again.exit_code == 0, again.output
    assert (json.loads(again.stdout)["status"], json.loads(again.stdout)["build"]) == ("unchanged", None)
    assert "--overwrite" in CliRunner().invoke(cli, words).output
    written = CliRunner().invoke(cli, [*words[:-1], "multiscale,flatregions", "--out", "measured.csv"])
    assert written.exit_code == 0, written.output
    rows = gpd.pd.read_csv("measured.csv")
    assert rows["has_footprint"].sum() == 11
    assert rows["number"].isna().sum() == 1
    kinds = Path("measured.csvt").read_text(encoding="utf-8").strip().replace('"', "").split(",")
    assert dict(zip(rows.columns, kinds, strict=True))["building_id"] == "String"
    assert shapely.area(shapely.from_wkt(rows["WKT"])).sum() > own.area.sum()


@pytest.mark.parametrize("call", [api.measure, api.update])
def test_an_unknown_option_names_the_function_that_was_called(call: Callable[..., object], tmp_path: Path) -> None:
    """As Python does; nothing is read or made."""
    given = {"db": tmp_path / "town.sqlite", "survey": "spring", "date": "2020-04-01", "nonsense": 1}
    with pytest.raises(TypeError, match=rf"^{call.__name__}\(\) got an unexpected keyword argument 'nonsense'$"):
        call("here.gpkg", "here.laz", **given) if call is api.measure else call("here.laz", **given)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("how", [{}, {"tile": TILE_M}], ids=["one", "tiles"])
def test_windows_of_the_rasters_change_no_measure(tmp_path: Path, how: dict[str, float]) -> None:
    """A footprint a window, all in one, and some in each give one result to the last bit, of whole rasters and pieces.

    The footprints overlap, and reach beyond the survey.
    """
    msbdb.build(write_town(tmp_path / "points"), db=tmp_path / "town.sqlite", survey="town", **how)
    rng = np.random.default_rng(3)
    with opened(tmp_path / "town.sqlite") as engine:
        detected = read_buildings(engine, "town")
        west, south, east, north = read_survey(engine, "town").bounds
        corners = rng.uniform((west - 15, south - 15), (east + 5, north + 5), (40, 2))
        lots = [box(x, y, x + w, y + h) for (x, y), (w, h) in zip(corners, rng.uniform(1, 18, (40, 2)), strict=True)]
        moved = detected.geometry.translate(2.2, -1.7)
        shapes = [*lots, *moved, *detected.geometry.buffer(1.5), box(east + 50, south, east + 60, north)]
        frame = gpd.GeoDataFrame(geometry=shapes, crs=detected.crs)
        whole, *others = (measure_footprints(engine, "town", frame, side=side) for side in (1_000_000, 1, 37))
    assert whole.footprints["state"].nunique() == 3
    assert whole.footprints["z_ground"].notna().sum() > 20
    assert len(whole.others) == 0
    for found in others:
        pd.testing.assert_frame_equal(found.footprints, whole.footprints, check_exact=True)


def test_a_window_without_a_footprint_beside_gives_the_buildings_that_have_none(tmp_path: Path) -> None:
    """Detected buildings are looked at window by window, too."""
    msbdb.build(write_town(tmp_path / "points"), db=tmp_path / "town.sqlite", survey="town")
    with opened(tmp_path / "town.sqlite") as engine:
        detected = read_buildings(engine, "town")
        frame = gpd.GeoDataFrame(geometry=[detected.geometry.iloc[0].buffer(-2)], crs=detected.crs)
        whole, small = (measure_footprints(engine, "town", frame, side=side) for side in (1_000_000, 1))
    assert len(whole.others) >= len(detected) - 1
    pd.testing.assert_frame_equal(small.others, whole.others, check_exact=True)


def test_a_survey_that_others_replace_meanwhile_is_no_basis(engine: Engine, cadastre: Path, monkeypatch) -> None:
    """The command says so, and writes nothing."""
    write_build(engine, town_build("s1", "2020-01-01", [*ROW, SHED]))
    inner = footprintcells.SurveyCells.read

    def replaced(self: footprintcells.SurveyCells, window: Box) -> footprintcells.WindowCells:
        write_build(engine, town_build("s1", "2020-01-01", ROW), basis=BuildBasis(replace=True))
        return inner(self, window)

    monkeypatch.setattr(footprintcells.SurveyCells, "read", replaced)
    with pytest.raises(DatabaseError, match="Others replaced"):
        take(engine, cadastre)
    assert len(footprint_at(engine, "2020-01-01")) == 0

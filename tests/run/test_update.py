"""Surveys brought into the inventory by the pipeline: from points, twice, after an interruption, and with labels."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import shapely
from simulated import scenes
from simulated.files import write_points
from support.sizes import sample
from support.towns import EPSG, ROW, town_build

import msbdb
from msbdb import api
from msbdb.database import canonical_dump, footprint_at, open_database, write_build
from msbdb.errors import InputError
from msbdb.params import profile, with_values
from msbdb.run.inventory import borders
from msbdb.run.inventory import update as module
from msbdb.tables import HEIGHTS

ONLY = {"extract": ("multiscale",)}
SPRING = {"survey": "spring", "date": "2024-04-20", **ONLY}


@pytest.fixture(scope="module")
def points(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the points of a small scene, without colours."""
    cloud = replace(scenes.podium_tower().points, colours=None, colour_names=())
    return write_points(tmp_path_factory.mktemp("points") / "town.laz", cloud)


@pytest.fixture(scope="module")
def spring(points: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a database that one update made, which no test changes."""
    db = tmp_path_factory.mktemp("spring") / "town.sqlite"
    report = api.update([points], db=db, **SPRING)
    assert report.build is not None
    assert report.inventory.counts == {"new": report.build.buildings, "versions": report.build.buildings}
    return db


def dump(db: Path) -> list[str]:
    """Return the content, with all that tells of files."""
    engine = open_database(db)
    lines = list(canonical_dump(engine, provenance=True))
    engine.dispose()
    return lines


def test_an_update_is_a_build_and_an_advance(points: Path, spring: Path, tmp_path: Path) -> None:
    """Both ways end in the same content, and a repeat builds nothing."""
    one = shutil.copy(spring, tmp_path / "one.sqlite")
    msbdb.build([points], db=tmp_path / "two.sqlite", **SPRING)
    assert api.advance(tmp_path / "two.sqlite", "spring").status == "created"
    assert dump(one) == dump(tmp_path / "two.sqlite")
    again = api.update([points], db=one, **SPRING)
    assert (again.build, again.inventory.status) == (None, "unchanged")
    with msbdb.open(one) as opened:
        found, versions = opened.buildings(), footprint_at(opened.engine, "2024-04-20")
    shown = [name for name in HEIGHTS if name in versions]
    assert len(shown) == len(HEIGHTS) - 2
    assert versions[shown].notna().all(axis=None)
    for name in shown:
        assert sorted(versions[name]) == sorted(found[name]), name
    assert dump(one) == dump(tmp_path / "two.sqlite")


@pytest.mark.parametrize(
    "other", sample([{"z_unit": "m"}, {"params": {"scale": {"merge_slivers": False}}}, {"date": "2024-05"}], 3)
)
def test_other_files_or_values_build_the_survey_again(
    points: Path, spring: Path, tmp_path: Path, other: dict[str, object]
) -> None:
    """What decides of a build is compared, what was stated by the user included."""
    db = shutil.copy(spring, tmp_path / "town.sqlite")
    if "params" in other:
        other = {"params": with_values(profile(), other["params"])}
    report = api.update([points], db=db, **{**SPRING, **other})
    assert report.build is not None
    assert report.inventory.status == "replaced"


def test_an_update_without_a_date_is_refused_before_any_work(points: Path, tmp_path: Path) -> None:
    """The message names the option."""
    with pytest.raises(InputError, match="--date"):
        api.update([points], db=tmp_path / "town.sqlite", survey="spring", date="")
    assert not (tmp_path / "town.sqlite").exists()


def test_an_interruption_between_build_and_advance_is_repaired_by_repeating(
    points: Path, spring: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The build stays, and the repeat only advances."""
    with monkeypatch.context() as patch:

        def killed(*_: object, **__: object) -> None:
            raise KeyboardInterrupt

        patch.setattr(module, "write_advance", killed)
        with pytest.raises(KeyboardInterrupt):
            api.update([points], db=tmp_path / "town.sqlite", **SPRING)
    assert footprint_at(open_database(tmp_path / "town.sqlite"), "2025").empty
    report = api.update([points], db=tmp_path / "town.sqlite", **SPRING)
    assert (report.build, report.inventory.status) == (None, "created")
    assert dump(tmp_path / "town.sqlite") == dump(spring)


@pytest.mark.long
def test_an_update_is_computed_again_when_others_change_the_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between reading and writing another survey is applied; the update sees its buildings."""
    db = tmp_path / "town.sqlite"
    engine = open_database(db, create=True, srid=EPSG)
    write_build(engine, town_build("one", "2020", ROW))
    write_build(engine, town_build("two", "2021", ROW))
    compare = module.compare
    seen = []

    def compared(before, *rest, **options):
        seen.append(len(before))
        if len(seen) == 1:
            api.advance(db, "one")
        return compare(before, *rest, **options)

    monkeypatch.setattr(module, "compare", compared)
    assert api.advance(db, "two").counts == {"unchanged": 8, "versions": 0}
    assert seen == [0, 0, 8]


@pytest.mark.long
def test_the_ground_beneath_a_block_is_no_change_of_its_roofs(tmp_path: Path) -> None:
    """Surveys interpolate it 2.5 m apart, from zeros of their own; what rose by the levels of its roof is modified."""
    db, bounds = tmp_path / "town.sqlite", (0.0, 0.0, 180.0, 32.0)
    raised = [(*ROW[0][:4], 11.0), *ROW[1:]]
    engine = open_database(db, create=True, srid=EPSG)
    surveys = (("one", ROW, 0.0, 0, 0), ("two", ROW, 0.5, 250, 4312), ("three", raised, 0.0, 0, -700))
    for year, (name, houses, shift, deeper_cm, zero_cm) in enumerate(surveys, 2020):
        build = town_build(name, str(year), houses, bounds=bounds, shift=shift)
        terrain = np.zeros(build.rasters.heights_cm.shape, dtype=np.int32)
        terrain[:, 280:] = deeper_cm
        heights = np.maximum(build.rasters.heights_cm - terrain, 0)
        rasters = replace(build.rasters, heights_cm=heights, terrain_cm=terrain + zero_cm)
        build.frames["building"]["area_m2"] += 3.0  # a fitted outline has not the area of its cells
        write_build(engine, replace(build, rasters=rasters))
    engine.dispose()
    assert api.advance(db, "one").counts == {"new": 8, "versions": 8}
    two = api.advance(db, "two")
    assert two.offset["dx_m"] == pytest.approx(0.5)
    assert two.counts == {"unchanged": 8, "versions": 0}
    assert api.advance(db, "three").counts == {"modified": 1, "unchanged": 7, "versions": 1}
    row = api.changes(db, since="2021-06-01").table.query("kind == 'modified'").iloc[0]
    assert (row["outline"], row["height"], row["darea_m2"], row["iou"]) == (False, True, 0.0, pytest.approx(1.0))


def test_operators_labels_survive_that_a_survey_is_built_again(points: Path, tmp_path: Path) -> None:
    """Labels of classes that are the same stay, others are told; building once more changes nothing."""
    db = tmp_path / "town.sqlite"
    msbdb.build([points], db=db, **SPRING)
    number = int(api.classes(db).query("source == 'structure'")["speindex"].min())
    msbdb.relabel(db, {number: "building"})
    labelled = dump(db)
    report = msbdb.build([points], db=db, **SPRING)
    assert not report.changed
    assert dump(db) == labelled
    coarse = with_values(profile(), {"scale": {"merge_slivers": False}})
    msbdb.build([points], db=db, params=coarse, **SPRING)
    table = api.classes(db).set_index("speindex")
    assert table.loc[number, ["label", "labelled_by"]].tolist() == ["building", "operator"]
    wide = with_values(profile(), {"surface": {"cell_m": 1.0}})
    report = msbdb.build([points], db=db, params=wide, **SPRING)
    assert any(f"label 'building' of class {number} was not kept" in sentence for sentence in report.notices)
    assert not msbdb.build([points], db=db, params=wide, **SPRING).changed
    assert np.all(api.classes(db)["labelled_by"] == "automatic")


@pytest.mark.parametrize("level_m", [20.43, 8.1, 12.35])
def test_a_level_roof_that_crosses_a_border_has_its_ridge_at_its_eaves(level_m: float) -> None:
    """The ridge above the ground is a difference, which by rounding may lie below the eaves: no database takes that."""
    names = {*borders.HIGHEST, *borders.LOWEST, *borders.MEANS, *borders.COUNTS, "volume_m3"}
    for ground_m in np.arange(0, 300) / 100:
        eaves_m = round(level_m - ground_m, 2)
        levels = {"z_ground": ground_m, "z_eaves": level_m, "z_ridge": level_m, "eaves": eaves_m, "ridge": eaves_m}
        row = dict.fromkeys(names, 0.9) | levels | {"area_m2": 25.0, "state": "confirmed"}
        found = borders.combined(pd.DataFrame([row | {"geometry": shapely.box(0, 0, 5, 5)}]), shapely.box(0, 0, 5, 5))
        assert found["ridge"] >= found["eaves"]
        assert found["ridge"] == pytest.approx(eaves_m)

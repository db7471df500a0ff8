"""The living inventory on both dialects: versions, changes, identity, order, repeats, and what people say."""

import shutil
import subprocess
import threading
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import pandas as pd
import pytest
from sqlalchemy import Engine, text
from support.towns import EPSG, ROW, SOUTH, WEST, House, footprints, town_build

from msbdb.api import advance, info
from msbdb.database import (
    canonical_dump,
    check_database,
    downgrade_schema,
    footprint_at,
    open_database,
    read_changes,
    read_history,
    read_states,
    run_example,
    upgrade_schema,
    write_build,
    write_import,
    write_samples,
    write_state,
)
from msbdb.database.history.versions import MEASURES
from msbdb.database.schema.sqltables import METADATA
from msbdb.errors import InputError, LoadError
from msbdb.kept import KeptRun
from msbdb.run.inventory.update import MEASURED_FIRST

LATER: list[House] = [*ROW[1:7], (150, 10, 162, 28, 13), (60, 60, 75, 75, 9)]
"""The first house of the row is gone, the last one is longer, and a new one stands apart."""


@cache
def built(name: str, date: str, houses: tuple[House, ...], shift: float = 0.0, version: str = "1") -> KeptRun:
    """Return a build of a survey, made once."""
    return town_build(name, date, list(houses), shift=shift, version=version)


FIRST = ("s1", "2020-01-01", tuple(ROW))
SECOND = ("s2", "2021-05", tuple(LATER))

COLUMNS = METADATA.tables["building_version"].columns.keys()
SAME_AGAIN = ", ".join("version_id + 1" if name == "version_id" else name for name in COLUMNS)


@pytest.fixture(scope="module")
def srid() -> int:
    """Return the town's."""
    return EPSG


def apply(engine: Engine, *survey: object, **options: object) -> str:
    """Write a build and update the inventory by it; return the update's status."""
    build = built(*survey, **options)
    write_build(engine, build)
    return advance(engine.url, build.survey.name).status


def kinds(engine: Engine, survey: str) -> dict[str, int]:
    """Count the changes of a survey."""
    found = read_changes(engine)
    return found.loc[found["survey"] == survey, "kind"].value_counts().to_dict()


def dump(engine: Engine, *leaving: str) -> list[str]:
    """Return the content, without some tables."""
    return [line for line in canonical_dump(engine) if not line.startswith(tuple(f'["{name}"' for name in leaving))]


def test_the_first_survey_brings_all_buildings_and_the_second_its_changes(engine: Engine) -> None:
    """Each building has one version at any date, and every change its row."""
    assert apply(engine, *FIRST) == "created"
    assert kinds(engine, "s1") == {"new": 8}
    assert apply(engine, *SECOND) == "created"
    assert kinds(engine, "s2") == {"unchanged": 6, "demolished": 1, "modified": 1, "new": 1}
    at = {date: footprint_at(engine, date) for date in ("2019-12-31", "2020-01-01", "2021-04-30", "2021-05-01")}
    assert [len(frame) for frame in at.values()] == [0, 8, 8, 8]
    old, new = at["2021-04-30"], at["2021-05-01"]
    assert len(set(old["uid"]) & set(new["uid"])) == 7
    history = read_history(engine)
    assert sorted(history.groupby("uid").size()) == [1, 1, 1, 1, 1, 1, 1, 1, 2]
    longer = history[history["uid"].duplicated(keep=False)]
    assert longer["valid_from"].tolist() == ["2020-01-01", "2021-05-01"]
    assert longer["valid_to"].tolist() == ["2021-05-01", None]
    assert longer["area_m2"].tolist() == pytest.approx([144, 216])
    gone = history[history["valid_to"].notna() & ~history["uid"].duplicated(keep=False)]
    assert gone["h_p90"].tolist() == pytest.approx([6.0])
    inventory = info(engine.url)["inventory"]
    assert inventory["buildings"]["all"] == 8
    assert sum(inventory["buildings"].values()) == 16
    assert inventory["decided"] == 0
    assert [(event["kind"], event["name"], event["date"]) for event in inventory["events"]] == [
        ("update", "s1", "2020-01-01"),
        ("update", "s2", "2021-05-01"),
    ]
    assert inventory["events"][1]["counts"]["demolished"] == 1


def test_the_views_show_the_present_and_the_past(engine: Engine) -> None:
    """``footprint_current`` is the state of today, ``building_history`` tells how each version began and ended."""
    apply(engine, *FIRST)
    apply(engine, *SECOND)
    with engine.connect() as connection:
        current = connection.scalars(text("SELECT uid FROM footprint_current ORDER BY uid")).all()
        told = connection.execute(
            text(
                "SELECT began_as, ended_as, ended_in, COUNT(*) FROM building_history GROUP BY 1, 2, 3 ORDER BY 1, 2, 4"
            )
        ).all()
    assert current == footprint_at(engine, "2021-05-01")["uid"].tolist()
    assert {tuple(row) for row in told} == {
        ("modified", None, None, 1),
        ("new", None, None, 7),
        ("new", "demolished", "s2", 1),
        ("new", "modified", "s2", 1),
    }


@pytest.mark.postgis
def test_the_function_of_postgis_tells_the_state_at_a_date(new_postgis: Callable[[], str]) -> None:
    """``footprint_at(date)`` gives what the Python reader gives, and a window in it uses the spatial index."""
    engine = open_database(new_postgis(), create=True, srid=EPSG)
    apply(engine, *FIRST)
    apply(engine, *SECOND)
    with engine.connect() as connection:
        for date in ("2020-06-01", "2021-05-01"):
            uids = connection.scalars(text("SELECT uid FROM footprint_at(:day) ORDER BY uid"), {"day": date}).all()
            assert uids == footprint_at(engine, date)["uid"].tolist()
        connection.execute(text("SET enable_seqscan = off"))
        plan = "\n".join(
            connection.scalars(
                text(
                    "EXPLAIN SELECT uid FROM footprint_at(DATE '2021-05-01') "
                    "WHERE geometry && ST_MakeEnvelope(500000, 4000000, 500020, 4000030, 32631)"
                )
            )
        )
    assert "idx_building_version_geometry" in plan


@pytest.mark.skipif(shutil.which("ogrinfo") is None, reason="GDAL's tools (gdal-bin) are not installed")
def test_gis_clients_read_the_layers_of_the_inventory(engine: Engine) -> None:
    """Tables and views have type, CRS, extent and count right, and a window finds what lies in it."""
    apply(engine, *FIRST)
    apply(engine, *SECOND)
    url = engine.url
    source = str(url.database)
    if engine.dialect.name == "postgresql":
        source = f"PG:host={url.query['host']} dbname={url.database} user={url.username}"
    window = ["-spat", *(str(v) for v in (WEST + 58, SOUTH + 58, WEST + 80, SOUTH + 80))]
    for layer, count in {"building_version": 10, "footprint_current": 8, "building_history": 10}.items():
        told = subprocess.run(["ogrinfo", "-ro", "-so", source, layer], capture_output=True, text=True, check=True)
        assert "Warning" not in told.stderr
        assert f"Feature Count: {count}\n" in told.stdout
        assert "Geometry: Multi Polygon" in told.stdout
        assert f'ID["EPSG",{EPSG}]]' in told.stdout
        near = subprocess.run(
            ["ogrinfo", "-ro", "-so", source, layer, *window], capture_output=True, text=True, check=True
        )
        assert "Feature Count: 1\n" in near.stdout


def test_a_repeat_changes_nothing(engine: Engine) -> None:
    """Applied surveys, the last and earlier ones, are left alone."""
    apply(engine, *FIRST)
    apply(engine, *SECOND)
    before = list(canonical_dump(engine))
    assert apply(engine, *SECOND) == "unchanged"
    assert apply(engine, *FIRST) == "unchanged"
    assert list(canonical_dump(engine)) == before


def test_the_last_survey_may_be_built_and_applied_again(engine: Engine, tmp_path: Path) -> None:
    """The result is that of a database which never knew the first attempt."""
    apply(engine, *FIRST)
    apply(engine, "s2", "2021-05", tuple(ROW[:3]))
    assert kinds(engine, "s2") == {"unchanged": 3, "demolished": 5}
    assert apply(engine, *SECOND) == "replaced"
    other = open_database(tmp_path / "other.sqlite", create=True, srid=EPSG)
    apply(other, *FIRST)
    apply(other, *SECOND)
    assert list(canonical_dump(engine)) == list(canonical_dump(other))


def test_surveys_come_in_the_order_of_their_dates(engine: Engine) -> None:
    """An earlier or a changed survey below a later one is refused by name, and nothing is touched."""
    apply(engine, *FIRST)
    apply(engine, *SECOND)
    before = dump(engine, "run", "survey")
    with pytest.raises(InputError, match="'s1' of 2020-01-01 cannot be applied: 's2' of 2021-05-01"):
        apply(engine, *FIRST, version="2")
    assert dump(engine, "run", "survey") == before
    with pytest.raises(InputError, match="in the order of their dates"):
        apply(engine, "s0", "2020-06-01", tuple(ROW))
    assert "s0" not in set(read_changes(engine)["survey"])


def test_a_rebuild_of_an_earlier_survey_leaves_the_inventory(engine: Engine) -> None:
    """``msbdb build`` replaces the run's rows, not the versions."""
    apply(engine, *FIRST)
    apply(engine, *SECOND)
    before = read_history(engine)
    write_build(engine, built("s1", "2020-01-01", tuple(ROW[:2]), version="2"))
    pd.testing.assert_frame_equal(pd.DataFrame(read_history(engine)), pd.DataFrame(before))


def test_a_survey_without_a_date_is_refused(engine: Engine) -> None:
    """Its place in the history is not known."""
    build = built("undated", "", tuple(ROW))
    write_build(engine, build)
    with pytest.raises(InputError, match="--date"):
        advance(engine.url, "undated")


def test_surveys_side_by_side_come_in_any_order_and_leave_each_other_alone(engine: Engine) -> None:
    """A tile of an earlier date may follow its neighbour, and rows outside of a tile are not written."""
    west = town_build("west", "2021-01-01", ROW[:4], bounds=(0, 0, 90, 60))
    east = town_build("east", "2020-01-01", ROW[4:], bounds=(90, 0, 180, 60))
    for build in (west, east):
        write_build(engine, build)
        assert advance(engine.url, build.survey.name).counts == {"new": 4, "versions": 4}
    lines = {line for line in dump(engine) if line.startswith('["building_version"')}
    write_build(engine, town_build("west2", "2022-01-01", ROW[1:4], bounds=(0, 0, 90, 60)))
    assert advance(engine.url, "west2").counts == {"demolished": 1, "unchanged": 3, "versions": 0}
    changed = {line for line in dump(engine) if line.startswith('["building_version"')} - lines
    assert len(changed) == 1
    assert len(footprint_at(engine, "2022")) == 7


def test_a_building_in_two_surveys_of_one_day_keeps_its_order(engine: Engine) -> None:
    """What began and ended on one day is never seen."""
    apply(engine, *FIRST)
    assert apply(engine, "s1b", "2020-01-01", tuple(LATER)) == "created"
    assert footprint_at(engine, "2020-01-01")["area_m2"].max() == pytest.approx(225)
    assert len(footprint_at(engine, "2020-01-01")) == 8


def test_merged_and_split_buildings_tell_their_pairs(engine: Engine) -> None:
    """The larger one keeps its identity, and the way back is a split."""
    pair: list[House] = [(20, 60, 40, 80, 8), (46, 60, 60, 80, 8)]
    apply(engine, "apart", "2020", (*ROW, *pair))
    apply(engine, "joined", "2021", (*ROW, (20.0, 60.0, 60.0, 80.0, 8.0)))
    merged = read_changes(engine, "2020")
    merged = merged[merged["kind"] == "merged"]
    assert len(merged) == 2
    assert merged["uid_after"].nunique() == merged["version_after"].nunique() == 1
    assert set(merged["uid_after"]) < set(merged["uid_before"])
    apply(engine, "again", "2022", (*ROW, *pair))
    split = read_changes(engine, "2021", "2022")
    split = split[split["kind"] == "split"]
    assert len(set(split["uid_before"])) == 1
    assert split["uid_after"].nunique() == split["version_after"].nunique() == 2
    assert len(footprint_at(engine, "2022")) == 10


def test_a_shift_is_stored_and_taken_out_of_later_comparisons(engine: Engine) -> None:
    """A shifted survey between two straight ones changes no building."""
    apply(engine, *FIRST)
    apply(engine, "s2", "2021", tuple(ROW), shift=1.5)
    assert kinds(engine, "s2") == {"unchanged": 8}
    with engine.connect() as connection:
        told = connection.execute(text("SELECT dx_m, pairs FROM survey_offset ORDER BY dx_m")).all()
    assert told == [(0.0, 0), (pytest.approx(1.5), 8)]
    apply(engine, "s3", "2022", tuple(ROW))
    assert kinds(engine, "s3") == {"unchanged": 8}


def test_an_imported_inventory_is_measured_and_updated_by_the_first_survey(engine: Engine) -> None:
    """Outlines and attributes stay where nothing changed; what changed takes the survey's outline (V49)."""
    office = office_frame([*ROW, (60, 90, 75, 105, 5)])
    assert write_import(engine, "cadastre", "2015-01-01", office, digest="a") == ("created", 9)
    assert write_import(engine, "cadastre", "2015-01-01", office, digest="a") == ("unchanged", 9)
    before = footprint_at(engine, "2016")
    assert before["h_p90"].isna().all()
    apply(engine, "s2", "2021", tuple(LATER))
    assert kinds(engine, "s2") == {"unchanged": 6, "demolished": 2, "modified": 1, "new": 1}
    after = footprint_at(engine, "2021").set_index("uid")
    assert after["h_p90"].notna().all()
    known = before.set_index("uid")["attributes"]
    kept = [uid for uid in after.index if uid in known.index]
    assert len(kept) == 7
    assert [after["attributes"][uid] for uid in kept] == [known[uid] for uid in kept]
    changes = read_changes(engine)
    assert set(changes.loc[changes["kind"] == "unchanged", "note"]) == {MEASURED_FIRST}


def test_an_imported_building_that_the_extraction_misses_still_stands(engine: Engine) -> None:
    """Where the inventory has no heights, a building is gone when its place is open, not when it was overlooked."""
    write_import(engine, "cadastre", "2015-01-01", office_frame(ROW), digest="a")
    build = built(*FIRST)
    first = build.frames["building"]["building_id"].iloc[0]
    frames = {name: build.frames[name] for name in ("building", "part")}
    kept = {name: frame[frame["building_id"] != first].reset_index(drop=True) for name, frame in frames.items()}
    without = {**build.frames, **kept}
    write_build(engine, replace(build, frames=without))
    assert advance(engine.url, "s1").counts["unchanged"] == 8


def test_an_import_into_a_place_that_is_known_is_refused(engine: Engine) -> None:
    """The inventory of an office comes first."""
    apply(engine, *FIRST)
    with pytest.raises(InputError, match="'cadastre' cannot be imported: the inventory has buildings of 's1'"):
        write_import(engine, "cadastre", "2022-01-01", office_frame(ROW), digest="a")


def office_frame(houses: list[House]) -> pd.DataFrame:
    """Return footprints as an import hands them over."""
    frame = footprints(houses)
    values = dict.fromkeys(MEASURES) | {"state": "unsure", "area_m2": frame.area}
    keys = [str(n) for n in range(len(frame))]
    attributes = [{"number": n, "owner": "O'Hara; DROP TABLE part"} for n in range(len(frame))]
    return frame.assign(key=keys, attributes=attributes, **values)


def test_an_operators_word_holds_through_rebuilds_and_updates(engine: Engine) -> None:
    """It is the building's, also when its survey is built otherwise and applied again."""
    apply(engine, *FIRST)
    uids = footprint_at(engine, "2020").sort_values("h_p90")["uid"].tolist()
    write_state(engine, uids[3], "refuted", operator="ann", note="a crane", decided_at="2020-02-01T00:00:00Z")
    write_state(engine, uids[3], "confirmed", operator="ben", note="", decided_at="2020-02-02T00:00:00Z")
    write_state(engine, uids[4], "refuted", operator="ann", note="", decided_at="2020-02-02T00:00:00Z")
    wider = [(w - 1, s, e, n, h) for w, s, e, n, h in ROW]
    assert apply(engine, "s1", "2020-01-01", tuple(wider)) == "replaced"
    apply(engine, *SECOND)
    now = footprint_at(engine, "2021-05-01").set_index("uid")
    assert now["state"][uids[3]] == "confirmed"
    assert now["operator"][uids[3]] == "ben"
    assert now["state"][uids[4]] == "refuted"
    assert now["found_state"][uids[4]] == "confirmed"
    write_state(engine, uids[4], None, operator="ann", note="", decided_at="")
    assert read_states(engine)["uid"].tolist() == [uids[3]]
    with pytest.raises(InputError, match="no building 7"):
        write_state(engine, 7, "refuted", operator="ann", note="", decided_at="")


def test_roof_samples_are_crossed_with_the_classes_of_finest_parts(engine: Engine) -> None:
    """Samples beside all parts are not counted, and a sample of the same place takes the old one's place (V53)."""
    apply(engine, *FIRST)
    points = [(16, 16), (36, 16), (56, 16), (5, 5)]
    frame = footprints(ROW[:4])
    frame = frame.set_geometry([shape.centroid for shape in frame.geometry])
    frame = frame.set_geometry(
        frame.geometry.from_xy(*zip(*((WEST + x, SOUTH + y) for x, y in points), strict=True), crs=frame.crs)
    )
    frame = frame.assign(material=["metal", "tile", "metal", "slate"], note="", attributes=None)
    assert write_samples(engine, frame) == 4
    assert write_samples(engine, frame.assign(material=["metal", "metal", "metal", "slate"])) == 4
    query = text("SELECT survey, material, speindex, class_label, samples FROM roof_material_by_class")
    with engine.connect() as connection:
        told = connection.execute(query).all()
    assert run_example(engine, "roof_materials_by_class")["samples"].tolist() == [3]
    assert told == [("s1", "metal", 0, None, 3)]


def test_a_sample_without_further_columns_has_no_attributes(engine: Engine) -> None:
    """Whatever stands for nothing in a frame is an empty object in the database, and its digest is that of the row."""
    apply(engine, *FIRST)
    frame = footprints(ROW[:2])
    frame = frame.set_geometry(frame.geometry.centroid).assign(material="tile", note="", attributes=float("nan"))
    write_samples(engine, frame)
    with engine.connect() as connection:
        assert connection.scalar(text("SELECT count(*) FROM roof_sample WHERE CAST(attributes AS TEXT) = '{}'")) == 2
    assert check_database(engine) == []


def test_an_older_inventory_gets_empty_objects(engine: Engine) -> None:
    """In place of nulls, of each of which QGIS warns; digests stay right on the way up and down."""
    apply(engine, *FIRST)
    nulls = text("SELECT count(*) FROM building_version WHERE attributes IS NULL")
    assert downgrade_schema(engine.url, "0009")[1:] == ("0009", [])
    with engine.connect() as connection:
        assert connection.scalar(nulls) == len(FIRST[2])
    upgrade_schema(engine.url)
    with engine.connect() as connection:
        assert connection.scalar(nulls) == 0
    assert check_database(engine) == []


def test_the_example_queries_tell_of_the_inventory(engine: Engine) -> None:
    """What stood at a date, what surveys did, and the life of one building."""
    apply(engine, *FIRST)
    apply(engine, *SECOND)
    columns = ["state", "source", "buildings"]
    found = [run_example(engine, "inventory_at_date", **at)[columns] for at in ({}, {"date": "2019-12-31"})]
    assert [frame.to_numpy().tolist() for frame in found] == [[["confirmed", "survey", 8]], []]
    told = run_example(engine, "changes_by_survey")[["number", "survey", "kind", "changes"]]
    assert told.to_numpy().tolist() == [
        [1, "s1", "new", 8],
        [2, "s2", "demolished", 1],
        [2, "s2", "modified", 1],
        [2, "s2", "new", 1],
        [2, "s2", "unchanged", 6],
    ]
    life = run_example(engine, "history_of_building")
    assert life["valid_from"].tolist() == ["2020-01-01", "2021-05-01"]
    assert life["began_as"].tolist() == ["new", "modified"]
    again = run_example(engine, "history_of_building", uid=int(life["uid"][0]))
    assert again["ended_as"].fillna("").tolist() == ["modified", ""]


BREAKING = [
    "UPDATE building_version SET valid_to = '2019-01-01'",
    "UPDATE building_version SET valid_from = 'early'",
    "UPDATE building_version SET survey_id = NULL",
    "UPDATE building_version SET state = 'lost'",
    f"INSERT INTO building_version ({', '.join(COLUMNS)}) SELECT {SAME_AGAIN} FROM building_version",
    "UPDATE building_change SET kind = 'not surveyed'",
    "UPDATE building_change SET uid_after = NULL",
    "UPDATE inventory_event SET kind = 'import'",
    "DELETE FROM inventory_building",
    "DELETE FROM survey",
]
"""Statements after which the history would no longer be whole."""


def test_the_database_itself_keeps_the_history_whole(engine: Engine) -> None:
    """Whoever writes: intervals, states, one current version a building, and keys hold."""
    apply(engine, *FIRST)
    before = dump(engine)
    for statement in BREAKING:
        with pytest.raises(Exception, match=r"(?i)constraint"), engine.begin() as connection:
            connection.execute(text(statement))
    assert dump(engine) == before


@pytest.mark.long
def test_updates_of_different_places_at_once_all_arrive(engine: Engine) -> None:
    """Writers wait for each other, readers see the last committed state, and the sum is that of any order."""
    tiles = [town_build(f"t{n}", "2020", ROW[2 * n : 2 * n + 2], bounds=(40 * n, 0, 40 * n + 40, 40)) for n in range(4)]
    for tile in tiles:
        write_build(engine, tile)
    failures: list[BaseException] = []

    def work(name: str) -> None:
        try:
            advance(engine.url, name)
        except BaseException as error:
            failures.append(error)

    threads = [threading.Thread(target=work, args=(tile.survey.name,)) for tile in tiles]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads):
        assert len(footprint_at(engine, "2021")) % 2 == 0
    for thread in threads:
        thread.join()
    assert failures == []
    assert len(footprint_at(engine, "2021")) == 8
    with engine.connect() as connection:
        assert connection.scalars(text("SELECT number FROM inventory_event ORDER BY number")).all() == [1, 2, 3, 4]


@pytest.mark.postgis
def test_both_dialects_hold_the_same_inventory(tmp_path: Path, new_postgis: Callable[[], str]) -> None:
    """Dumps and views are equal, line by line."""
    engines = [open_database(t, create=True, srid=EPSG) for t in (tmp_path / "a.sqlite", new_postgis())]
    views = "footprint_current", "building_history", "roof_material_by_class"
    shown = []
    for engine in engines:
        write_import(engine, "Ävila", "2015-01-01", office_frame(ROW), digest="a")
        apply(engine, *FIRST)
        apply(engine, *SECOND)
        uid = int(footprint_at(engine, "2021-05-01")["uid"].min())
        write_state(engine, uid, "refuted", operator="Änne", note="'; --", decided_at="2021-06-01T00:00:00Z")
        with engine.connect() as connection:
            rows = [connection.execute(text(f"SELECT * FROM {view}")).mappings().all() for view in views]
        shown.append(
            [
                sorted(repr([(k, v) for k, v in r.items() if k not in ("geometry", "attributes")]) for r in found)
                for found in rows
            ]
        )
    assert list(canonical_dump(engines[0])) == list(canonical_dump(engines[1]))
    assert shown[0] == shown[1]
    assert len(shown[0][0]) == 8


def test_refused_rows_leave_the_inventory_as_it_was(engine: Engine, monkeypatch: pytest.MonkeyPatch) -> None:
    """An update is whole or not at all."""
    from msbdb.database.history import versions as inventory_write

    apply(engine, *FIRST)
    write_build(engine, built(*SECOND))
    before = list(canonical_dump(engine))
    monkeypatch.setattr(inventory_write, "_values", lambda column: [None] * len(column))
    with pytest.raises(LoadError):
        advance(engine.url, "s2")
    assert list(canonical_dump(engine)) == before
    monkeypatch.undo()
    assert advance(engine.url, "s2").status == "created"

"""Buildings that the border of tiles cuts: one building in any order of the tiles, with the same content."""

import itertools
import json
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import shapely
from sqlalchemy import Engine, text
from support.sizes import sample
from support.towns import EPSG, SOUTH, WEST, House, town_build

from msbdb.api import advance, changes, qgis
from msbdb.database import (
    Seams,
    canonical_dump,
    check_database,
    current_pieces,
    footprint_at,
    open_database,
    read_changes,
    read_history,
    read_parts,
    read_shown,
    write_build,
)

Box = tuple[float, float, float, float]

TOWN: list[House] = [(30, 10, 60, 24, 8), (10, 40, 24, 52, 6), (70, 40, 84, 60, 9), (36, 66, 52, 90, 12)]
"""Two houses on the border at 45 m, the second of which lies on the corner of four tiles at 80 m; one on each side."""

WEST_TILE, EAST_TILE = (0.0, 0.0, 45.0, 120.0), (45.0, 0.0, 100.0, 120.0)


TILES = {"west": WEST_TILE, "east": EAST_TILE}


@pytest.fixture(scope="module")
def srid() -> int:
    """Return the SRID of ``engine``."""
    return EPSG


@pytest.fixture(scope="module")
def new(tmp_path_factory: pytest.TempPathFactory, empty_file: Callable[[int], Path]) -> Callable[[], Engine]:
    """Return what makes an empty file."""
    folder, numbers = tmp_path_factory.mktemp("towns"), itertools.count()
    return lambda: open_database(shutil.copy(empty_file(EPSG), folder / f"{next(numbers)}.sqlite"))


@pytest.fixture(scope="module")
def two_days(new: Callable[[], Engine]) -> Engine:
    """Return the town from two tiles, the eastern one a year later."""
    return town_of(new(), ("west", "2020-01-01"), ("east", "2021-03-01"))


def town_of(engine: Engine, *tiles: tuple[str, str], houses: list[House] = TOWN) -> Engine:
    """Return a database with tiles of these names and days."""
    for name, day in tiles:
        update(engine, name, houses, TILES[name], day)
    return engine


def update(engine: Engine, name: str, houses: list[House], bounds: Box, date: str = "2020-01-01", **more: str) -> str:
    """Build a tile and update the inventory by it; return the status."""
    west, south, east, north = bounds
    seen = [h for h in houses if h[0] < east and h[2] > west and h[1] < north and h[3] > south]
    write_build(engine, town_build(name, date, seen, bounds=bounds, **more))
    return advance(engine.url, name).status


def content(engine: Engine) -> list[str]:
    """Return the history, without the numbers of events."""
    lines = []
    for line in canonical_dump(engine):
        row = json.loads(line)
        if row[0] == "inventory_event":
            row = [row[0], *row[2:]]
        if row[0] in ("inventory_building", "building_version", "building_change", "survey_offset", "inventory_event"):
            lines.append(json.dumps(row))
    return sorted(lines)


def outlines(engine: Engine, date: str = "2030") -> list[Box]:
    """Return the bounds of the current buildings in metres from the corner, whole cells."""
    bounds = footprint_at(engine, date).bounds.to_numpy() - [WEST, SOUTH, WEST, SOUTH]
    return sorted(tuple(row) for row in np.round(bounds).astype(int).tolist())


def boxes(houses: list[House]) -> list[Box]:
    """Return the bounds of houses."""
    return sorted(tuple(int(value) for value in house[:4]) for house in houses)


def test_a_building_cut_by_a_border_is_one_in_any_order(engine: Engine, new: Callable[[], Engine]) -> None:
    """Its outline, height and area are those of the whole, in each dialect with the same content."""
    found = []
    for place, order in ((new(), ("west", "east")), (engine, ("east", "west"))):
        for name in order:
            assert update(place, name, TOWN, TILES[name]) == "created"
        assert outlines(place) == boxes(TOWN)
        now = footprint_at(place, "2020-01-01")
        assert now["area_m2"].sum() == pytest.approx(sum((h[2] - h[0]) * (h[3] - h[1]) for h in TOWN))
        assert sorted(now["h_max"].round(6)) == [6, 8, 9, 12]
        assert check_database(place) == []
        before = content(place)
        assert [advance(place.url, name).status for name in order] == ["unchanged"] * 2
        assert content(place) == before
        found.append(before)
    assert found[0] == found[1]


@pytest.mark.long
def test_four_tiles_with_a_building_on_their_corner(new: Callable[[], Engine]) -> None:
    """It is one building after all four, whichever comes first, also when their days differ."""
    town = [*TOWN, (35.0, 94.0, 57.0, 110.0, 7.0)]
    sides = {"a": (0.0, 45.0), "b": (45.0, 100.0)}
    rows = {"1": (0.0, 80.0, "2020-01-01"), "2": (80.0, 120.0, "2020-02-01")}
    tiles = [(a + b, (w, s, e, n), day) for a, (w, e) in sides.items() for b, (s, n, day) in rows.items()]
    found = []
    for order in (tiles, tiles[::-1], [tiles[1], tiles[2], tiles[0], tiles[3]]):
        engine = new()
        for name, tile, day in order:
            update(engine, name, town, tile, day)
        assert outlines(engine) == boxes(town)
        # Before the second day the corner was known in part alone.
        assert max(box[3] for box in outlines(engine, "2020-01-15")) == 80
        assert check_database(engine) == []
        found.append(content(engine))
    assert found[0] == found[1] == found[2]


@pytest.mark.long
def test_a_later_survey_of_the_whole_finds_no_change(new: Callable[[], Engine]) -> None:
    """Neither one that sees all at once, nor tiles that are cut elsewhere; nothing is new or demolished."""
    engine = new()
    for name, tile in (("west", WEST_TILE), ("east", EAST_TILE)):
        update(engine, name, TOWN, tile)
    uids = set(footprint_at(engine, "2021")["uid"])
    update(engine, "all", TOWN, (0, 0, 100, 120), "2022-01-01")
    for name, tile in (("left", (0, 0, 38, 120)), ("right", (38, 0, 100, 120))):
        update(engine, name, TOWN, tile, "2024-01-01")
    later = read_changes(engine, "2020-06-01")
    assert set(later["kind"]) == {"unchanged"}
    assert set(footprint_at(engine, "2030")["uid"]) == uids
    assert outlines(engine) == boxes(TOWN)
    assert check_database(engine) == []


@pytest.mark.long
def test_a_change_beyond_the_border_leaves_the_other_side(new: Callable[[], Engine]) -> None:
    """A tile that sees a part of a building changes this part alone."""
    engine = new()
    for name, tile in (("west", WEST_TILE), ("east", EAST_TILE)):
        update(engine, name, TOWN, tile)
    longer = [(30.0, 10.0, 72.0, 24.0, 8.0), *TOWN[1:]]
    update(engine, "east2", longer, EAST_TILE, "2022-01-01")
    assert outlines(engine) == boxes(longer)
    changed = read_changes(engine, "2020-06-01")
    assert changed.loc[changed["kind"] != "unchanged", "kind"].tolist() == ["modified"]
    assert footprint_at(engine, "2030")["area_m2"].max() == pytest.approx(42 * 14)
    # The western tile sees a third of it go; the ground of the other one stays.
    update(engine, "west2", longer[1:], WEST_TILE, "2024-01-01")
    assert check_database(engine) == []
    assert (45, 10, 72, 24) in outlines(engine)


def test_houses_that_a_step_or_a_lane_divides_at_the_border_stay_two(new: Callable[[], Engine]) -> None:
    """One is a storey higher, or they face each other over a metre of ground; a level roof beside them is one."""
    lane: list[House] = [(30, 80, 44.5, 94, 8), (45.5, 80, 60, 94, 8)]
    step: list[House] = [(30, 10, 45, 24, 6), (45, 10, 60, 24, 9.5), (30, 40, 60, 54, 7)]
    engine = town_of(new(), ("west", "2020-01-01"), ("east", "2020-01-01"), houses=step + lane)
    found = outlines(engine)
    assert len(found) == 5
    assert set(boxes(step)) < set(found)
    assert check_database(engine) == []


@pytest.mark.parametrize(("overlap", "cut"), sample(itertools.product((0.5, 6.0), (47.5, 33.0, 51.0)), 6))
def test_tiles_that_overlap_give_the_same_buildings(new: Callable[[], Engine], cut: float, overlap: float) -> None:
    """The strip that both have seen is in one building, and no ground is in two."""
    engine = new()
    for name, tile in (("west", (0.0, 0.0, cut + overlap, 120.0)), ("east", (cut, 0.0, 100.0, 120.0))):
        update(engine, name, TOWN, tile)
    assert outlines(engine) == boxes(TOWN)
    assert check_database(engine) == []


@pytest.mark.long
def test_a_tile_built_again_is_joined_again(new: Callable[[], Engine]) -> None:
    """The buildings are those of tiles that were like this from the beginning, and what stays keeps its identity."""
    engine, fresh = new(), new()
    other = [(30.0, 10.0, 60.0, 24.0, 8.0), (70.0, 40.0, 84.0, 66.0, 9.0), *TOWN[3:]]
    update(engine, "west", TOWN, WEST_TILE)
    update(engine, "east", TOWN, EAST_TILE)
    uids = set(footprint_at(engine, "2020-01-01")["uid"])
    assert update(engine, "east", other, EAST_TILE, version="2") == "replaced"
    assert update(engine, "west", TOWN[:1], WEST_TILE, version="2") == "replaced"
    update(fresh, "east", other, EAST_TILE, version="2")
    update(fresh, "west", TOWN[:1], WEST_TILE, version="2")
    one, two = (footprint_at(each, "2020-01-01") for each in (engine, fresh))
    assert outlines(engine) == outlines(fresh)
    assert sorted(one["area_m2"].round(6)) == sorted(two["area_m2"].round(6))
    assert len(set(one["uid"]) & uids) == 3
    assert check_database(engine) == []


def test_the_history_of_a_joined_building_has_its_pieces(two_days: Engine) -> None:
    """Pieces of two days: one alone until the second day, then both as one, and its note has the surveys."""
    now = footprint_at(two_days, "2021-06-01")
    uid = int(now.loc[now["h_max"] == TOWN[0][4], "uid"].iloc[0])
    history = read_history(two_days, uid)
    assert history["valid_from"].tolist() == ["2020-01-01", "2021-03-01"]
    assert history["valid_to"].tolist() == ["2021-03-01", None]
    assert [round(area) for area in history["area_m2"]] == [15 * 14, 30 * 14]
    assert shapely.is_valid(history.geometry).all()
    changed = read_changes(two_days)
    notes = changed.loc[(changed["uid_after"] == uid) & changed["note"].str.contains("border"), "note"]
    assert len(notes) == 2
    assert notes.str.contains("'east' and 'west'").all()


def test_pieces_that_are_joined_are_no_change(two_days: Engine) -> None:
    """Each building is there from the beginning, new once where nothing was there, and none is gone."""
    require_no_change(two_days, later={"unchanged": 3})


@pytest.mark.long
@pytest.mark.parametrize(("west", "later"), [("2021-03-01", {}), ("2022-03-01", {"unchanged": 3})])
def test_pieces_of_other_days_are_no_change(new: Callable[[], Engine], west: str, later: dict[str, int]) -> None:
    """As well where both tiles are of one day, or the eastern one is older."""
    require_no_change(town_of(new(), ("west", west), ("east", "2021-03-01")), later=later, day="2021-06-01")


def require_no_change(engine: Engine, *, later: dict[str, int], day: str = "2020-06-01") -> None:
    """Require that a town has four buildings from its beginning, and these changes after a day."""
    db = str(engine.url.database)
    assert changes(db).counts == {"unchanged": 4}
    assert changes(db, since="2019-01-01").counts == {"new": 4}
    assert changes(db, since=day).counts == later


def test_two_buildings_on_the_same_ground_are_found(engine: Engine, monkeypatch: pytest.MonkeyPatch) -> None:
    """As older versions left them: the area is named, and the two buildings."""
    monkeypatch.setattr("msbdb.run.inventory.update._seams", lambda *_: Seams())
    update(engine, "west", TOWN, (0.0, 0.0, 47.0, 120.0))
    update(engine, "east", TOWN, EAST_TILE)
    found = check_database(engine)
    assert [finding.check for finding in found] == ["overlaps"] * 2
    assert {finding.what.split(" m2")[0].split("covers ")[1] for finding in found} == {"28.00", "48.00"}
    uids = set(footprint_at(engine, "2020-01-01")["uid"].astype(str))
    assert all(sum(uid in finding.what for uid in uids) == 2 for finding in found)


def test_an_export_and_qgis_have_the_parts_of_all_pieces(engine: Engine, tmp_path: Path) -> None:
    """The current inventory of two tiles has the parts of both, each in the building of the inventory."""
    town_of(engine, ("west", "2020-01-01"), ("east", "2021-03-01"))
    parts = sum(len(read_parts(engine, name)) for name in TILES)
    assert len(current_pieces(engine)) == 6
    found = read_shown(engine, ["footprint", "part"]).layers
    assert len(found["part"]["part_id"]) == parts
    assert set(found["part"]["building_id"]) == set(found["footprint"]["building_id"])
    qgis(engine.url, tmp_path / "town.qgz")
    with zipfile.ZipFile(tmp_path / "town.qgz") as archive:
        sources = [one.text or "" for one in ElementTree.fromstring(archive.read("town.qgs")).iter("datasource")]
    [shown] = [one for one in sources if 'part_current"' in one]
    assert "sql=" not in shown
    with engine.connect() as connection:
        rows = connection.execute(text("SELECT part_id, building_id FROM part_current")).all()
    keys = zip(found["part"]["part_id"].tolist(), found["part"]["building_id"].tolist(), strict=True)
    assert sorted(map(tuple, rows)) == sorted(keys)
    # On the days before the eastern tile, only the western pieces are there.
    west = read_shown(engine, ["footprint", "part"], date="2020-06-01").layers["part"]
    assert set(west["survey"]) == {"west"}
    assert len(west["part_id"]) == len(read_parts(engine, "west"))

"""A build in tiles: the content of the build of the whole, in any order, after failures, crashes and resumption."""

import errno
import json
import random
import signal
import subprocess
import sys
from dataclasses import replace

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import shapely
from affine import Affine
from click.testing import CliRunner
from pyproj import CRS, Transformer
from simulated.files import write_heights, write_points
from simulated.scenes import DATUM_M, Block, World, scan
from support.processes import environment
from support.tiledtown import KILLED, TILE_M, town, write_town

import msbdb
from msbdb.cli.main import cli
from msbdb.database import (
    TileStatus,
    begin_tiles,
    canonical_dump,
    check_database,
    note_result,
    open_database,
    opened,
    read_buildings,
    read_result,
    read_run,
    read_tables,
)
from msbdb.database.runs.merging import Piece, overruled
from msbdb.errors import InputError, ParameterError, TilesError, collected_notices
from msbdb.grid import Grid, GridSpec
from msbdb.params import Params, with_values
from msbdb.run import compose
from msbdb.run.preparation.pointfacts import THINNED
from msbdb.scale import tiledbuild, tilework
from msbdb.scale.tiledbuild import FOLDER
from msbdb.tables import BUILDING, Reason


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Return the files of the town."""
    return write_town(tmp_path_factory.mktemp("town"))


@pytest.fixture(scope="module")
def whole(files, tmp_path_factory):
    """Return a database of the town that is built in one piece, by all detectors."""
    db = tmp_path_factory.mktemp("whole") / "town.sqlite"
    msbdb.build(files, db=db, survey="town")
    return db


@pytest.fixture(scope="module")
def quick(files, tmp_path_factory):
    """Return a database of the town that is built in tiles, in one go, by one detector."""
    db = tmp_path_factory.mktemp("quick") / "town.sqlite"
    msbdb.build(files, db=db, survey="town", extract="multiscale", tile=TILE_M)
    return db


def lines(db):
    """Return the lines of the dump of a sound database."""
    engine = open_database(db)
    found = list(canonical_dump(engine))
    assert not check_database(engine)
    engine.dispose()
    return found


def buildings_of(db):
    """Return the buildings of a database of one survey."""
    with opened(db) as engine:
        return read_buildings(engine)


def counts(db):
    """Return what the run of a database counts."""
    with opened(db) as engine:
        return read_run(engine).counts


def without_counts(dumped):
    """Return the lines without the counts of the run: of tiles those of kept regions are not known."""
    return [line for line in dumped if not line.startswith('["run", ')]


def ordered_runner(order):
    """Return a runner that takes the tiles in another order."""
    return lambda tasks, begin: tilework.one_by_one(order(list(tasks)), begin)


def test_tiles_that_see_enough_give_the_content_of_the_whole(files, whole, tmp_path):
    """All rows of all tables and all rasters are equal; of the counts, those of dropped regions and of cells."""
    db = tmp_path / "town.sqlite"
    report = msbdb.build(files, db=db, survey="town", tile=TILE_M)
    assert without_counts(lines(db)) == without_counts(lines(whole))
    one, other = (counts(path) for path in (whole, db))
    assert report.buildings == 5
    assert len(msbdb.tiles(db)) == 4
    assert {tile.state for tile in msbdb.tiles(db)} == {"done"}
    assert sum(tile.points for tile in msbdb.tiles(db)) == len(town().points)
    assert sum(report.overview.states.values()) == 5
    assert one.cells == other.cells
    assert one.chosen == other.chosen
    for method, stages in other.regions.items():
        for stage, numbers in stages.items():
            assert numbers["dropped"] == one.regions[method][stage]["dropped"], (method, stage)
    assert not (tmp_path / f"town.sqlite{FOLDER}").exists()
    assert msbdb.why(db, 389_088.0, 5_821_080.0).building is not None


def test_points_of_a_web_map_are_reprojected_also_in_tiles(quick, tmp_path):
    """Files in Pseudo-Mercator give the buildings of the same points in UTM, in one piece as in tiles."""
    points, files = town().points, []
    x, y = Transformer.from_crs(points.crs, 3857, always_xy=True).transform(points.x, points.y)
    mercator = replace(points, x=np.asarray(x), y=np.asarray(y))
    for name, own in (("w", points.x < 389_090.0), ("e", points.x >= 389_090.0)):
        files.append(write_points(tmp_path / f"{name}.laz", mercator.take(own), crs=CRS.from_epsg(3857)))
    found = []
    for name, tile in (("one", None), ("four", TILE_M)):
        db = tmp_path / f"{name}.sqlite"
        report = msbdb.build(files, db=db, survey="town", extract="multiscale", tile=tile)
        [notice] = [each for each in report.notices if "reprojected" in each]
        assert notice.startswith("w.laz (and 1 more): coordinates of 'WGS 84 / Pseudo-Mercator' (EPSG:3857)")
        assert notice.endswith("off here, were reprojected to 'WGS 84 / UTM zone 33N' (EPSG:32633).")
        found.append(db)
    assert without_counts(lines(found[0])) == without_counts(lines(found[1]))
    truth, ours = (buildings_of(db) for db in (quick, found[0]))
    assert ours.crs == truth.crs
    assert len(ours) == len(truth) == 5
    both = shapely.intersection(ours.union_all(), truth.union_all()).area
    assert both > 0.97 * max(ours.area.sum(), truth.area.sum())


@pytest.mark.parametrize("tile", [None, TILE_M])
def test_tiles_with_margins_and_copies_change_nothing(files, whole, quick, tmp_path, tile):
    """A survey whose files overlap, and all of whose points come once more from another file, gives the same dump."""
    points = town().points
    given = [write_points(tmp_path / "all.las", points.take(np.arange(len(points))[::-1]))]
    for name, own in (("w", points.x < 389_110.0), ("e", points.x > 389_070.0)):
        given.append(write_points(tmp_path / f"{name}.laz", points.take(own)))
    db = tmp_path / "town.sqlite"
    methods = {"extract": "multiscale"} if tile else {}
    report = msbdb.build(given, db=db, survey="town", tile=tile, **methods)
    assert lines(db) == lines(quick if tile else whole)
    repeats = [notice for notice in report.notices if "repeat another one" in notice]
    assert len(repeats) == 1


@pytest.mark.parametrize("tile", [None, TILE_M])
def test_points_that_are_left_out_are_told_once(files, quick, tmp_path, tile):
    """Also by a build in tiles, whose plan and tiles all leave some out; nothing is said where all are taken."""
    params = with_values(Params(), {"surface": {"most_density": 0.5}})
    db = tmp_path / "town.sqlite"
    report = msbdb.build(files, db=db, survey="town", extract="multiscale", tile=tile, params=params)
    assert report.notices.count(THINNED) == 1
    for path, times in ((db, 1), (quick, 0)):
        with opened(path) as engine:
            assert read_run(engine).notices.count(THINNED) == times


def test_a_build_in_tiles_finds_their_size_by_itself(files, whole, tmp_path):
    """Resumed or given to workers, a survey is cut so that a window takes 2 GiB: the small town into one tile."""
    db = tmp_path / "town.sqlite"
    msbdb.build(files, db=db, survey="town", resume=True)
    [tile] = msbdb.tiles(db)
    assert tile.east - tile.west == 2000
    assert without_counts(lines(db)) == without_counts(lines(whole))


def test_notices_of_tiles_wait_for_the_merge(files, tmp_path, monkeypatch):
    """A merge that is killed and repeated keeps in the run what the tiles said."""
    params = with_values(Params(), {"surface": {"most_density": 0.5}})
    given = {"survey": "town", "extract": "multiscale", "tile": TILE_M, "params": params}
    msbdb.build(files, db=tmp_path / "one.sqlite", **given)
    db = tmp_path / "town.sqlite"

    def killed(*_given, **_words):
        raise KeyboardInterrupt

    monkeypatch.setattr(tiledbuild, "merge_tiles", killed)
    with pytest.raises(KeyboardInterrupt):
        msbdb.build(files, db=db, **given)
    monkeypatch.undo()
    made = tiledbuild.make_plan

    def silent(*words):
        with collected_notices():
            return made(*words)

    # What the tiles alone say, not the plan.
    monkeypatch.setattr(tiledbuild, "make_plan", silent)
    msbdb.build(files, db=db, **given, resume=True)
    with opened(db) as engine, opened(tmp_path / "one.sqlite") as whole:
        assert THINNED in read_run(engine).notices
        assert read_run(engine).notices == read_run(whole).notices
    assert lines(db) == lines(tmp_path / "one.sqlite")


def test_a_digest_that_fails_leaves_no_survey(files, quick, tmp_path, monkeypatch):
    """It is made in a thread beside the merge: its error ends the merge, and the tiles wait for the next one."""
    db = tmp_path / "town.sqlite"
    given = {"db": db, "survey": "town", "extract": "multiscale", "tile": TILE_M}

    def breaks(*_content):
        msg = "no memory is left"
        raise MemoryError(msg)

    with monkeypatch.context() as broken:
        broken.setattr("msbdb.database.runs.merging.tables_digest", breaks)
        with pytest.raises(MemoryError, match="no memory is left"):
            msbdb.build(files, **given)
    assert msbdb.info(db)["runs"] == []
    msbdb.build(files, **given, resume=True)
    assert lines(db) == lines(quick)


def test_what_two_tiles_claim_is_there_once_with_its_links(files, whole, tmp_path, monkeypatch):
    """Where windows see a place otherwise, two tiles may claim a building: one of them has it."""
    every = "msbdb.scale.tileresults.owned_buildings"
    monkeypatch.setattr(every, lambda _tile, parts: np.unique(parts["building_id"]))
    db = tmp_path / "town.sqlite"
    msbdb.build(files, db=db, survey="town", tile=TILE_M)
    assert without_counts(lines(db)) == without_counts(lines(whole))


@pytest.mark.parametrize("order", [reversed, lambda tasks: random.Random(3).sample(tasks, len(tasks))])
def test_the_order_of_tiles_does_not_matter(files, quick, tmp_path, monkeypatch, order):
    """The dump is the same to the byte."""
    monkeypatch.setattr(tiledbuild, "one_by_one", ordered_runner(lambda tasks: list(order(tasks))))
    db = tmp_path / "town.sqlite"
    msbdb.build(files[::-1], db=db, survey="town", extract="multiscale", tile=TILE_M)
    assert lines(db) == lines(quick)


def test_other_tiles_give_the_same(files, quick, tmp_path):
    """Tiles of another size give the same dump, where they see enough."""
    db = tmp_path / "town.sqlite"
    msbdb.build(files, db=db, survey="town", extract="multiscale", tile=75)
    assert len(msbdb.tiles(db)) != len(msbdb.tiles(quick))
    assert lines(db) == lines(quick)


def test_the_window_grows_until_it_holds_whole_islands(files, whole, tmp_path, monkeypatch):
    """With a narrow halo the block over the corner is whole all the same, and each building is there once."""
    monkeypatch.setattr(tiledbuild, "HALO_M", 25.0)
    monkeypatch.setattr(tiledbuild, "MOST_HALO_M", 75.0)
    db = tmp_path / "town.sqlite"
    msbdb.build(files, db=db, survey="town", tile=TILE_M)
    assert {tile.halo_m for tile in msbdb.tiles(db)} == {75.0}
    with msbdb.open(whole) as one, msbdb.open(db) as other:
        before, after = one.buildings(), other.buildings()
    assert after["building_id"].tolist() == before["building_id"].tolist()
    assert after["area_m2"].to_numpy() == pytest.approx(before["area_m2"].to_numpy(), rel=0.02)


def test_a_window_that_is_too_narrow_is_left_before_its_outlines(files, tmp_path, monkeypatch):
    """Each tile is taken to its parts twice, with both halos, and described once, with the wide one."""
    monkeypatch.setattr(tiledbuild, "HALO_M", 25.0)
    monkeypatch.setattr(tiledbuild, "MOST_HALO_M", 75.0)
    begun, described = [], []

    def begins(job, plan, stages, window, original=tilework.find_regions):
        begun.append(window.seen[2] - window.seen[0])
        return original(job, plan, stages, window)

    def describes(scene, *given, original=compose.describe, **words):
        made = original(scene, *given, **words)
        roofs = made.rasters.reason == Reason.BUILDING
        assert np.array_equal(roofs, given[1].root_labels > 0)
        described.append(roofs)
        return made

    monkeypatch.setattr(tilework, "find_regions", begins)
    monkeypatch.setattr(compose, "describe", describes)
    msbdb.build(files, db=tmp_path / "town.sqlite", survey="town", extract="multiscale", tile=TILE_M)
    assert begun == [TILE_M + 50.0, TILE_M + 150.0] * 4
    assert len(described) == 4
    assert all(roofs.any() for roofs in described)


def test_a_window_grows_further_for_a_single_long_hall(tmp_path, monkeypatch):
    """A hall of 130 m across tiles of 50 m is whole where islands alone are seen up to 60 m beyond a tile."""
    monkeypatch.setattr(tiledbuild, "HALO_M", 10.0)
    monkeypatch.setattr(tiledbuild, "MOST_HALO_M", 60.0)
    hall = World("hall", (160, 50), (Block("hall", 12, 14, 130, 20, DATUM_M + 8.0, 1),))
    cloud = scan(hall, seed=0, density=4.0).points
    east = cloud.x - cloud.x.min() > 130
    points = [write_points(tmp_path / f"{name}.laz", cloud.take(part)) for name, part in (("a", ~east), ("b", east))]
    whole, tiled = tmp_path / "whole.sqlite", tmp_path / "tiled.sqlite"
    msbdb.build(points, db=whole, survey="hall")
    report = msbdb.build(points, db=tiled, survey="hall", tile=TILE_M)
    assert not any("may be cut there" in notice for notice in report.notices)
    assert max(tile.halo_m for tile in msbdb.tiles(tiled)) == 120.0
    with msbdb.open(whole) as one, msbdb.open(tiled) as other:
        before, after = one.buildings(), other.buildings()
    assert after["building_id"].tolist() == before["building_id"].tolist()
    assert after["area_m2"].to_numpy() == pytest.approx(before["area_m2"].to_numpy(), rel=0.01)


def test_a_window_does_not_grow_further_for_a_row_of_houses(tmp_path, monkeypatch):
    """Six houses of a row, each higher than the one before, are 132 m long together; each of them is seen whole."""
    monkeypatch.setattr(tiledbuild, "HALO_M", 10.0)
    monkeypatch.setattr(tiledbuild, "MOST_HALO_M", 60.0)
    houses = tuple(Block(f"{n}", 12 + 22 * n, 14, 22, 14, DATUM_M + 6.0 + 2.5 * n, n + 1) for n in range(6))
    points = [write_points(tmp_path / "row.laz", scan(World("row", (160, 50), houses), seed=0, density=4.0).points)]
    db = tmp_path / "row.sqlite"
    report = msbdb.build(points, db=db, survey="row", tile=TILE_M)
    assert report.buildings == 6
    assert {tile.halo_m for tile in msbdb.tiles(db) if tile.points} <= {10.0, 60.0}
    assert any("may be cut there" in notice for notice in report.notices)


def test_a_larger_building_overrules_what_another_tile_sees_of_it():
    """Two tiles take annexes of a factory for buildings apart; the first one is in order before it."""

    def piece(column, areas, parts):
        rows = [(part, building) for building, own in parts.items() for part in own]
        frames = {
            "building": pd.DataFrame({"building_id": list(areas), "area_m2": list(areas.values())}),
            "part": pd.DataFrame(rows, columns=["part_id", "building_id"]),
        }
        return Piece((0, column), frames, (0, 0), {}, {}, {})

    def taken(pieces):
        def again(_names, *, rasters):
            assert not rasters
            return iter(pieces)

        return again

    pieces = [
        piece(0, {1: 30.0, 2: 500.0}, {1: [1, 11], 2: [2]}),
        piece(1, {3: 60_000.0}, {3: [3, 11, 4]}),
        piece(2, {4: 20.0, 5: 80.0}, {4: [4], 5: [5, 51]}),
        piece(3, {5: 80.0}, {5: [5, 52]}),
    ]
    assert overruled(taken(pieces)) == {(0, 0): {1}, (0, 2): {4}, (0, 3): {5}}
    assert overruled(taken(pieces[:1])) == {}


def test_what_a_window_cuts_is_told(files, tmp_path, monkeypatch):
    """Where the window may not grow, the notice counts the islands, and where neighbours differ."""
    monkeypatch.setattr(tiledbuild, "HALO_M", 5.0)
    monkeypatch.setattr(tiledbuild, "MOST_HALO_M", 5.0)
    db = tmp_path / "town.sqlite"
    report = msbdb.build(files, db=db, survey="town", extract="multiscale", tile=TILE_M)
    assert any("may be cut there" in notice for notice in report.notices)
    lines(db)


def test_a_failed_tile_is_named_and_the_others_complete(files, quick, tmp_path, monkeypatch):
    """No survey is written; the repetition builds this tile alone, and ends in the undisturbed dump."""
    db = tmp_path / "town.sqlite"
    original, built = tilework.find_regions, []

    def fails(job, plan, stages, window):
        built.append(window.own)
        if broken and window.own[:2] == (389_100.0, 5_821_080.0):
            msg = "the disk is on fire"
            raise OSError(msg)
        return original(job, plan, stages, window)

    monkeypatch.setattr(tilework, "find_regions", fails)
    broken = True
    given = {"db": db, "survey": "town", "extract": "multiscale", "tile": TILE_M}
    with pytest.raises(TilesError, match=r"1 tile of 4 of 'town' failed.*the disk is on fire.*--resume"):
        msbdb.build(files, **given)
    states = [tile.state for tile in msbdb.tiles(db)]
    assert (states.count("done"), states.count("failed")) == (3, 1)
    assert "on fire" in next(tile.reason for tile in msbdb.tiles(db) if tile.state == "failed")
    assert msbdb.info(db)["runs"] == []
    shown = CliRunner().invoke(cli, ["tiles", str(db)])
    assert shown.exit_code == 0, shown.output
    assert "1 failed" in shown.stdout
    broken, built[:] = False, []
    assert msbdb.build(files, **given, resume=True).changed
    assert len(built) == 1
    assert lines(db) == lines(quick)
    listed = json.loads(CliRunner().invoke(cli, ["tiles", str(db), "--json"]).stdout)
    assert [tile["state"] for tile in listed] == ["done"] * 4


def test_a_file_that_vanishes_leaves_the_other_tiles(files, tmp_path, monkeypatch):
    """The tiles that do not need it are done; when it is back, the repetition ends in the undisturbed dump."""
    own = [tmp_path / path.name for path in files]
    for path, kept in zip(own, files, strict=True):
        path.write_bytes(kept.read_bytes())
    original = tilework.find_regions

    def loses(job, plan, stages, window):
        own[1].unlink(missing_ok=True)
        return original(job, plan, stages, window)

    monkeypatch.setattr(tilework, "find_regions", loses)
    # Tiles of the west do not see the eastern file.
    monkeypatch.setattr(tiledbuild, "HALO_M", 5.0)
    monkeypatch.setattr(tiledbuild, "MOST_HALO_M", 5.0)
    given = {"survey": "town", "extract": "multiscale", "tile": 50}
    db = tmp_path / "town.sqlite"
    with pytest.raises(TilesError, match=r"e\.laz.*--resume"):
        msbdb.build(own, db=db, **given)
    states = {tile.state for tile in msbdb.tiles(db)}
    assert states == {"done", "failed"}
    own[1].write_bytes(files[1].read_bytes())
    monkeypatch.setattr(tilework, "find_regions", original)
    msbdb.build(own, db=db, **given, resume=True)
    undisturbed = tmp_path / "undisturbed.sqlite"
    msbdb.build(own, db=undisturbed, **given)
    assert lines(db) == lines(undisturbed)


def test_a_full_disk_leaves_the_other_tiles(files, quick, tmp_path, monkeypatch):
    """What could not be written is named, and nothing half is left; with room again the dump is the undisturbed one."""
    original, calls = tilework.Path.write_bytes, []

    def full(path, content):
        if path.name.endswith(".partial"):
            calls.append(path)
            if len(calls) == 2:
                original(path, content[:100])
                raise OSError(errno.ENOSPC, "No space left on device")
        return original(path, content)

    monkeypatch.setattr(tilework.Path, "write_bytes", full)
    db = tmp_path / "town.sqlite"
    given = {"db": db, "survey": "town", "extract": "multiscale", "tile": TILE_M}
    with pytest.raises(TilesError, match=r"1 tile of 4.*No space left on device.*--resume"):
        msbdb.build(files, **given)
    assert [tile.state for tile in msbdb.tiles(db)].count("done") == 3
    assert not list(tmp_path.rglob("*.partial"))
    # A worker that is killed while it writes cannot clear up.
    calls[0].write_bytes(b"half")
    msbdb.build(files, **given, resume=True)
    assert lines(db) == lines(quick)
    assert [path.name for path in tmp_path.iterdir()] == ["town.sqlite"]


def test_a_late_result_is_left_out(tmp_path):
    """A worker may outlive its command: results of another build, or of a tile that is done, change nothing."""
    db = str(tmp_path / "town.sqlite")
    status = TileStatus("town", 0, 0, 0.0, 0.0, 60.0, 60.0)
    begin_tiles(db, [status], "new", epsg=25833, crs_wkt="", resume=False)
    done = replace(status, state="done", points=1)
    note_result(db, done, b"old", "former")
    assert [tile.state for tile in msbdb.tiles(db)] == ["queued"]
    note_result(db, done, b"own", "new")
    note_result(db, replace(done, points=2), b"late", "new")
    assert [(tile.state, tile.points) for tile in msbdb.tiles(db)] == [("done", 1)]
    with opened(db) as engine:
        assert read_result(engine, "town", (0, 0)) == b"own"


def test_the_same_again_changes_nothing(files, quick, tmp_path, monkeypatch):
    """Neither a repetition nor a resumption after the end changes the database; the latter builds no tile."""
    db = tmp_path / "town.sqlite"
    db.write_bytes(quick.read_bytes())
    given = {"db": db, "survey": "town", "extract": "multiscale", "tile": TILE_M}
    assert not msbdb.build(files, **given).changed
    monkeypatch.setattr(tilework, "find_regions", None)
    assert not msbdb.build(files, **given, resume=True).changed
    assert lines(db) == lines(quick)


def test_a_digest_of_a_few_rows_at_a_time_is_that_of_the_rows(files, quick, tmp_path, monkeypatch):
    """Tables in shares of three rows; the check of the database makes the digest again from all rows."""
    db = tmp_path / "town.sqlite"
    monkeypatch.setattr("msbdb.database.runs.digests.SHARE", 3)
    msbdb.build(files, db=db, survey="town", extract="multiscale", tile=TILE_M)
    with opened(db) as engine:
        assert len(read_tables(engine, (BUILDING,))["building"]) > 3
    assert lines(db) == lines(quick)


def test_a_killed_client_goes_on_where_it_was(files, quick, tmp_path):
    """Tiles that were done are not repeated; the dump is the undisturbed one."""
    db, marker = tmp_path / "town.sqlite", tmp_path / "done"
    code = (
        "import sys, msbdb\n"
        "from msbdb.scale import tilework\n"
        "from support.tiledtown import TILE_M, end_at_third\n"
        "tilework.work = end_at_third\n"
        "msbdb.build(sys.argv[2:], db=sys.argv[1], survey='town', extract='multiscale', tile=TILE_M)\n"
    )
    ended = subprocess.run(
        [sys.executable, "-c", code, str(db), *map(str, files)],
        env=environment(**{KILLED: str(marker)}), capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert ended.returncode == -signal.SIGKILL, ended.stderr
    states = [tile.state for tile in msbdb.tiles(db)]
    assert (states.count("done"), states.count("running")) == (2, 1)
    before = {tile.key: tile.seconds for tile in msbdb.tiles(db) if tile.state == "done"}
    msbdb.build(files, db=db, survey="town", extract="multiscale", tile=TILE_M, resume=True)
    assert before == {tile.key: tile.seconds for tile in msbdb.tiles(db) if tile.key in before}
    assert lines(db) == lines(quick)
    assert {path.name for path in tmp_path.iterdir()} == {"done", "town.sqlite"}


def test_results_of_two_surveys_do_not_mix(files, quick, tmp_path, monkeypatch):
    """A survey that fails half-way, and another one on the same tiles, go on and end as if each had been alone."""
    db = tmp_path / "town.sqlite"
    original = tilework.find_regions

    def fails(job, plan, stages, window):
        if window.own[:2] == (389_100.0, 5_821_080.0):
            raise OSError
        return original(job, plan, stages, window)

    monkeypatch.setattr(tilework, "find_regions", fails)
    given = {"db": db, "extract": "multiscale", "tile": TILE_M}
    with pytest.raises(TilesError):
        msbdb.build(files, survey="town", **given)
    monkeypatch.setattr(tilework, "find_regions", original)
    msbdb.build(files[:1], survey="west", **given)
    msbdb.build(files, survey="town", **given, resume=True)
    with opened(quick) as one, opened(db) as other:
        before, after = (read_buildings(engine, "town")["building_id"] for engine in (one, other))
    assert before.tolist() == after.tolist()
    assert [path.name for path in tmp_path.iterdir()] == ["town.sqlite"]


def test_an_area_of_interest_is_cut_in_tiles(files, tmp_path):
    """What lies in the area is built as in one piece, and the survey's extent is the same."""
    shape = shapely.box(389_095.0, 5_821_025.0, 389_155.0, 5_821_135.0)
    area = tmp_path / "district.geojson"
    gpd.GeoDataFrame(geometry=[shape], crs=town().points.crs).to_crs("EPSG:4326").to_file(area)
    given = {"survey": "town", "extract": "multiscale", "aoi": area}
    msbdb.build(files, db=tmp_path / "one.sqlite", **given)
    msbdb.build(files, db=tmp_path / "tiles.sqlite", **given, tile=TILE_M)
    assert without_counts(lines(tmp_path / "tiles.sqlite")) == without_counts(lines(tmp_path / "one.sqlite"))
    assert all(tile.points for tile in msbdb.tiles(tmp_path / "tiles.sqlite"))


def test_parcels_and_a_terrain_are_cut_in_tiles(files, tmp_path):
    """They divide houses and give the ground as in one piece; no parcel lies in most windows."""
    crs, corner = town().points.crs, (389_040.0, 5_821_020.0)
    halves = [shapely.box(corner[0] + x, corner[1] + 40, corner[0] + x + 17, corner[1] + 80) for x in (44, 61)]
    gpd.GeoDataFrame(geometry=halves, crs=crs).to_crs("EPSG:4326").to_file(tmp_path / "parcels.geojson")
    spec = GridSpec((300, 300), Affine(1.0, 0, corner[0] - 90, 0, -1.0, corner[1] + 210), crs)
    ground = np.fromfunction(lambda row, col: DATUM_M + (row - col) / 500, spec.shape).astype(np.float32)
    dtm = write_heights(tmp_path / "dtm.tif", Grid(ground, np.ones(spec.shape, bool), spec))
    given = {"survey": "town", "parcels": tmp_path / "parcels.geojson", "dtm": dtm}
    msbdb.build(files, db=tmp_path / "one.sqlite", **given)
    msbdb.build(files, db=tmp_path / "tiles.sqlite", **given, tile=TILE_M)
    with msbdb.open(tmp_path / "tiles.sqlite") as found:
        assert "parcel" in set(found.buildings()["divided_by"])
    assert without_counts(lines(tmp_path / "tiles.sqlite")) == without_counts(lines(tmp_path / "one.sqlite"))


def test_a_build_in_one_piece_takes_the_place_of_tiles(files, quick, tmp_path):
    """The rows of the tiles go with them; the content stays but for the counts."""
    db = tmp_path / "town.sqlite"
    db.write_bytes(quick.read_bytes())
    msbdb.build(files, db=db, survey="town", extract="multiscale")
    assert msbdb.tiles(db) == []
    assert without_counts(lines(db)) == without_counts(lines(quick))


def test_classes_of_a_survey_in_tiles_are_labelled_again(quick, tmp_path):
    """A re-labelling reads the pieces as one; a build in tiles that would lose the label is refused."""
    db = tmp_path / "town.sqlite"
    db.write_bytes(quick.read_bytes())
    msbdb.relabel(db, {1: "vegetation"})
    assert msbdb.classes(db)["labelled_by"].tolist()[0] == "operator"


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        ({"tile": 20}, ParameterError, "at least 50 m"),
        ({"tile": 60, "denoising_figure": "figure.png"}, InputError, "does not take a picture"),
    ],
)
def test_what_cannot_be_cut_is_refused(files, tmp_path, given, error, words):
    """The message says what to leave out; no database is made."""
    given = {name: tmp_path / value if name == "denoising_figure" else value for name, value in given.items()}
    with pytest.raises(error, match=words):
        msbdb.build(files, db=tmp_path / "town.sqlite", **given)
    assert not (tmp_path / "town.sqlite").exists()


def test_labels_are_not_lost(files, quick, tmp_path):
    """A build in tiles of a survey with labels needs --replace."""
    db = tmp_path / "town.sqlite"
    db.write_bytes(quick.read_bytes())
    msbdb.relabel(db, {1: "vegetation"})
    with pytest.raises(InputError, match="would lose the labels"):
        msbdb.build(files, db=db, survey="town", extract="multiscale", tile=TILE_M)
    assert np.count_nonzero(msbdb.classes(db)["labelled_by"] == "operator") == 1

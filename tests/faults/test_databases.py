"""Bad databases and full disks: the build says so in one clear line, and what was there before stays as it was."""

import contextlib
import hashlib
import json
import os
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import geopandas as gpd
import pytest
import shapely
from click.testing import CliRunner
from pyproj import CRS
from simulated.scenes import SCENES
from support.faultfiles import write_points
from support.sizes import sample

import msbdb
from msbdb.cli.main import cli
from msbdb.database import check_target, open_database
from msbdb.database.dialects.sqliteconnection import driver
from msbdb.run import store


def run(*args):
    """Run the program inside of this process."""
    return CliRunner().invoke(cli, [str(arg) for arg in args])


def refused(result, *expected):
    """Check that a command failed in one line that says what is expected."""
    assert isinstance(result.exception, SystemExit), result.exception
    assert result.exit_code == 1, result.output
    told = result.stderr.strip().splitlines()
    assert len(told) == 1, result.stderr
    assert told[0].startswith("Error: ")
    assert "bug in msbdb" not in told[0]
    for words in expected:
        assert words in told[0], told[0]


def checksums(folder):
    """Return the checksum of every file in a folder."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path: hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def dump(db):
    """Return a database's content after checking that it is sound."""
    with msbdb.open(db) as inventory:
        with inventory.engine.connect() as connection:
            assert connection.exec_driver_sql("PRAGMA integrity_check").scalar() == "ok"
            assert connection.exec_driver_sql("PRAGMA foreign_key_check").all() == []
        return inventory.dump()


@contextlib.contextmanager
def connect(path):
    """Open a file as another program would; by the same library, as two in one process drop each other's locks."""
    connection = driver().connect(str(path), isolation_level=None)
    try:
        yield connection
    finally:
        connection.close()


@pytest.fixture(scope="module")
def tiles(tmp_path_factory):
    """Return two tiles of the same place: one with a building, one with a meadow."""
    folder = tmp_path_factory.mktemp("tiles")
    scenes = {name: SCENES[name](density=2.0).points for name in ("podium_tower", "flat_field")}
    return {name: write_points(folder / f"{name}.laz", cloud, crs=cloud.crs) for name, cloud in scenes.items()}


@pytest.fixture(scope="module")
def built(tmp_path_factory, tiles):
    """Return a database of the meadow."""
    db = tmp_path_factory.mktemp("built") / "town.sqlite"
    assert run("build", "--points", tiles["flat_field"], "--db", db).exit_code == 0
    return db


@pytest.fixture
def town(tmp_path, built):
    """Return a copy of that database in a folder of its own."""
    folder = tmp_path / "place"
    folder.mkdir()
    return Path(shutil.copy(built, folder / "town.sqlite"))


@contextlib.contextmanager
def file_limit(size):
    """Let no file of this process grow beyond a size, as on a full disk: Python ignores the signal, writing fails.

    Bytecode is not written meanwhile: Python would keep what a module's file has room for, and fail to import it later.
    """
    before, kept = resource.getrlimit(resource.RLIMIT_FSIZE), sys.dont_write_bytecode
    sys.dont_write_bytecode = True
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        sys.dont_write_bytecode = kept


@contextlib.contextmanager
def small_disk(folder, size, *options):
    """Mount a small file system in memory, where that is allowed."""
    folder.mkdir(exist_ok=True)
    mount = ["mount", "-t", "tmpfs", "-o", ",".join([f"size={size}", *options]), "tmpfs", str(folder)]
    if (
        os.getuid() != 0
        or shutil.which("mount") is None
        or subprocess.run(mount, check=False, capture_output=True).returncode
    ):
        pytest.skip("mounting a small file system needs more rights")
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def make_text(path):
    """Write a text under the database's name."""
    path.write_text("These are my notes, not a database.\n" * 50)


def make_sqlite(path):
    """Write a SQLite file of another program."""
    with connect(path) as connection:
        connection.execute("CREATE TABLE notes (words TEXT)")
        connection.execute("INSERT INTO notes VALUES ('mine')")


def make_geopackage(path):
    """Write a GeoPackage."""
    layer = gpd.GeoDataFrame(geometry=[shapely.box(0, 0, 1, 1)], crs="EPSG:32633")
    layer.to_file(path, driver="GPKG")


FOREIGN = {
    "text": (make_text, "not an SQLite file"),
    "another SQLite": (make_sqlite, "without the table msbdb_schema_version"),
    "a GeoPackage": (make_geopackage, "without the table msbdb_schema_version"),
}


@pytest.mark.parametrize("kind", FOREIGN)
@pytest.mark.parametrize("command", ["build", "info", "export"])
def test_foreign_files_are_refused_and_left_alone(tmp_path, tiles, kind, command):
    """Before any work is done, byte for byte."""
    make, expected = FOREIGN[kind]
    db = tmp_path / "town.gpkg"
    make(db)
    before = checksums(tmp_path)
    broken = tmp_path / "broken.laz"
    args = {"build": ["--points", broken, "--db", db], "info": [db], "export": [db, tmp_path / "out.gpkg"]}
    broken.write_bytes(b"")
    before[broken] = hashlib.sha256(b"").hexdigest()
    refused(run(command, *args[command]), str(db), "no msbdb database", expected, "Give another path")
    assert checksums(tmp_path) == before


@pytest.mark.long
@pytest.mark.parametrize("command", ["build", "info"])
def test_a_newer_schema_is_refused(tiles, town, command):
    """The message tells both versions, and nothing is changed."""
    with connect(town) as connection:
        connection.execute("UPDATE msbdb_schema_version SET version_num = '9999'")
    before = checksums(town.parent)
    args = {"build": ["--points", tiles["podium_tower"], "--db", town], "info": [town]}
    refused(run(command, *args[command]), "schema 9999", "knows schemas up to", "Use the msbdb that wrote it")
    assert checksums(town.parent) == before


def test_a_torn_database_is_refused(tiles, town):
    """A file that lost its second half is damaged, not a bug."""
    town.write_bytes(town.read_bytes()[: town.stat().st_size // 2])
    before = checksums(town.parent)
    refused(run("build", "--points", tiles["podium_tower"], "--db", town), str(town), "damaged")
    assert checksums(town.parent) == before


def test_another_crs_is_refused(tmp_path, tiles, town, monkeypatch):
    """A database has one CRS; both are named, before the points are read."""
    monkeypatch.delattr("msbdb.run.preparation.drafts.read_points")
    cloud = SCENES["podium_tower"](density=1.0).points
    other = write_points(tmp_path / "other.laz", cloud, crs=CRS.from_epsg(32632))
    before = checksums(town.parent)
    refused(run("build", "--points", other, "--db", town), "32633", "32632", "Reproject")
    assert checksums(town.parent) == before


@pytest.mark.long
@pytest.mark.parametrize("lock", sample(["EXCLUSIVE", "IMMEDIATE"], 2))
def test_a_locked_database_is_told(tiles, town, monkeypatch, lock):
    """After a wait; the old content stays, and the build completes once the lock is gone."""
    before = dump(town)
    for function in (open_database, check_target):
        monkeypatch.setitem(function.__kwdefaults__, "timeout_s", 0.2)
    monkeypatch.setattr(store, "PATIENCE_S", 0.2)
    build = ("build", "--points", tiles["podium_tower"], "--db", town)
    with connect(town) as other:
        other.execute(f"BEGIN {lock}")
        refused(run(*build), str(town), "locked", "try again")
        other.execute("ROLLBACK")
    assert dump(town) == before
    assert run(*build).exit_code == 0
    assert len(dump(town)) > len(before)


def test_a_reader_does_not_stop_a_build(tiles, town):
    """A GIS that has the database open sees the old content, and the new one afterwards."""
    count = "SELECT count(*) FROM part"
    with connect(town) as reader:
        reader.execute("PRAGMA journal_mode = WAL")
        reader.execute("BEGIN")
        assert reader.execute(count).fetchone() == (0,)
        assert run("build", "--points", tiles["podium_tower"], "--db", town).exit_code == 0
        assert reader.execute(count).fetchone() == (0,)
        reader.execute("COMMIT")
        assert reader.execute(count).fetchone() == (3,)


PLACES = {
    "a missing folder": (lambda folder: folder / "none" / "town.sqlite", "there is no folder"),
    "a folder": (lambda folder: folder, "Is a directory"),
    "a file's inside": (lambda folder: folder / "file" / "town.sqlite", "there is no folder"),
    "an unknown server": (lambda _: "mysql://me@localhost/town", "SpatiaLite file or a PostGIS URL"),
}


@pytest.mark.parametrize("kind", PLACES)
def test_impossible_places_are_refused(tmp_path, tiles, kind):
    """Before any work is done."""
    (tmp_path / "file").write_text("a file")
    where, expected = PLACES[kind]
    refused(run("build", "--points", tiles["flat_field"], "--db", where(tmp_path)), expected)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize("command", ["info", "classes", "export", "view", "evaluate"])
def test_a_missing_database_is_told_and_not_made(tmp_path, tiles, command):
    """Reading creates nothing."""
    args = {
        "export": [tmp_path / "out.gpkg"],
        "view": ["--out", tmp_path / "out.png"],
        "evaluate": ["--reference", tiles["flat_field"]],
    }
    result = run(command, tmp_path / "none.sqlite", *args.get(command, []))
    refused(result, "There is no msbdb database", "none.sqlite")
    assert list(tmp_path.iterdir()) == []


def test_a_read_only_place_is_refused_for_writing_and_read(tmp_path, tiles, built):
    """A database on read-only media can be looked at, not built into; a map beside it cannot be drawn."""
    with small_disk(tmp_path / "disk", "20m") as disk:
        db = Path(shutil.copy(built, disk / "town.sqlite"))
        subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
        refused(run("build", "--points", tiles["podium_tower"], "--db", db), "read-only")
        refused(run("build", "--points", tiles["podium_tower"], "--db", disk / "new.sqlite"), "read-only")
        refused(run("view", db, "--out", disk / "town.png"), "town.png", "read-only")
        refused(run("export", db, disk / "town.gpkg"), "town.gpkg", "read-only")
        assert json.loads(run("info", db, "--json").stdout)["runs"][0]["parts"] == 0


def full_then_free(tile, db, full, *, before):
    """Build while the disk is full: refused and as before; then with room; return the content.

    All that may lie beside an old database meanwhile is its log, which the second build takes in.
    """
    build = ("build", "--points", tile, "--db", db)
    there = {path for path in db.parent.iterdir() if path != db}
    with full():
        refused(run(*build), str(db), "free some space")
    log = {db.with_name(f"{db.name}-{part}") for part in ("wal", "shm")}
    assert {path for path in db.parent.iterdir() if path != db} - (set() if before is None else log) == there
    if before is None:
        assert not db.exists()
    else:
        assert dump(db) == before
    assert run(*build).exit_code == 0
    assert {path for path in db.parent.iterdir() if path != db} == there
    return dump(db)


@pytest.mark.parametrize("limit", sample([50_000, 0, 300_000], 3))
def test_a_new_file_that_may_not_grow_is_like_a_full_disk(tmp_path, tiles, built, limit):
    """Wherever in its creation it stops; the second build makes the same database as an undisturbed one."""
    assert limit < built.stat().st_size
    again = full_then_free(tiles["flat_field"], tmp_path / "town.sqlite", lambda: file_limit(limit), before=None)
    assert again == dump(built)


@pytest.mark.parametrize("limit", sample([20_000, 0, 100_000], 3))
def test_an_old_file_that_may_not_grow_keeps_its_content(tiles, town, limit):
    """Wherever in the transaction it stops."""
    full_then_free(tiles["podium_tower"], town, lambda: file_limit(limit), before=dump(town))


@pytest.mark.parametrize("room", sample([20_000, 0, 80_000], 3))
@pytest.mark.parametrize("new", sample([True, False], 2), ids=["new", "old"])
def test_a_full_disk_is_told_and_nothing_is_lost(tmp_path, tiles, built, new, room):
    """On a disk that is really full, with that much room left."""
    with small_disk(tmp_path / "disk", "5m") as disk:
        db = disk / "town.sqlite"
        if not new:
            shutil.copy(built, db)

        @contextlib.contextmanager
        def full():
            block = disk / "block"
            block.write_bytes(bytes(shutil.disk_usage(disk).free - room))
            yield
            block.unlink()

        tile = tiles["flat_field" if new else "podium_tower"]
        again = full_then_free(tile, db, full, before=None if new else dump(db))
        assert not new or again == dump(built)


@pytest.mark.parametrize("ending", sample(["gpkg", "shp", "geojson", "png"], 4))
def test_outputs_on_a_full_disk_are_whole_or_absent(tmp_path, tiles, built, ending):
    """An export or map that does not fit leaves the former file, or none, and no strays."""
    folder = tmp_path / "out"
    folder.mkdir()
    db = Path(shutil.copy(built, tmp_path / "town.sqlite"))
    assert run("build", "--points", tiles["podium_tower"], "--db", db, "--survey", "podium").exit_code == 0
    out = folder / f"town.{ending}"
    options = [db, "--survey", "podium"]
    command = ["view", *options, "--out", out] if ending == "png" else ["export", *options, out]
    for before in ({}, {out: "the former file"}):
        for path, words in before.items():
            path.write_text(words)
        with file_limit(150):
            refused(run(*command, "--overwrite"), f"town.{ending}", "space")
        assert {path: path.read_text() for path in folder.iterdir()} == before
    assert run(*command, "--overwrite").exit_code == 0
    assert out.stat().st_size > 150

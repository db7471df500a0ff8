"""Opening, creating and upgrading databases, and every way in which that can fail."""

import os
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import pytest
from pyproj import CRS
from simulated.builds import EPSG, big_build, small_build
from sqlalchemy import Engine, event, text
from support.latermigration import LATER, migrations_of_tomorrow

from msbdb.database import canonical_dump, open_database, read_build, srid_of, write_build
from msbdb.database.dialects import migration as upgrade
from msbdb.database.dialects import sqliteconnection
from msbdb.database.dialects.dialect import database_url, dialect_of, shown
from msbdb.errors import CRSError, DatabaseError, MissingDependencyError, ParameterError, SchemaVersionError

ROOT = Path(__file__).resolve().parents[2]


def test_a_new_database_opens_again_without_its_crs_being_told(target: str) -> None:
    """The CRS is chosen once, and is found in the database afterwards."""
    open_database(target, create=True, srid=EPSG)
    engine = open_database(target)
    with engine.connect() as connection:
        assert dialect_of(engine.url).database_srid(connection) == EPSG
        words = connection.scalar(text("SELECT srtext FROM spatial_ref_sys WHERE srid = :srid"), {"srid": EPSG})
    assert "Amersfoort / RD New" in words


def test_creating_twice_keeps_what_is_there(target: str) -> None:
    """``create`` makes a database only where there is none."""
    engine = open_database(target, create=True, srid=EPSG)
    write_build(engine, small_build())
    before = list(canonical_dump(engine))
    assert list(canonical_dump(open_database(target, create=True, srid=EPSG))) == before


def test_a_database_that_is_not_there_is_not_made_unasked(target: str, tmp_path: Path) -> None:
    """Reading never leaves an empty file behind."""
    with pytest.raises(DatabaseError, match="There is no msbdb database"):
        open_database(target)
    assert list(tmp_path.iterdir()) == []


def test_a_new_database_needs_a_crs(target: str) -> None:
    """The geometry columns have an SRID from the first."""
    with pytest.raises(ParameterError, match="needs its CRS"):
        open_database(target, create=True)


def test_a_second_crs_is_refused(target: str) -> None:
    """One database has one CRS."""
    engine = open_database(target, create=True, srid=EPSG)
    with pytest.raises(CRSError, match=r"is in EPSG:28992, and EPSG:25832 was given.*Reproject"):
        open_database(target, create=True, srid=25832)
    with pytest.raises(CRSError, match="25832"):
        write_build(engine, big_build(1, epsg=25832))


def test_degrees_are_refused(target: str) -> None:
    """Areas and lengths are metric."""
    with pytest.raises(CRSError, match="projected"):
        open_database(target, create=True, srid=4326)


def test_an_unknown_code_is_refused(target: str) -> None:
    """PROJ must know the CRS."""
    with pytest.raises(CRSError, match="999"):
        open_database(target, create=True, srid=999)


def test_a_crs_without_code_is_registered_under_a_number_of_its_own(target: str) -> None:
    """The number depends on the CRS alone, and lies where PostGIS wants it."""
    wkt = CRS.from_proj4("+proj=tmerc +lat_0=10 +lon_0=20 +k=1 +x_0=500 +y_0=0 +ellps=GRS80 +units=m").to_wkt()
    srid = srid_of(0, wkt)
    assert 910_000 <= srid <= 998_999
    engine = open_database(target, create=True, srid=0, crs_wkt=wkt)
    open_database(target, srid=0, crs_wkt=wkt)
    with engine.connect() as connection:
        assert dialect_of(engine.url).database_srid(connection) == srid
        words = connection.scalar(text("SELECT srtext FROM spatial_ref_sys WHERE srid = :srid"), {"srid": srid})
    parameters = {p.name: p.value for p in CRS.from_wkt(words).coordinate_operation.params}
    assert parameters["Longitude of natural origin"] == 20


@pytest.mark.parametrize("content", [b"just words\n" * 100, b"\x00" * 4096, b"S"])
def test_a_file_that_is_no_sqlite_is_left_alone(tmp_path: Path, content: bytes) -> None:
    """A foreign file is refused, and not touched."""
    path = tmp_path / "notes.txt"
    path.write_bytes(content)
    for create in (False, True):
        with pytest.raises(SchemaVersionError, match="not an SQLite file"):
            open_database(path, create=create, srid=EPSG)
    assert path.read_bytes() == content


def test_somebody_elses_sqlite_is_left_alone(tmp_path: Path) -> None:
    """Nothing of msbdb is written into another program's file."""
    path = tmp_path / "other.sqlite"
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("CREATE TABLE alembic_version (version_num TEXT)")
    before = path.read_bytes()
    with pytest.raises(SchemaVersionError, match="no msbdb database"):
        open_database(path, create=True, srid=EPSG)
    assert path.read_bytes() == before


def test_a_damaged_file_is_told(tmp_path: Path) -> None:
    """A file that only begins as SQLite gives our error, not the driver's."""
    path = tmp_path / "city.sqlite"
    path.write_bytes(b"SQLite format 3\x00" + b"\xff" * 5000)
    with pytest.raises(DatabaseError):
        open_database(path)


def test_an_empty_file_is_replaced(tmp_path: Path) -> None:
    """A file of no bytes, such as mktemp makes, is as good as none."""
    path = tmp_path / "city.sqlite"
    path.touch()
    open_database(path, create=True, srid=EPSG)
    open_database(path)
    assert [p.name for p in tmp_path.iterdir()] == ["city.sqlite"]


def test_a_newer_schema_is_refused(target: str) -> None:
    """An older msbdb does not touch what it does not understand."""
    engine = open_database(target, create=True, srid=EPSG)
    with engine.begin() as connection:
        connection.execute(text("UPDATE msbdb_schema_version SET version_num = '9999'"))
    for create in (False, True):
        with pytest.raises(SchemaVersionError, match="9999"):
            open_database(target, create=create, srid=EPSG)


def test_an_older_schema_is_upgraded_when_building(
    target: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reading says what to do; building upgrades, and keeps the content."""
    engine = open_database(target, create=True, srid=EPSG)
    write_build(engine, small_build())
    before = list(canonical_dump(engine))
    tomorrow = migrations_of_tomorrow(tmp_path / "a folder of 100%")
    with monkeypatch.context() as patch:
        patch.setattr(upgrade, "packaged", lambda _name: tomorrow)
        with pytest.raises(SchemaVersionError, match=r"older schema .*'msbdb db upgrade \S+'"):
            open_database(target)
        upgraded = open_database(target, create=True)
        with upgraded.connect() as connection:
            assert connection.scalar(text("SELECT count(*) FROM visit")) == 1
        assert list(canonical_dump(open_database(target))) == before
    with pytest.raises(SchemaVersionError, match=LATER):
        open_database(target)


def test_a_failing_upgrade_changes_nothing(target: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Changes of the schema are part of the transaction, on SQLite too."""
    engine = open_database(target, create=True, srid=EPSG)
    broken = migrations_of_tomorrow(tmp_path / "broken", broken='op.execute("SELECT no_such_function()")')
    with monkeypatch.context() as patch:
        patch.setattr(upgrade, "packaged", lambda _name: broken)
        with pytest.raises(DatabaseError):
            open_database(target, create=True)
    open_database(target)
    with engine.connect() as connection:
        assert "visit" not in connection.dialect.get_table_names(connection)


def hold_write_lock(engine: Engine) -> object:
    """Return an open connection that holds the writers' lock."""
    connection = engine.raw_connection()
    if engine.dialect.name == "sqlite":
        connection.cursor().execute("BEGIN IMMEDIATE")
    else:
        connection.cursor().execute("SELECT pg_advisory_xact_lock(%s)", (0x6D73626462,))
    return connection


def test_a_locked_database_is_told_after_a_wait(target: str) -> None:
    """Two writers do not wait for each other for ever, and the second changes nothing."""
    open_database(target, create=True, srid=EPSG)
    engine = open_database(target, timeout_s=0.5)
    holder = hold_write_lock(engine)
    start = time.monotonic()
    try:
        with pytest.raises(DatabaseError, match="locked"):
            write_build(engine, small_build())
    finally:
        holder.close()
    assert 0.4 < time.monotonic() - start < 60
    assert write_build(engine, small_build()).status == "created"


@pytest.mark.parametrize("place", ["no/such/folder/city.sqlite", "file/city.sqlite", "folder", "/proc/city.sqlite"])
def test_an_unwritable_path_is_told(tmp_path: Path, place: str) -> None:
    """Missing folders, files taken for folders and the like end in our error."""
    (tmp_path / "file").write_text("x")
    (tmp_path / "folder").mkdir()
    with pytest.raises(DatabaseError, match=r"city\.sqlite|folder"):
        open_database(tmp_path / place, create=True, srid=EPSG)


def test_a_full_disk_leaves_the_old_content(tmp_path: Path) -> None:
    """When the space runs out, nothing was changed."""
    engine = open_database(tmp_path / "city.sqlite", create=True, srid=EPSG)
    write_build(engine, small_build())
    before = list(canonical_dump(engine))

    def limit(connection: sqlite3.Connection, _record: object) -> None:
        connection.execute("PRAGMA max_page_count = 130")

    event.listen(engine, "connect", limit)
    with pytest.raises(DatabaseError, match="full"):
        write_build(engine, big_build(2000))
    event.remove(engine, "connect", limit)
    assert list(canonical_dump(engine)) == before


def test_missing_spatialite_names_the_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The message says what to install."""
    monkeypatch.setattr(sqliteconnection, "EXTENSION", "no_such_extension")
    with pytest.raises(MissingDependencyError, match="apt-get install libsqlite3-mod-spatialite"):
        open_database(tmp_path / "city.sqlite", create=True, srid=EPSG)
    assert list(tmp_path.iterdir()) == []


def test_a_python_without_extensions_names_the_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where neither SQLite can load SpatiaLite, the message says what to install."""
    monkeypatch.setattr(sqlite3, "Connection", object)
    monkeypatch.setitem(sys.modules, "pysqlite3", None)
    monkeypatch.setitem(sys.modules, "pysqlite3.dbapi2", None)
    with pytest.raises(MissingDependencyError, match="pysqlite3-binary"):
        open_database(tmp_path / "city.sqlite", create=True, srid=EPSG)


@pytest.mark.parametrize(
    "url",
    [
        "postgresql://me:s3cret@127.0.0.1:1/none",
        "postgresql+psycopg://me@127.0.0.1:1/none?password=s3cret",
        "postgresql://me:s3cret@127.0.0.1:port/none",
        "mysql://me:s3cret@127.0.0.1/none",
        "nonsense://me:s3cret@@@",
    ],
)
def test_passwords_are_never_shown(url: str) -> None:
    """Neither the message nor its causes' messages hold the password."""
    with pytest.raises(DatabaseError) as caught:
        open_database(url, timeout_s=2)
    error: BaseException | None = caught.value
    while error is not None:
        assert "s3cret" not in str(error)
        error = error.__cause__


def test_a_url_is_shown_without_its_password() -> None:
    """Reports and logs show servers so that they can be recognised."""
    url = database_url("postgresql://me:s3cret@host/city")
    assert shown(url) == "postgresql+psycopg://me:***@host/city"


@pytest.mark.postgis
def test_a_server_database_that_does_not_exist_is_told(new_postgis) -> None:
    """The server's own words are passed on."""
    url = database_url(new_postgis()).set(database="no_such_database")
    with pytest.raises(DatabaseError, match="no_such_database"):
        open_database(url)


@pytest.mark.postgis
def test_tables_of_another_program_are_left_alone(new_postgis) -> None:
    """A database in which a name is taken is refused as a whole."""
    url = database_url(new_postgis())
    engine = dialect_of(url).make_engine(url, 5)
    with engine.begin() as connection:
        connection.execute(text("CREATE TABLE part (what TEXT)"))
    with pytest.raises(DatabaseError, match="another program"):
        open_database(url, create=True, srid=EPSG)
    with engine.connect() as connection:
        assert sorted(connection.dialect.get_table_names(connection)) == ["part", "spatial_ref_sys"]


def test_odd_paths_are_just_paths(tmp_path: Path) -> None:
    """Blanks, quotes, question marks and percent signs in names are of no matter."""
    folder = tmp_path / "o'Brien & söhne?mode=ro#1 100%[x]"
    folder.mkdir()
    path = folder / 'ci"ty.sqlite'
    write_build(open_database(path, create=True, srid=EPSG), small_build())
    assert len(read_build(open_database(path)).frames["part"]) == 6
    assert [p.name for p in folder.iterdir()] == [path.name]


KILLED_CREATION = """
import os, signal, sys
from msbdb.database import open_database
from msbdb.database.dialects import migration
def die(*args):
    os.kill(os.getpid(), signal.SIGKILL)
migration.{function} = die
open_database(sys.argv[1], create=True, srid=28992)
"""


@pytest.mark.parametrize("function", ["register", "migrate"])
def test_a_kill_during_creation_leaves_no_half_database(tmp_path: Path, function: str) -> None:
    """The file appears whole or not at all, and the next creation clears up."""
    path = tmp_path / "city.sqlite"
    code = KILLED_CREATION.format(function=function)
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    assert subprocess.run([sys.executable, "-c", code, str(path)], env=env, check=False).returncode == -9
    assert not path.exists()
    assert list(tmp_path.iterdir()) != []
    open_database(path, create=True, srid=EPSG)
    assert [p.name for p in tmp_path.iterdir()] == ["city.sqlite"]


def test_many_may_create_at_once(tmp_path: Path) -> None:
    """Whoever comes second uses the first one's database."""
    path = tmp_path / "city.sqlite"
    code = "import sys; from msbdb.database import open_database; open_database(sys.argv[1], create=True, srid=28992)"
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    processes = [subprocess.Popen([sys.executable, "-c", code, str(path)], env=env) for _ in range(2)]
    assert [process.wait() for process in processes] == [0, 0]
    assert [p.name for p in tmp_path.iterdir()] == ["city.sqlite"]
    assert open_database(path, srid=EPSG) is not None


AFTERWARDS = """
import sys
from msbdb.database.dialects import spatialite
from sqlalchemy import make_url, text

engine = spatialite.make_engine(make_url("sqlite://"), 1.0)
with engine.connect() as connection:
    assert connection.scalar(text("SELECT InitSpatialMetaData(0)")) == 1
assert "rasterio" not in sys.modules
import rasterio.warp
import pyogrio
import geopandas
from pyproj import Transformer

assert Transformer.from_crs(28992, 4326).transform(85000, 446000)[0] > 51
assert rasterio.warp.transform("EPSG:28992", "EPSG:4326", [85000], [446000])[1][0] > 51
frame = geopandas.GeoDataFrame(geometry=geopandas.points_from_xy([85000], [446000]), crs=28992)
frame.to_crs(4326).to_file(sys.argv[1])
assert len(pyogrio.read_dataframe(sys.argv[1])) == 1
with engine.connect() as connection:
    assert connection.scalar(text("SELECT ST_Area(BuildMbr(0, 0, 2, 3))")) == 6
print("whole")
"""


def test_other_libraries_can_be_imported_after_spatialite(tmp_path: Path) -> None:
    """Rasterio, pyogrio, geopandas and PROJ work in a process that has opened a SpatiaLite database before."""
    call = [sys.executable, "-c", AFTERWARDS, str(tmp_path / "point.gpkg")]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "whole\n"), done.stderr


@pytest.mark.postgis
def test_loads_share_a_session_that_is_kept_open(new_postgis):
    """One process of the server serves loads until the engine is disposed of; a lost one is replaced."""
    engine = open_database(new_postgis(), create=True, srid=EPSG, keep_open=True)
    own = text("SELECT pg_backend_pid()")
    others = text("SELECT count(*) FROM pg_stat_activity WHERE datname = current_database() AND pid = :pid")
    with engine.connect() as connection:
        first = connection.scalar(own)
    write_build(engine, small_build())
    with engine.connect() as connection:
        assert connection.scalar(own) == first
    again = open_database(engine.url)
    with again.connect() as connection:
        connection.execute(text("SELECT pg_terminate_backend(:pid)"), {"pid": first})
    assert write_build(engine, small_build()).status == "unchanged"
    with engine.connect() as connection:
        second = connection.scalar(own)
    assert second != first
    engine.dispose()
    with again.connect() as connection:
        for _ in range(50):
            if not connection.scalar(others, {"pid": second}):
                return
            time.sleep(0.1)
    pytest.fail("The session is still there.")

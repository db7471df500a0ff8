"""Creating, upgrading, downgrading and copying databases on purpose."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from pyproj import CRS
from simulated.builds import EPSG, HOSTILE, small_build
from sqlalchemy import func, select, text
from support.latermigration import LATER, TODAY, migrations_of_tomorrow
from support.sizes import sample

from msbdb.database import (
    canonical_dump,
    check_database,
    copy_database,
    create_database,
    downgrade_schema,
    list_runs,
    open_database,
    read_build,
    srid_of,
    upgrade_schema,
    write_build,
)
from msbdb.database.admin.lifecycle import open_any, version_of
from msbdb.database.dialects import migration as upgrade
from msbdb.database.schema.sqltables import METADATA
from msbdb.errors import CRSError, DatabaseError, ParameterError, SchemaVersionError

ROOT = Path(__file__).resolve().parents[2]
BOTH = ["spatialite", pytest.param("postgis", marks=pytest.mark.postgis)]


@pytest.fixture(params=BOTH)
def other(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """Return a second place, on each dialect, so that with ``target`` all pairs are tried."""
    if request.param == "spatialite":
        return str(tmp_path / "other.sqlite")
    return request.getfixturevalue("new_postgis")()


def dump(target: str) -> list[str]:
    """Return all content, source files included."""
    return list(canonical_dump(open_database(target), provenance=True))


def counts(target: str) -> dict[str, int]:
    """Return the rows by table."""
    with open_database(target).connect() as connection:
        return {
            name: connection.scalar(select(func.count()).select_from(table)) for name, table in METADATA.tables.items()
        }


def test_a_created_database_is_empty_sound_and_in_its_crs(target: str) -> None:
    """Created once; the second time it is left as it is, rows and all."""
    assert create_database(target, "EPSG:28992")
    engine = open_database(target, srid=EPSG)
    assert set(counts(target).values()) == {0}
    assert check_database(engine) == []
    write_build(engine, small_build())
    before = dump(target)
    assert not create_database(target, "EPSG:28992")
    assert dump(target) == before


@pytest.mark.parametrize(
    ("crs", "says"),
    [("EPSG:25832", "28992.*25832"), ("EPSG:4326", "28992.*4326"), ("EPSG:1", "not known"), ("x", "EPSG")],
)
def test_another_crs_is_refused(target: str, crs: str, says: str) -> None:
    """A database has one CRS, projected in metres."""
    create_database(target, "EPSG:28992")
    with pytest.raises(CRSError, match=says):
        create_database(target, crs)


@pytest.fixture
def tomorrow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Return what makes the schema of tomorrow the newest."""
    folder = migrations_of_tomorrow(tmp_path / "migrations")
    return lambda: monkeypatch.setattr(upgrade, "packaged", lambda _name: folder)


def test_old_databases_upgrade_with_all_they_hold(target: str, tomorrow: Callable[[], None]) -> None:
    """Refused before, sound afterwards; every row is there, and the loader goes on from it."""
    engine = open_database(target, create=True, srid=EPSG)
    write_build(engine, small_build())
    write_build(engine, small_build(HOSTILE, shift=1000))
    before, today = dump(target), upgrade.head_version()
    tomorrow()
    with pytest.raises(SchemaVersionError, match="msbdb db upgrade"):
        open_database(target)
    with pytest.raises(SchemaVersionError, match="msbdb db upgrade"):
        create_database(target, "EPSG:28992")
    assert upgrade_schema(target) == (today, LATER)
    assert upgrade_schema(target) == (LATER, LATER)
    engine = open_database(target)
    assert check_database(engine) == []
    assert dump(target) == before
    assert list_runs(engine)["survey"].tolist() == ["delft", HOSTILE]
    assert write_build(engine, read_build(engine, HOSTILE)).status == "unchanged"
    assert write_build(engine, small_build(HOSTILE, "multiscale", shift=1000)).status == "replaced"
    assert check_database(engine) == []


def test_a_downgrade_says_what_would_be_lost_and_does_nothing(target: str, tomorrow: Callable[[], None]) -> None:
    """Rows that go, and values of columns that go from rows that stay."""
    tomorrow()
    engine = open_database(target, create=True, srid=EPSG)
    write_build(engine, small_build())
    with engine.begin() as connection:
        connection.execute(text("UPDATE building SET colour = 'red' WHERE storeys > 1"))
    before = dump(target)
    rows = counts(target)["flat_region_candidate"]
    assert rows > 0
    with pytest.raises(SchemaVersionError) as refused:
        downgrade_schema(target, TODAY)
    for word in (f"{rows} rows of flat_region_candidate", "3 values of building.colour", "--force"):
        assert word in str(refused.value)
    assert version_of(open_any(target)) == LATER
    assert dump(target) == before


def test_a_forced_downgrade_loses_just_what_it_says(target: str, tomorrow: Callable[[], None]) -> None:
    """The way up is open again, and the lost rows are missed by the check until the survey is built again."""
    tomorrow()
    engine = open_database(target, create=True, srid=EPSG)
    write_build(engine, small_build())
    before = dump(target)
    _, after, lost = downgrade_schema(target, TODAY, force=True)
    assert (after, version_of(open_any(target))) == (TODAY, TODAY)
    [loss] = map(str, lost)
    assert loss.endswith("rows of flat_region_candidate")
    upgrade_schema(target)
    assert {finding.check for finding in check_database(engine)} == {"content"}
    assert write_build(engine, small_build()).status == "replaced"
    assert dump(target) == before
    assert check_database(engine) == []


def test_a_downgrade_that_loses_nothing_needs_no_force(target: str, tomorrow: Callable[[], None]) -> None:
    """By default one step, and back."""
    tomorrow()
    engine = open_database(target, create=True, srid=EPSG)
    write_build(engine, small_build(method="multiscale"))
    before = dump(target)
    assert downgrade_schema(target) == (LATER, TODAY, [])
    upgrade_schema(target)
    assert dump(target) == before
    assert check_database(engine) == []


@pytest.mark.parametrize("to", sample([LATER, "8999", "9", "head", "-1", "base", HOSTILE], 3))
def test_only_older_schemas_with_a_way_back_are_taken(target: str, to: str, tomorrow: Callable[[], None]) -> None:
    """Each refusal names those that can be had."""
    tomorrow()
    create_database(target, "EPSG:28992")
    with pytest.raises(SchemaVersionError, match=rf"brought down to: (\d+, )*{TODAY}\."):
        downgrade_schema(target, to, force=True)


def test_the_first_schema_has_no_way_back(target: str) -> None:
    """From the oldest that today's can be brought down to."""
    create_database(target, "EPSG:28992")
    downgrade_schema(target, "0004", force=True)
    with pytest.raises(SchemaVersionError, match="brought down to: none"):
        downgrade_schema(target)


def test_a_copy_holds_all_rows_whatever_the_kinds(target: str, other: str) -> None:
    """Dumps are equal, the copy is sound, and there is nothing in it to copy onto again."""
    engine = open_database(target, create=True, srid=EPSG)
    write_build(engine, small_build())
    write_build(engine, small_build(HOSTILE, shift=1000))
    steps: list[tuple[str, int, int]] = []
    rows = copy_database(target, other, progress=lambda *step: steps.append(step))
    assert rows == counts(target) == counts(other)
    assert dump(other) == dump(target)
    assert check_database(open_database(other)) == []
    assert steps[-1] == ("copy", len(rows), len(rows))
    with pytest.raises(DatabaseError, match=r"is not empty: .*survey"):
        copy_database(target, other)
    assert write_build(open_database(other), small_build()).status == "unchanged"


def test_a_copy_goes_into_a_database_that_was_created_empty(target: str, other: str) -> None:
    """In the same CRS; another one is refused."""
    write_build(open_database(target, create=True, srid=EPSG), small_build())
    create_database(other, "EPSG:25832")
    with pytest.raises(CRSError, match="25832"):
        copy_database(target, other)
    with pytest.raises(ParameterError, match="onto itself"):
        copy_database(target, target)


def test_a_crs_without_code_is_copied(target: str, other: str) -> None:
    """Under the same number, with the same definition."""
    wkt = CRS.from_proj4("+proj=tmerc +lat_0=10 +lon_0=20 +k=1 +x_0=500 +y_0=0 +ellps=GRS80 +units=m").to_wkt()
    create_database(target, wkt)
    copy_database(target, other)
    open_database(other, srid=0, crs_wkt=wkt)
    assert srid_of(0, wkt) >= 910_000


COPIER = """
import os, signal, sys
from msbdb.database.admin import copying
original = copying._copy_table
def stopped(reading, writing, dialect, table, srid):
    original(reading, writing, dialect, table, srid)
    if table.name == sys.argv[3]:
        os.kill(os.getpid(), signal.SIGKILL)
copying._copy_table = stopped
copying.copy_database(sys.argv[1], sys.argv[2])
"""


@pytest.mark.parametrize(
    ("table", "is_new"), sample([("survey", True), ("part_flat_region", True), ("part_flat_region", False)], 3)
)
def test_a_killed_copy_leaves_nothing_and_can_be_repeated(
    target: str, tmp_path: Path, table: str, is_new: bool
) -> None:
    """Whether one table is over or all but the last: no target, or an empty one, and the source as it was."""
    source = str(tmp_path / "source.sqlite")
    write_build(open_database(source, create=True, srid=EPSG), small_build())
    before = dump(source)
    if not is_new:
        create_database(target, f"EPSG:{EPSG}")
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", COPIER, source, target, table], env=env, check=False)
    assert done.returncode == -signal.SIGKILL
    if is_new:
        with pytest.raises(DatabaseError, match="no msbdb database"):
            open_database(target)
    else:
        assert set(counts(target).values()) == {0}
        assert check_database(open_database(target)) == []
    copy_database(source, target)
    assert dump(target) == before == dump(source)

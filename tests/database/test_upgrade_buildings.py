"""A database of the first schema, in which a building is one root, becomes one of buildings as objects."""

import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from simulated.builds import BLOCK, EPSG, HOUSE, PODIUM, SHED, small_build
from sqlalchemy import Engine, text
from support import towns
from support.baseline import as_baseline, first_migration
from support.processes import environment
from support.schemaobjects import objects
from support.sizes import sample

from msbdb.api import advance
from msbdb.database import (
    canonical_dump,
    check_database,
    downgrade_schema,
    open_database,
    read_buildings,
    read_fallback,
    read_former,
    read_parts,
    upgrade_schema,
    write_build,
)
from msbdb.database.dialects.migration import head_version
from msbdb.database.runs.digests import digest_again
from msbdb.database.schema.sqltables import SQL
from msbdb.errors import DatabaseError, InputError, SchemaVersionError
from msbdb.tables import HEIGHTS

DIGEST = "7d4072dd211b31378503f7094ebfb46acd6ae1e8e966588c20e4f667a0a0039c"
"""The digest that the last version with the first schema wrote for the small build."""

LOST = (
    "probability",
    "multiscale_share",
    *(name for name in HEIGHTS if name != "storeys"),
    *("floor_area_m2", "coverage", "nodata_share", "density"),
)
"""What the first schema has no place for, so that an upgraded database cannot have it."""


@pytest.fixture
def old(target: str, tmp_path: Path) -> Engine:
    """Return a database of the first schema with the small build."""
    today = open_database(tmp_path / "today.sqlite", create=True, srid=EPSG)
    write_build(today, small_build())
    engine = as_baseline(today, target, EPSG, first_migration(tmp_path / "migrations"))
    with engine.begin() as connection:
        connection.execute(text("UPDATE run SET content_sha256 = :digest"), {"digest": DIGEST})
    return engine


def test_a_build_over_an_old_schema_knows_what_it_would_replace(old: Engine, target: str) -> None:
    """Before the upgrade: the sources, the results of detectors, and the CRS for files that state none."""
    build = small_build()
    former, fallback = read_former(target, build.survey.name), read_fallback(target)
    assert former is not None
    assert fallback is not None
    assert fallback.crs.to_epsg() == EPSG
    former.require_sources(build.survey.sources)
    former.require_place(build.survey)
    with pytest.raises(InputError, match=f"{len(build.frames['flat_region'])} flat regions? of flatregions"):
        former.require_methods(["multiscale"])
    assert read_former(target, "elsewhere") is None


def test_every_building_keeps_its_id_and_gets_its_tree(old: Engine, target: str) -> None:
    """All rows are there, each part names its building, and the digest of the first schema is known as right."""
    assert upgrade_schema(target) == ("0001", head_version())
    build = small_build()
    buildings, parts = read_buildings(old), read_parts(old)
    expected = build.frames["building"].sort_values("building_id").reset_index(drop=True)
    assert buildings["building_id"].tolist() == [PODIUM, HOUSE, BLOCK, SHED]
    for name in set(buildings.columns) - {"geometry", *LOST}:
        assert buildings[name].tolist() == pytest.approx(expected[name].tolist(), nan_ok=True), name
    assert buildings[list(LOST)].isna().all(axis=None)
    assert parts.set_index("part_id")["building_id"].to_dict() == dict(
        build.frames["part"][["part_id", "building_id"]].to_numpy().tolist()
    )
    assert all(a.equals(b) for a, b in zip(buildings.geometry, expected.geometry, strict=True))
    assert check_database(old) == []


def test_the_upgraded_schema_is_that_of_a_new_database(
    old: Engine, target: str, tmp_path: Path, new_postgis: Callable[[], str]
) -> None:
    """Tables, keys, checks, indexes and views, in the same order of columns."""
    upgrade_schema(target)
    is_postgis = old.dialect.name == "postgresql"
    new = open_database(new_postgis() if is_postgis else tmp_path / "new.sqlite", create=True, srid=EPSG)
    with old.connect() as one, new.connect() as two:
        # The planner's own statistics tables come with the first rows.
        assert {row for row in objects(one) if "sqlite_stat" not in row[1]} == objects(two)


def test_an_edited_row_is_found_after_the_upgrade_too(old: Engine, target: str) -> None:
    """A digest that was wrong before stays wrong: the upgrade does not approve what it did not write."""
    with old.begin() as connection:
        connection.execute(text("UPDATE part SET h_max = h_max + 1 WHERE part_id = :shed"), {"shed": SHED})
    upgrade_schema(target)
    assert {finding.check for finding in check_database(old)} == {"content"}


def test_the_inventory_keeps_versions_changes_and_digests(target: str, tmp_path: Path) -> None:
    """The history is the same, but for what was not known; a survey goes on from it."""
    today = open_database(tmp_path / "today.sqlite", create=True, srid=towns.EPSG)
    for name, date, houses in (("s1", "2020-01-01", towns.ROW), ("s2", "2021-05", towns.ROW[1:])):
        write_build(today, towns.town_build(name, date, list(houses)))
        advance(today.url, name)
    with today.begin() as connection:
        # What the first schema has no place for was not in its digests either.
        unknown = ", ".join(f"{name} = NULL" for name in LOST if name in SQL["building_version"].columns)
        connection.execute(text(f"UPDATE building_version SET {unknown}"))
        digest_again(connection, SQL["building_version"])
    kept = ("building_version", "building_change", "inventory", "survey_offset", "operator")
    before = [line for line in canonical_dump(today) if line.startswith(tuple(f'["{name}' for name in kept))]
    old = as_baseline(today, target, towns.EPSG, first_migration(tmp_path / "migrations"))
    upgrade_schema(target)
    after = [line for line in canonical_dump(old) if line.startswith(tuple(f'["{name}' for name in kept))]
    assert len(before) > 20
    assert after == before
    assert {finding.check for finding in check_database(old)} <= {"content"}
    write_build(old, towns.town_build("s3", "2022-01-01", list(towns.ROW)))
    assert advance(old.url, "s3").counts["new"] == 1


def test_a_damaged_database_is_not_upgraded(old: Engine, target: str) -> None:
    """A root without its building has no place; the message says what to do, and nothing is changed."""
    with old.begin() as connection:
        connection.execute(text("DELETE FROM building WHERE building_id = :shed"), {"shed": SHED})
    with pytest.raises(
        DatabaseError, match=r"1 of 6 rows of part refer to rows that are missing\. Nothing was changed"
    ):
        upgrade_schema(target)
    with old.connect() as connection:
        assert connection.scalar(text("SELECT count(*) FROM part")) == 6
        assert connection.scalar(text("SELECT version_num FROM msbdb_schema_version")) == "0001"


def test_there_is_no_way_back(old: Engine, target: str) -> None:
    """A building of several trees has no place in the first schema."""
    upgrade_schema(target)
    with pytest.raises(SchemaVersionError, match=r"brought down to: 0004, 0005, 0006, 0007, 0008, 0009\."):
        downgrade_schema(target, "0001", force=True)
    assert len(read_buildings(old)) == 4


UPGRADE = """
import sys
from msbdb.database import upgrade_schema
from msbdb.database.dialects import {dialect}

def stop_here(original):
    def stopped(*args, **options):
        found = original(*args, **options)
        if {when}:
            print("here", flush=True)
            sys.stdin.read()
        return found
    return stopped

{dialect}.{function} = stop_here({dialect}.{function})
upgrade_schema(sys.argv[1])
"""


@pytest.mark.parametrize(
    ("function", "when"),
    sample(
        [
            ("geometry_ddl", "args[0] == 'building_version'"),
            ("drop_geometry_ddl", "args[0] == 'building'"),
            ("after_load", "True"),
        ],
        3,
    ),
)
def test_a_kill_during_the_upgrade_leaves_the_first_schema(old: Engine, target: str, function: str, when: str) -> None:
    """Whether tables are dropped, made anew, or filled and all but committed; the next upgrade completes."""
    dialect = "postgis" if "://" in target else "spatialite"
    code = UPGRADE.format(dialect=dialect, function=function, when=when)
    call = [sys.executable, "-c", code, target]
    process = subprocess.Popen(call, env=environment(), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdin is not None
    assert process.stdout.readline() == "here\n"
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    process.stdin.close()
    process.stdout.close()
    with old.connect() as connection:
        assert connection.scalar(text("SELECT version_num FROM msbdb_schema_version")) == "0001"
        assert connection.scalar(text("SELECT count(root_id) FROM building")) == 4
        assert connection.scalar(text("SELECT count(*) FROM footprint")) == 4
    assert upgrade_schema(target) == ("0001", head_version())
    assert check_database(old) == []

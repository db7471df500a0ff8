"""A database from before houses were divided and outlines fitted says of each that it was not."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from simulated.builds import EPSG, SHED, small_build
from sqlalchemy import Engine, text
from support.baseline import as_baseline
from support.schemaobjects import objects

from msbdb.database import (
    check_database,
    downgrade_schema,
    open_database,
    read_buildings,
    read_parts,
    read_run,
    upgrade_schema,
    write_build,
)
from msbdb.database.dialects.migration import head_version
from msbdb.errors import SchemaVersionError
from msbdb.params import Params, with_values

ROOT = Path(__file__).resolve().parents[2]
DESCRIPTION = "0003"


def migrations_before(folder: Path) -> Path:
    """Write a copy of the migrations up to that of the description, without it."""
    later = [path.name for path in (ROOT / "migrations" / "versions").glob("*.py") if path.name >= DESCRIPTION]
    shutil.copytree(ROOT / "migrations", folder, ignore=shutil.ignore_patterns("__pycache__", *later))
    return folder


@pytest.fixture
def old(target: str, tmp_path: Path) -> Engine:
    """Return a database of the schema before with the small build."""
    today = open_database(tmp_path / "today.sqlite", create=True, srid=EPSG)
    write_build(today, small_build())
    return as_baseline(today, target, EPSG, migrations_before(tmp_path / "migrations"))


def test_all_outlines_were_traced_and_nothing_was_divided(old: Engine, target: str) -> None:
    """Buildings, parts and the parameters of their run say so; all other values stay."""
    with old.connect() as connection:
        names = {table: f"{table}_id, area_m2" for table in ("building", "part")}
        before = {table: connection.execute(text(f"SELECT {of} FROM {table}")).all() for table, of in names.items()}
    assert upgrade_schema(target)[1] == head_version()
    with old.connect() as connection:
        after = {table: connection.execute(text(f"SELECT {of} FROM {table}")).all() for table, of in names.items()}
        vector = connection.scalar(text("SELECT parameters FROM run"))
    assert {table: sorted(rows) for table, rows in after.items()} == {
        table: sorted(rows) for table, rows in before.items()
    }
    assert set(read_buildings(old)["outline_source"]) == set(read_parts(old)["outline_source"]) == {"traced"}
    assert '"walls": "traced"' in str(vector).replace("'", '"')
    assert read_buildings(old)["divided_by"].tolist() == [""] * 4
    assert not with_values(Params(), read_run(old).parameters).touching.divide  # type: ignore[arg-type]  # plain nested values


@pytest.mark.long
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


@pytest.mark.long
def test_an_edited_row_is_found_after_the_upgrade_too(old: Engine, target: str) -> None:
    """A digest that was wrong before stays wrong."""
    with old.begin() as connection:
        connection.execute(text("UPDATE part SET h_max = h_max + 1 WHERE part_id = :shed"), {"shed": SHED})
    upgrade_schema(target)
    assert "content" in {finding.check for finding in check_database(old)}


@pytest.mark.long
def test_there_is_no_way_back(old: Engine, target: str) -> None:
    """A fitted outline has no place in the schema before."""
    upgrade_schema(target)
    with pytest.raises(SchemaVersionError, match="brought down to: 0004"):
        downgrade_schema(target, "0002", force=True)
    assert len(read_buildings(old)) == 4

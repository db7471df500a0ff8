"""A database of an older schema is upgraded with all of its rows, in one transaction, and brought back."""

from collections.abc import Callable
from pathlib import Path

import pytest
from simulated.builds import EPSG, HOUSE, small_build
from sqlalchemy import Connection, Engine, text
from support.latermigration import LATER, TODAY, migrations_of_tomorrow
from support.schemaobjects import objects

from msbdb.database import canonical_dump, downgrade_schema, open_database, read_buildings, upgrade_schema, write_build
from msbdb.database.dialects import migration as upgrade
from msbdb.database.dialects.dialect import database_url, dialect_of
from msbdb.database.schema.sqlfiles import parse_sql, sql_names
from msbdb.errors import DatabaseError

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def old(target: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Engine:
    """Return a database of today's schema with the small build, which is an old one for what the test does then."""
    engine = open_database(target, create=True, srid=EPSG)
    write_build(engine, small_build())
    folder = migrations_of_tomorrow(tmp_path / "migrations")
    monkeypatch.setattr(upgrade, "packaged", lambda _name: folder)
    return engine


def schema(engine: Engine) -> set[tuple[str, ...]]:
    """Return all that the schema consists of, but for comments, which are documentation, and figures for planning."""
    with engine.connect() as connection:
        return {row for row in objects(connection) if row[0] != "comment" and "sqlite_stat" not in row[1]}


def version(engine: Engine) -> str:
    """Return the schema's version."""
    with engine.connect() as connection:
        return upgrade.schema_version(connection)


def test_an_upgrade_keeps_every_row_and_makes_views_anew(old: Engine, target: str) -> None:
    """What the migration brings is there, registered, indexed and counted."""
    before = list(canonical_dump(old, provenance=True))
    engine = open_database(target, create=True)
    assert version(engine) == LATER
    assert list(canonical_dump(engine, provenance=True)) == before
    with engine.connect() as connection:
        assert connection.scalar(text("SELECT count(*) FROM visit")) == 1
        assert connection.scalar(text("SELECT count(*) FROM footprint WHERE colour = 'grey'")) == 3
        if engine.dialect.name == "sqlite":
            assert connection.scalar(text("SELECT CheckSpatialIndex('building', 'geometry')")) == 1
            assert connection.execute(text("PRAGMA foreign_key_check")).all() == []
            assert connection.scalar(text("PRAGMA integrity_check")) == "ok"
            figures = "SELECT view_name, row_count FROM views_geometry_columns_statistics ORDER BY view_name"
            assert dict(connection.execute(text(figures)).all())["footprint"] == 4
    with engine.begin() as connection:
        connection.execute(text("DELETE FROM building WHERE building_id = :house"), {"house": HOUSE})
        connection.execute(text("DELETE FROM part WHERE part_id = :house"), {"house": HOUSE})
    assert len(read_buildings(engine)) == 3


def test_an_upgrade_that_fails_at_the_end_changes_nothing(
    old: Engine, target: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Dropping, creating and filling is all in one transaction."""
    before, content = schema(old), list(canonical_dump(old))

    def full(_connection: Connection) -> None:
        message = "no space"
        raise DatabaseError(message)

    with monkeypatch.context() as patch:
        patch.setattr(dialect_of(database_url(target)), "after_load", full)
        with pytest.raises(DatabaseError, match="no space"):
            open_database(target, create=True)
    assert (version(old), schema(old), list(canonical_dump(old))) == (TODAY, before, content)
    open_database(target, create=True)
    assert list(canonical_dump(old)) == content


def test_a_downgraded_schema_is_the_old_one(old: Engine, target: str) -> None:
    """No table, column or view is left that the older schema had not."""
    before = schema(old)
    upgrade_schema(target)
    assert schema(old) != before
    downgrade_schema(target, force=True)
    assert version(old) == TODAY
    assert schema(old) == before


@pytest.mark.postgis
def test_comments_are_written_afresh(
    new_postgis: Callable[[], str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They are documentation of the declared tables, which no migration copies."""
    target = new_postgis()
    engine = open_database(target, create=True, srid=EPSG)
    with engine.begin() as connection:
        connection.execute(text("COMMENT ON COLUMN part.supid IS 'an old text'"))
    folder = migrations_of_tomorrow(tmp_path / "migrations")
    monkeypatch.setattr(upgrade, "packaged", lambda _name: folder)
    upgrade_schema(target)
    with engine.connect() as connection:
        query = "SELECT col_description('part'::regclass, 3)"
        assert connection.scalar(text(query)) == "SUPID: the father's ID; 0 for a root"


@pytest.mark.parametrize("kind", ["views", "functions"])
def test_the_newest_texts_of_the_migrations_are_those_of_the_schema(kind: str) -> None:
    """Migrations keep their own texts, as they are frozen; the newest of each view is the one that is shown."""
    newest = {path.stem: path for path in sorted((ROOT / "migrations" / "sql").glob("*/*.sql"))}
    for name in sql_names(kind):
        shown = ROOT / "schema" / kind / f"{name}.sql"
        assert parse_sql(newest[name]).sql == parse_sql(shown).sql

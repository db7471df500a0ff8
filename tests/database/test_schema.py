"""The declared tables, the migrations, the generated schema and the database agree."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from simulated.builds import EPSG
from sqlalchemy import Engine, text
from support.schemaobjects import objects

from msbdb.database import open_database
from msbdb.database.admin.ddl import ddl, dictionary, statements
from msbdb.database.dialects.dialect import database_url, dialect_of
from msbdb.database.schema import sqlfiles
from msbdb.database.schema.sqlfiles import TABLE_VIEWS, VIEWS, footprint_at_query
from msbdb.database.schema.sqltables import METADATA, SPATIAL, VERSION_TABLE, Geometry
from msbdb.database.schema.srid import crs_from, register
from msbdb.errors import DatabaseError
from msbdb.tables import CONFIRMING_CLASS_SHARE, CONFIRMING_COVER, DATABASE_TABLES

ROOT = Path(__file__).resolve().parents[2]


def test_migrated_database_equals_the_generated_schema(engine: Engine, request: pytest.FixtureRequest) -> None:
    """Creating by migrations and running ``schema/*.sql`` give the same tables, keys, checks, indexes and views."""
    is_postgis = engine.dialect.name == "postgresql"
    if is_postgis:
        other = database_url(request.getfixturevalue("new_postgis")())
    else:
        other = database_url(request.getfixturevalue("tmp_path") / "generated.sqlite")
    generated = dialect_of(other).make_engine(other, 5)
    with generated.begin() as connection:
        first, *others = statements("postgis" if is_postgis else "spatialite", EPSG)
        connection.exec_driver_sql(first)
        register(connection, EPSG, crs_from(EPSG, ""))
        for statement in others:
            connection.exec_driver_sql(statement.replace("%", "%%") if is_postgis else statement)
    with engine.connect() as one, generated.connect() as two:
        assert objects(one) == objects(two)
        assert len(objects(one)) > 40


def same_type(_context: Any, _inspected: Any, _column: Any, found: Any, declared: Any) -> bool | None:
    """Return whether types differ; a geometry's SRID is the database's."""
    if isinstance(declared, Geometry):
        if isinstance(found, Geometry):
            return (found.kind.upper(), int(found.srid)) != (declared.kind, EPSG)
        # SQLite reports no geometries; SpatiaLite's register has their types and SRIDs.
        return False
    return None


def test_alembic_sees_no_difference_between_tables_and_database(engine: Engine) -> None:
    """``compare_metadata`` is empty: tables, columns, types, nulls, comments, unique constraints, indexes, keys."""
    options = {
        "compare_type": same_type,
        "include_name": lambda name, kind, _parents: kind != "table" or name in METADATA.tables,
        "include_object": lambda _item, name, kind, *_: not (kind == "index" and name.startswith("idx_")),
        "version_table": VERSION_TABLE,
    }
    with engine.connect() as connection:
        context = MigrationContext.configure(connection, opts=options)
        assert compare_metadata(context, METADATA) == []


def test_every_declared_column_is_in_the_database_tables() -> None:
    """Names, meanings and nullability come from the declared tables."""
    for table in DATABASE_TABLES:
        columns = METADATA.tables[table.name].columns
        for declared in table.stored:
            column = columns[declared.name]
            assert str(column.comment).startswith(declared.doc)
            assert column.nullable == declared.nullable
        assert ("geometry" in columns) == (table.geometry is not None)
        assert SPATIAL.get(table.name) == table.geometry


@pytest.mark.parametrize("name", ["spatialite.sql", "postgis.sql", "dictionary.md"])
def test_generated_files_are_up_to_date(name: str) -> None:
    """What lies in ``schema/`` is what scripts/generate_schema writes."""
    expected = dictionary() if name == "dictionary.md" else ddl(name.removesuffix(".sql"))
    assert (ROOT / "schema" / name).read_text(encoding="utf-8") == expected


def test_the_generator_tells_stale_files(tmp_path: Path) -> None:
    """``--check`` ends with 1 when a file was edited by hand, and names it."""
    script = tmp_path / "scripts" / "generate_schema"
    script.parent.mkdir()
    script.write_text((ROOT / "scripts" / "generate_schema").read_text())
    (tmp_path / "schema").mkdir()
    for name in ("spatialite.sql", "postgis.sql"):
        (tmp_path / "schema" / name).write_text(ddl(name.removesuffix(".sql")))
    (tmp_path / "schema" / "dictionary.md").write_text("edited by hand")
    call = [sys.executable, str(script), "--check"]
    done = subprocess.run(call, env={"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (1, "out of date: dictionary.md; run scripts/generate_schema\n")


def test_spatial_indexes_are_real(engine: Engine) -> None:
    """Each geometry has an index that the database keeps by itself."""
    with engine.connect() as connection:
        if engine.dialect.name == "postgresql":
            query = "SELECT tablename FROM pg_indexes WHERE indexdef LIKE '%USING gist (geometry)'"
        else:
            query = "SELECT f_table_name FROM geometry_columns WHERE spatial_index_enabled = 1"
        assert set(connection.scalars(text(query))) == set(SPATIAL)


def test_the_dictionary_names_everything() -> None:
    """Each table, column, view and example query is in the data dictionary."""
    words = dictionary()
    for table in METADATA.tables.values():
        assert f"## {table.name}\n" in words
        assert all(f"| {column.name} | " in words for column in table.columns)
    assert all(f"## {view.name}\n" in words for view in VIEWS)


def test_views_and_tables_agree_on_what_confirms() -> None:
    """The numbers in the view's text are those that the package decides by."""
    text_of = {view.name: view.sql for view in VIEWS}["building_evidence"]
    assert f"b.building_share >= {CONFIRMING_CLASS_SHARE} " in text_of
    for column in ("flat_share", "area3d_share", "adaptive_share"):
        assert f"b.{column} >= {CONFIRMING_COVER} " in text_of


def test_the_inventory_at_a_day_has_the_columns_of_today() -> None:
    """The function shows what the view shows, of another day."""
    both = [footprint_at_query(), {view.name: view.sql for view in VIEWS}["footprint_current"]]
    assert both[0].partition("WHERE")[0] == both[1].partition("WHERE")[0]
    assert both[0].count(":date") == 2


def test_every_view_has_a_text_and_every_text_a_view() -> None:
    """No file is left over, and each says what its view shows."""
    views = (*VIEWS, *TABLE_VIEWS)
    assert sorted(view.name for view in views) == sqlfiles.sql_names("views")
    assert all(view.doc.endswith(".") for view in views)


def test_an_installed_msbdb_finds_its_folders_beside_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The wheel puts migrations and schema into the package; a checkout has them at its top."""
    monkeypatch.setattr(sqlfiles, "__file__", str(tmp_path / "msbdb" / "database" / "schema" / "sqlfiles.py"))
    with pytest.raises(DatabaseError, match="Install msbdb again"):
        sqlfiles.packaged("migrations")
    (tmp_path / "migrations").mkdir()
    assert sqlfiles.packaged("migrations") == tmp_path / "migrations"
    (tmp_path / "msbdb" / "database" / "migrations").mkdir(parents=True)
    assert sqlfiles.packaged("migrations") == tmp_path / "msbdb" / "database" / "migrations"


@pytest.mark.postgis
def test_the_extension_is_created_where_it_is_missing(new_postgis) -> None:
    """An empty PostgreSQL database is enough."""
    url = database_url(new_postgis())
    engine = dialect_of(url).make_engine(url, 5)
    with engine.begin() as connection:
        connection.execute(text("DROP EXTENSION postgis"))
    open_database(url, create=True, srid=EPSG)
    with engine.connect() as connection:
        assert connection.scalar(text("SELECT count(*) FROM geometry_columns WHERE f_table_name = 'part'")) == 1

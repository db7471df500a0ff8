"""Readers, operators and owners of a PostGIS database: each statement is tried as each of them, on a real server."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psycopg
import pytest
from psycopg import sql
from simulated.builds import EPSG, small_build
from sqlalchemy import URL, make_url
from support.latermigration import migrations_of_tomorrow
from support.sizes import sample

from msbdb.database import (
    canonical_dump,
    check_database,
    create_database,
    downgrade_schema,
    grant_role,
    open_database,
    upgrade_schema,
    write_build,
)
from msbdb.database.admin.lifecycle import open_any
from msbdb.database.dialects import migration as upgrade
from msbdb.database.dialects.rights import written_by_operators
from msbdb.database.schema.sqlfiles import TABLE_VIEWS, VIEWS
from msbdb.database.schema.sqltables import METADATA, VERSION_TABLE
from msbdb.errors import DatabaseError, ParameterError

pytestmark = pytest.mark.postgis

DENIED = "42501"
UNSEEN = (DENIED, "3F000", "42P01")
"""To a user without rights on the schema there is no schema, and no table."""
TRIGGER = "suppress_redundant_updates_trigger"
TABLES = sorted(METADATA.tables)
USERS = {
    "reader": f"x'; DROP TABLE part; -- {os.getpid()}",
    "operator": f'"quoted" {os.getpid()}',
    "owner": f"Ümläut % {{}} :name {os.getpid()}",
    "stranger": f"stranger {os.getpid()}",
}
"""Names as bad as the server takes them."""


@pytest.fixture(scope="module")
def place(databases: Any) -> Iterator[URL]:
    """Return the URL of a database with content, and users of all roles on its server."""
    url = make_url(databases.acquire())
    engine = open_database(url, create=True, srid=EPSG)
    write_build(engine, small_build())
    run_as(url, *(sql.SQL("CREATE ROLE {} LOGIN").format(sql.Identifier(name)) for name in USERS.values()))
    yield url
    for name in USERS.values():
        user = sql.Identifier(name)
        run_as(url, sql.SQL("REASSIGN OWNED BY {} TO CURRENT_USER").format(user))
        run_as(url, sql.SQL("DROP OWNED BY {}").format(user), sql.SQL("DROP ROLE {}").format(user))
    databases.release([url.render_as_string(hide_password=False)])


@pytest.fixture
def granted(place: URL) -> URL:
    """Return the same, with reader and operator as they are granted by whoever owns it."""
    engine = open_database(place)
    for role in ("reader", "operator"):
        grant_role(engine, role, USERS[role])
    return place


def as_user(url: URL, user: str) -> URL:
    """Return the URL for another user."""
    return url.set(username=user)


def run_as(url: URL, *statements: Any, user: str = "") -> None:
    """Run statements in one transaction as a user, by default the superuser of the tests."""
    own = as_user(url, user) if user else url
    keys = {"user": own.username, "dbname": own.database, "host": own.query["host"]}
    with psycopg.connect(**{name: str(word) for name, word in keys.items()}) as connection:
        connection.execute("SET client_min_messages = warning")
        for statement in statements:
            connection.execute(statement)


def outcome(url: URL, user: str, statement: str) -> str:
    """Return '' when a user may run a statement, and the SQLSTATE when not; nothing is committed."""
    try:
        run_as(url, statement.encode(), b"DO $$ BEGIN RAISE EXCEPTION 'undone'; END $$", user=user)
    except psycopg.Error as error:
        return "" if "undone" in str(error) else str(error.sqlstate)
    return "not undone"


def changes(table: str) -> dict[str, str]:
    """Return a statement of each kind that changes rows of a table."""
    column = METADATA.tables[table].primary_key.columns[0].name if table in METADATA.tables else "version_num"
    return {
        "INSERT": f"INSERT INTO {table} SELECT * FROM {table} WHERE false"
        if not has_computed(table)
        else f"INSERT INTO {table} ({column}) SELECT {column} FROM {table} WHERE false",
        "UPDATE": f"UPDATE {table} SET {column} = {column} WHERE false",
        "DELETE": f"DELETE FROM {table} WHERE false",
    }


def has_computed(table: str) -> bool:
    """Tell whether a table has computed columns, which no INSERT names."""
    return table in METADATA.tables and any(c.computed is not None for c in METADATA.tables[table].columns)


def owners(table: str) -> dict[str, str]:
    """Return a statement of each kind that only an owner may run on a table."""
    return {
        "TRUNCATE": f"TRUNCATE {table} CASCADE",
        "DROP": f"DROP TABLE {table} CASCADE",
        "ALTER": f"ALTER TABLE {table} ADD COLUMN extra int",
        "INDEX": f"CREATE INDEX extra ON {table} ((1))",
        "TRIGGER": f"CREATE TRIGGER extra BEFORE UPDATE ON {table} EXECUTE FUNCTION {TRIGGER}()",
        "RULE": f"CREATE RULE extra AS ON DELETE TO {table} DO INSTEAD NOTHING",
        "POLICY": f"CREATE POLICY extra ON {table}",
        "COMMENT": f"COMMENT ON TABLE {table} IS 'mine'",
        "OWNER": f"ALTER TABLE {table} OWNER TO CURRENT_USER",
        "LOCK": f"LOCK TABLE {table} IN ACCESS EXCLUSIVE MODE",
    }


MAKING = {
    "table": "CREATE TABLE extra (a int)",
    "temporary table": "CREATE TEMPORARY TABLE extra (a int)",
    "view": "CREATE VIEW extra AS SELECT 1",
    "function": "CREATE FUNCTION extra() RETURNS int LANGUAGE sql AS 'SELECT 1'",
    "sequence": "CREATE SEQUENCE extra",
    "type": "CREATE TYPE extra AS (a int)",
    "schema": "CREATE SCHEMA extra",
    "extension": "CREATE EXTENSION postgis_topology",
    "role": "CREATE ROLE extra",
    "database's own rights": "ALTER DATABASE {database} SET work_mem = '1MB'",
    "program": "COPY part TO PROGRAM 'true'",
    "file": "COPY part FROM '/etc/hosts'",
}
"""Ways to make something new or to reach out of the database."""


@pytest.mark.parametrize("table", sample([VERSION_TABLE, "spatial_ref_sys", *TABLES], 4))
def test_a_reader_reads_and_changes_nothing(granted: URL, table: str) -> None:
    """SELECT passes; each other kind of statement is refused for want of rights."""
    reader = USERS["reader"]
    assert outcome(granted, reader, f"SELECT * FROM {table} LIMIT 1") == ""
    own = changes(table) if table != "spatial_ref_sys" else {"DELETE": "DELETE FROM spatial_ref_sys WHERE false"}
    tried = {kind: outcome(granted, reader, statement) for kind, statement in (own | owners(table)).items()}
    assert tried == dict.fromkeys(tried, DENIED)


@pytest.mark.parametrize("table", sample([VERSION_TABLE, *TABLES], 4))
def test_an_operator_changes_rows_of_builds_and_decisions_alone(granted: URL, table: str) -> None:
    """Rows of the inventory's history and the schema's version are not an operator's, and no table's shape is."""
    operator = USERS["operator"]
    assert outcome(granted, operator, f"SELECT * FROM {table} LIMIT 1") == ""
    may = table != VERSION_TABLE and written_by_operators(table)
    tried = {kind: outcome(granted, operator, statement) for kind, statement in changes(table).items()}
    assert tried == dict.fromkeys(tried, "" if may else DENIED)
    shape = owners(table)
    if may:
        # Whoever may delete rows may lock the table.
        del shape["LOCK"]
    tried = {kind: outcome(granted, operator, statement) for kind, statement in shape.items()}
    assert tried == dict.fromkeys(tried, DENIED)


def test_history_is_not_an_operators() -> None:
    """What is written by updates and imports stays the owner's; what operators decide is theirs."""
    history = {"inventory_building", "building_version", "building_change", "survey_offset", "inventory_event"}
    assert {table for table in TABLES if not written_by_operators(table)} == history


@pytest.mark.parametrize("role", ["reader", "operator", "stranger"])
@pytest.mark.parametrize("kind", sample(MAKING, 3))
def test_nobody_but_the_owner_makes_anything(granted: URL, role: str, kind: str) -> None:
    """Neither objects, nor roles, nor files."""
    refused = UNSEEN if role == "stranger" else (DENIED,)
    assert outcome(granted, USERS[role], MAKING[kind].format(database=granted.database)) in refused


@pytest.mark.parametrize("role", ["reader", "operator"])
def test_rights_cannot_be_passed_on(granted: URL, role: str) -> None:
    """A GRANT by one who may not has no effect, and msbdb's own grant is refused."""
    # The server says by a warning alone that nothing was granted.
    run_as(granted, "GRANT SELECT ON part TO PUBLIC", user=USERS[role])
    assert outcome(granted, USERS["stranger"], "SELECT * FROM part") in UNSEEN
    with pytest.raises(DatabaseError, match="are given by its owner"):
        grant_role(open_database(as_user(granted, USERS[role])), "reader", USERS["stranger"])
    assert outcome(granted, USERS["stranger"], "SELECT * FROM part") in UNSEEN


@pytest.mark.parametrize("role", ["reader", "operator"])
def test_views_and_functions_are_readable(granted: URL, role: str) -> None:
    """Each view, and the state of the inventory at a date."""
    for view in (*VIEWS, *TABLE_VIEWS):
        assert outcome(granted, USERS[role], f"SELECT * FROM {view.name} LIMIT 1") == ""
    assert outcome(granted, USERS[role], "SELECT * FROM footprint_at('2020-01-01')") == ""


def test_msbdb_works_for_each_role(granted: URL) -> None:
    """A reader dumps and checks; an operator builds, which leaves the same as if the owner had."""
    reader = open_database(as_user(granted, USERS["reader"]))
    before = list(canonical_dump(reader))
    assert check_database(reader) == []
    with pytest.raises(DatabaseError, match="does not allow it"):
        write_build(reader, small_build("another", shift=5000))
    operator = open_database(as_user(granted, USERS["operator"]))
    assert write_build(operator, small_build(notices=("again",))).status == "replaced"
    assert check_database(operator) == []
    assert write_build(operator, small_build()).status == "replaced"
    assert list(canonical_dump(reader)) == before


def test_the_owner_does_all_and_hands_on(granted: URL, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An owner changes the schema and grants; the others keep their rights; ownership moves on, and back."""
    first, owner = str(granted.username), USERS["owner"]
    grant_role(open_database(granted), "owner", owner)
    mine = as_user(granted, owner)
    for table in TABLES:
        tried = {kind: outcome(mine, owner, statement) for kind, statement in (changes(table) | owners(table)).items()}
        assert tried == dict.fromkeys(tried, ""), table
    for kind in ("table", "temporary table", "view", "function"):
        assert outcome(mine, owner, MAKING[kind]) == ""
    grant_role(open_database(mine), "reader", USERS["stranger"])
    assert outcome(granted, USERS["stranger"], "SELECT * FROM part") == ""
    tomorrow = migrations_of_tomorrow(tmp_path / "migrations")
    with monkeypatch.context() as patch:
        patch.setattr(upgrade, "packaged", lambda _name: tomorrow)
        upgrade_schema(mine)
        downgrade_schema(mine, force=True)
    assert write_build(open_database(mine), small_build()).status == "replaced"
    for role in ("reader", "operator", "stranger"):
        assert outcome(granted, USERS[role], "SELECT * FROM building_version") == ""
    assert outcome(granted, USERS["operator"], "DELETE FROM building WHERE false") == ""
    with pytest.raises(DatabaseError, match="Make another one its owner first"):
        grant_role(open_database(mine), "reader", owner)
    grant_role(open_database(mine), "none", USERS["stranger"])
    assert outcome(granted, USERS["stranger"], "SELECT * FROM part") in UNSEEN
    grant_role(open_database(granted), "owner", first)
    grant_role(open_database(granted), "none", owner)
    assert outcome(granted, owner, "SELECT * FROM part") in UNSEEN
    assert outcome(granted, owner, MAKING["table"]) in UNSEEN
    for role in ("reader", "operator"):
        assert outcome(granted, USERS[role], "SELECT * FROM part") == ""


def test_another_role_takes_the_place_of_the_first(granted: URL) -> None:
    """From operator to reader the right to write goes."""
    engine = open_database(granted)
    grant_role(engine, "reader", USERS["operator"])
    assert outcome(granted, USERS["operator"], "DELETE FROM building WHERE false") == DENIED
    assert outcome(granted, USERS["operator"], "SELECT * FROM building") == ""
    grant_role(engine, "operator", USERS["operator"])
    assert outcome(granted, USERS["operator"], "DELETE FROM building WHERE false") == ""


def test_unknown_users_and_roles_are_refused(granted: URL) -> None:
    """By name, and nothing is granted."""
    engine = open_database(granted)
    with pytest.raises(DatabaseError, match=r"no user 'part; DROP TABLE part'.*CREATE ROLE"):
        grant_role(engine, "reader", "part; DROP TABLE part")
    with pytest.raises(ParameterError, match="reader, operator, owner"):
        grant_role(engine, "king", USERS["reader"])


def test_rights_outlive_the_upgrade_of_an_old_database(
    new_postgis: Any, place: URL, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Views that the migrations make anew are readable by whoever could read the old ones."""
    target = new_postgis()
    create_database(target, f"EPSG:{EPSG}")
    engine = open_any(target)
    for role in ("reader", "operator"):
        grant_role(engine, role, USERS[role])
    tomorrow = migrations_of_tomorrow(tmp_path / "migrations")
    with monkeypatch.context() as patch:
        patch.setattr(upgrade, "packaged", lambda _name: tomorrow)
        upgrade_schema(target)
    url = make_url(target)
    for table in TABLES:
        assert outcome(url, USERS["reader"], f"SELECT * FROM {table} LIMIT 1") == ""
        assert outcome(url, USERS["reader"], changes(table)["DELETE"]) == DENIED
    assert outcome(url, USERS["operator"], "DELETE FROM building WHERE false") == ""
    for role in ("reader", "operator"):
        run_as(url, sql.SQL("DROP OWNED BY {}").format(sql.Identifier(USERS[role])))

"""Tables, columns, views, keys, checks, indexes and triggers are all there."""

from collections.abc import Iterator

from sqlalchemy import CheckConstraint, Connection, ForeignKeyConstraint, Inspector, Table, UniqueConstraint, inspect
from sqlalchemy import text as sql

from msbdb.database.integrity.finding import Finding, tables
from msbdb.database.upgrade import head_version
from msbdb.database.views import TABLE_VIEWS, VIEWS

CHECK = "schema"
_TRIGGERS = ("ggi", "ggu", "gii", "giu", "gid")
"""Beginnings of the names of SpatiaLite's triggers by which types, SRIDs and the index are kept."""


def missing_tables(connection: Connection) -> list[Finding]:
    """Return which tables and columns are missing; without them nothing else can be checked."""
    inspector = inspect(connection)
    there = set(inspector.get_table_names())
    found = []
    for table in tables():
        if table.name not in there:
            found.append(Finding(CHECK, table.name, "", "the table is missing", f"a table of schema {head_version()}"))
            continue
        names = {str(column["name"]) for column in inspector.get_columns(table.name)}
        names |= _hidden_columns(connection, table)
        found += [
            Finding(CHECK, table.name, column.name, "the column is missing", str(column.comment))
            for column in table.columns
            if column.name not in names
        ]
    return found


def _hidden_columns(connection: Connection, table: Table) -> set[str]:
    """Return SQLite's computed columns, which not every version lists as columns."""
    if connection.dialect.name != "sqlite":
        return set()
    query = sql("SELECT name FROM pragma_table_xinfo(:table)")
    return set(connection.scalars(query, {"table": table.name}))


def check_schema(connection: Connection) -> Iterator[Finding]:
    """Yield the views, constraints, indexes and triggers that are missing."""
    inspector = inspect(connection)
    there = set(inspector.get_view_names())
    for view in (*VIEWS, *TABLE_VIEWS):
        if view.name not in there:
            yield Finding(CHECK, view.name, "", "the view is missing", view.doc)
    for table in tables():
        for kind, names in _missing(inspector, table).items():
            for name in sorted(names):
                yield Finding(CHECK, table.name, name, f"the {kind} is missing", "it keeps wrong rows out")
        if connection.dialect.name == "sqlite" and "geometry" in table.columns:
            yield from _missing_triggers(connection, table)


def _missing(inspector: Inspector, table: Table) -> dict[str, set[str]]:
    """Return the names of constraints and indexes that a table should have and has not."""
    name = table.name
    declared: dict[str, set[str]] = {
        "foreign key": {str(c.name) for c in table.constraints if isinstance(c, ForeignKeyConstraint)},
        "check": {str(c.name) for c in table.constraints if isinstance(c, CheckConstraint)},
        "unique key": {str(c.name) for c in table.constraints if isinstance(c, UniqueConstraint)},
        "index": {str(index.name) for index in table.indexes},
    }
    there: dict[str, set[str]] = {
        "foreign key": {str(c["name"]) for c in inspector.get_foreign_keys(name)},
        "check": {str(c["name"]) for c in inspector.get_check_constraints(name)},
        "unique key": {str(c["name"]) for c in inspector.get_unique_constraints(name)},
        "index": {str(index["name"]) for index in inspector.get_indexes(name)},
    }
    return {kind: names - there[kind] for kind, names in declared.items()}


def _missing_triggers(connection: Connection, table: Table) -> Iterator[Finding]:
    query = sql("SELECT name FROM sqlite_master WHERE type = 'trigger' AND tbl_name = :table")
    there = set(connection.scalars(query, {"table": table.name}))
    for kind in _TRIGGERS:
        name = f"{kind}_{table.name}_geometry"
        if name not in there:
            yield Finding(
                CHECK, table.name, name, "the trigger is missing", "it keeps geometries and their index right"
            )

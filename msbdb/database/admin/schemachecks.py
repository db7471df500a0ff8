"""Checks of the schema: no table, column, view, constraint, index or trigger is missing.

Each question is one query of the database's own catalogue, because an inspector asks for every table many times.
"""

import re
from collections import defaultdict
from collections.abc import Iterator

from sqlalchemy import CheckConstraint, Connection, Constraint, ForeignKeyConstraint, Table, UniqueConstraint
from sqlalchemy import text as sql

from msbdb.database.admin.findings import Finding, tables
from msbdb.database.schema.migration import head_version
from msbdb.database.schema.sqlfiles import TABLE_VIEWS, VIEWS

CHECK = "schema"

_TRIGGERS = ("ggi", "ggu", "gii", "giu", "gid")
"""Prefixes of the names of SpatiaLite's triggers that check types and SRIDs and update the index."""

_KINDS: dict[str, type[Constraint]] = {
    "foreign key": ForeignKeyConstraint,
    "check": CheckConstraint,
    "unique key": UniqueConstraint,
}

_COLUMNS = {
    # Computed columns are hidden from pragma_table_info.
    "sqlite": """
        SELECT m.name, x.name FROM sqlite_master AS m JOIN pragma_table_xinfo(m.name) AS x
        WHERE m.type = 'table' AND m.sql LIKE 'CREATE TABLE%'
    """,
    "postgresql": """
        SELECT c.relname, a.attname FROM pg_class AS c JOIN pg_attribute AS a ON a.attrelid = c.oid
        WHERE c.relnamespace = current_schema()::regnamespace AND c.relkind = 'r' AND a.attnum > 0
    """,
}
"""Tables and their columns."""

_OBJECTS = {
    "sqlite": "SELECT tbl_name, name, sql FROM sqlite_master WHERE sql IS NOT NULL",
    "postgresql": """
        SELECT c.relname, n.conname, '' FROM pg_constraint AS n JOIN pg_class AS c ON c.oid = n.conrelid
        WHERE c.relnamespace = current_schema()::regnamespace
        UNION ALL SELECT tablename, indexname, '' FROM pg_indexes WHERE schemaname = current_schema()
        UNION ALL SELECT viewname, viewname, '' FROM pg_views WHERE schemaname = current_schema()
    """,
}
"""Table, name and declaration of each object; SQLite has the constraints only in the declarations of the tables."""

_CONSTRAINT = re.compile(r'CONSTRAINT\s+"?(\w+)')


def missing_tables(connection: Connection) -> list[Finding]:
    """Return the missing tables and columns; without them no other check can run."""
    there: dict[str, set[str]] = defaultdict(set)
    for table_name, column_name in connection.execute(sql(_COLUMNS[connection.dialect.name])):
        there[table_name].add(column_name)
    found = []
    for table in tables():
        if table.name not in there:
            found.append(Finding(CHECK, table.name, "", "the table is missing", f"a table of schema {head_version()}"))
            continue
        found += [
            Finding(CHECK, table.name, column.name, "the column is missing", str(column.comment))
            for column in table.columns
            if column.name not in there[table.name]
        ]
    return found


def check_schema(connection: Connection) -> Iterator[Finding]:
    """Yield the views, constraints, indexes and triggers that are missing."""
    there = _objects(connection)
    for view in (*VIEWS, *TABLE_VIEWS):
        if (view.name, view.name) not in there:
            yield Finding(CHECK, view.name, "", "the view is missing", view.doc)
    for table in tables():
        for kind, name in _declared(table):
            if (table.name, name) not in there:
                yield Finding(CHECK, table.name, name, f"the {kind} is missing", "it prevents wrong rows")
        if connection.dialect.name == "sqlite" and "geometry" in table.columns:
            for name in (f"{kind}_{table.name}_geometry" for kind in _TRIGGERS):
                if (table.name, name) not in there:
                    expected = "it checks geometries and updates their index"
                    yield Finding(CHECK, table.name, name, "the trigger is missing", expected)


def _objects(connection: Connection) -> set[tuple[str, str]]:
    """Return table and name of each constraint, index and trigger; a view counts as its own table."""
    found = set()
    for table, name, declaration in connection.execute(sql(_OBJECTS[connection.dialect.name])):
        found.add((table, name))
        found.update((table, constraint) for constraint in _CONSTRAINT.findall(declaration))
    return found


def _declared(table: Table) -> Iterator[tuple[str, str]]:
    """Yield kind and name of the constraints and indexes of a table."""
    for kind, type_ in _KINDS.items():
        yield from ((kind, str(own.name)) for own in table.constraints if isinstance(own, type_))
    yield from (("index", str(index.name)) for index in table.indexes)

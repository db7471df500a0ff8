"""Checks against the declarations: no part of the schema is missing, and every row fulfils its constraints.

The catalogue is asked by one query for each kind, because an inspector asks for every table many times. Constraints are
tested by queries, because a database that was edited may not have enforced them.
"""

import re
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TypeVar

from sqlalchemy import (
    CheckConstraint,
    Column,
    Connection,
    Constraint,
    Double,
    ForeignKeyConstraint,
    Integer,
    LargeBinary,
    Table,
    Text,
    UniqueConstraint,
    func,
    literal_column,
    select,
)
from sqlalchemy import text as sql

from msbdb.database.admin.findings import Finding, key_columns, key_of, keyed, tables
from msbdb.database.dialects.migration import head_version
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

T = TypeVar("T")

_STORED: tuple[tuple[type, tuple[str, ...]], ...] = (
    (Integer, ("integer",)),
    (Double, ("real", "integer")),
    (Text, ("text",)),
    (LargeBinary, ("blob",)),
)
"""The types of values that SQLite may store in a column of a type; BIGINT is an Integer for SQLAlchemy."""

_BATCH = {"yield_per": 5000}
"""Rows are read in batches, because a table may have millions."""


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


@dataclass(frozen=True, slots=True)
class _Fault:
    """What is found in rows that fulfil a condition, and what is expected.

    ``what`` has a pair of braces for each of the SQL expressions ``shown``.
    """

    what: str
    expected: str
    shown: tuple[str, ...] = ()


def check_values(connection: Connection) -> Iterator[Finding]:
    """Yield rows with a missing or wrongly typed value, that break a declared rule, or whose key is not unique."""
    for table in tables():
        faults = _nulls(table) | _rules(table)
        if connection.dialect.name == "sqlite":
            faults |= _types(table)
        yield from _faulty(connection, "values", table, faults)
        yield from _repeated(connection, table)


def check_foreign_keys(connection: Connection) -> Iterator[Finding]:
    """Yield rows that refer to no row, found by queries, not by the database's own constraints."""
    for table in tables():
        faults = dict(_dangling(table, constraint) for constraint in _references(table))
        yield from _faulty(connection, "foreign keys", table, faults)


def check_links(connection: Connection) -> Iterator[Finding]:
    """Yield rows of a run that refer to rows of another run."""
    for table in tables():
        faults = {}
        for constraint in _references(table):
            other = constraint.referred_table
            names = [element.parent.name for element in constraint.elements]
            if other.name != "run" and "run_id" in table.c and "run_id" in other.c and "run_id" not in names:
                condition, fault = _strange(table, constraint)
                faults[condition] = fault
        yield from _faulty(connection, "links", table, faults)


def _references(table: Table) -> list[ForeignKeyConstraint]:
    found = [c for c in table.constraints if isinstance(c, ForeignKeyConstraint)]
    return sorted(found, key=lambda constraint: str(constraint.name))


def _faulty(connection: Connection, check: str, table: Table, faults: Mapping[str, _Fault]) -> Iterator[Finding]:
    """Yield the rows that fulfil a condition, for each fault by its condition; one scan finds those that are met."""
    counts = {f"count(*) FILTER (WHERE {condition})": (condition, fault) for condition, fault in faults.items()}
    for condition, fault in _above_0(connection, counts, f"FROM {table.name}"):
        keys = key_columns(table)
        query = select(*keys, *(literal_column(each) for each in fault.shown)).select_from(table).where(sql(condition))
        for row in connection.execute(query, execution_options=_BATCH):
            key = keyed(table, row[: len(keys)])
            yield Finding(check, table.name, key, fault.what.format(*row[len(keys) :]), fault.expected)


def _above_0(connection: Connection, counts: Mapping[str, T], scanned: str = "") -> Iterator[T]:
    """Yield the values of the SQL expressions that are above 0; one statement asks for all of them."""
    if counts:
        found = connection.execute(sql(f"SELECT {', '.join(counts)} {scanned}")).one()
        yield from (value for value, rows in zip(counts.values(), found, strict=True) if rows)


def _nulls(table: Table) -> dict[str, _Fault]:
    required = [c.name for c in table.columns if not c.nullable and c.computed is None]
    return {f"{name} IS NULL": _Fault(f"{name} is null", "a value") for name in required}


def _types(table: Table) -> dict[str, _Fault]:
    """Return the conditions of values whose type differs from their column's; SQLite accepts them."""
    faults = {}
    for column in table.columns:
        allowed = next((kinds for type_, kinds in _STORED if isinstance(column.type, type_)), None)
        if allowed is not None and column.computed is None:
            found = f"typeof({column.name})"
            what = f"{column.name} holds a value of type {{}}"
            faults[f"{found} NOT IN {(*allowed, 'null')}"] = _Fault(what, " or ".join(allowed), (found,))
    return faults


def _rules(table: Table) -> dict[str, _Fault]:
    rules = {str(c.name): str(c.sqltext) for c in table.constraints if isinstance(c, CheckConstraint)}
    return {f"NOT ({rule})": _Fault(f"it breaks {name}", rule) for name, rule in rules.items()}


def _repeated(connection: Connection, table: Table) -> Iterator[Finding]:
    groups = [key_columns(table)]
    groups += [list(c.columns) for c in table.constraints if isinstance(c, UniqueConstraint)]
    whole = [index for index in table.indexes if index.unique and not index.dialect_kwargs]
    groups += [[table.c[column.name] for column in index.columns] for index in whole]
    for columns in _above_0(connection, {_repeats(table, columns): columns for columns in groups}):
        query = select(*columns, func.count()).group_by(*columns).having(func.count() > 1)
        query = query.where(*(column.is_not(None) for column in columns))
        for *values, times in connection.execute(query, execution_options=_BATCH):
            yield Finding("values", table.name, key_of(columns, values), f"{times} rows have this key", "one row")


def _repeats(table: Table, columns: list[Column[object]]) -> str:
    """Return the expression that counts the values of a key that several rows have."""
    names = [column.name for column in columns]
    known = " AND ".join(f"{name} IS NOT NULL" for name in names)
    groups = f"SELECT 1 FROM {table.name} WHERE {known} GROUP BY {', '.join(names)} HAVING count(*) > 1"  # noqa: S608  (as above)
    return f"(SELECT count(*) FROM ({groups}) AS repeated)"  # noqa: S608  (as above)


def _referred(table: Table, constraint: ForeignKeyConstraint) -> str:
    """Return the rows to which a row refers, as the end of a SELECT."""
    pairs = [(element.column.name, element.parent.name) for element in constraint.elements]
    joined = " AND ".join(f"referred.{its} = {table.name}.{own}" for its, own in pairs)
    return f"FROM {constraint.referred_table.name} AS referred WHERE {joined}"


def _dangling(table: Table, constraint: ForeignKeyConstraint) -> tuple[str, _Fault]:
    """Return the condition of rows that refer to no row."""
    own = [element.parent.name for element in constraint.elements]
    known = " AND ".join(f"{name} IS NOT NULL" for name in own)
    names = ", ".join(element.column.name for element in constraint.elements)
    what = "it refers to no row: " + ", ".join(f"{name}={{}}" for name in own)
    fault = _Fault(what, f"a row of {constraint.referred_table.name} with this {names}", tuple(own))
    return f"{known} AND NOT EXISTS (SELECT 1 {_referred(table, constraint)})", fault


def _strange(table: Table, constraint: ForeignKeyConstraint) -> tuple[str, _Fault]:
    """Return the condition of rows that refer to a row of another run."""
    others = f"{_referred(table, constraint)} AND referred.run_id <> {table.name}.run_id"
    what = f"it is of run {{}}, the row of {constraint.referred_table.name} that it refers to of run {{}}"
    fault = _Fault(what, "rows of the same run", ("run_id", f"(SELECT min(referred.run_id) {others})"))
    return f"EXISTS (SELECT 1 {others})", fault

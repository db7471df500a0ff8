"""Checks of the schema and of every row: no object is missing, and all declared constraints are fulfilled.

The constraints are tested by queries, because a database that was edited may not have enforced them.
"""

from collections.abc import Iterator, Mapping
from typing import Any, TypeVar

from sqlalchemy import (
    CheckConstraint,
    Connection,
    Double,
    Executable,
    ForeignKeyConstraint,
    Inspector,
    Integer,
    LargeBinary,
    Table,
    Text,
    TextClause,
    UniqueConstraint,
    and_,
    exists,
    func,
    inspect,
    select,
)
from sqlalchemy import text as sql

from msbdb.database.admin.findings import Finding, key_columns, key_of, keyed, tables
from msbdb.database.schema.migration import head_version
from msbdb.database.schema.sqlfiles import TABLE_VIEWS, VIEWS

T = TypeVar("T")

_STORED: tuple[tuple[type, tuple[str, ...]], ...] = (
    (Integer, ("integer",)),
    (Double, ("real", "integer")),
    (Text, ("text",)),
    (LargeBinary, ("blob",)),
)
"""The types of values that SQLite may store in a column of a type; BIGINT is an Integer for SQLAlchemy."""


def check_values(connection: Connection) -> Iterator[Finding]:
    """Yield rows with a missing or wrongly typed value, that break a declared rule, or whose key is not unique."""
    for table in tables():
        yield from _nulls(connection, table)
        if connection.dialect.name == "sqlite":
            yield from _types(connection, table)
        yield from _rules(connection, table)
        yield from _repeated(connection, table)


def check_foreign_keys(connection: Connection) -> Iterator[Finding]:
    """Yield rows that refer to no row, found by joins, not by the database's own constraints."""
    for table in tables():
        for constraint in _references(table):
            yield from _dangling(connection, table, constraint)


def check_links(connection: Connection) -> Iterator[Finding]:
    """Yield rows of a run that refer to rows of another run."""
    for table in tables():
        for constraint in _references(table):
            other = constraint.referred_table
            names = [element.parent.name for element in constraint.elements]
            if other.name != "run" and "run_id" in table.c and "run_id" in other.c and "run_id" not in names:
                yield from _strangers(connection, table, constraint)


def _references(table: Table) -> list[ForeignKeyConstraint]:
    found = [c for c in table.constraints if isinstance(c, ForeignKeyConstraint)]
    return sorted(found, key=lambda constraint: str(constraint.name))


def _rows(connection: Connection, query: Executable) -> Iterator[Any]:
    """Yield rows in batches, because a table may have millions."""
    yield from connection.execute(query, execution_options={"yield_per": 5000})


def _fulfilled(connection: Connection, table: Table, conditions: Mapping[str, T]) -> Iterator[tuple[TextClause, T]]:
    """Yield the conditions that some rows fulfil, with their values; one scan of the table finds them all."""
    if conditions:
        counts = ", ".join(f"count(*) FILTER (WHERE {condition})" for condition in conditions)
        found = connection.execute(sql(f"SELECT {counts} FROM {table.name}")).one()  # noqa: S608  (the models' names)
        for (condition, value), rows in zip(conditions.items(), found, strict=True):
            if rows:
                yield sql(condition), value


def _nulls(connection: Connection, table: Table) -> Iterator[Finding]:
    required = {f"{c.name} IS NULL": c for c in table.columns if not c.nullable and c.computed is None}
    for condition, column in _fulfilled(connection, table, required):
        for row in _rows(connection, select(*key_columns(table)).where(condition)):
            yield Finding("values", table.name, keyed(table, row), f"{column.name} is null", "a value")


def _types(connection: Connection, table: Table) -> Iterator[Finding]:
    """Yield values whose type differs from their column's; SQLite accepts them."""
    conditions = {}
    for column in table.columns:
        allowed = next((kinds for type_, kinds in _STORED if isinstance(column.type, type_)), None)
        if allowed is not None and column.computed is None:
            conditions[f"typeof({column.name}) NOT IN {(*allowed, 'null')}"] = column, allowed
    for condition, (column, allowed) in _fulfilled(connection, table, conditions):
        for *key, kind in _rows(connection, select(*key_columns(table), func.typeof(column)).where(condition)):
            what = f"{column.name} holds a value of type {kind}"
            yield Finding("values", table.name, keyed(table, key), what, " or ".join(allowed))


def _rules(connection: Connection, table: Table) -> Iterator[Finding]:
    rules = {f"NOT ({c.sqltext})": c for c in table.constraints if isinstance(c, CheckConstraint)}
    for condition, rule in _fulfilled(connection, table, rules):
        for row in _rows(connection, select(*key_columns(table)).where(condition)):
            yield Finding("values", table.name, keyed(table, row), f"it breaks {rule.name}", str(rule.sqltext))


def _repeated(connection: Connection, table: Table) -> Iterator[Finding]:
    groups = [key_columns(table)]
    groups += [list(c.columns) for c in table.constraints if isinstance(c, UniqueConstraint)]
    whole = [index for index in table.indexes if index.unique and not index.dialect_kwargs]
    groups += [[table.c[column.name] for column in index.columns] for index in whole]
    for columns in groups:
        query = select(*columns, func.count()).group_by(*columns).having(func.count() > 1)
        for *values, times in _rows(connection, query.where(*(column.is_not(None) for column in columns))):
            yield Finding("values", table.name, key_of(columns, values), f"{times} rows have this key", "one row")


def _joined(table: Table, constraint: ForeignKeyConstraint, other: Any) -> Any:  # noqa: ANN401  (an alias)
    return and_(*(table.c[e.parent.name] == other.c[e.column.name] for e in constraint.elements))


def _dangling(connection: Connection, table: Table, constraint: ForeignKeyConstraint) -> Iterator[Finding]:
    other = constraint.referred_table.alias("referred")
    own = [table.c[element.parent.name] for element in constraint.elements]
    there = exists().where(_joined(table, constraint, other))
    query = select(*key_columns(table), *own).where(*(column.is_not(None) for column in own), ~there)
    number = len(key_columns(table))
    for row in _rows(connection, query):
        names = ", ".join(element.column.name for element in constraint.elements)
        expected = f"a row of {constraint.referred_table.name} with this {names}"
        what = f"it refers to no row: {key_of(own, row[number:])}"
        yield Finding("foreign keys", table.name, keyed(table, row[:number]), what, expected)


def _strangers(connection: Connection, table: Table, constraint: ForeignKeyConstraint) -> Iterator[Finding]:
    other = constraint.referred_table.alias("referred")
    query = (
        select(*key_columns(table), table.c.run_id, other.c.run_id)
        .join(other, _joined(table, constraint, other))
        .where(table.c.run_id != other.c.run_id)
    )
    for *key, own, its in _rows(connection, query):
        what = f"it is of run {own}, the row of {constraint.referred_table.name} that it refers to of run {its}"
        yield Finding("links", table.name, keyed(table, key), what, "rows of the same run")


CHECK = "schema"

_TRIGGERS = ("ggi", "ggu", "gii", "giu", "gid")
"""Prefixes of the names of SpatiaLite's triggers that check types and SRIDs and update the index."""


def missing_tables(connection: Connection) -> list[Finding]:
    """Return the missing tables and columns; without them no other check can run."""
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
    """Return SQLite's computed columns, which some versions do not list as columns."""
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
                yield Finding(CHECK, table.name, name, f"the {kind} is missing", "it prevents wrong rows")
        if connection.dialect.name == "sqlite" and "geometry" in table.columns:
            yield from _missing_triggers(connection, table)


def _missing(inspector: Inspector, table: Table) -> dict[str, set[str]]:
    """Return the names of the constraints and indexes that a table lacks."""
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
                CHECK, table.name, name, "the trigger is missing", "it checks geometries and updates their index"
            )

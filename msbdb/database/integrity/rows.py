"""What the declared constraints say holds of every row, also where the database did not enforce it."""

from collections.abc import Iterator
from typing import Any

from sqlalchemy import (
    CheckConstraint,
    Connection,
    Double,
    Executable,
    ForeignKeyConstraint,
    Integer,
    LargeBinary,
    Table,
    Text,
    UniqueConstraint,
    and_,
    exists,
    func,
    not_,
    select,
)
from sqlalchemy.sql.elements import Grouping

from msbdb.database.integrity.finding import Finding, key_columns, key_of, keyed, tables

_STORED: tuple[tuple[type, tuple[str, ...]], ...] = (
    (Integer, ("integer",)),
    (Double, ("real", "integer")),
    (Text, ("text",)),
    (LargeBinary, ("blob",)),
)
"""What SQLite may hold in a column of a type; BIGINT is an Integer to SQLAlchemy."""


def check_values(connection: Connection) -> Iterator[Finding]:
    """Yield rows with a missing or wrongly typed value, that break a declared rule, or whose key is not unique."""
    for table in tables():
        yield from _nulls(connection, table)
        if connection.dialect.name == "sqlite":
            yield from _types(connection, table)
        yield from _rules(connection, table)
        yield from _repeated(connection, table)


def check_foreign_keys(connection: Connection) -> Iterator[Finding]:
    """Yield rows that refer to nothing, found by joins and not by what the database believes."""
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
    """Yield rows in batches, as a table may hold millions."""
    yield from connection.execute(query, execution_options={"yield_per": 5000})


def _nulls(connection: Connection, table: Table) -> Iterator[Finding]:
    for column in table.columns:
        if column.nullable or column.computed is not None:
            continue
        for row in _rows(connection, select(*key_columns(table)).where(column.is_(None))):
            yield Finding("values", table.name, keyed(table, row), f"{column.name} is null", "a value")


def _types(connection: Connection, table: Table) -> Iterator[Finding]:
    """Yield values of another type than their column's, which SQLite lets in."""
    for column in table.columns:
        allowed = next((kinds for type_, kinds in _STORED if isinstance(column.type, type_)), None)
        if allowed is None or column.computed is not None:
            continue
        stored = func.typeof(column)
        query = select(*key_columns(table), stored).where(stored.not_in([*allowed, "null"]))
        for *key, kind in _rows(connection, query):
            what = f"{column.name} holds a value of type {kind}"
            yield Finding("values", table.name, keyed(table, key), what, " or ".join(allowed))


def _rules(connection: Connection, table: Table) -> Iterator[Finding]:
    rules = [c for c in table.constraints if isinstance(c, CheckConstraint)]
    for rule in sorted(rules, key=lambda constraint: str(constraint.name)):
        for row in _rows(connection, select(*key_columns(table)).where(not_(Grouping(rule.sqltext)))):
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
        what = f"it refers to nothing: {key_of(own, row[number:])}"
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

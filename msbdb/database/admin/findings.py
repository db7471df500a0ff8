"""A finding of a check, and names of rows in findings."""

from collections.abc import Iterable
from dataclasses import dataclass

from sqlalchemy import Column, Table

from msbdb.database.schema.sqltables import METADATA, SQL


@dataclass(frozen=True, slots=True, order=True)
class Finding:
    """One error in a database.

    Parameters
    ----------
    check : str
        Name of the check.
    table : str
        Name of the table.
    key : str
        The row as ``column=value``; empty for a whole table.
    what : str
        The value or state that was found.
    expected : str
        The value or state that is right.
    """

    check: str
    table: str
    key: str
    what: str
    expected: str


def tables() -> list[Table]:
    """Return all tables, by name."""
    return sorted(METADATA.tables.values(), key=lambda table: table.name)


def key_columns(table: Table) -> list[Column[object]]:
    """Return a table's primary key."""
    return list(table.primary_key.columns)


def key_of(columns: Iterable[Column[object]], values: Iterable[object]) -> str:
    """Return the name of a row in findings.

    Examples
    --------
    >>> key_of([SQL["part"].c.part_id], [5])
    'part_id=5'
    """
    return ", ".join(f"{column.name}={value}" for column, value in zip(columns, values, strict=True))


def keyed(table: Table, values: Iterable[object]) -> str:
    """Return the name of the row with these key values."""
    return key_of(key_columns(table), values)


def by_id(table: str, column: str, value: object) -> str:
    """Return the name of a row whose key has one column."""
    return key_of([SQL[table].columns[column]], [value])

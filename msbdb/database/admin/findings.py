"""What a check found, and how rows are named."""

from collections.abc import Iterable
from dataclasses import dataclass

from sqlalchemy import Column, Table

from msbdb.database.schema.sqltables import METADATA, SQL


@dataclass(frozen=True, slots=True, order=True)
class Finding:
    """One thing that is wrong.

    ``check`` names the check, ``key`` the row as ``column=value`` (empty where a whole table is meant), ``what`` what
    was found and ``expected`` what should be there.
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
    """Return how a row is named.

    Examples
    --------
    >>> key_of([SQL["part"].c.part_id], [5])
    'part_id=5'
    """
    return ", ".join(f"{column.name}={value}" for column, value in zip(columns, values, strict=True))


def keyed(table: Table, values: Iterable[object]) -> str:
    """Return how a row of these key values is named."""
    return key_of(key_columns(table), values)


def by_id(table: str, column: str, value: object) -> str:
    """Return how a row of a key of one column is named."""
    return key_of([SQL[table].columns[column]], [value])

"""The SQLAlchemy tables, generated from the declarations of ``msbdb.tables``, and rows as their drivers take them."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import sqlalchemy as sa
from numpy.typing import NDArray
from sqlalchemy.types import TypeEngine, UserDefinedType

from msbdb.tables import DATABASE_TABLES, ROW_DIGEST, Check, Column, Index, KeyReference, Table, Unique

METADATA = sa.MetaData(
    naming_convention={
        "pk": "pk_%(table_name)s",
        "fk": "fk_%(table_name)s_%(referred_table_name)s",
        "uq": "uq_%(table_name)s",
        "ix": "ix_%(table_name)s_%(column_0_N_name)s",
        "ck": "ck_%(table_name)s_%(constraint_name)s",
    }
)
"""All tables; every constraint has a name, so that migrations can refer to it."""

VERSION_TABLE = "msbdb_schema_version"
"""The table with the version of the schema, which Alembic writes."""

SPATIAL: dict[str, str] = {table.name: table.geometry for table in DATABASE_TABLES if table.geometry is not None}
"""Geometry type of each table that has one; the column is always ``geometry``."""


class Geometry(UserDefinedType[bytes]):
    """A column of geometries. The hooks of the dialects create it, with the SRID of the database.

    Parameters
    ----------
    kind : str
        ``MULTIPOLYGON`` or ``POINT``.
    srid : int or str
        As the server reports it when a table is inspected.
    """

    cache_ok = True

    def __init__(self, kind: str = "GEOMETRY", srid: int | str = 0) -> None:
        self.kind = kind
        self.srid = srid

    def get_col_spec(self, **_: object) -> str:
        """Return the type as SQL."""
        return f"geometry({self.kind})"


_ROW_ID = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
"""Always 64 bits. Spatial indexes need the row number, for which SQLite accepts only ``INTEGER PRIMARY KEY``. All other
integers are BIGINT, because GDAL reads INTEGER in a view as 32 bits and truncates ids."""

_TYPES: dict[str, TypeEngine[Any]] = {
    "int64": sa.BigInteger(),
    "Int64": sa.BigInteger(),
    "int32": sa.Integer(),
    "float64": sa.Double(),
    "str": sa.Text(),
    "bool": sa.Boolean(),
    "json": sa.JSON(),
    "bytes": sa.LargeBinary(),
}


def sql_type(column: Column) -> TypeEngine[Any]:
    """Return the type of a declared column in a view, where no key has a type of its own."""
    return _TYPES[column.dtype]


def _type(table: Table, column: Column) -> TypeEngine[Any]:
    """Return the type of a declared column."""
    keys = [own for own in table.stored if own.primary]
    if keys == [column] and column.dtype == "int64" and not column.refers:
        return _ROW_ID
    if column.dtype == "json" and column.nullable:
        return sa.JSON(none_as_null=True)
    return sql_type(column)


def _column(table: Table, column: Column) -> sa.Column[Any]:
    """Return a declared column."""
    more: list[Any] = []
    if column.refers:
        on_delete = "CASCADE" if column.cascade else None
        more.append(sa.ForeignKey(column.refers, name=column.key_name or None, ondelete=on_delete))
    if column.zero_of:
        more.append(sa.Computed(f"nullif({column.zero_of}, 0)", persisted=True))
    return sa.Column(
        column.name,
        _type(table, column),
        *more,
        primary_key=column.primary,
        autoincrement=False,
        nullable=column.nullable,
        comment=column.comment,
    )


def _rule(rule: Check | Unique | KeyReference) -> sa.Constraint:
    """Return a declared rule as a constraint."""
    if isinstance(rule, Check):
        return sa.CheckConstraint(rule.rule, name=rule.name)
    if isinstance(rule, Unique):
        return sa.UniqueConstraint(*rule.columns)
    return sa.ForeignKeyConstraint(
        rule.columns,
        [f"{rule.table}.{name}" for name in rule.to],
        ondelete="CASCADE" if rule.cascade else None,
        deferrable=rule.deferred or None,
        initially="DEFERRED" if rule.deferred else None,
    )


def _index(index: Index) -> sa.Index:
    """Return a declared index; `msbdb.database.dialects.postgis` gives its condition to PostgreSQL, too."""
    # A condition for PostgreSQL would load SQLAlchemy's dialect of it, also for a file.
    condition: dict[str, Any] = {"sqlite_where": sa.text(index.where)} if index.where else {}
    return sa.Index(index.name or None, *index.columns, unique=index.unique, **condition)


def _table(table: Table) -> sa.Table:
    """Return a declared table."""
    # Made before the columns' own keys, because constraints appear in the schema in the order of creation.
    rules = [_rule(rule) for rule in table.rules]
    columns = [_column(table, column) for column in table.stored]
    if table.geometry:
        comment = "in the database's CRS [m]"
        columns.append(sa.Column("geometry", Geometry(table.geometry), nullable=False, comment=comment))
    if table.digested:
        columns.append(_column(table, ROW_DIGEST))
    indexes = [_index(index) for index in table.indexes]
    return sa.Table(table.name, METADATA, *columns, *rules, *indexes, comment=table.doc)


SQL: dict[str, sa.Table] = {table.name: _table(table) for table in DATABASE_TABLES}
"""The tables by name."""


def plain_rows(columns: Mapping[str, Sequence[Any] | NDArray[Any]]) -> list[tuple[Any, ...]]:
    """Return the rows of columns as plain Python values, with None for NaN."""
    return list(zip(*(_plain(values) for values in columns.values()), strict=True))


def _plain(values: Sequence[Any] | NDArray[Any]) -> Sequence[Any]:
    """Return a column as plain Python values."""
    if not isinstance(values, np.ndarray):
        return values
    found: list[Any] = values.tolist()
    if values.dtype.kind == "f":
        for row in np.flatnonzero(np.isnan(values)).tolist():
            found[row] = None
    return found

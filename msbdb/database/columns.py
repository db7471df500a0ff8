"""What the models' columns and constraints are made of: names, comments and types from ``msbdb.tables``."""

from typing import Any

from geoalchemy2 import Geometry, WKBElement
from sqlalchemy import BigInteger, CheckConstraint, Double, ForeignKey, Integer, MetaData, Text, event
from sqlalchemy import Table as SqlTable
from sqlalchemy.orm import DeclarativeBase, MappedColumn, mapped_column
from sqlalchemy.types import TypeEngine

from msbdb.tables import Column, Table

RowId = BigInteger().with_variant(Integer(), "sqlite")
"""64 bits everywhere. SQLite takes only an ``INTEGER PRIMARY KEY`` as the row's own number, which spatial indexes need;
every other integer is BIGINT, as GDAL reads INTEGER in a view as 32 bits and cuts ids off."""

_TYPES: dict[str, TypeEngine[Any]] = {"int64": BigInteger(), "float64": Double(), "str": Text()}


class Base(DeclarativeBase):
    """Root of the models, with names for all constraints, so that migrations can speak of them."""

    metadata = MetaData(
        naming_convention={
            "pk": "pk_%(table_name)s",
            "fk": "fk_%(table_name)s_%(referred_table_name)s",
            "uq": "uq_%(table_name)s",
            "ix": "ix_%(table_name)s_%(column_0_N_name)s",
            "ck": "ck_%(table_name)s_%(constraint_name)s",
        }
    )


@event.listens_for(Base, "instrument_class", propagate=True)
def _comment_table(_mapper: object, model: type[Base]) -> None:
    """Take the first sentence of a model's docstring as its table's comment."""
    table = model.__table__
    if isinstance(table, SqlTable):
        table.comment = (model.__doc__ or "").splitlines()[0].rstrip(".")


def _column(table: Table, name: str) -> Column:
    return next(column for column in table.columns if column.name == name)


def comment_of(table: Table, name: str) -> str:
    """Return a declared column's meaning and unit."""
    column = _column(table, name)
    return column.doc if column.unit == "-" else f"{column.doc} [{column.unit}]"


def declared(table: Table, name: str, **options: Any) -> MappedColumn[Any]:  # noqa: ANN401
    """Return the column that ``msbdb.tables`` declares."""
    column = _column(table, name)
    options.setdefault("nullable", column.nullable)
    return mapped_column(_TYPES[column.dtype], comment=comment_of(table, name), **options)


def row_id(comment: str) -> MappedColumn[int]:
    """Return a primary key of one column."""
    return mapped_column(RowId, comment=comment, primary_key=True, autoincrement=False)


def key(comment: str, *args: Any, **options: Any) -> MappedColumn[int]:  # noqa: ANN401
    """Return an integer key column that the database never counts up by itself."""
    return mapped_column(BigInteger, *args, comment=comment, autoincrement=False, **options)


def run_key(**options: Any) -> MappedColumn[int]:  # noqa: ANN401
    """Return the column that names the row's run; the row goes when its run goes."""
    return key("the run that made the row", ForeignKey("run.run_id", ondelete="CASCADE"), **options)


def text(comment: str, **options: Any) -> MappedColumn[str]:  # noqa: ANN401
    """Return a column of words."""
    return mapped_column(Text, comment=comment, **options)


def number(comment: str) -> MappedColumn[float]:
    """Return a column of floating-point numbers."""
    return mapped_column(Double, comment=comment)


def geometry(kind: str) -> MappedColumn[WKBElement]:
    """Return a geometry column; its SRID is the database's, chosen when the database is created."""
    return mapped_column(
        Geometry(kind, srid=-1, spatial_index=False), nullable=False, comment="in the database's CRS [m]"
    )


def digest() -> MappedColumn[int | None]:
    """Return the column of a row's own digest, the last of its table."""
    return mapped_column(
        BigInteger, comment="digest of the row's values, by which an edit that msbdb did not make is noticed"
    )


def one_of(name: str, values: tuple[str, ...]) -> CheckConstraint:
    """Return the check of a column that holds one of some words."""
    return CheckConstraint(f"{name} IN ({', '.join(repr(v) for v in values)})", name=name)


def shares(*names: str) -> list[CheckConstraint]:
    """Return the checks of shares, from 0 to 1 or null."""
    return [CheckConstraint(f"{name} >= 0 AND {name} <= 1", name=name) for name in names]


def overlaps(*names: str) -> list[CheckConstraint]:
    """Return the checks of a link: what is shared, and its shares of both, are above 0."""
    # The checks stand in the schema in the order in which they are made.
    overlap = CheckConstraint("overlap_m2 > 0", name="overlap")
    return [overlap, *(CheckConstraint(f"{name} > 0 AND {name} <= 1", name=name) for name in names)]

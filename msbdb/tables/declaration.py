"""How a table is declared: columns, keys, checks and indexes, independent of any database library."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from msbdb.errors import TableError

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a table.

    Parameters
    ----------
    name : str
        Its name.
    dtype : str
        pandas dtype: ``int64``, ``float64``, ``str``, or ``Int64`` for whole numbers that may be null. Columns that no
        frame has may also be ``int32``, ``bool``, ``json`` or ``bytes``.
    unit : str
        Unit; ``-`` for none.
    doc : str
        Meaning. Upper-case names in it are the paper's.
    nullable : bool
        May hold NaN, which the database stores as NULL.
    primary : bool
        Belongs to the primary key.
    refers : str
        ``table.column`` of the row that it refers to; empty for none.
    cascade : bool
        The row is deleted together with the row that it refers to.
    key_name : str
        Name of the foreign key, where a table refers twice to the same table; by default made of both tables' names.
    zero_of : str
        A column in which 0 means "none". The database computes this column from it, with NULL in place of 0, because a
        foreign key cannot hold a 0 that refers to no row.
    in_frame : bool
        False for a column that only the database has.
    """

    name: str
    dtype: str
    unit: str
    doc: str
    nullable: bool = False
    primary: bool = False
    refers: str = ""
    cascade: bool = False
    key_name: str = ""
    zero_of: str = ""
    in_frame: bool = True

    @property
    def comment(self) -> str:
        """Meaning and unit."""
        return self.doc if self.unit == "-" else f"{self.doc} [{self.unit}]"


@dataclass(frozen=True, slots=True)
class Check:
    """A rule for every row, as an SQL expression that both dialects accept."""

    name: str
    rule: str


@dataclass(frozen=True, slots=True)
class Unique:
    """Columns whose values together are unique."""

    columns: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class KeyReference:
    """Columns that refer to columns of another table; ``deferred`` ones are checked when the transaction ends."""

    columns: tuple[str, ...]
    table: str
    to: tuple[str, ...]
    deferred: bool = False
    cascade: bool = False


@dataclass(frozen=True, slots=True)
class Index:
    """An index; ``where`` restricts it to the rows that fulfil the SQL expression, and then it has a name."""

    columns: tuple[str, ...]
    unique: bool = False
    name: str = ""
    where: str = ""


@dataclass(frozen=True, slots=True)
class Table:
    """A declared table.

    Parameters
    ----------
    name, doc : str
        Its name and meaning.
    stored : tuple of Column
        All columns of the database in order, without the geometry.
    rules : tuple of Check, Unique and KeyReference
        Rules for every row, besides the columns' own keys.
    indexes : tuple of Index
        For frequent queries.
    geometry : str, optional
        Type of the column ``geometry``, where the table has one.
    digested : bool
        Each row has its own digest, which detects edits by other programs.
    """

    name: str
    doc: str
    stored: tuple[Column, ...]
    rules: tuple[Check | Unique | KeyReference, ...] = ()
    indexes: tuple[Index, ...] = ()
    geometry: str | None = None
    digested: bool = False

    @property
    def columns(self) -> tuple[Column, ...]:
        """The columns of a frame, in order and without the geometry."""
        return tuple(column for column in self.stored if column.in_frame)

    @property
    def names(self) -> list[str]:
        """The names of a frame's columns in order, without the geometry."""
        return [column.name for column in self.columns]

    @property
    def key(self) -> list[str]:
        """The frame's columns of the primary key; empty where only the database has a key."""
        return [column.name for column in self.columns if column.primary]

    @property
    def order(self) -> list[str]:
        """The columns by which rows are ordered, so that their order in a frame does not matter."""
        return self.key or self.names

    def __getitem__(self, name: str) -> Column:
        """Return a column by its name."""
        return next(column for column in self.stored if column.name == name)

    def empty(self) -> "pd.DataFrame":
        """Return a table of these columns without rows (and without geometry)."""
        import pandas as pd

        return pd.DataFrame({c.name: pd.Series(dtype=c.dtype) for c in self.columns})

    def narrowed(self, *names: str) -> "Table":
        """Return the table with some of its columns alone, to be read without the others and without the geometry."""
        return replace(self, stored=tuple(column for column in self.stored if column.name in names), geometry=None)

    def typed(self, frame: "pd.DataFrame") -> "pd.DataFrame":
        """Return these columns of a frame (and its geometry), in order and of their dtypes."""
        more = [name for name in ("geometry",) if name in frame]
        return frame[[*self.names, *more]].astype({c.name: c.dtype for c in self.columns})


RUN_ID = Column("run_id", "int64", "-", "the run that made the row", refers="run.run_id", cascade=True, in_frame=False)
"""The column with the row's run; the row is deleted together with its run."""

RUN_KEY = replace(RUN_ID, primary=True)
"""The same as a part of the primary key."""


def only_stored(*columns: Column) -> tuple[Column, ...]:
    """Return columns that only the database has."""
    return tuple(replace(column, in_frame=False) for column in columns)


def one_of(name: str, values: tuple[str, ...]) -> Check:
    """Return the check of a column that holds one of some words."""
    return Check(name, f"{name} IN ({', '.join(repr(v) for v in values)})")


def shares(*names: str) -> tuple[Check, ...]:
    """Return the checks of shares, from 0 to 1 or null."""
    return tuple(Check(name, f"{name} >= 0 AND {name} <= 1") for name in names)


def overlaps(*names: str) -> tuple[Check, ...]:
    """Return the checks of a link: the shared area and its shares of both sides are above 0."""
    return (Check("overlap", "overlap_m2 > 0"), *(Check(name, f"{name} > 0 AND {name} <= 1") for name in names))


def validate(frame: "pd.DataFrame", table: Table) -> None:
    """Check a frame against its declaration: columns in order, dtypes, and geometry where declared.

    Raises
    ------
    TableError
        Naming the first column that differs.
    """
    expected = table.names + (["geometry"] if table.geometry else [])
    if list(frame.columns) != expected:
        msg = f"Table {table.name} must have the columns {expected}; got {list(frame.columns)}."
        raise TableError(msg)
    for column, dtype in zip(table.columns, frame.dtypes, strict=False):
        found = str(dtype)
        if found != column.dtype and not (column.dtype == "str" and found in ("object", "string")):
            msg = f"Column {table.name}.{column.name} must be {column.dtype}; got {found}."
            raise TableError(msg)

"""Digests of content, which detect edits by other programs.

A run is replaced completely and has one digest. The history is written row by row over years, and updates end versions
of earlier ones. So each of its rows has its own digest, in the column `COLUMN`.
"""

import hashlib
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, fields
from itertools import pairwise
from pathlib import Path
from typing import IO, Any

import numpy as np
import shapely
from numpy.typing import NDArray
from sqlalchemy import JSON, Boolean, ColumnElement, Connection, Double, bindparam, func, select, update
from sqlalchemy import Table as SqlTable
from sqlalchemy.types import TypeEngine

from msbdb.database.dialects.dialect import Dialect
from msbdb.database.runs.mosaics import Mosaic
from msbdb.database.schema.sqltables import SQL
from msbdb.errors import FileError
from msbdb.identity import exact_json, plain, text_id, to_json
from msbdb.surveyplan import Plan
from msbdb.tables import DATABASE_TABLES, ROW_DIGEST, Run, Survey, Table

COLUMN = ROW_DIGEST.name

TABLES = tuple(table.name for table in DATABASE_TABLES if table.digested)
"""The tables whose rows have digests."""

BATCH = 5000
"""Rows in memory at a time."""

SHARE = 100_000
"""About so many rows of a table that is larger than memory are there at a time."""

BLOCK = 2**20
"""Bytes that are read at a time."""

NONE = -1
"""Length of a text that is missing."""

ColumnBytes = tuple[str, Iterable[bytes]]
"""A column's name, and what the digest takes of it, in pieces."""

Columns = Mapping[str, NDArray[Any]]


def digests(table: str, columns: Sequence[tuple[str, TypeEngine[Any]]], rows: Sequence[Sequence[Any]]) -> list[int]:
    """Return the digest of each row.

    Parameters
    ----------
    table : str
        Its name, which is part of the digest.
    columns : sequence of str and type
        Name and type of each column, in any order. A geometry is one of the name ``geometry``.
    rows : sequence of sequence
        Values from the database; a geometry as WKB, a document as an object or as JSON. A missing column is null.

    Returns
    -------
    list of int
        Numbers above 0, from `text_id`. Migrations use this function: the result for a row must stay the same.
    """
    cells = {
        name: _canonical(name, type_, values)
        for (name, type_), values in zip(columns, zip(*rows, strict=True), strict=True)
    }
    found = []
    for values in zip(*cells.values(), strict=True):
        known = {name: value for name, value in zip(cells, values, strict=True) if value is not None}
        found.append(text_id(table, exact_json(known)))
    return found


def _canonical(name: str, type_: TypeEngine[Any], values: Sequence[Any]) -> list[Any]:
    """Return a column's values in a form that is the same for all dialects."""
    if name == "geometry":
        shapes = shapely.from_wkb(np.array([bytes(value) for value in values], dtype=object))
        return [str(words) for words in shapely.to_wkb(shapes, byte_order=1, output_dimension=2, hex=True)]
    if isinstance(type_, Boolean):
        return [None if value is None else bool(value) for value in values]
    if isinstance(type_, Double):
        # Adding zero turns -0.0 into 0.0, because SQLite does not store -0.0.
        return [None if value is None else float(value) + 0.0 for value in values]
    if isinstance(type_, JSON):
        words = [value if isinstance(value, str) else to_json(value) for value in values]
        # The document 'null' is read as no value, and so is an empty object in a column that may have none.
        none = ("null", "{}") if type_.none_as_null else ("null",)
        return [None if value in none else value for value in words]
    return list(values)


def insert_digested(
    connection: Connection,
    dialect: Dialect,
    table: str,
    columns: Sequence[str],
    rows: Sequence[tuple[Any, ...]],
    *,
    srid: int,
    shapes: Any = None,  # noqa: ANN401  (an array of geometries)
) -> None:
    """Insert rows in bulk, each with its digest; documents are JSON already, ``shapes`` are the rows' geometries."""
    if not rows:
        return
    types = {column.name: column.type for column in SQL[table].columns}
    names, plain = list(columns), list(rows)
    stored: dict[str, Sequence[Any]] = dict(zip(names, zip(*rows, strict=True), strict=True))
    if shapes is not None:
        names.append("geometry")
        stored["geometry"] = shapely.to_wkb(shapes, byte_order=1)
        plain = [(*row, wkb) for row, wkb in zip(rows, stored["geometry"], strict=True)]
    stored[COLUMN] = digests(table, [(name, types[name]) for name in names], plain)
    dialect.insert_rows(connection, table, stored, srid)


def digest_again(connection: Connection, table: SqlTable, where: ColumnElement[bool] | None = None) -> None:
    """Write the digests of rows again after SQL changed them."""
    [key] = table.primary_key.columns
    named = update(table).where(key == bindparam("own_key")).values({COLUMN: bindparam("own_digest")})
    for batch in list(digested(connection, table, where)):
        connection.execute(named, [{"own_key": number, "own_digest": digest} for number, _, digest in batch])


def digested(
    connection: Connection, table: SqlTable, where: ColumnElement[bool] | None = None
) -> Iterator[list[tuple[int, int | None, int]]]:
    """Yield rows of a table in batches: key, stored digest, and digest of the values."""
    [key] = table.primary_key.columns
    columns = [column for column in table.columns if column.name != COLUMN]
    chosen: list[Any] = [func.ST_AsBinary(c, type_=None) if c.name == "geometry" else c for c in columns]
    query = select(key, table.c[COLUMN], *chosen).order_by(key)
    if where is not None:
        query = query.where(where)
    kinds = [(column.name, column.type) for column in columns]
    for rows in connection.execute(query, execution_options={"yield_per": BATCH}).partitions():
        made = digests(table.name, kinds, [row[2:] for row in rows])
        yield [(row[0], row[1], digest) for row, digest in zip(rows, made, strict=True)]


@dataclass(frozen=True, slots=True, eq=False)
class RunContent:
    """The content of a run as plain columns, which are read faster than frames.

    Parameters
    ----------
    survey : Survey
        The survey with its sources.
    run : Run
        Parameters, counts, timings and notices.
    columns : mapping of str to mapping of str to (N,) ndarray
        The columns of each of ``tables.TABLES`` by their names: int64, float64 with NaN for null, or objects for texts
        and geometries, which may be little-endian WKB; whole numbers that may be null are int64 where all are known.
        Rows are in the table's order, polygons are multipolygons.
    rasters : mapping of str to (H, W) ndarray or Mosaic
        Heights, classes and labels of the regions, by the names of their rows.
    plan : Plan, optional
        The plan by which it was built.
    """

    survey: Survey
    run: Run
    columns: Mapping[str, Mapping[str, NDArray[Any]]]
    rasters: Mapping[str, NDArray[Any] | Mosaic]
    plan: Plan | None = None

    def digest(self, tables: "hashlib._Hash | None" = None) -> str:
        """Return the SHA-256 of the content except its timings; ``tables`` is the begun one of `tables_digest`."""
        digest = tables_digest(self.survey, self.run, self._tables()) if tables is None else tables
        for name, raster in sorted(self.rasters.items()):
            # Equal numbers are equal content, in 16 bits or 32.
            dtype = np.dtype("<i4") if raster.dtype == np.int16 else raster.dtype.newbyteorder("<")
            digest.update(f"\0{name}\0{dtype.str}\0{tuple(raster.shape)}\0".encode())
            for cells in raster.bands() if isinstance(raster, Mosaic) else (raster,):
                digest.update(portable(cells.astype(dtype, copy=False)).ravel().data)
        if self.plan is not None:
            digest.update(f"\0plan\0{self.plan.as_json()}".encode())
        return digest.hexdigest()

    def _tables(self) -> Iterator[tuple[str, Iterable[ColumnBytes]]]:
        """Yield the tables with the bytes of their columns."""
        for table, columns in self.columns.items():
            yield table, ((name, (column_bytes(name, values),)) for name, values in columns.items())


def tables_digest(survey: Survey, run: Run, tables: Iterable[tuple[str, Iterable[ColumnBytes]]]) -> "hashlib._Hash":
    """Return the SHA-256 of the survey, the run and its tables, to which the rasters and the plan are to come."""
    digest = hashlib.sha256()
    own = run_row(run)
    del own["timings"]
    digest.update(to_json([survey_row(survey), source_rows(survey), own]).encode())
    for table, columns in tables:
        for name, pieces in columns:
            digest.update(f"\0{table}.{name}\0".encode())
            for piece in pieces:
                digest.update(piece)
    return digest


def run_row(run: Run) -> dict[str, Any]:
    """Return a run's own values by name; parameters and timings are not copied, which takes longer than using them."""
    return {field.name: getattr(run, field.name) for field in fields(run)} | {"counts": plain(run.counts)}


def survey_row(survey: Survey) -> dict[str, Any]:
    """Return the survey's columns except its key."""
    row = {field.name: getattr(survey, field.name) for field in fields(survey) if field.name != "sources"}
    row["west"], row["south"], row["east"], row["north"] = row.pop("bounds")
    return {name: plain(value) for name, value in row.items()}


def source_rows(survey: Survey) -> list[dict[str, Any]]:
    """Return the sources in canonical order."""
    rows = [plain(source) for source in survey.sources]
    return sorted(rows, key=lambda row: (row["role"], row["name"], row["sha256"]))


def portable(values: NDArray[Any]) -> NDArray[Any]:
    """Return an array in C order and little-endian."""
    return np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<"))


def column_bytes(name: str, values: NDArray[Any]) -> bytes:
    """Return a column's content as bytes; equal columns give equal bytes."""
    if name == "geometry":
        if not values.size or not isinstance(values[0], bytes):
            return b"".join(shapely.to_wkb(shapely.normalize(values), byte_order=1))
        from msbdb.database.runs.normalform import normal_form  # numba takes long to load

        return normal_form(values)
    if values.dtype.kind == "f":
        # SQLite stores -0.0 as 0.0, and a missing value has no sign: equal numbers are equal content.
        values = np.where(np.isnan(values), np.nan, values + 0.0)
    if values.dtype.kind in "if":
        return portable(values).tobytes()
    words = values.tolist()
    # Each different text is encoded once.
    written = {word: to_json(word) for word in set(words)}
    return f"[{', '.join(map(written.__getitem__, words))}]".encode()


def ordered(columns: Mapping[str, NDArray[Any]], table: Table) -> dict[str, NDArray[Any]]:
    """Return the rows in the table's order."""
    first = columns[table.order[0]]
    order = np.argsort(first, kind="stable")
    if (first[order][1:] == first[order][:-1]).any():
        order = np.lexsort([columns[name] for name in reversed(table.order)])
    return {name: values[order] for name, values in columns.items()}


def limits_of(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return where to cut a table with these keys, which are sorted, so that about `SHARE` of them come together.

    Examples
    --------
    >>> limits_of(np.arange(250_000))
    array([100000, 200000])
    """
    return keys[SHARE::SHARE]


def spooled(chunks: Iterable[Columns], table: Table, limits: NDArray[np.int64]) -> Iterator[ColumnBytes]:
    """Yield each column of a table with its bytes for the digest: those of the whole table in its order.

    Parameters
    ----------
    chunks : iterable of mapping of str to (N,) ndarray
        All rows, some at a time: columns as `msbdb.database.runs.digests.RunContent` has them.
    table : Table
        The first column of its order holds whole numbers.
    limits : (K,) ndarray of int64
        The table is cut at these values of that column, which rise: rows between two of them are in memory together.

    Raises
    ------
    FileError
        When the folder of temporary files has no room.

    Notes
    -----
    Each row goes into the file of its share of the table. Then each share is put in order, and its columns are appended
    to files of their own. Rows that are equal in all columns of the order keep the order of the chunks.
    """
    with ExitStack() as stack:
        with _needed_for(table):
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="msbdb.")))
        kinds: dict[str, str] = {}
        for columns in chunks:
            with _needed_for(table):
                _share_out(columns, table, limits, folder)
            for name, values in columns.items():
                # A column of whole numbers holds floats as soon as one of them is missing.
                both = kinds.get(name, "") + values.dtype.kind
                kinds[name] = next(kind for kind in "fiO" if kind in both)
        with _needed_for(table):
            for number in range(len(limits) + 1):
                _append_share(folder / f"{number}.share", table, kinds, folder)
        for column, kind in kinds.items():
            yield column, _read_back(folder / f"{column}.column", kind)


@contextmanager
def _needed_for(table: Table) -> Iterator[None]:
    """Say what temporary files are for where they cannot be used."""
    try:
        yield
    except OSError as error:
        msg = (
            f"The digest of the table {table.name} could not use the folder of temporary files, "
            f"{tempfile.gettempdir()}: {error.strerror}. Make room there, or name another folder by TMPDIR."
        )
        raise FileError(msg) from error


def _share_out(columns: Columns, table: Table, limits: NDArray[np.int64], folder: Path) -> None:
    """Append each row to the file of its share."""
    share = np.searchsorted(limits, columns[table.order[0]], side="right")
    rows = np.argsort(share, kind="stable")
    ends = np.searchsorted(share[rows], np.arange(len(limits) + 2)).tolist()
    for number, (begin, end) in enumerate(pairwise(ends)):
        if end > begin:
            with (folder / f"{number}.share").open("ab") as file:
                for values in columns.values():
                    _write(file, values[rows[begin:end]])


def _append_share(path: Path, table: Table, kinds: Mapping[str, str], folder: Path) -> None:
    """Put a share in order, and append what the digest takes of its columns to their files."""
    pieces: dict[str, list[NDArray[Any]]] = {name: [] for name in kinds}
    if path.exists():
        with path.open("rb") as file:
            while file.peek(1):
                for name, kind in kinds.items():
                    pieces[name].append(_read(file, kind, is_text=name != "geometry"))
        path.unlink()
    columns = {name: np.concatenate(found) for name, found in pieces.items() if found}
    for name, values in (ordered(columns, table) if columns else {}).items():
        kind = kinds[name]
        content = column_bytes(name, values.astype(np.float64) if kind == "f" else values)
        with (folder / f"{name}.column").open("ab") as file:
            if kind == "O" and name != "geometry":
                # The brackets of the whole list are put around it when it is read.
                content = (b", " if file.tell() else b"") + content[1:-1]
            file.write(content)


def _read_back(path: Path, kind: str) -> Iterator[bytes]:
    """Yield what the digest takes of a column."""
    is_list = kind == "O" and path.stem != "geometry"
    if is_list:
        yield b"["
    if path.exists():
        with path.open("rb") as file:
            while block := file.read(BLOCK):
                yield block
    if is_list:
        yield b"]"


def _write(file: IO[bytes], values: NDArray[Any]) -> None:
    """Append an array; of texts and bytes their lengths, and then all of them."""
    if values.dtype.kind in "if":
        np.save(file, values, allow_pickle=False)
        return
    parts = [None if one is None else one if isinstance(one, bytes) else str(one).encode() for one in values]
    np.save(file, np.array([NONE if one is None else len(one) for one in parts], dtype=np.int64), allow_pickle=False)
    file.write(b"".join(filter(None, parts)))


def _read(file: IO[bytes], kind: str, *, is_text: bool) -> NDArray[Any]:
    """Read the next array of a file."""
    numbers: NDArray[Any] = np.load(file, allow_pickle=False)
    if kind in "if":
        return numbers
    found = np.empty(len(numbers), dtype=object)
    ends = np.cumsum(np.maximum(numbers, 0))
    content = file.read(int(ends[-1]) if len(ends) else 0)
    for row, (length, end) in enumerate(zip(numbers.tolist(), ends.tolist(), strict=True)):
        part = content[end - length : end] if length != NONE else None
        found[row] = part.decode() if is_text and part is not None else part
    return found

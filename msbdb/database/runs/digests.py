"""Digests of content, which detect edits by other programs.

A run is replaced completely and has one digest. The history is written row by row over years, and updates end versions
of earlier ones. So each of its rows has its own digest, in the column `COLUMN`.
"""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from numpy.typing import NDArray
from sqlalchemy import (
    JSON,
    Boolean,
    ColumnElement,
    Connection,
    Double,
    Table,
    bindparam,
    func,
    select,
    update,
)
from sqlalchemy.types import TypeEngine

from msbdb.database.dialects.dialect import Dialect
from msbdb.database.runs.mosaics import Mosaic
from msbdb.database.schema.sqltables import SQL
from msbdb.identity import exact_json, plain, text_id, to_json
from msbdb.surveyplan import Plan
from msbdb.tables import DATABASE_TABLES, ROW_DIGEST, Run, Survey

if TYPE_CHECKING:
    pass


COLUMN = ROW_DIGEST.name

TABLES = tuple(table.name for table in DATABASE_TABLES if table.digested)
"""The tables whose rows have digests."""

BATCH = 5000
"""Rows in memory at a time."""


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


def digest_again(connection: Connection, table: Table, where: ColumnElement[bool] | None = None) -> None:
    """Write the digests of rows again after SQL changed them."""
    [key] = table.primary_key.columns
    named = update(table).where(key == bindparam("own_key")).values({COLUMN: bindparam("own_digest")})
    for batch in list(digested(connection, table, where)):
        connection.execute(named, [{"own_key": number, "own_digest": digest} for number, _, digest in batch])


def digested(
    connection: Connection, table: Table, where: ColumnElement[bool] | None = None
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
        """Return the SHA-256 of the content except its timings; ``tables`` is the begun one of `tables_digested`."""
        digest = self.tables_digested() if tables is None else tables
        for name, raster in sorted(self.rasters.items()):
            # Equal numbers are equal content, in 16 bits or 32.
            dtype = np.dtype("<i4") if raster.dtype == np.int16 else raster.dtype.newbyteorder("<")
            digest.update(f"\0{name}\0{dtype.str}\0{tuple(raster.shape)}\0".encode())
            for cells in raster.bands() if isinstance(raster, Mosaic) else (raster,):
                digest.update(portable(cells.astype(dtype, copy=False)).ravel().data)
        if self.plan is not None:
            digest.update(f"\0plan\0{self.plan.as_json()}".encode())
        return digest.hexdigest()

    def tables_digested(self) -> "hashlib._Hash":
        """Return the SHA-256 of the survey, the run and its tables, to which the rasters and the plan are to come."""
        digest = hashlib.sha256()
        run = run_row(self.run)
        del run["timings"]
        digest.update(to_json([survey_row(self.survey), source_rows(self.survey), run]).encode())
        for table, columns in self.columns.items():
            for name, values in columns.items():
                digest.update(f"\0{table}.{name}\0".encode())
                digest.update(_column_bytes(name, values))
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


def _column_bytes(name: str, values: NDArray[Any]) -> bytes:
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

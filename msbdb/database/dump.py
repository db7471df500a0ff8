"""The canonical dump: the content as lines of text, the same for the same content on every dialect."""

import hashlib
import json
import zlib
from collections.abc import Iterator
from typing import Any

import shapely
from sqlalchemy import Connection, Engine, LargeBinary, Table, select, text

from msbdb.database.canonical import to_json
from msbdb.database.snapshot import snapshot
from msbdb.database.sqltables import METADATA

DECIMALS = 6
"""Decimals of numbers: a micrometre."""
COORDINATE_DECIMALS = 4

_LEFT_OUT = {"timings", "content_sha256", "row_digest", "decided_at"}
"""Timings differ between equal runs, and so does the hour of a decision; digests stand for more decimals than the
dump shows."""

_OF_FILES = {"source"}
"""The table that tells of files: the same points in another order are another file."""

_ON_FILES = {"notices"}
"""The column that names files."""


def canonical_dump(engine: Engine, *, provenance: bool = False) -> Iterator[str]:
    """Yield the content of all tables, one JSON list a row, in order of tables and keys: one committed state.

    Numbers have six decimals, geometries are normalised WKT with four, rasters are given by their checksum. Timings,
    the schema's version and whatever a dialect keeps for itself are left out.

    Parameters
    ----------
    engine : Engine
        From ``open_database``.
    provenance : bool
        Also the names and checksums of the source files, and the notices that name them.

    Yields
    ------
    str
        First a line of names for each table, then its rows, without line ends.
    """
    with snapshot(engine) as connection:
        left_out = _LEFT_OUT if provenance else _LEFT_OUT | _ON_FILES
        for table in sorted(METADATA.tables.values(), key=lambda t: t.name):
            if provenance or table.name not in _OF_FILES:
                yield from _table_lines(connection, table, left_out)


def _table_lines(connection: Connection, table: Table, left_out: set[str]) -> Iterator[str]:
    columns = [c for c in table.columns if c.name not in left_out and c.computed is None]
    yield json.dumps(["table", table.name, *(c.name for c in columns)])
    plain = [c for c in columns if c.name != "geometry"]
    query = select(*plain)
    if "geometry" in table.columns:
        query = query.add_columns(text("ST_AsBinary(geometry)"))
    blobs = {i for i, c in enumerate(plain) if isinstance(c.type, LargeBinary)}
    keys = [i for i, c in enumerate(plain) if c.primary_key]
    # Texts are ordered here, as every server has its own order for them.
    rows = sorted(connection.execute(query), key=lambda row: [row[i] for i in keys])
    for row in rows:
        cells = [_shown(value, is_raster=i in blobs) for i, value in enumerate(row[: len(plain)])]
        if len(row) > len(plain):
            cells.append(_shown_geometry(bytes(row[-1])))
        yield json.dumps([table.name, *cells], ensure_ascii=False)


def _shown(value: Any, *, is_raster: bool) -> Any:  # noqa: ANN401  (any column's value)
    if is_raster:
        return hashlib.sha256(zlib.decompress(value)).hexdigest()
    if isinstance(value, float):
        # Adding zero turns a rounded -0.0 into 0.0.
        return f"{round(value, DECIMALS) + 0.0:.{DECIMALS}f}"
    if isinstance(value, dict | list):
        return to_json(value)
    return value


def _shown_geometry(wkb: bytes) -> str:
    shape = shapely.normalize(shapely.from_wkb(wkb))
    return str(shapely.to_wkt(shape, rounding_precision=COORDINATE_DECIMALS, trim=False))

"""Bulk loads into SpatiaLite: rows are inserted without triggers, then indexes and statistics are made for all rows."""

import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from sqlalchemy import Connection, text

from msbdb.database.schema.sqlfiles import VIEWS
from msbdb.database.schema.sqltables import SPATIAL
from msbdb.errors import DatabaseError, LoadError

logger = logging.getLogger(__name__)

WORTH = 4
"""A spatial index with at most so many times the incoming rows is rebuilt; a larger one takes rows one by one.

Ours: triggers cost about 50 µs for each incoming row, a new index about 12 µs for each row of the table.
"""

_TRIGGERS = ("ggi", "tmi", "tmd")
"""Prefixes of SpatiaLite's triggers on inserted and deleted rows: geometry type, and times of changes.

The triggers that update the index (gii, giu, gid) are dropped and made together with it.
"""

_CHANGED = (
    """
    UPDATE geometry_columns_time SET last_insert = now, last_delete = now
    FROM (SELECT strftime('%Y-%m-%dT%H:%M:%fZ', 'now') AS now)
    WHERE f_table_name = :table AND f_geometry_column = 'geometry'
    """,
    """
    INSERT OR REPLACE INTO geometry_columns_statistics (f_table_name, f_geometry_column, last_verified)
    VALUES (:table, 'geometry', '0000-01-01T00:00:00.000Z')
    """,
)
"""Statements that mark a table's statistics as outdated for SpatiaLite: times of the last changes and the last count.

The second also works when the clock was set back since the last count.
"""

_COPY = """
INSERT OR REPLACE INTO views_geometry_columns_statistics
  (view_name, view_geometry, last_verified, row_count, extent_min_x, extent_min_y, extent_max_x, extent_max_y)
SELECT :view, 'geometry', last_verified, row_count, extent_min_x, extent_min_y, extent_max_x, extent_max_y
FROM geometry_columns_statistics WHERE f_table_name = :base AND f_geometry_column = 'geometry'
"""


@contextmanager
def in_bulk(connection: Connection, coming: Mapping[str, int]) -> Iterator[None]:
    """Drop spatial indexes and triggers while many rows change, and let SpatiaLite make them again at the end.

    Parameters
    ----------
    connection : Connection
        In a writer's transaction. A failure or a kill undoes everything, the missing triggers included.
    coming : Mapping
        Number of rows that will be inserted into each table. Tables with few incoming rows keep their triggers.

    Raises
    ------
    LoadError
        When a row's geometry is not of the column's type and SRID.
    DatabaseError
        When SpatiaLite cannot make an index.
    """
    tables = _worthwhile(connection, coming)
    for table in tables:
        _call(connection, "DisableSpatialIndex", table)
        connection.exec_driver_sql(f"DROP TABLE idx_{table}_geometry")
        for kind in _TRIGGERS:
            connection.exec_driver_sql(f"DROP TRIGGER IF EXISTS {kind}_{table}_geometry")
    yield
    for table in tables:
        _require_type(connection, table)
        # This also makes all triggers of the column again.
        _call(connection, "CreateSpatialIndex", table)
        for statement in _CHANGED:
            connection.execute(text(statement), {"table": table})


def update_statistics(connection: Connection) -> None:
    """Write the row counts, extents and value ranges of all layers for GIS clients.

    A view with one row for each row of its base table gets the base's count and extent, because SpatiaLite needs
    several times longer to count the view.
    """
    for table in SPATIAL:
        _call(connection, "UpdateLayerStatistics", table)
    for view in VIEWS:
        if view.complete:
            connection.execute(text(_COPY), {"view": view.name, "base": view.base})
        else:
            _call(connection, "UpdateLayerStatistics", view.name)


def _call(connection: Connection, function: str, layer: str) -> None:
    """Call one of SpatiaLite's functions on a layer; they return 0 instead of raising an error.

    Raises
    ------
    DatabaseError
        When the function fails.
    """
    if connection.scalar(text(f"SELECT {function}(:layer, 'geometry')"), {"layer": layer}) != 1:
        msg = (
            f"SpatiaLite's {function} failed on the layer {layer}. Nothing was written; "
            "check for free space on the disk, check the file with 'msbdb db check', and try again."
        )
        raise DatabaseError(msg)


def _worthwhile(connection: Connection, coming: Mapping[str, int]) -> list[str]:
    """Return the tables whose index is cheaper to rebuild; tables without an index are left out."""
    indexed = connection.exec_driver_sql(
        "SELECT f_table_name FROM geometry_columns WHERE f_geometry_column = 'geometry' AND spatial_index_enabled = 1"
    ).scalars()
    tables = [table for table in indexed if table in SPATIAL and coming.get(table)]
    return [table for table in tables if _held(connection, table) <= WORTH * coming[table]]


def _held(connection: Connection, table: str) -> int:
    """Return the number of rows in a table's index."""
    query = f"SELECT count(*) FROM idx_{table}_geometry_rowid"  # noqa: S608  (names are the models')
    return int(connection.exec_driver_sql(query).scalar_one())


def _require_type(connection: Connection, table: str) -> None:
    """Check the type and SRID of all rows in one statement, as the trigger does for each row."""
    wrong = connection.execute(
        text(
            f"SELECT count(*) FROM {table} JOIN geometry_columns ON f_table_name = :table "  # noqa: S608  (the models')
            "WHERE f_geometry_column = 'geometry' AND GeometryConstraints(geometry, geometry_type, srid) IS NOT 1"
        ),
        {"table": table},
    ).scalar_one()
    if wrong:
        msg = f"The table {table} refused {wrong} geometries of another type or SRID than its own. Nothing was written."
        raise LoadError(msg)

"""Bulk changes of SpatiaLite's tables: what its triggers do row by row is done once for all rows."""

import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import numpy as np
from sqlalchemy import Connection, text

from msbdb.database.rtree import ROOT, pack
from msbdb.database.sqltables import SPATIAL
from msbdb.errors import LoadError

logger = logging.getLogger(__name__)

WORTH = 8
"""A spatial index with up to so many times the rows that come is made anew; a larger one takes them one by one.

Ours: a row takes the triggers some 20 µs, the making anew some 2 µs.
"""

_TRIGGERS = ("ggi", "gii", "gid", "tmi", "tmd")
"""Beginnings of the names of SpatiaLite's triggers for rows that come and go: geometry, index and time."""


@contextmanager
def in_bulk(connection: Connection, coming: Mapping[str, int]) -> Iterator[None]:
    """Leave out SpatiaLite's triggers while many rows come and go, and make up for them at the end.

    Parameters
    ----------
    connection : Connection
        In a writer's transaction. A failure or a kill undoes this with all else, the triggers' absence included.
    coming : Mapping
        Number of rows that will be inserted into each table. Tables that it would not pay for keep their triggers.

    Raises
    ------
    LoadError
        When a row's geometry is not of the column's type and SRID.
    """
    triggers = {table: _triggers(connection, table) for table in _worthwhile(connection, coming)}
    for own in triggers.values():
        for name in own:
            connection.exec_driver_sql(f'DROP TRIGGER "{name}"')
    yield
    for table, own in triggers.items():
        _require_type(connection, table)
        _make_index(connection, table)
        _note_time(connection, table)
        for statement in own.values():
            connection.exec_driver_sql(statement)


def _worthwhile(connection: Connection, coming: Mapping[str, int]) -> list[str]:
    """Return the tables whose index it pays to make anew; not those that somebody took the index off."""
    indexed = connection.exec_driver_sql(
        "SELECT f_table_name FROM geometry_columns WHERE f_geometry_column = 'geometry' AND spatial_index_enabled = 1"
    ).scalars()
    tables = [table for table in indexed if table in SPATIAL and coming.get(table)]
    return [table for table in tables if _held(connection, table) <= WORTH * coming[table]]


def _held(connection: Connection, table: str) -> int:
    """Return the number of rows in a table's index."""
    query = f'SELECT count(*) FROM "idx_{table}_geometry_rowid"'  # noqa: S608  (names are the models')
    return int(connection.exec_driver_sql(query).scalar_one())


def _triggers(connection: Connection, table: str) -> dict[str, str]:
    """Return the names and statements of a table's triggers that can be made up for."""
    names = [f"{kind}_{table}_geometry" for kind in _TRIGGERS]
    query = text("SELECT name, sql FROM sqlite_master WHERE type = 'trigger' AND tbl_name = :table")
    return {name: sql for name, sql in connection.execute(query, {"table": table}) if name in names}


def _require_type(connection: Connection, table: str) -> None:
    """Hold all rows to the type and SRID of their column, as the trigger would have."""
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


def _make_index(connection: Connection, table: str) -> None:
    """Write the spatial index of all rows of a table, in place of the one that is there."""
    index = f"idx_{table}_geometry"
    edges = ", ".join(f"Mbr{edge}(geometry)" for edge in ("MinX", "MaxX", "MinY", "MaxY"))
    cursor = connection.connection.cursor()
    cursor.execute(f"SELECT rowid, {edges} FROM {table}")  # noqa: S608  (names are the models')
    rows = np.fromiter(iter(cursor.fetchone, None), dtype="i8, f8, f8, f8, f8").view(
        [("number", "i8"), ("box", "f8", 4)]
    )
    cursor.close()
    root = f'SELECT length(data) FROM "{index}_node" WHERE nodeno = {ROOT}'  # noqa: S608
    packed = pack(rows["number"], rows["box"], connection.exec_driver_sql(root).scalar_one())
    for part, content in (("node", packed.nodes), ("rowid", packed.leaves), ("parent", packed.fathers)):
        connection.exec_driver_sql(f'DELETE FROM "{index}_{part}"')  # noqa: S608
        if content:
            connection.exec_driver_sql(f'INSERT INTO "{index}_{part}" VALUES (?, ?)', content)  # noqa: S608
    logger.debug("Spatial index of %s: %d rows in %d nodes", table, len(rows), len(packed.nodes))


def _note_time(connection: Connection, table: str) -> None:
    """Tell SpatiaLite's register that rows came and went, by which it knows outdated statistics."""
    statement = text(
        "UPDATE geometry_columns_time SET last_insert = now, last_delete = now "
        "FROM (SELECT strftime('%Y-%m-%dT%H:%M:%fZ', 'now') AS now) "
        "WHERE f_table_name = :table AND f_geometry_column = 'geometry'"
    )
    connection.execute(statement, {"table": table})

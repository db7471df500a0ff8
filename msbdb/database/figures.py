"""The figures of SpatiaLite's layers: counts, extents and columns' ranges, which GIS clients read from its register."""

from typing import Any

from sqlalchemy import Connection, text

from msbdb.database.sqltables import SPATIAL
from msbdb.database.views import VIEWS

_KINDS = {"INTEGER": "integer", "BIGINT": "integer", "DOUBLE": "real", "TEXT": "text", "JSON": "text"}
"""What a column of a declared type holds, as SQLite's ``typeof`` has it."""

_COPY = """
INSERT OR REPLACE INTO views_geometry_columns_statistics
  (view_name, view_geometry, last_verified, row_count, extent_min_x, extent_min_y, extent_max_x, extent_max_y)
SELECT :view, 'geometry', last_verified, row_count, extent_min_x, extent_min_y, extent_max_x, extent_max_y
FROM geometry_columns_statistics WHERE f_table_name = :base AND f_geometry_column = 'geometry'
"""

_LAYER = """
INSERT OR REPLACE INTO geometry_columns_statistics
  (f_table_name, f_geometry_column, last_verified, row_count, extent_min_x, extent_min_y, extent_max_x, extent_max_y)
VALUES (?, 'geometry', strftime('%Y-%m-%dT%H:%M:%fZ', 'now'), ?, ?, ?, ?, ?)
"""

_COLUMN = """
INSERT OR REPLACE INTO geometry_columns_field_infos
  (f_table_name, f_geometry_column, ordinal, column_name, null_values, integer_values, double_values, text_values,
   blob_values, max_size, integer_min, integer_max, double_min, double_max)
VALUES (?, 'geometry', ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)
"""


def update_figures(connection: Connection) -> None:
    """Write the figures of all layers.

    A view with a row for every row of its base table takes the base's figures, as counting a recursive view is slow.
    """
    own = text("SELECT UpdateLayerStatistics(:layer, 'geometry')")
    for table in SPATIAL:
        if not _write_figures(connection, table):
            connection.execute(own, {"layer": table})
    for view in VIEWS:
        if view.complete:
            connection.execute(text(_COPY), {"view": view.name, "base": view.base})
        else:
            connection.execute(own, {"layer": view.name})


def _write_figures(connection: Connection, table: str) -> bool:
    """Write what ``UpdateLayerStatistics`` would, from one scan; it sorts all rows by the types of all columns.

    Return False, without a change, where a column holds values of another type than its own.
    """
    columns = [(str(row[1]), str(row[2])) for row in connection.exec_driver_sql(f"PRAGMA table_info({table})")]
    kinds = ["blob" if name == "geometry" else _KINDS.get(declared, "") for name, declared in columns]
    wanted = ["count(*)", *(f"{m}(Mbr{m}{axis}(geometry))" for m in ("Min", "Max") for axis in "XY")]
    for (name, _), kind in zip(columns, kinds, strict=True):
        wanted += _expressions(name, kind)
    found = list(connection.exec_driver_sql(f"SELECT {', '.join(wanted)} FROM {table}").one())  # noqa: S608  (models')
    count, extent, figures = found[0], found[1:5], [found[i : i + 5] for i in range(5, len(found), 5)]
    if any(filled != typed for filled, typed, *_ in figures):
        return False
    rows = [
        (table, ordinal, name, count - filled, *_by_kind(kind, filled, size, least, most))
        for ordinal, ((name, _), kind, (filled, _, size, least, most)) in enumerate(
            zip(columns, kinds, figures, strict=True)
        )
    ]
    connection.exec_driver_sql(_LAYER, (table, count, *extent))
    connection.exec_driver_sql("DELETE FROM geometry_columns_field_infos WHERE f_table_name = ?", (table,))
    if count:
        connection.exec_driver_sql(_COLUMN, rows)
    return True


def _expressions(name: str, kind: str) -> list[str]:
    """Return what tells of a column: values, those of its kind, the longest, the least, the largest."""
    counts = [f"count({name})", f"total(typeof({name}) = '{kind}')"]
    if kind in ("integer", "real"):
        return [*counts, "NULL", f"min({name})", f"max({name})"]
    return [*counts, f"max(length({name}))", "NULL", "NULL"]


def _by_kind(kind: str, filled: int, size: int | None, least: Any, most: Any) -> tuple[Any, ...]:  # noqa: ANN401
    """Return a column's counts by kind, its longest value, and its range as integers and as doubles."""
    counts = tuple(filled if kind == one else 0 for one in ("integer", "real", "text", "blob"))
    least_most, nothing = (least, most), (None, None)
    return (*counts, size, *(least_most + nothing if kind == "integer" else nothing + least_most))

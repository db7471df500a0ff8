"""Checks of geometries: valid, right type and SRID, within their survey, registered, and in the spatial index."""

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from sqlalchemy import ColumnElement, Connection, Table, func, literal_column, select
from sqlalchemy import text as sql

from msbdb.database.admin.findings import Finding, key_columns, keyed, tables
from msbdb.database.schema.sqlfiles import VIEWS
from msbdb.database.schema.sqltables import SPATIAL, SQL
from msbdb.database.schema.srid import srid_of
from msbdb.errors import CRSError

RUN = SQL["run"]

SURVEY = SQL["survey"]

OFFSET = SQL["survey_offset"]

VERSION = SQL["building_version"]

SLACK_CELLS = 2.0
"""Cells by which an outline may reach beyond its survey's edge: smoothing and buffering move outlines."""

OVERLAP_M2 = 1.0
"""Less common ground is no overlap: fitted walls of two surveys differ by centimetres over some metres."""

STRIP_M = 1.0
"""Outlines of two days overlap where a disc of this radius fits: those of one roof differ by less to each side."""

_BATCH = 5000

_WKB: ColumnElement[Any] = literal_column("ST_AsBinary(geometry)")

_SRID: ColumnElement[Any] = literal_column("ST_SRID(geometry)")

WRITTEN_M = 1e-6
"""SpatiaLite hands a box to its index in 16 digits: the last one of a coordinate such as 120872.99999999999 is lost."""


def check_geometries(connection: Connection) -> Iterator[Finding]:
    """Yield geometries that are unreadable, invalid, empty, of another type or SRID, or outside their survey."""
    srid = _database_srid(connection)
    bounds = _bounds(connection)
    for table in _spatial_tables():
        keys = key_columns(table)
        run = table.c.run_id if "run_id" in table.c else literal_column("NULL")
        query = select(*keys, run, _SRID, _WKB).select_from(table)
        result = connection.execute(query, execution_options={"yield_per": _BATCH})
        for rows in result.partitions():
            yield from _wrong_shapes(table, rows, srid, bounds)


def check_overlaps(connection: Connection) -> Iterator[Finding]:
    """Yield current buildings of the inventory that cover the same ground, each pair once.

    Outlines are compared where they are without their surveys' offsets. Those of one day have no ground in common but
    for fitted walls that differ by centimetres. Outlines of two days differ by less than a metre to each side, so a
    strip along a wall is none. Two outlines of imports are as the office drew them.
    """
    version, shift = VERSION.c, OFFSET.c
    query = (
        select(version.version_id, version.uid, version.valid_from, version.source, shift.dx_m, shift.dy_m, _WKB)
        .select_from(VERSION.outerjoin(OFFSET, shift.survey_id == version.survey_id))
        .where(version.valid_to.is_(None))
        .order_by(version.version_id)
    )
    rows = connection.execute(query).all()
    if not rows:
        return
    shapes = shapely.from_wkb(np.array([bytes(row[-1]) for row in rows], dtype=object))
    moves = np.array([[row.dx_m or 0.0, row.dy_m or 0.0] for row in rows])
    counts = shapely.get_num_coordinates(shapes)
    shapely.set_coordinates(shapes, shapely.get_coordinates(shapes) - np.repeat(moves, counts, axis=0))
    one, other = shapely.STRtree(shapes).query(shapes, predicate="intersects")
    drawn = np.array([row.source == "import" for row in rows])
    pairs = np.stack([one, other])[:, (one < other) & ~(drawn[one] & drawn[other])]
    shared = shapely.intersection(shapes[pairs[0]], shapes[pairs[1]])
    area_m2 = shapely.area(shared)
    for at in np.flatnonzero(area_m2 >= OVERLAP_M2).tolist():
        a, b = (rows[row] for row in pairs[:, at].tolist())
        if a.valid_from != b.valid_from and shapely.buffer(shared[at], -STRIP_M).is_empty:
            continue
        what = f"building {a.uid} covers {area_m2[at]:.2f} m2 of the ground of building {b.uid}"
        expected = f"less than {OVERLAP_M2:g} m2, or outlines of two days that differ by a strip along a wall"
        yield Finding("overlaps", "building_version", keyed(VERSION, [a.version_id]), what, expected)


def check_registers(connection: Connection) -> Iterator[Finding]:
    """Yield geometry columns and views that are not registered for GIS clients, and surveys in another CRS."""
    srid = _database_srid(connection)
    known = sql("SELECT COUNT(*) FROM spatial_ref_sys WHERE srid = :srid")
    if not connection.scalar(known, {"srid": srid}):
        yield Finding("registers", "spatial_ref_sys", f"srid={srid}", "the database's CRS is missing", "its definition")
    registered = dict(_registered(connection))
    for name in SPATIAL:
        if registered.get(name) != srid:
            found = registered.get(name, "none")
            yield Finding("registers", name, "geometry", f"the registered SRID is {found}", f"{srid}, the database's")
    yield from _unlisted_views(connection)
    for survey_id, epsg, wkt in connection.execute(select(SURVEY.c.survey_id, SURVEY.c.epsg, SURVEY.c.crs_wkt)):
        try:
            own = srid_of(epsg, wkt)
        except CRSError:
            own = 0
        if own != srid:
            yield Finding("registers", "survey", f"survey_id={survey_id}", f"its CRS is {own or 'unknown'}", str(srid))


def check_spatial_index(connection: Connection) -> Iterator[Finding]:
    """Yield rows that a spatial search would miss, or would find in a wrong place."""
    for table in _spatial_tables():
        if connection.dialect.name == "sqlite":
            yield from _spatialite_index(connection, table)
        else:
            yield from _postgis_index(connection, table)


def _spatial_tables() -> list[Table]:
    return [table for table in tables() if "geometry" in table.columns]


def _registered(connection: Connection) -> list[tuple[str, int]]:
    """Return the tables whose geometry is registered, with the SRID; only those of the right type."""
    if connection.dialect.name == "sqlite":
        query = "SELECT f_table_name, srid, geometry_type FROM geometry_columns WHERE f_geometry_column = 'geometry'"
        kinds: dict[Any, str] = {1: "POINT", 6: "MULTIPOLYGON"}
    else:
        query = (
            "SELECT f_table_name, srid, type FROM geometry_columns "
            "WHERE f_geometry_column = 'geometry' AND f_table_schema = current_schema()"
        )
        kinds = {kind: kind for kind in SPATIAL.values()}
    rows = connection.execute(sql(query)).all()
    return [(name, srid) for name, srid, kind in rows if name in SPATIAL and kinds.get(kind) == SPATIAL[name]]


def _database_srid(connection: Connection) -> int:
    """Return the SRID of the database, which most of its geometry columns have; 0 where none is registered."""
    counted = Counter(srid for _, srid in _registered(connection)).most_common(1)
    return counted[0][0] if counted else 0


def _unlisted_views(connection: Connection) -> Iterator[Finding]:
    """Yield views with a geometry that clients do not list."""
    if connection.dialect.name == "sqlite":
        query = "SELECT view_name FROM views_geometry_columns WHERE view_geometry = 'geometry'"
    else:
        query = "SELECT f_table_name FROM geometry_columns WHERE f_table_schema = current_schema()"
    listed = set(connection.scalars(sql(query)))
    for view in VIEWS:
        if view.base and view.name not in listed:
            yield Finding("registers", view.name, "geometry", "the view is not registered", "a layer for GIS clients")


def _bounds(connection: Connection) -> dict[int, tuple[float, float, float, float]]:
    """Return west, south, east and north of each run's survey, extended by the slack for outlines."""
    columns = (RUN.c.run_id, SURVEY.c.west, SURVEY.c.south, SURVEY.c.east, SURVEY.c.north, SURVEY.c.cell_m)
    rows = connection.execute(select(*columns).join_from(RUN, SURVEY))
    return {
        run: (
            west - SLACK_CELLS * cell,
            south - SLACK_CELLS * cell,
            east + SLACK_CELLS * cell,
            north + SLACK_CELLS * cell,
        )
        for run, west, south, east, north, cell in rows
    }


def _wrong_shapes(
    table: Table, rows: Sequence[Any], srid: int, bounds: dict[int, tuple[float, float, float, float]]
) -> Iterator[Finding]:
    """Yield what is wrong with a batch of rows: keys, run, SRID and WKB."""
    kind = SPATIAL[table.name]
    blobs = np.array([None if row[-1] is None else bytes(row[-1]) for row in rows], dtype=object)
    shapes = shapely.from_wkb(blobs, on_invalid="ignore")
    within = _within(shapes, [bounds.get(row[-3]) for row in rows])
    types = shapely.get_type_id(shapes)
    right_type = np.asarray(types == int(shapely.GeometryType[kind]))
    valid, empty = shapely.is_valid(shapes), shapely.is_empty(shapes)
    for place, row in enumerate(rows):
        key = keyed(table, row[:-3])
        if shapes[place] is None:
            yield Finding("geometries", table.name, key, "the geometry is missing or unreadable", kind)
            continue
        if row[-2] != srid:
            yield Finding("geometries", table.name, key, f"its SRID is {row[-2]}", str(srid))
        if not right_type[place]:
            yield Finding("geometries", table.name, key, f"it is a {shapes[place].geom_type.upper()}", kind)
        if empty[place]:
            yield Finding("geometries", table.name, key, "it is empty", "a geometry with coordinates")
        elif not valid[place]:
            reason = shapely.is_valid_reason(shapes[place])
            yield Finding("geometries", table.name, key, f"it is not valid: {reason}", "a valid geometry")
        elif not within[place]:
            where = ", ".join(f"{edge:.2f}" for edge in shapes[place].bounds)
            limits = ", ".join(f"{edge:.2f}" for edge in bounds[row[-3]])
            yield Finding("geometries", table.name, key, f"it reaches to {where}", f"within its survey: {limits}")


def _within(
    shapes: NDArray[np.object_], limits: Sequence[tuple[float, float, float, float] | None]
) -> NDArray[np.bool_]:
    """Return which geometries are within their limits; without limits all are."""
    everywhere = (-np.inf, -np.inf, np.inf, np.inf)
    edges = np.array([limit or everywhere for limit in limits], dtype=np.float64).reshape(-1, 4)
    found = shapely.bounds(shapes).reshape(-1, 4)
    inside: NDArray[np.bool_] = np.all((found[:, :2] >= edges[:, :2]) & (found[:, 2:] <= edges[:, 2:]), axis=1)
    return inside


def _spatialite_index(connection: Connection, table: Table) -> Iterator[Finding]:
    """Yield rows that the R*Tree lacks or has in a wrong place, and entries without a row.

    The tree stores single precision, rounded outwards. So an entry must contain its geometry and be little larger.
    """
    enabled = sql("SELECT spatial_index_enabled FROM geometry_columns WHERE f_table_name = :table")
    there = sql("SELECT COUNT(*) FROM sqlite_master WHERE name = :index")
    index = f"idx_{table.name}_geometry"
    if connection.scalar(enabled, {"table": table.name}) != 1 or not connection.scalar(there, {"index": index}):
        yield Finding("spatial index", table.name, "", "the index is missing", index)
        return
    [key] = key_columns(table)
    box = "MbrMinX(t.geometry), MbrMaxX(t.geometry), MbrMinY(t.geometry), MbrMaxY(t.geometry)"
    query = (
        f"SELECT t.{key.name}, i.pkid, {box}, i.xmin, i.xmax, i.ymin, i.ymax "  # noqa: S608  (names are the models')
        f"FROM {table.name} AS t LEFT JOIN {index} AS i ON i.pkid = t.{key.name}"
    )
    # The size is given twice: SQLAlchemy does not take it from the options where the query is a text.
    for rows in connection.execute(sql(query), execution_options={"yield_per": _BATCH}).partitions(_BATCH):
        columns = list(zip(*rows, strict=True))
        own, entry = (np.array(columns[start : start + 4], dtype=np.float64) for start in (2, 6))
        held = _holds(own, entry)
        for place in np.flatnonzero(~held).tolist():
            number, pkid, *edges = rows[place]
            what = "the index lacks the row" if pkid is None else f"the index has it at {_box(edges[4:])}"
            yield Finding("spatial index", table.name, keyed(table, [number]), what, f"the box {_box(edges[:4])}")
    orphans = f"SELECT pkid FROM {index} WHERE pkid NOT IN (SELECT {key.name} FROM {table.name})"  # noqa: S608  (as above)
    for number in connection.scalars(sql(orphans)):
        yield Finding("spatial index", table.name, keyed(table, [number]), "the index has a box without a row", "none")


def _holds(own: NDArray[np.float64], entry: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return (N,) which index entries are the boxes of their geometries, up to single precision.

    Both arrays are (4, N): west, east, south, north. A geometry that cannot be read is a finding of another check.
    """
    slack = 4 * np.spacing(np.abs(own).astype(np.float32)).astype(np.float64)
    outwards = np.array([[-1.0], [1.0], [-1.0], [1.0]]) * (entry - own)
    contained = (outwards >= -WRITTEN_M) & (outwards <= slack)
    right: NDArray[np.bool_] = np.all(contained, axis=0) | np.isnan(own).any(axis=0)
    return right


def _box(edges: Sequence[float | None]) -> str:
    return ", ".join("none" if edge is None else f"{edge:.2f}" for edge in edges)


def _postgis_index(connection: Connection, table: Table) -> Iterator[Finding]:
    """Yield an index that is missing, not valid, or finds fewer rows than the table has."""
    query = sql(
        "SELECT bool_or(x.indisvalid AND x.indisready) FROM pg_index AS x JOIN pg_class AS i ON i.oid = x.indexrelid "
        "JOIN pg_am AS m ON m.oid = i.relam JOIN pg_attribute AS a ON a.attrelid = x.indrelid "
        "AND a.attnum = x.indkey[0] WHERE x.indrelid = CAST(:table AS regclass) AND a.attname = 'geometry' "
        "AND m.amname IN ('gist', 'spgist')"
    )
    usable = connection.scalar(query, {"table": table.name})
    if not usable:
        what = "the index is missing" if usable is None else "the index is not valid"
        yield Finding("spatial index", table.name, "", what, f"idx_{table.name}_geometry")
        return
    held = connection.scalar(select(func.count()).select_from(table))
    everywhere: ColumnElement[bool] = literal_column("geometry && ST_MakeEnvelope(-1e30, -1e30, 1e30, 1e30)")
    connection.execute(sql("SET LOCAL enable_seqscan = off"))
    seen = connection.scalar(select(func.count()).select_from(table).where(everywhere))
    connection.execute(sql("SET LOCAL enable_seqscan = on"))
    if seen != held:
        yield Finding("spatial index", table.name, "", f"the index finds {seen} rows", f"all {held}")

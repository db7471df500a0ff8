"""Buildings and building parts in the schema of Overture Maps, as GeoParquet in longitude and latitude.

Each file has one type of features, as in Overture's own releases. What the schema asks for and nothing here knows, such
as use or material, is null.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely

from msbdb.export.content import Content
from msbdb.export.standards.town import Building, Part, Town, side_by_side
from msbdb.io.files import write_atomic

if TYPE_CHECKING:
    import pyarrow as pa

VERSION = 0
"""Version of the features: they are no release of Overture's."""

ROWS_A_GROUP = 10_000
"""Rows of a file that readers skip together by their bounds."""

Row = dict[str, Any]


def write_overture(content: Content, path: Path, options: Mapping[str, str]) -> None:  # noqa: ARG001  (none)
    """Write the buildings: a feature of the type ``building`` for each."""
    town = Town.of(content)
    rows = [_building_row(building, town) for building in town.buildings]
    _write(rows, [building.geometry for building in town.buildings], town, path, _building_fields())


def write_parts(content: Content, path: Path, options: Mapping[str, str]) -> None:  # noqa: ARG001  (none)
    """Write the parts of buildings that have several: features of the type ``building_part``, side by side."""
    town = Town.of(content)
    pairs = [(building, part, own) for building in town.buildings for part, own in side_by_side(building)]
    rows = [_part_row(building, part, town) for building, part, _ in pairs]
    _write(rows, [own for *_, own in pairs], town, path, _part_fields())


def _building_row(building: Building, town: Town) -> Row:
    """Return the properties of a building."""
    record = building.record
    row = _common(f"building-{building.id}", "building", record, town)
    eaves, ridge = record.get("eaves"), record.get("ridge")
    height = record.get("h_p90") if ridge is None else ridge
    row |= {"height": height or None, "num_floors": record.get("storeys") or None}
    row |= {"roof_height": None if eaves is None or ridge is None else ridge - eaves}
    return row | {"subtype": None, "class": None, "has_parts": bool(side_by_side(building))}


def _part_row(building: Building, part: Part, town: Town) -> Row:
    """Return the properties of a part."""
    row = _common(f"part-{part.id}", "building_part", building.record, town)
    row |= {"height": part.own_height or None, "num_floors": part.record.get("hindex") or None, "roof_height": None}
    return row | {"building_id": f"building-{building.id}"}


def _common(key: str, kind: str, record: Row, town: Town) -> Row:
    """Return what all features have."""
    day = f"{town.date}T00:00:00Z" if len(town.date) == len("2024-05-31") else None
    source: Row = {"property": "", "dataset": f"msbdb {town.name}", "record_id": key.partition("-")[2]}
    source |= {"update_time": day, "confidence": record.get("probability")}
    return {"id": key, "theme": "buildings", "type": kind, "version": VERSION, "sources": [source]}


def _building_fields() -> "list[pa.Field]":
    """Return the fields of buildings alone."""
    import pyarrow as pa

    return [pa.field("subtype", pa.string()), pa.field("class", pa.string()), pa.field("has_parts", pa.bool_())]


def _part_fields() -> "list[pa.Field]":
    """Return the fields of parts alone."""
    import pyarrow as pa

    return [pa.field("building_id", pa.string(), nullable=False)]


def _write(rows: list[Row], shapes: list[shapely.Geometry], town: Town, path: Path, own: "list[pa.Field]") -> None:
    """Write rows with their outlines, in longitude and latitude."""
    import json

    import pyarrow as pa
    import pyarrow.parquet as pq
    from pyproj import Transformer

    texts = ("property", "dataset", "record_id", "update_time")
    source = pa.struct([*(pa.field(name, pa.string()) for name in texts), pa.field("confidence", pa.float64())])
    edges = ("xmin", "xmax", "ymin", "ymax")
    schema = pa.schema(
        [
            pa.field("id", pa.string(), nullable=False),
            pa.field("geometry", pa.binary(), nullable=False),
            pa.field("bbox", pa.struct([pa.field(edge, pa.float64()) for edge in edges])),
            pa.field("theme", pa.string(), nullable=False),
            pa.field("type", pa.string(), nullable=False),
            pa.field("version", pa.int32(), nullable=False),
            pa.field("sources", pa.list_(source)),
            pa.field("height", pa.float64()),
            pa.field("num_floors", pa.int32()),
            pa.field("roof_height", pa.float64()),
            *own,
        ]
    )
    to_degrees = Transformer.from_crs(town.crs, "OGC:CRS84", always_xy=True)
    degrees = shapely.transform(
        np.array(shapes, dtype=object), lambda xy: np.column_stack(to_degrees.transform(*xy.T)) if len(xy) else xy
    )
    degrees = shapely.orient_polygons(degrees)
    bounds = shapely.bounds(degrees).reshape(-1, 4).tolist()
    for row, (west, south, east, north), wkb in zip(rows, bounds, shapely.to_wkb(degrees), strict=True):
        row["bbox"] = {"xmin": west, "xmax": east, "ymin": south, "ymax": north}
        row["geometry"] = wkb
    column: Row = {"encoding": "WKB", "geometry_types": ["Polygon", "MultiPolygon"], "orientation": "counterclockwise"}
    column["covering"] = {"bbox": {edge: ["bbox", edge] for edge in edges}}
    if bounds:
        column["bbox"] = shapely.total_bounds(degrees).tolist()
    geo = {"version": "1.1.0", "primary_column": "geometry", "columns": {"geometry": column}}
    table = pa.Table.from_pylist(rows, schema=schema.with_metadata({"geo": json.dumps(geo)}))
    with write_atomic(path) as temporary:
        pq.write_table(table, temporary, compression="zstd", row_group_size=ROWS_A_GROUP)

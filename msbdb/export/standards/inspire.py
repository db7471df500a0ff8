"""INSPIRE Buildings, core 2D, as GeoPackage: the types Building and BuildingPart, flattened into columns.

Properties of properties have names with underscores, such as ``inspireId_localId``. Values of code lists have their
address in a column ``_href``. A building has two heights above ground, so these are also rows of a table of their own.
Why a value is missing is in ``gpkg_metadata``, by column: Unpopulated where nothing here knows it, else Unknown.
"""

import sqlite3
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from msbdb.export.content import ROOF_EDGES, Content
from msbdb.export.standards.town import ROOF_EDGE, Building, Part, Record, Town, side_by_side
from msbdb.io.layers import Layer, write_layers

CODES = "http://inspire.ec.europa.eu/codelist"
"""Where the code lists are."""

OPTIONS = {"namespace": "the namespace of the ids; by default msbdb"}
"""The options of the format."""

UNPOPULATED = (
    "conditionOfConstruction", "dateOfConstruction_beginning", "dateOfConstruction_end", "dateOfDemolition_beginning",
    "dateOfDemolition_end", "dateOfRenovation_beginning", "dateOfRenovation_end", "endLifespanVersion",
    "externalReference_informationSystem", "externalReference_reference", "name", "buildingNature", "currentUse",
    "numberOfDwellings", "numberOfBuildingUnits", "geometry2D_verticalGeometryReference",
    "geometry2D_horizontalGeometryEstimatedAccuracy", "geometry2D_verticalGeometryEstimatedAccuracy",
)  # fmt: skip
"""Columns of properties that nothing here knows; they are null."""

UNKNOWN = (
    "beginLifespanVersion", "inspireId_versionId", "heightAboveGround_value", "elevation_elevationValue",
    "numberOfFloorsAboveGround",
)  # fmt: skip
"""Columns whose value may be unknown for some objects."""

HEIGHTS = "Building_heightAboveGround"
"""The table of all heights above ground."""


def write_inspire(content: Content, path: Path, options: Mapping[str, str]) -> None:
    """Write buildings, and the parts of those that have several.

    Parameters
    ----------
    content : Content
        With the layers ``footprint`` and ``part``.
    path : Path
        The file to write or replace.
    options : mapping
        See `OPTIONS`.
    """
    town, namespace = Town.of(content), options.get("namespace", "msbdb")
    pairs = [(building, part, own) for building in town.buildings for part, own in side_by_side(building)]
    buildings = [_building_row(building, town, namespace) for building in town.buildings]
    parts = [_part_row(building, part, town, namespace) for building, part, _ in pairs]
    layers = {
        "Building": _layer(buildings, [building.geometry for building in town.buildings], town.crs, _BUILDING),
        "BuildingPart": _layer(parts, [own for *_, own in pairs], town.crs, _PART),
    }
    heights = [row for building in town.buildings for row in _heights(building)]

    def complete(written: Path) -> None:
        with closing(sqlite3.connect(written)) as file, file:
            _add_heights(file, heights)
            _add_voids(file, {"Building": _BUILDING, "BuildingPart": _PART})

    write_layers(path, layers, "GPKG", complete, DESCRIPTION=ROOF_EDGES, GEOMETRY_NAME="geometry", VERSION="1.2")


_BUILDING: dict[str, type] = {
    "inspireId_localId": str,
    "inspireId_namespace": str,
    "inspireId_versionId": str,
    "beginLifespanVersion": str,
    "heightAboveGround_value": float,
    "heightAboveGround_heightReference": str,
    "heightAboveGround_heightReference_href": str,
    "heightAboveGround_lowReference": str,
    "heightAboveGround_lowReference_href": str,
    "heightAboveGround_status": str,
    "heightAboveGround_status_href": str,
    "elevation_elevationValue": float,
    "elevation_elevationReference": str,
    "elevation_elevationReference_href": str,
    "numberOfFloorsAboveGround": int,
    "geometry2D_referenceGeometry": bool,
    "geometry2D_horizontalGeometryReference": str,
    "geometry2D_horizontalGeometryReference_href": str,
} | dict.fromkeys(UNPOPULATED, str)
"""The columns of buildings and what their values are."""

_PART = {"building_inspireId_localId": str} | _BUILDING
"""The columns of parts."""


def _building_row(building: Building, town: Town, namespace: str) -> Record:
    """Return the values of a building."""
    record = building.record
    row = _common(record, town, namespace) | {"inspireId_localId": building.id}
    if "version_id" in record:
        row["inspireId_versionId"] = str(record["version_id"])
    if record.get("storeys"):
        row["numberOfFloorsAboveGround"] = record["storeys"]
    for _, value, reference in _heights(building)[-1:]:
        row |= _height(value, reference)
    return row


def _part_row(building: Building, part: Part, town: Town, namespace: str) -> Record:
    """Return the values of a part."""
    row = _common(building.record, town, namespace) | {"inspireId_localId": f"part-{part.id}"}
    row |= {"building_inspireId_localId": building.id} | _height(part.own_height, "generalRoof")
    return row | ({"numberOfFloorsAboveGround": part.record["hindex"]} if part.record.get("hindex") else {})


def _common(record: Record, town: Town, namespace: str) -> Record:
    """Return what buildings and parts have."""
    row: Record = {"inspireId_namespace": namespace, "geometry2D_referenceGeometry": True}
    row |= _code("geometry2D_horizontalGeometryReference", "HorizontalGeometryReferenceValue", ROOF_EDGE)
    begin = record.get("valid_from", town.date)
    if begin:
        row["beginLifespanVersion"] = begin
    if "z_ground" in record:
        row["elevation_elevationValue"] = record["z_ground"]
        row |= _code("elevation_elevationReference", "ElevationReferenceValue", "generalGround")
    return row


def _heights(building: Building) -> list[tuple[str, float, str]]:
    """Return the known heights above ground of a building, the highest last: its id, metres, and their reference."""
    known = (("eaves", "generalEave"), ("ridge", "topOfConstruction"))
    return [(building.id, building.record[name], code) for name, code in known if name in building.record]


def _height(value: float, reference: str) -> Record:
    """Return the columns of a height above ground."""
    row: Record = {"heightAboveGround_value": value}
    row |= _code("heightAboveGround_heightReference", "ElevationReferenceValue", reference)
    row |= _code("heightAboveGround_lowReference", "ElevationReferenceValue", "generalGround")
    return row | _code("heightAboveGround_status", "HeightStatusValue", "measured")


def _code(column: str, codes: str, value: str) -> Record:
    """Return the columns of a value of a code list."""
    return {column: value, f"{column}_href": f"{CODES}/{codes}/{value}"}


def _layer(rows: list[Record], shapes: list[shapely.Geometry], crs: str, columns: Mapping[str, type]) -> Layer:
    """Return rows as a layer of multipolygons; what a row lacks is null."""
    found: dict[str, Any] = {}
    for name, kind in columns.items():
        values = [row.get(name) for row in rows]
        if kind is str:
            found[name] = np.array(values, dtype=object)
        elif kind is float:
            found[name] = np.array(values, dtype=np.float64)  # None is NaN
        else:
            null = [value is None for value in values]
            dtype = np.int32 if kind is int else np.bool_
            found[name] = np.ma.MaskedArray(np.array([value or 0 for value in values], dtype=dtype), mask=null)
    outlines = [shapely.multipolygons(shapely.get_parts(shape)) for shape in shapes]
    return Layer(found, np.array(outlines, dtype=object), crs)


def _add_heights(file: sqlite3.Connection, heights: list[tuple[str, float, str]]) -> None:
    """Add the table of all heights above ground."""
    file.execute(
        f"CREATE TABLE {HEIGHTS} (id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, "
        "building_inspireId_localId TEXT NOT NULL, value DOUBLE NOT NULL, heightReference TEXT NOT NULL, "
        "heightReference_href TEXT NOT NULL, lowReference TEXT NOT NULL, status TEXT NOT NULL)"
    )
    columns = "building_inspireId_localId, value, heightReference, heightReference_href, lowReference, status"
    rows = [
        (key, value, code, f"{CODES}/ElevationReferenceValue/{code}", "generalGround", "measured")
        for key, value, code in heights
    ]
    file.executemany(f"INSERT INTO {HEIGHTS} ({columns}) VALUES (?, ?, ?, ?, ?, ?)", rows)  # noqa: S608  (our own text)
    file.execute(
        "INSERT INTO gpkg_contents (table_name, data_type, identifier, description) VALUES (?, 'attributes', ?, ?)",
        (HEIGHTS, HEIGHTS, "All heights above ground of each building"),
    )


def _add_voids(file: sqlite3.Connection, tables: Mapping[str, Mapping[str, type]]) -> None:
    """Add why values are missing: a piece of metadata a reason, which the columns refer to."""
    file.execute(
        "CREATE TABLE gpkg_metadata (id INTEGER CONSTRAINT m_pk PRIMARY KEY ASC NOT NULL, "
        "md_scope TEXT NOT NULL DEFAULT 'dataset', md_standard_uri TEXT NOT NULL, "
        "mime_type TEXT NOT NULL DEFAULT 'text/xml', metadata TEXT NOT NULL DEFAULT '')"
    )
    file.execute(
        "CREATE TABLE gpkg_metadata_reference (reference_scope TEXT NOT NULL, table_name TEXT, column_name TEXT, "
        "row_id_value INTEGER, timestamp DATETIME NOT NULL DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ','now')), "
        "md_file_id INTEGER NOT NULL, md_parent_id INTEGER, "
        "CONSTRAINT crmr_mfi_fk FOREIGN KEY (md_file_id) REFERENCES gpkg_metadata(id), "
        "CONSTRAINT crmr_mpi_fk FOREIGN KEY (md_parent_id) REFERENCES gpkg_metadata(id))"
    )
    about = "http://www.geopackage.org/spec120/#extension_metadata"
    extensions = [
        (table, "gpkg_metadata", about, "read-write") for table in ("gpkg_metadata", "gpkg_metadata_reference")
    ]
    file.executemany(
        "INSERT INTO gpkg_extensions (table_name, extension_name, definition, scope) VALUES (?, ?, ?, ?)", extensions
    )
    for number, (reason, columns) in enumerate((("Unknown", UNKNOWN), ("Unpopulated", UNPOPULATED)), start=1):
        uri = f"{CODES}/VoidReasonValue"
        row = (number, "attributeType", uri, "text/plain", f"{uri}/{reason}")
        file.execute("INSERT INTO gpkg_metadata VALUES (?, ?, ?, ?, ?)", row)
        file.executemany(
            "INSERT INTO gpkg_metadata_reference (reference_scope, table_name, column_name, md_file_id) "
            "VALUES ('column', ?, ?, ?)",
            [(table, name, number) for table, own in tables.items() for name in columns if name in own],
        )

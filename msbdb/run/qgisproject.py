"""A project of QGIS that reads a database itself: a file by its relative path, a server without the password."""

import os
from pathlib import Path

from msbdb.database import ClientPlace, client_place, database_crs_of, opened, read_shown
from msbdb.database.history.shownlayers import columns_of
from msbdb.export.qgis.project import Bounds, layers_of, project
from msbdb.io.files import require_output, write_atomic
from msbdb.tables import Column, Survey
from msbdb.tables.view_columns import VIEW_COLUMNS

SHOWN = {"footprint": "by height"}
"""The style that is visible when the project is opened."""

_CHANGED = (
    "(began_as NOT IN ('imported', 'unchanged') AND valid_from > (SELECT min(date) FROM inventory_event)) "
    "OR ended_as = 'demolished'"
)
"""The versions that show a change: the first state of the inventory is a beginning."""


def write_project(db: str | Path, out: Path, *, overwrite: bool) -> list[str]:
    """Write a project, and return the titles of its layers; see `msbdb.api.qgis`."""
    require_output(out, overwrite=overwrite, endings=(".qgz",), sources=[db])
    with opened(db) as engine:
        found = read_shown(engine, ())
        crs = database_crs_of(engine)
        code = crs.to_epsg()
        place = client_place(engine)
    layers = [
        layer
        for name, table, key, columns, only in _tables(present=found.present)
        for layer in layers_of(
            name,
            _source(place, out, (table, key, only), _kind(name), found.srid),
            "spatialite" if place.file else "postgres",
            columns,
            SHOWN.get(name, ""),
        )
    ]
    packed = project(out.stem, layers, crs.to_wkt("WKT2_2019"), f"EPSG:{code}" if code else "", _bounds(found.surveys))
    with write_atomic(out) as temporary:
        temporary.write_bytes(packed)
    return [layer.title for layer in layers]


def _tables(*, present: bool) -> list[tuple[str, str, str, tuple[Column, ...], str]]:
    """Return the layers: name of the style, table or view, its key, its columns, and the condition of its rows."""
    buildings, parts = ("footprint_current", "part_current") if present else ("footprint", "part")
    history = [("history", "building_history", "version_id", VIEW_COLUMNS["building_history"], _CHANGED)]
    return [
        *(history if present else []),
        ("footprint", buildings, VIEW_COLUMNS[buildings][0].name, VIEW_COLUMNS[buildings], ""),
        ("part", parts, "part_id", columns_of("part")[1:], ""),
        ("building_evidence", "building_evidence", "building_id", columns_of("building_evidence"), ""),
        ("part_evidence", "part_evidence", "part_id", columns_of("part_evidence"), ""),
        ("flat_region", "flat_region", "region_id", columns_of("flat_region")[1:], ""),
        ("candidate_evidence", "candidate_evidence", "candidate_id", columns_of("candidate_evidence"), ""),
        ("rejection", "rejection", "rejection_id", columns_of("rejection")[1:], ""),
    ]


def _kind(name: str) -> str:
    """Return the type of a layer's geometries."""
    return "Point" if name == "rejection" else "MultiPolygon"


def _source(place: ClientPlace, out: Path, layer: tuple[str, str, str], kind: str, srid: int) -> str:
    """Return where QGIS reads a table or view, its key and its rows given, in the words of its provider."""
    table, key, only = layer
    rows = f" sql={only}" if only else ""
    if place.file:
        path = os.path.relpath(place.file, out.absolute().parent)
        near = path if path.startswith("..") else f"./{path}"
        return f'dbname={_quoted(near)} table="{table}" (geometry){rows}'
    words = " ".join(f"{name}={_quoted(value)}" for name, value in place.server.items())
    shown = f'table="{place.schema}"."{table}" (geometry){rows}'
    return f"{words} key={_quoted(key)} srid={srid} type={kind} checkPrimaryKeyUnicity='0' {shown}"


def _quoted(value: str) -> str:
    """Return a value as QGIS quotes it in a source."""
    return "'" + value.replace("\\", "\\\\").replace("'", "\\'") + "'"


def _bounds(surveys: tuple[Survey, ...]) -> Bounds | None:
    """Return the extent of all surveys; None without one, and QGIS shows the layers' own."""
    if not surveys:
        return None
    wests, souths, easts, norths = zip(*(survey.bounds for survey in surveys), strict=True)
    return min(wests), min(souths), max(easts), max(norths)

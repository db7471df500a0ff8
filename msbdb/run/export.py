"""From a database to a file: layers of surveys or of a day; and a project of QGIS that reads the database itself."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from msbdb.database import (
    ClientPlace,
    Engine,
    ShownLayers,
    client_place,
    crs_words_of,
    database_crs_of,
    opened,
    read_shown,
)
from msbdb.database.history.shownlayers import columns_of
from msbdb.errors import InputError, PassingNotice, give_notice
from msbdb.export import Content, check_options, choose_layers, export, find_format
from msbdb.export.qgis.project import Bounds, layers_of, project
from msbdb.io.files import require_input, require_output, write_atomic
from msbdb.io.layers import Layer, crs_text
from msbdb.run.contents import Choice, tell_choice
from msbdb.tables import FIRST_SURVEY, Column, Survey
from msbdb.tables.declaration import RUN_ID
from msbdb.tables.view_columns import VIEW_COLUMNS

if TYPE_CHECKING:
    pass

_BUILDINGS = ("footprint", "part", "flat_region", "candidate_region")

LAYERS_OF: Mapping[str, tuple[str, ...]] = {
    "current": _BUILDINGS,
    "survey": _BUILDINGS,
    "changes": ("change",),
    "parts": ("part",),
    "evidence": ("building_evidence", "part_evidence", "flat_region", "candidate_evidence", "rejection"),
}
"""The layers of each choice of what is exported, the main one first."""

PLACES = (("xo", "yo"), ("xcen", "ycen"), ("xin", "yin"))
"""Columns with the coordinates of a place."""

SHOWN = {"footprint": "by height"}
"""The style that is visible when the project is opened."""

_SEEN_FIRST = (
    "version_id IN (SELECT version_after FROM building_change WHERE kind = 'new' "  # noqa: S608  (our own words)
    f"AND note LIKE '%{FIRST_SURVEY}%') AND NOT EXISTS (SELECT 1 FROM inventory_event AS event "
    "WHERE event.kind = 'import' AND ST_Intersects(event.geometry, ST_PointOnSurface(building_history.geometry)))"
)
"""The versions by the first survey of a place, which no import has: `msbdb.change.netchange.with_beginnings` in SQL."""

_CHANGED = (
    "(began_as NOT IN ('imported', 'unchanged') "  # noqa: S608  (our own words)
    "AND valid_from > (SELECT min(date) FROM inventory_event) "
    f"AND NOT ({_SEEN_FIRST})) OR ended_as = 'demolished'"
)
"""The versions that show a change: the first state of a place is a beginning."""


def export_database(
    db: str | Path,
    out: Path,
    *,
    what: str | None,
    survey: str | None,
    layers: Sequence[str],
    crs: str | None,
    aoi: Path | None,
    at: str | None,
    name: str | None,
    options: Mapping[str, str],
    overwrite: bool,
) -> dict[str, int]:
    """Write layers to a file, and return their numbers of rows; see `msbdb.api.export`."""
    chosen = find_format(out, name)
    check_options(chosen, options)
    what = _what(what, survey, at)
    names = choose_layers(chosen, LAYERS_OF[what], layers)
    require_output(out, overwrite=overwrite, sources=[db, *([aoi] if aoi else [])])
    target = None if crs is None else _target(crs)
    if aoi is not None:
        require_input(aoi)
    # Nothing looks at geometries on the way to the file.
    encoded = chosen.encoded and aoi is None and target is None
    with opened(db) as engine:
        if what == "changes":
            content = _changes(db, at)
        else:
            content = read_content(engine, what, names, survey=survey, at=at, encoded=encoded)
        if aoi is not None:
            content = _within(content, aoi)
    if target is not None:
        content = _projected(content, target)
    if what == "current" and names == ("part",):
        _tell_lost(out, content)
    export(content.only(*names), out, name=chosen.name, options=options, overwrite=overwrite)
    return {own: len(content.layers[own]) for own in names}


def read_content(
    engine: Engine,
    what: str,
    names: Sequence[str],
    *,
    survey: str | None = None,
    at: str | None = None,
    encoded: bool = False,
) -> Content:
    """Read layers as one committed state, and give a notice of what was taken where that is not one survey.

    ``footprint`` is read, too, where ``part`` is. ``encoded`` leaves geometries as WKB, for a file alone.
    """
    wanted = dict.fromkeys(("footprint", *names) if "part" in names else names)
    present = what in ("current", "parts")
    found = read_shown(engine, tuple(wanted), survey=survey, inventory=present, date=at, encoded=encoded)
    tell_choice(
        engine, Choice(tuple(own.name for own in found.surveys), present=found.present), named=survey is not None
    )
    crs = crs_words_of(engine)
    layers = {name: _layer(found, name, crs) for name in wanted}
    return Content("current" if found.present and what == "current" else what, layers, found.surveys, at or "")


def _changes(db: str | Path, until: str | None) -> Content:
    """Return the net changes since the first state of each place."""
    from msbdb.run.inventory.changed import change_content, changes_of

    found = changes_of(db, until=until)
    return replace(change_content(found.table), date=until or "")


def _what(what: str | None, survey: str | None, at: str | None) -> str:
    """Return what is exported, and refuse options that contradict it."""
    chosen = what or ("survey" if survey is not None else "current")
    if chosen not in LAYERS_OF:
        msg = f"There is no '{chosen}' to export; choose {', '.join(LAYERS_OF)}."
        raise InputError(msg)
    if survey is not None and chosen in ("current", "changes"):
        msg = f"--survey names what one survey found; it has no meaning for --what {chosen}. Leave one of them out."
        raise InputError(msg)
    if at is not None and (survey is not None or chosen in ("survey", "evidence")):
        msg = f"--at names a day of the inventory; it has no meaning for --what {chosen}. Leave one of them out."
        raise InputError(msg)
    return chosen


def _layer(found: ShownLayers, name: str, crs: str) -> Layer:
    """Return what was read as a layer of a file."""
    columns = dict(found.layers[name])
    geometry = columns.pop("geometry")
    return Layer(columns, geometry, crs, "Point" if name == "rejection" else "MultiPolygon")


def _rows(layer: Layer, kept: "np.ndarray[Any, np.dtype[np.bool_]]") -> Layer:
    """Return some rows of a layer."""
    return replace(
        layer, columns={name: own[kept] for name, own in layer.columns.items()}, geometry=layer.geometry[kept]
    )


def _within(content: Content, aoi: Path) -> Content:
    """Return what meets the polygons of a file; of parts, those of the buildings that meet them."""
    import shapely
    from pyproj import CRS

    from msbdb.io.vector import read_polygons

    area = read_polygons(aoi, to=CRS.from_user_input(content.crs)).union_all()
    shapely.prepare(area)
    layers = {name: _rows(layer, shapely.intersects(layer.geometry, area)) for name, layer in content.layers.items()}
    if "part" in layers:
        known = layers["footprint"].columns["building_id"]
        buildings = np.ma.compressed(np.ma.asarray(known))
        parts = content.layers["part"]
        layers["part"] = _rows(parts, np.isin(parts.columns["building_id"], buildings))
    return replace(content, layers=layers)


def _target(crs: str) -> Any:  # noqa: ANN401  (pyproj is loaded late)
    """Return the CRS that the user asks for."""
    from msbdb.io.crs import parse_crs

    return parse_crs(crs)


def _projected(content: Content, target: Any) -> Content:  # noqa: ANN401  (pyproj is loaded late)
    """Return the layers in another CRS, with the columns of places; lengths and areas stay in metres."""
    import shapely
    from pyproj import CRS, Transformer

    transform = Transformer.from_crs(CRS.from_user_input(content.crs), target, always_xy=True).transform
    words = crs_text(target)
    layers = {}
    for name, layer in content.layers.items():
        columns = dict(layer.columns)
        for x, y in PLACES:
            if x in columns:
                columns[x], columns[y] = transform(columns[x], columns[y])
        geometry = shapely.transform(layer.geometry, transform, interleaved=False)
        layers[name] = replace(layer, columns=columns, geometry=geometry, crs=words)
    return replace(content, layers=layers, chosen_crs=True)


def _tell_lost(out: Path, content: Content) -> None:
    """Give a notice of buildings that a file of parts lacks, because they have none."""
    known = np.ma.asarray(content.layers["footprint"].columns["building_id"]).filled(0)
    without = int((~np.isin(known, content.layers["part"].columns["building_id"])).sum())
    if without:
        some = "1 building of the inventory has" if without == 1 else f"{without} buildings of the inventory have"
        msg = f"{some} no parts, so {out} has none of it. --layer footprint writes all buildings."
        give_notice(msg, PassingNotice, stacklevel=3)


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
            runs=found.runs,
            read_only=True,
        )
    ]
    packed = project(out.stem, layers, crs.to_wkt("WKT2_2019"), f"EPSG:{code}" if code else "", _bounds(found.surveys))
    with write_atomic(out) as temporary:
        temporary.write_bytes(packed)
    return [layer.title for layer in layers]


def _tables(*, present: bool) -> list[tuple[str, str, str, tuple[Column, ...], str]]:
    """Return the layers, the topmost first: name of the style, table or view, key, columns, condition of the rows."""
    buildings, parts = ("footprint_current", "part_current") if present else ("footprint", "part")
    history = [("history", "building_history", "version_id", VIEW_COLUMNS["building_history"], _CHANGED)]
    return [
        ("rejection", "rejection", "rejection_id", _of_table("rejection"), ""),
        ("candidate_evidence", "candidate_evidence", "candidate_id", columns_of("candidate_evidence"), ""),
        ("flat_region", "flat_region", "region_id", _of_table("flat_region"), ""),
        ("part_evidence", "part_evidence", "part_id", columns_of("part_evidence"), ""),
        ("building_evidence", "building_evidence", "building_id", columns_of("building_evidence"), ""),
        *(history if present else []),
        ("part", parts, "part_id", VIEW_COLUMNS[parts] if present else _of_table("part"), ""),
        ("footprint", buildings, VIEW_COLUMNS[buildings][0].name, VIEW_COLUMNS[buildings], ""),
    ]


def _of_table(name: str) -> tuple[Column, ...]:
    """Return the columns of a table of a run: the run in place of its survey."""
    return (RUN_ID, *columns_of(name)[1:])


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

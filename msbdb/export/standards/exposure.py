"""Exposure for OpenQuake: an asset a building, with a string of the GEM Building Taxonomy.

What is not measured comes from a table of the user's, or from the attributes of an imported inventory: occupancy, date
of construction, material, system, and the people by day, at night and in transit.
"""

import csv
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import shapely

from msbdb.errors import InputError, PassingNotice, counted, give_notice
from msbdb.export.content import Content
from msbdb.export.standards.taxonomy import (
    UNKNOWN,
    Described,
    height_atoms,
    occupancy_atom,
    other_atoms,
    plan_shape,
    positions,
    year_atom,
)
from msbdb.export.standards.town import Building, Town
from msbdb.io.files import require_input, write_atomic

READERS = {"occupancy": occupancy_atom, "year": year_atom, "material": other_atoms, "llrs": other_atoms}
"""What becomes part of the taxonomy string, with the function that reads its values."""

PERIODS = ("day", "night", "transit")
"""Periods with numbers of people."""

OPTIONS = {
    "join": "a CSV table with more about the buildings",
    "on": "its column with the ids of the buildings; by default id",
} | {
    name: f"its column, or the imported attribute, with the {name}; by default {name}" for name in (*READERS, *PERIODS)
}
"""The options of the format."""

TAGS = ("material", "llrs", "year", "shape", "position", "occupancy", "state")
"""Tags of the assets."""

NRML = "http://openquake.org/xmlns/nrml/0.5"


def write_exposure(content: Content, path: Path, options: Mapping[str, str]) -> None:
    """Write an exposure model.

    Parameters
    ----------
    content : Content
        With the layers ``footprint`` and ``part``.
    path : Path
        An .xml, which names the .csv with the assets beside it; or the .csv alone.
    options : mapping
        See `OPTIONS`.

    Raises
    ------
    InputError
        When the joined table lacks a named column, or has none that is of use.
    FileError
        When the joined table cannot be read.
    """
    town = Town.of(content)
    table, known = _facts(town, options)
    periods = [name for name in PERIODS if name in known]
    assets = _assets(town, table, periods)
    with write_atomic(path) as temporary:
        with temporary.with_suffix(".csv").open("w", encoding="utf-8", newline="") as file:
            names = ["id", "lon", "lat", "taxonomy", "number", "area", *periods, *TAGS]
            writer = csv.DictWriter(file, names, lineterminator="\n")
            writer.writeheader()
            writer.writerows(assets)
        if path.suffix.lower() == ".xml":
            _model(town, path.with_suffix(".csv").name, periods).write(temporary, "utf-8", xml_declaration=True)


def _facts(town: Town, options: Mapping[str, str]) -> tuple[list[dict[str, str]], set[str]]:
    """Return by building what attributes and the joined table say, as text, and the names of all that is there."""
    columns = {name: options.get(name, name) for name in (*READERS, *PERIODS)}
    imported = [_imported(building) for building in town.buildings]
    joined: dict[str, dict[str, str]] = {}
    if "join" in options:
        wanted = {column for name, column in columns.items() if name in options} - {
            name for row in imported for name in row
        }
        joined = _read_table(Path(options["join"]), options.get("on", "id"), columns, wanted)
        missing = sum(building.id not in joined for building in town.buildings)
        if missing:
            msg = f"{counted(missing, 'building')} of {len(town.buildings)} not in {options['join']}: {UNKNOWN} there."
            give_notice(msg, PassingNotice, stacklevel=3)
    facts = []
    for building, attributes in zip(town.buildings, imported, strict=True):
        row = attributes | joined.get(building.id, {})
        facts.append({name: row[column] for name, column in columns.items() if row.get(column)})
    return facts, {name for fact in facts for name in fact}


def _imported(building: Building) -> dict[str, str]:
    """Return the attributes of an imported building as texts."""
    attributes = building.record.get("attributes")
    found = json.loads(attributes) if isinstance(attributes, str) else attributes or {}
    return {name: str(value) for name, value in found.items() if value is not None}


def _read_table(path: Path, key: str, columns: Mapping[str, str], wanted: set[str]) -> dict[str, dict[str, str]]:
    """Return the rows of a CSV table by their id; the wanted columns must be there."""
    require_input(path)
    with path.open(encoding="utf-8-sig", newline="") as file:
        reader = csv.DictReader(file)
        header = list(reader.fieldnames or [])
        for column in (key, *sorted(wanted)):
            if column not in header:
                msg = f"{path} has no column '{column}'; it has {', '.join(header)}. Name another one by its option."
                raise InputError(msg)
        if not set(columns.values()) & set(header):
            msg = f"{path} has none of the columns {', '.join(columns)}. Name its own, such as occupancy=COLUMN."
            raise InputError(msg)
        return {row[key]: row for row in reader}


def _assets(town: Town, facts: list[dict[str, str]], periods: list[str]) -> list[dict[str, Any]]:
    """Return the rows of the table of assets."""
    from pyproj import Transformer

    shapes = np.array([building.geometry for building in town.buildings], dtype=object)
    inside = shapely.get_coordinates(shapely.point_on_surface(shapes))
    lon, lat = Transformer.from_crs(town.crs, "EPSG:4326", always_xy=True).transform(inside[:, 0], inside[:, 1])
    unread: dict[str, int] = {}
    rows = []
    for building, fact, x, y, position in zip(town.buildings, facts, lon, lat, positions(shapes), strict=True):
        read = {name: read(fact[name]) for name, read in READERS.items() if name in fact}
        for name, atom in read.items():
            unread[name] = unread.get(name, 0) + (atom == UNKNOWN)
        record = building.record
        height = height_atoms(record.get("storeys"), record.get("ridge", record.get("h_p90")))
        known = Described(height=height, shape=plan_shape(building.geometry), position=position, **read)
        row = {"id": building.id, "lon": f"{x:.6f}", "lat": f"{y:.6f}", "taxonomy": known.string, "number": 1}
        row |= {"area": round(_floor_area(building), 1), "state": record.get("state", UNKNOWN)}
        row |= {name: _people(fact.get(name, ""), building) for name in periods}
        rows.append(row | {name: getattr(known, name) for name in TAGS if name != "state"})
    for name, count in unread.items():
        if count:
            msg = f"{counted(count, 'value')} of {name} could not be read as one of the taxonomy: {UNKNOWN} there."
            give_notice(msg, PassingNotice, stacklevel=3)
    return rows


def _floor_area(building: Building) -> float:
    """Return the area of all storeys, square metres: as estimated, else that of the footprint for each storey."""
    record = building.record
    estimated = record.get("floor_area_m2")
    return float(record["area_m2"] * max(record.get("storeys", 1), 1) if estimated is None else estimated)


def _people(value: str, building: Building) -> float:
    """Return a number of people; none where the table has no number."""
    try:
        return float(value or 0)
    except ValueError as error:
        msg = f"Building {building.id} has '{value}' people; a number is expected. Correct the table."
        raise InputError(msg) from error


def _model(town: Town, assets: str, periods: list[str]) -> "ET.ElementTree[ET.Element]":
    """Return the head of the exposure model, which names the table of assets."""
    root = ET.Element("nrml", {"xmlns": NRML})
    source = "GEM Building Taxonomy 3.3"
    model = ET.SubElement(root, "exposureModel", {"id": "msbdb", "category": "buildings", "taxonomySource": source})
    ET.SubElement(model, "description").text = f"Buildings of {town.name} by msbdb"
    conversions = ET.SubElement(model, "conversions")
    ET.SubElement(conversions, "costTypes")
    ET.SubElement(conversions, "area", {"type": "aggregated", "unit": "SQM"})
    ET.SubElement(model, "occupancyPeriods").text = " ".join(periods) or None
    ET.SubElement(model, "tagNames").text = " ".join(TAGS)
    ET.SubElement(model, "assets").text = assets
    ET.indent(root)
    return ET.ElementTree(root)

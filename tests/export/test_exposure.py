"""Exposure of OpenQuake: strings that GEM's own validator accepts, and tables that say what is known."""

import csv
import json
import warnings
from dataclasses import replace
from functools import cache
from xml.etree import ElementTree as ET

import numpy as np
import pytest
import shapely
from openquake.gem_taxonomy import GemTaxonomy
from shapely.affinity import rotate
from support.exported import town_content

from msbdb.errors import FileError, InputError, PassingNotice
from msbdb.export import export
from msbdb.export.standards.exposure import NRML
from msbdb.export.standards.taxonomy import (
    BAYS,
    OCCUPANCIES,
    Described,
    height_atoms,
    occupancy_atom,
    plan_shape,
    positions,
    year_atom,
)

BOX = shapely.box(0, 0, 20, 20)

PLANS = {
    "PLFSQ": BOX,
    "PLFSQO": BOX - shapely.box(6, 6, 14, 14),
    "PLFR": shapely.box(0, 0, 10, 20),
    "PLFRO": shapely.box(0, 0, 30, 20) - shapely.box(10, 6, 20, 14),
    "PLFC": shapely.affinity.scale(shapely.Point(0, 0).buffer(10), 1.5, 1),
    "PLFCO": shapely.Point(0, 0).buffer(10) - shapely.Point(0, 0).buffer(5),
    "PLFD": shapely.Polygon([(0, 0), (20, 0), (8, 15)]),
    "PLFL": BOX - shapely.box(8, 8, 20, 20),
    "PLFU": BOX - shapely.box(6, 8, 14, 20),
    "PLFT": BOX - shapely.box(0, 0, 6, 14) - shapely.box(14, 0, 20, 14),
    "PLFS": BOX - shapely.box(0, 0, 8, 12) - shapely.box(12, 8, 20, 20),
    "PLFE": BOX - shapely.box(6, 4, 20, 8) - shapely.box(6, 12, 20, 16),
    "PLFH": BOX - shapely.box(6, 0, 14, 7) - shapely.box(6, 13, 14, 20),
    "PLFX": shapely.union_all([shapely.box(7, 0, 13, 20), shapely.box(0, 7, 20, 13)]),
    "PLFI": shapely.union_all([shapely.box(0, 0, 5, 5), shapely.box(10, 10, 16, 15)]),
}
"""A plan of each shape that is told apart."""


@cache
def validator(version):
    """Return GEM's validator, which leaves its table to Python to close."""
    with warnings.catch_warnings(action="ignore", category=ResourceWarning):
        return GemTaxonomy(version)


def rows_of(path):
    """Return the assets of a table by their id."""
    with path.open(encoding="utf-8", newline="") as file:
        return {row["id"]: row for row in csv.DictReader(file)}


@pytest.mark.parametrize("name", PLANS)
@pytest.mark.parametrize("turn", [0, 33])
def test_plans_have_their_shape(name, turn):
    """In any direction, and with a jagged wall, which LiDAR gives."""
    plan = rotate(PLANS[name], turn, origin=(0, 0))
    assert plan_shape(plan) == name
    assert plan_shape(shapely.MultiPolygon([plan]) if plan.geom_type == "Polygon" else plan) == name
    jagged = shapely.transform(shapely.segmentize(plan, 2.0), lambda xy: xy + 0.12 * np.sin(7 * xy + 11 * xy[:, ::-1]))
    assert jagged.is_valid
    assert plan_shape(jagged) == name
    assert set(BAYS.values()) <= set(PLANS)


def test_positions_count_the_sides_that_adjoin():
    """A row, a block around a house, a gap, and a corner that alone touches."""
    row = [shapely.box(10 * n, 0, 10 * n + 10, 8) for n in range(3)]
    behind, apart, corner = shapely.box(0, 8, 30, 16), shapely.box(60, 0, 70, 10), shapely.box(70, 10, 80, 20)
    found = positions(np.array([*row, behind, apart, corner]))
    assert found == ["BP2", "BP3", "BP2", "BP1", "BPD", "BPD"]
    around = [
        shapely.box(-10, 0, 0, 10),
        shapely.box(10, 0, 20, 10),
        shapely.box(0, 10, 10, 20),
        shapely.box(0, -9, 10, 0),
    ]
    turned = [rotate(shape, 40, origin=(0, 0)) for shape in [shapely.box(0, 0, 10, 10), *around]]
    assert positions(np.array(turned)) == ["BP3", "BP1", "BP1", "BP1", "BP1"]
    assert positions(np.array([shapely.box(0, 0, 9, 9), shapely.box(9.5, 0, 18, 9)])) == ["BPD", "BPD"]


@pytest.mark.parametrize("version", ["3.3", "4.0"])
def test_gem_accepts_every_atom_that_is_written(version):
    """In both versions of the taxonomy; an atom of version 2 is refused."""
    gem = validator(version)
    known = [Described(), Described(height=height_atoms(3, 9.46)), Described(height=height_atoms(None, 2.04))]
    known += [
        Described(shape=shape, position=place) for shape in PLANS for place in ("UNK", "BPD", "BP1", "BP2", "BP3")
    ]
    known += [Described(occupancy=occupancy_atom(word)) for word in (*OCCUPANCIES, "res:2", "mix(RES;COM)", "School")]
    known += [Described(year=year_atom(word)) for word in ("1950", "1950-06-01", "1950-1960", "<1950", "1950.0")]
    known.append(Described("MUR", "LWAL", "HAPP:2+HHT:6.1", "Y:1950", "PLFR", "BP2", "RES"))
    assert all(own.string != "UNK" for own in known[1:])
    for own in known:
        gem.validate(own.string)
    with pytest.raises(ValueError, match="HEX"):
        gem.validate("HEX:3")


def test_assets_say_what_is_measured(tmp_path):
    """Storeys, height, shape and position in strings that GEM's validator accepts; all else is UNK."""
    content = town_content()
    export(content, tmp_path / "town.xml")
    rows = rows_of(tmp_path / "town.csv")
    frame = content.frame("footprint").set_index("building_id").to_crs(4326)
    for key, row in rows.items():
        own = frame.loc[int(key)]
        validator("4.0").validate(row["taxonomy"])
        assert row["taxonomy"].startswith(f"HAPP:{own['storeys']}+HHT:{own['ridge']:.1f}/")
        assert own.geometry.contains(shapely.Point(float(row["lon"]), float(row["lat"])))
        assert float(row["area"]) == pytest.approx(own["floor_area_m2"], abs=0.1)
        assert {row[name] for name in ("material", "llrs", "year", "occupancy")} == {"UNK"}
    assert sorted(row["taxonomy"].split("/")[1] for row in rows.values()) == ["PLFR+BPD", "PLFSQ+BPD", "PLFSQO+BPD"]


def test_the_model_names_its_table(tmp_path):
    """With empty occupancy periods, and tags that the table has."""
    export(town_content(), tmp_path / "town.xml")
    model = ET.parse(tmp_path / "town.xml").getroot().find(f"{{{NRML}}}exposureModel")
    texts = {child.tag.removeprefix(f"{{{NRML}}}"): child.text for child in model}
    assert (texts["assets"], texts["occupancyPeriods"]) == ("town.csv", None)
    header = next(iter(rows_of(tmp_path / "town.csv").values()))
    assert set(texts["tagNames"].split()) <= set(header)
    with pytest.raises(FileError, match=r"with town\.csv"):
        export(town_content(), tmp_path / "town.xml")


def test_a_table_and_imported_attributes_give_what_is_not_measured(tmp_path):
    """The table has priority; people give periods; values that cannot be read and missing rows are reported."""
    content = town_content()
    footprint = content.layers["footprint"]
    first, second, third = (str(value) for value in footprint.columns["building_id"])
    imported = np.array(
        [json.dumps({"use": "school", "built": 1950}), json.dumps({"use": "house"}), None], dtype=object
    )
    footprint = replace(footprint, columns=dict(footprint.columns) | {"attributes": imported})
    content = replace(content, layers=dict(content.layers) | {"footprint": footprint})
    (tmp_path / "people.csv").write_text(f"number,use,night\n{second},COM,4\n{third},castle,2.5\n")
    options = {"join": str(tmp_path / "people.csv"), "on": "number", "occupancy": "use", "year": "built"}
    with pytest.warns(PassingNotice) as notices:
        export(content, tmp_path / "town.csv", name="openquake", options=options)
    rows = rows_of(tmp_path / "town.csv")
    assert [rows[key]["occupancy"] for key in (first, second, third)] == ["EDU", "COM", "UNK"]
    assert [rows[key]["night"] for key in (first, second, third)] == ["0.0", "4.0", "2.5"]
    assert rows[first]["taxonomy"].endswith("/EDU")
    assert "/Y:1950/" in rows[first]["taxonomy"]
    words = sorted(str(notice.message) for notice in notices)
    assert "1 building of 3 not in" in words[0]
    assert words[1] == "1 value of occupancy could not be read as one of the taxonomy: UNK there."
    assert not (tmp_path / "town.xml").exists()


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("id,use\n1,RES\n", {"occupancy": "usage"}, "no column 'usage'; it has id, use"),
        ("number,occupancy\n1,RES\n", {}, "no column 'id'"),
        ("id,colour\n1,red\n", {}, "none of the columns occupancy, year"),
        ("id,night\n1,many\n", {}, "has 'many' people"),
    ],
)
@pytest.mark.filterwarnings("ignore:2 buildings of 3 not in")
def test_tables_that_cannot_be_joined_are_refused(tmp_path, text, options, message):
    """With the columns that there are; and nothing is written."""
    content = town_content()
    key = str(content.layers["footprint"].columns["building_id"][0])
    (tmp_path / "more.csv").write_text(text.replace("1,", f"{key},"))
    with pytest.raises(InputError, match=message):
        export(content, tmp_path / "town.xml", options={"join": str(tmp_path / "more.csv"), **options})
    assert sorted(path.name for path in tmp_path.iterdir()) == ["more.csv"]


def test_an_empty_town_has_a_table_without_rows(tmp_path):
    """With its head."""
    export(town_content(empty=True), tmp_path / "town.xml")
    assert rows_of(tmp_path / "town.csv") == {}
    assert (tmp_path / "town.csv").read_text().startswith("id,lon,lat,taxonomy,number,area,material")

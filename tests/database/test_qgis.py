"""QGIS opens databases, projects and GeoPackages: valid layers, styles that fit the rows, names of columns and rows."""

from pathlib import Path
from typing import Any

import pytest
from support.offices import office, surveyed
from support.qgis import opened_by_qgis
from support.towns import EPSG

from msbdb import api
from msbdb.database import open_database, store_build
from msbdb.errors import PassingNotice
from msbdb.export.qgis.symbology import HEIGHT_COLOURS, HEIGHTS_M
from msbdb.tables.aliases import words_of
from msbdb.tables.view_columns import VIEW_COLUMNS

BY_HEIGHT = {"below 4 m": 0, "4 to 7 m": 1, "7 to 10 m": 2, "height not known": 1}
"""The office's buildings: 6, 7 and 9 m as they were surveyed, and one that the cadastre alone has."""

Found = dict[str, dict[str, Any]]


@pytest.fixture(scope="module", params=["spatialite", pytest.param("postgis", marks=pytest.mark.postgis)])
def opened(request, tmp_path_factory):
    """Return what QGIS finds in the database of an office, its project and its files, on each dialect."""
    folder = tmp_path_factory.mktemp("qgis")
    if request.param == "spatialite":
        yield seen(office(str(folder / "a town.sqlite"), folder), folder)
        return
    databases = request.getfixturevalue("databases")
    url = databases.acquire()
    yield seen(office(url, folder), folder)
    databases.release([url])


def seen(target: str, folder: Path) -> dict[str, Found]:
    """Return what QGIS finds, by a short name of what it opened."""
    api.qgis(target, folder / "town.qgz")
    with pytest.warns(PassingNotice, match="current inventory"):
        api.export(target, folder / "town.gpkg")
    api.export(target, folder / "changes.gpkg", what="changes")
    api.export(target, folder / "evidence.gpkg", what="evidence", survey="here")
    files = [folder / name for name in ("town.qgz", "town.gpkg", "changes.gpkg", "evidence.gpkg")]
    names = ("project", "town", "changes", "evidence")
    found = dict(zip(names, opened_by_qgis(*files), strict=True))
    [tables] = opened_by_qgis(target.replace("+psycopg", ""))
    return found | {"database": tables}


def test_every_layer_of_a_database_is_as_in_sql(opened: dict[str, Found]) -> None:
    """As somebody adds tables and views by hand: types, CRS, extent, rows and the spatial filter."""
    found = opened["database"]
    assert {"footprint_current", "part_current", "building_history", "building_evidence", "rejection"} <= set(found)
    assert found["footprint_current"]["features"] == 4


def test_classes_hold_the_rows_that_they_name(opened: dict[str, Found]) -> None:
    """By height, state, scale, kind of change and probability; in the project and in the files."""
    project, town = opened["project"], opened["town"]
    for heights in (project["footprint_by_height"], town["footprint"], town["footprint_by_height"]):
        assert BY_HEIGHT.items() <= heights["classes"].items()
        assert len(heights["classes"]) == len(HEIGHTS_M) + 2 == len(HEIGHT_COLOURS) + 1
        # The colours of three classes, and of borders and paper.
        assert len(heights["colours"]) >= 5
    for states in (project["footprint_by_state"], town["footprint_by_state"]):
        assert states["classes"] == {"confirmed": 3, "unsure": 1, "refuted": 0}
    assert sum(project["part_by_scale"]["classes"].values()) == 3
    for kinds in (project["history_by_kind"], opened["changes"]["change"]):
        assert {own: n for own, n in kinds["classes"].items() if n and own != "unchanged"} == {
            "demolished": 1,
            "new": 2,
        }
    # One detector alone gives no probability.
    assert opened["evidence"]["building_evidence"]["classes"]["not known"] == 2


def test_layers_of_a_project_lie_in_order_and_are_read_only(opened: dict[str, Found]) -> None:
    """Evidence above changes, these above parts, parts above buildings; the files' own layers may be edited."""
    layers = {name: row for name, row in opened["project"].items() if "read_only" in row}
    assert [row["group"] == "Evidence" for row in layers.values()] == [True] * 5 + [False] * 4
    assert [*layers][5:] == ["history_by_kind", "part_by_scale", "footprint_by_height", "footprint_by_state"]
    assert [name for name, row in layers.items() if row["shown"]] == ["footprint_by_height"]
    assert all(row["read_only"] and row["crs"] == f"EPSG:{EPSG}" for row in layers.values())
    assert opened["town"]["footprint_by_height"]["read_only"] is False
    # What is selected is yellow. Without a colour in the project, QGIS 3.22 selects in white.
    assert opened["project"]["map"]["selected"] == "#ffffff00"


def test_columns_and_rows_are_named_in_words(opened: dict[str, Found]) -> None:
    """Each column by its words and unit, each row by what it is; columns of the database alone are hidden."""
    heights, parts = (opened["project"][name] for name in ("footprint_by_height", "part_by_scale"))
    assert heights["aliases"] == {column.name: words_of(column) for column in VIEW_COLUMNS["footprint_current"]}
    assert heights["aliases"]["ridge"] == "Ridge above ground [m]"
    assert heights["row"].startswith("Building ")
    assert parts["row"].startswith("Scale ")
    assert "survey" in parts["tabs"]["Identity"]
    assert opened["changes"]["change"]["row"].split(",")[0] in opened["changes"]["change"]["classes"]
    assert "fid" not in opened["town"]["footprint"]["aliases"]


def test_measures_have_the_decimals_that_they_deserve(opened: dict[str, Found]) -> None:
    """Heights have two. What a view computes has no type in SQLite: a spin box would cut its decimals off."""
    parts, evidence = (opened["project"][name] for name in ("part_by_scale", "part_evidence_outlined"))
    assert parts["shown_as"]["h_p90"].partition(".")[2].isdigit()
    assert len(parts["shown_as"]["h_p90"].partition(".")[2]) == 2
    assert evidence["widgets"]["area_m2"] == "Range"
    assert evidence["widgets"]["flat_share"] == "TextEdit"


def test_tables_of_a_run_name_the_survey(opened: dict[str, Found]) -> None:
    """Dropped regions have the number of a run; the name of its survey is shown in its place."""
    for name in ("rejection_by_detector", "flat_region_outlined"):
        row = opened["project"][name]
        assert row["aliases"]["run_id"] == "Survey"
        assert row["widgets"]["run_id"] == "ValueMap"
        assert row["shown_as"].get("run_id", "here") in ("here", "there", "later")


def test_a_form_leads_to_parts_and_to_the_parts_on_them(opened: dict[str, Found]) -> None:
    """The relations hold all parts, and the forms have them."""
    for found in (opened["project"], opened["town"]):
        assert found["relation parts_of_building"]["features"] == 3
        assert "relation children_of_part" in found
        assert found["footprint_by_height"]["tabs"]["Parts"] == ["parts_of_building"]
        assert found["part_by_scale"]["tabs"]["Parts on it"] == ["children_of_part"]


def test_beginnings_are_no_changes(tmp_path: Path) -> None:
    """Neither an empty database nor the first surveys of two places have changes; what a later one finds are some."""
    for name, surveys in (("empty", ()), ("begun", ("here", "there")), ("later", ("here", "there", "later"))):
        target = str(tmp_path / f"{name}.sqlite")
        open_database(target, create=True, srid=EPSG).dispose()
        for survey in surveys:
            store_build(target, surveyed(survey))
            api.advance(target, survey)
        api.qgis(target, tmp_path / f"{name}.qgz")
    empty, begun, later = opened_by_qgis(*(tmp_path / f"{name}.qgz" for name in ("empty", "begun", "later")))
    assert empty["footprint_by_height"]["features"] == 0
    assert "history_by_kind" not in empty
    assert (begun["footprint_by_height"]["features"], begun["history_by_kind"]["features"]) == (3, 0)
    assert {own: n for own, n in later["history_by_kind"]["classes"].items() if n} == {"demolished": 1, "new": 1}

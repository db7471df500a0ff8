"""CityJSON files are read by other programs as they were meant, and their blocks are closed."""

import json
import warnings
from dataclasses import replace

import numpy as np
import pytest
from support.blocks import coordinates, mesh_of, solids_of
from support.cjioreader import cityjson as cjio
from support.exported import GROUND_M, town_content

from msbdb.errors import PassingNotice
from msbdb.export import export
from msbdb.export.standards.town import Town

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # of the libraries when they are loaded
    import cityjson_lib


@pytest.fixture(scope="module")
def town(tmp_path_factory):
    """Return the town, its document and the lines of its sequence."""
    folder, content = tmp_path_factory.mktemp("cityjson"), town_content()
    for name in ("town.city.json", "town.city.jsonl"):
        export(content, folder / name)
    lines = (folder / "town.city.jsonl").read_text(encoding="utf-8").splitlines()
    return content, folder / "town.city.json", [json.loads(line) for line in lines]


def meshes(document, lod, base=None):
    """Return the blocks of an LoD as meshes, by the key of their object."""
    places = coordinates(document, base)
    found = document["CityObjects"].items()
    return {key: [mesh_of(shell, places) for shell in solids_of(own, lod)] for key, own in found}


@pytest.mark.parametrize("lod", ["1.2", "1.3"])
def test_blocks_are_closed_and_have_the_measured_volume(town, lod):
    """The buildings as a whole, and in their parts."""
    content, path, _ = town
    solids = [mesh for found in meshes(json.loads(path.read_text()), lod).values() for mesh in found]
    assert all(mesh.is_watertight and mesh.is_winding_consistent for mesh in solids)
    measured = content.layers["footprint"].columns["volume_m3"].sum()
    assert sum(mesh.volume for mesh in solids) == pytest.approx(measured, rel=1e-4)
    assert {round(float(mesh.bounds[0, 2]), 3) for mesh in solids} == {GROUND_M}


def test_parts_stand_beside_each_other_with_their_own_heights(town):
    """The podium does not reach under the tower, and has its own height of 6 m, not their mean."""
    _, path, _ = town
    document = json.loads(path.read_text())
    found = {key: own for key, own in meshes(document, "1.3").items() if key.startswith("part-")}
    heights = {key: round(float(np.ptp(mesh.bounds[:, 2])), 2) for key, [mesh] in found.items()}
    assert sorted(heights.values()) == [5.0, 6.0, 9.0, 15.0]
    [tower] = [key for key, height in heights.items() if height == 15.0]
    father = document["CityObjects"][tower]["attributes"]["father"]
    assert heights[f"part-{father}"] == 6.0
    assert found[f"part-{father}"][0].area == pytest.approx(2 * (1200 - 150) + 6 * (140 + 50), rel=1e-3)


def test_surfaces_have_their_meaning(town):
    """The bottom is ground, the top roof, and what stands is wall."""
    _, path, _ = town
    document = json.loads(path.read_text())
    places = coordinates(document)
    for city_object in document["CityObjects"].values():
        for geometry in city_object["geometry"]:
            [faces], [kinds] = geometry["boundaries"], geometry["semantics"]["values"]
            for face, kind in zip(faces, kinds, strict=True):
                levels = places[face[0], 2]
                flat = "GroundSurface" if np.allclose(levels, GROUND_M) else "RoofSurface"
                name = geometry["semantics"]["surfaces"][kind]["type"]
                assert name == ("WallSurface" if np.ptp(levels) > 0 else flat)


def test_attributes_and_metadata_say_what_was_measured(town):
    """With texts for ids, the reference of the outlines and of the roof, and the survey's date."""
    content, path, _ = town
    document = json.loads(path.read_text())
    frame = content.frame("footprint").set_index("building_id")
    for key, own in document["CityObjects"].items():
        attributes = own["attributes"]
        assert attributes["horizontalGeometryReference"] == "roofEdge"
        if own["type"] == "Building":
            row = frame.loc[int(attributes["id"])]
            assert (key, attributes["state"]) == (f"building-{row.name}", row["state"])
            assert attributes["storeysAboveGround"] == row["storeys"]
            assert attributes["lod1Height"] == pytest.approx(row["h_mean"], abs=0.001)
            assert attributes["ridge"] == pytest.approx(row["ridge"], abs=0.001)
            assert "probability" not in attributes  # not known with one detector
    metadata = document["metadata"]
    assert (metadata["title"], metadata["referenceDate"]) == ("spring", "2024-05-31")
    assert metadata["geographicalExtent"] == [500_010, 4_000_010, GROUND_M, 500_122, 4_000_050, GROUND_M + 15]


@pytest.mark.parametrize(
    ("crs", "vertical", "code"),
    [("EPSG:28992", "NAP height", 7415), ("EPSG:2154", "NGF-IGN69 height", 5698), ("EPSG:32631", "NAP height", 32631)],
)
def test_the_compound_crs_is_kept(tmp_path, crs, vertical, code):
    """By its code where EPSG has the pair; otherwise the horizontal code and the vertical name."""
    content = town_content(vertical=vertical)
    layers = {name: replace(layer, crs=crs) for name, layer in content.layers.items()}
    export(replace(content, layers=layers), tmp_path / "town.city.json")
    metadata = json.loads((tmp_path / "town.city.json").read_text())["metadata"]
    assert metadata["referenceSystem"] == f"https://www.opengis.net/def/crs/EPSG/0/{code}"
    assert metadata["verticalReferenceSystem"] == vertical


def test_a_sequence_has_a_building_on_each_line(town):
    """With the same objects as the document, and vertices of their own."""
    _, path, (head, *features) = town
    document = json.loads(path.read_text())
    assert (head["type"], head["CityObjects"], head["vertices"]) == ("CityJSON", {}, [])
    assert [feature["type"] for feature in features] == ["CityJSONFeature"] * 3
    objects = {key: own for feature in features for key, own in feature["CityObjects"].items()}
    assert list(objects) == list(document["CityObjects"])
    for feature in features:
        assert feature["CityObjects"][feature["id"]]["type"] == "Building"
        for found in meshes(feature, "1.3", head).values():
            assert all(mesh.is_watertight for mesh in found)


def test_cjio_and_cityjson_lib_read_both(town, tmp_path):
    """The same number of objects, with geometry of the LoDs; and cjio splits the document into the same sequence."""
    content, path, (head, *features) = town
    with path.open(encoding="utf-8") as file:
        read = cjio.CityJSON(file=file)
    assert (read.get_version(), read.get_epsg()) == ("2.0", 32631)
    assert read.number_city_objects_level1() == 3
    assert read.get_bbox() == head["metadata"]["geographicalExtent"]
    before = len(read.j["vertices"])
    read.remove_duplicate_vertices()
    read.remove_orphan_vertices()
    assert len(read.j["vertices"]) == before  # there were none
    assert [split.j["id"] for split in read.generate_features()] == [feature["id"] for feature in features]
    model = cityjson_lib.CityModel.parse_document_bytes(path.read_bytes())
    summary = model.summary()
    parts = len(content.layers["part"])
    assert (summary.cityobject_count, summary.geometry_count) == (3 + parts, 3 + parts)
    assert model.metadata_title() == "spring"
    base = json.dumps(head).encode()
    for feature in features:
        part = cityjson_lib.CityModel.parse_feature_with_base_bytes(json.dumps(feature).encode(), base)
        assert part.cityobject_ids()


def test_an_empty_town_is_a_valid_file(tmp_path):
    """Both formats, read by cjio."""
    content = town_content(empty=True)
    export(content, tmp_path / "town.city.json")
    export(content, tmp_path / "town.city.jsonl")
    with (tmp_path / "town.city.json").open() as file:
        assert cjio.CityJSON(file=file).is_empty()
    assert len((tmp_path / "town.city.jsonl").read_text().splitlines()) == 1


def test_buildings_without_a_level_have_no_block_and_refuted_ones_are_left_out(tmp_path):
    """A notice says how many have none."""
    content = town_content()
    footprint = content.layers["footprint"]
    columns = dict(footprint.columns)
    columns["z_ground"] = np.array([np.nan, GROUND_M, GROUND_M])
    columns["state"] = np.array(["unsure", "refuted", "confirmed"], dtype=object)
    content = replace(content, layers=dict(content.layers) | {"footprint": replace(footprint, columns=columns)})
    with pytest.warns(PassingNotice, match=r"^1 building without a level"):
        export(content, tmp_path / "town.city.json")
    found = json.loads((tmp_path / "town.city.json").read_text())["CityObjects"]
    blocks = {own["attributes"]["id"]: bool(own["geometry"]) for own in found.values() if own["type"] == "Building"}
    ids = [str(value) for value in footprint.columns["building_id"]]
    assert blocks == {ids[0]: False, ids[2]: True}


def test_buildings_of_the_inventory_have_its_ids_and_their_imported_columns():
    """And a building that was imported has no parts."""
    content = town_content()
    footprint = content.layers["footprint"]
    ids = footprint.columns["building_id"]
    columns = dict(footprint.columns) | {
        "uid": np.array([7, 8, 9]),
        "building_id": np.ma.MaskedArray(ids, mask=[True, False, False]),
        "attributes": np.array(['{"use": "school"}', None, None], dtype=object),
    }
    layers = dict(content.layers) | {"footprint": replace(footprint, columns=columns)}
    town = Town.of(replace(content, layers=layers))
    assert [building.id for building in town.buildings] == ["7", "8", "9"]
    assert [bool(building.parts) for building in town.buildings] == [False, True, True]
    assert town.buildings[0].record["attributes"] == '{"use": "school"}'

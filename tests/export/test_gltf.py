"""Binary glTF is read by another program as the town that it shows."""

import json
import struct

import numpy as np
import pytest
import trimesh
from support.exported import GROUND_M, town_content

from msbdb.export import export


@pytest.fixture(scope="module")
def town(tmp_path_factory):
    """Return the town and its file."""
    content, path = town_content(), tmp_path_factory.mktemp("gltf") / "town.glb"
    export(content, path)
    return content, path


def document(path):
    """Return the JSON of a file, after checking the lengths of its chunks."""
    data = path.read_bytes()
    magic, version, length, size, kind = struct.unpack_from("<4s3I4s", data)
    assert (magic, version, length, kind, size % 4) == (b"glTF", 2, len(data), b"JSON", 0)
    found = json.loads(data[20 : 20 + size])
    if "buffers" in found:
        assert struct.unpack_from("<I4s", data, 20 + size) == (found["buffers"][0]["byteLength"], b"BIN\0")
    return found


def test_trimesh_reads_closed_blocks_of_the_measured_volume(town):
    """A mesh for each building, upright, above the ground, and the sum of the parts is the building."""
    content, path = town
    scene = trimesh.load(path, process=False)
    footprint = content.frame("footprint").set_index("building_id")
    assert set(scene.graph.nodes_geometry) == {f"building-{key}" for key in footprint.index}
    for name in scene.graph.nodes_geometry:
        mesh = scene.geometry[scene.graph[name][1]]
        blocks = mesh.split(only_watertight=False)
        assert all(block.is_watertight and block.is_winding_consistent and block.volume > 0 for block in blocks)
        volume = sum(block.volume for block in blocks)
        assert volume == pytest.approx(footprint.loc[int(name.split("-")[1]), "volume_m3"], rel=1e-4)
    assert scene.bounds[0, 1] == pytest.approx(GROUND_M - np.floor(GROUND_M), abs=1e-6), "y is up"


def test_places_and_attributes_are_those_of_the_database(town):
    """East is x, north is the other way of z; the origin and the CRS stand beside."""
    content, path = town
    found = document(path)
    extras = found["asset"]["extras"]
    footprint = content.frame("footprint").set_index("building_id")
    for node in found["nodes"]:
        row = footprint.loc[int(node["extras"]["id"])]
        box = found["accessors"][found["meshes"][node["mesh"]]["primitives"][0]["attributes"]["POSITION"]]
        west, south, east, north = row["geometry"].bounds
        assert extras["origin"][0] + box["min"][0] == pytest.approx(west, abs=0.01)
        assert extras["origin"][0] + box["max"][0] == pytest.approx(east, abs=0.01)
        assert extras["origin"][1] - box["max"][2] == pytest.approx(south, abs=0.01)
        assert extras["origin"][1] - box["min"][2] == pytest.approx(north, abs=0.01)
        assert node["extras"]["storeysAboveGround"] == row["storeys"]
    assert extras["crs"] == content.layers["footprint"].crs


def test_a_town_without_buildings_is_an_empty_scene(tmp_path):
    """The lists of glTF may not be empty, so they are missing."""
    export(town_content(empty=True), tmp_path / "town.glb")
    assert set(document(tmp_path / "town.glb")) == {"asset"}

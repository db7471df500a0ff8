"""Binary glTF: a mesh for each building, of the blocks that CityJSON has as LoD 1.3, for viewers and game engines.

The axes are those of glTF: x to the east, y up, z to the south, in metres. Numbers of 32 bits do not hold coordinates
of a CRS, so they count from an origin, which stands with the CRS in ``asset.extras``.
"""

import json
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from msbdb.export.content import Content
from msbdb.export.standards.cityjson import BUILDING_COLUMNS, attributes_of, origin_of, placed
from msbdb.export.standards.solids import GRID_M, Vertices, block_of, on_grid, outlines_of
from msbdb.export.standards.town import Building, Record, Town
from msbdb.io.files import write_atomic

FLOAT, UINT, POSITIONS, INDICES = 5126, 5125, 34962, 34963
"""Codes of glTF: 32 bits of a number, and what a part of the buffer is for."""

MAGIC, JSON_CHUNK, BINARY_CHUNK = b"glTF", b"JSON", b"BIN\0"

AXES = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""East, north and up as x, y and z of glTF."""

COLOUR = [0.8, 0.72, 0.6, 1.0]
"""Of all buildings, red, green, blue and opacity."""


def write_gltf(content: Content, path: Path, options: Mapping[str, str]) -> None:  # noqa: ARG001  (it has none)
    """Write the layers ``footprint`` and ``part`` as binary glTF; where no building has a block, an empty one."""
    town = Town.of(content)
    origin = origin_of(town)
    made = [one for building in placed(town) if len((one := (building, *_mesh(building, origin)))[2])]
    extras = {"crs": town.crs, "verticalCrs": town.vertical, "origin": origin.tolist(), "title": town.name}
    document = {"asset": {"version": "2.0", "generator": "msbdb", "extras": extras}} | (_scene(made) if made else {})
    binary = b"".join(points.tobytes() for _, points, _ in made) + b"".join(faces.tobytes() for *_, faces in made)
    words = json.dumps(document, ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode()
    chunks = [(JSON_CHUNK, words + b" " * (-len(words) % 4))] + ([(BINARY_CHUNK, binary)] if made else [])
    with write_atomic(path) as temporary, temporary.open("wb") as file:
        file.write(MAGIC + struct.pack("<2I", 2, 12 + sum(8 + len(data) for _, data in chunks)))
        for kind, data in chunks:
            file.write(struct.pack("<I", len(data)) + kind + data)


def _mesh(building: Building, origin: NDArray[np.float64]) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
    """Return the vertices (V, 3) and the triangles (T, 3) of a building's blocks, counter-clockwise from outside."""
    places, faces, count = [np.zeros((0, 3))], [np.zeros((0, 3), dtype=np.uint32)], 0
    if building.block is not None:
        ground, height = building.block
        blocks = [(part.own, part.own_height) for part in building.parts] or [(building.geometry, height)]
        outlines = on_grid(np.array([outline for outline, _ in blocks], dtype=object))
        for outline, (_, high) in zip(outlines, blocks, strict=True):
            for polygon in outlines_of(outline):
                # Each block has vertices of its own, so that it is closed by itself.
                vertices = Vertices(origin)
                faces.append(_triangles(polygon, ground, ground + high, vertices) + np.uint32(count))
                places.append(np.array(vertices.coordinates(), dtype=np.float64).reshape(-1, 3) * GRID_M)
                count += len(places[-1])
    return (np.concatenate(places) @ AXES).astype("<f4"), np.concatenate(faces).astype("<u4")


def _triangles(polygon: shapely.Polygon, low_m: float, high_m: float, vertices: Vertices) -> NDArray[np.uint32]:
    """Return the triangles of the block over an outline, (T, 3); none where the top is not above the bottom."""
    block = block_of(polygon, low_m, high_m, vertices)
    if block is None:
        return np.zeros((0, 3), dtype=np.uint32)
    flat = shapely.get_parts(shapely.orient_polygons(shapely.constrained_delaunay_triangles(polygon)))
    xy = np.stack([shapely.get_coordinates(one)[:3] for one in flat])
    x, y = vertices.steps(xy[..., 0], 0), vertices.steps(xy[..., 1], 1)
    level = [int(vertices.steps(height, 2)) for height in (low_m, high_m)]
    bottom, top = (
        [[vertices.number((int(a), int(b), z)) for a, b in zip(*one, strict=True)] for one in zip(x, y, strict=True)]
        for z in level
    )
    walls = [(ring[a], ring[b], ring[c]) for [ring] in block.faces[2:] for a, b, c in ((0, 1, 2), (0, 2, 3))]
    return np.array([*(one[::-1] for one in bottom), *top, *walls], dtype=np.uint32)


def _scene(made: list[tuple[Building, NDArray[np.float32], NDArray[np.uint32]]]) -> dict[str, Any]:
    """Return scene, nodes, meshes and accessors; first all vertices lie in the buffer, then all triangles."""
    sizes = sum(points.nbytes for _, points, _ in made), sum(faces.nbytes for *_, faces in made)
    accessors: list[Record] = []
    begins = [0, 0]
    for _, points, faces in made:
        own: Record = {"bufferView": 0, "byteOffset": begins[0], "componentType": FLOAT, "type": "VEC3"}
        own |= {"count": len(points), "min": points.min(axis=0).tolist(), "max": points.max(axis=0).tolist()}
        other = {"bufferView": 1, "byteOffset": begins[1], "componentType": UINT, "type": "SCALAR", "count": faces.size}
        accessors += [own, other]
        begins = [begins[0] + points.nbytes, begins[1] + faces.nbytes]
    nodes: list[Record] = []
    for number, (building, *_) in enumerate(made):
        extras = {"id": building.id} | attributes_of(building.record, BUILDING_COLUMNS)
        nodes.append({"name": f"building-{building.id}", "mesh": number, "extras": extras})
    meshes = [
        {"primitives": [{"attributes": {"POSITION": 2 * number}, "indices": 2 * number + 1, "material": 0}]}
        for number in range(len(made))
    ]
    views = [
        {"buffer": 0, "byteOffset": 0, "byteLength": sizes[0], "byteStride": 12, "target": POSITIONS},
        {"buffer": 0, "byteOffset": sizes[0], "byteLength": sizes[1], "target": INDICES},
    ]
    material = {"name": "building", "pbrMetallicRoughness": {"baseColorFactor": COLOUR, "metallicFactor": 0.0}}
    return {
        "scene": 0,
        "scenes": [{"nodes": list(range(len(nodes)))}],
        "nodes": nodes,
        "meshes": meshes,
        "materials": [material],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": sum(sizes)}],
    }

"""The solids of a CityJSON file as meshes of triangles, which trimesh measures."""

import mapbox_earcut
import numpy as np
import trimesh


def coordinates(document, base=None):
    """Return the vertices of a document or a feature in metres, (N, 3)."""
    transform = (base or document)["transform"]
    return np.array(document["vertices"]).reshape(-1, 3) * transform["scale"] + transform["translate"]


def solids_of(city_object, lod):
    """Return the shells of a city object in an LoD, each a list of faces."""
    found = [geometry for geometry in city_object["geometry"] if geometry["lod"] == lod]
    shells = []
    for geometry in found:
        solids = geometry["boundaries"] if geometry["type"] == "MultiSolid" else [geometry["boundaries"]]
        values = geometry["semantics"]["values"]
        values = values if geometry["type"] == "MultiSolid" else [values]
        for solid, surfaces in zip(solids, values, strict=True):
            [shell], [kinds] = solid, surfaces
            assert len(shell) == len(kinds)
            shells.append(shell)
    return shells


def is_closed(shell):
    """Whether each edge of the faces belongs to two of them, which run through it in opposite directions."""
    edges = [(a, b) for face in shell for ring in face for a, b in zip(ring, [*ring[1:], ring[0]], strict=True)]
    return len(set(edges)) == len(edges) and {(b, a) for a, b in edges} == set(edges)


def mesh_of(shell, vertices):
    """Return a shell as a mesh, its faces triangulated with their holes; equal vertices are not merged."""
    triangles = [triangle for face in shell for triangle in triangulated(face, vertices)]
    return trimesh.Trimesh(vertices, triangles, process=False)


def triangulated(face, vertices):
    """Return a plane face as triangles of its vertices, seen from the same side."""
    numbers = np.concatenate([np.array(ring) for ring in face])
    corners = vertices[numbers]
    following = np.concatenate([np.roll(np.array(ring), -1) for ring in face])
    normal = np.cross(corners - corners[0], vertices[following] - corners[0]).sum(axis=0)
    axis = int(np.abs(normal).argmax())
    assert np.allclose((corners - corners[0]) @ (normal / np.linalg.norm(normal)), 0, atol=0.002)
    flat = np.delete(corners - corners[0], axis, axis=1)
    ends = np.cumsum([len(ring) for ring in face]).astype(np.uint32)
    found = numbers[mapbox_earcut.triangulate_float64(flat, ends).reshape(-1, 3)]
    made = np.cross(vertices[found[:, 1]] - vertices[found[:, 0]], vertices[found[:, 2]] - vertices[found[:, 0]])
    return np.where((made @ normal > 0)[:, None], found, found[:, ::-1]).tolist()

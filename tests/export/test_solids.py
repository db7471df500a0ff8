"""Blocks over outlines are closed, whatever the outline."""

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from support.blocks import is_closed, mesh_of

from msbdb.export.standards.solids import CUT_M, SLIVER_M, Vertices, block_of, on_grid, outlines_of

ORIGIN = np.array([809_276.0, 6_304_822.0])

SQUARE = shapely.box(0, 0, 10, 10)

PINCHED = {
    "a hole in a corner": shapely.Polygon(SQUARE.exterior, [[(0, 0), (3, 1), (1, 3)]]),
    "a hole at a wall": shapely.Polygon(SQUARE.exterior, [[(5, 0), (7, 3), (3, 3)]]),
    "two holes": shapely.Polygon(SQUARE.exterior, [[(2, 5), (5, 5), (3, 7)], [(5, 5), (8, 5), (7, 3)]]),
    "two squares": shapely.union_all([shapely.box(0, 0, 5, 5), shapely.box(5, 5, 10, 10)]),
    "a ring of two corners": shapely.box(0, 0, 9, 9) - shapely.box(3, 3, 6, 6) - shapely.box(6, 6, 9, 9),
}
"""Outlines that touch themselves in a point."""


def blocks(geometry, low=40.0, high=47.5):
    """Return the blocks over a geometry as meshes, and the area of their outlines; all blocks are closed."""
    [rounded] = on_grid(np.array([geometry], dtype=object))
    vertices = Vertices(np.floor([*rounded.bounds[:2], low]))
    outlines = outlines_of(rounded)
    made = [block_of(outline, low, high, vertices) for outline in outlines]
    places = np.array(vertices.coordinates()) * 0.001 + vertices.origin
    assert all(is_closed(block.faces) for block in made)
    return [mesh_of(block.faces, places) for block in made], sum(outline.area for outline in outlines)


def assert_closed(meshes, area, height=7.5):
    """Another program finds them closed, with normals outwards, and the volume is area times height."""
    assert meshes
    assert all(mesh.is_watertight and mesh.is_winding_consistent for mesh in meshes)
    assert_volume(meshes, area, height)


def assert_volume(meshes, area, height=7.5):
    """Require that the volume is area times height, and positive: normals point outwards."""
    assert sum(mesh.volume for mesh in meshes) == pytest.approx(area * height, rel=1e-6)


def test_a_courtyard_is_open_to_the_sky():
    """The block is closed around it, and its volume lacks it."""
    meshes, area = blocks(SQUARE - shapely.box(3, 3, 6, 6))
    assert_closed(meshes, 91.0)
    assert meshes[0].euler_number == 0  # of a ring
    assert area == pytest.approx(91.0)


@pytest.mark.parametrize("name", PINCHED)
def test_an_outline_that_touches_itself_is_cut_open(name):
    """By squares of 2 cm, so that no four walls meet in an edge."""
    meshes, area = blocks(PINCHED[name])
    assert_closed(meshes, area)
    assert PINCHED[name].area - area <= (2 * CUT_M) ** 2 + 0.001  # edges turn by rounding


@given(st.integers(0, 2**32 - 1), st.booleans())
def test_every_outline_has_closed_blocks(seed, is_cells):
    """Of cells, which touch in corners, and of circles that overlap at random."""
    random = np.random.default_rng(seed)
    if is_cells:
        row, column = np.nonzero(random.random((6, 6)) < 0.6)
        geometry = shapely.union_all(shapely.box(column, row, column + 1, row + 1))
    else:
        discs = shapely.points(random.random((5, 2)) * 20)
        geometry = shapely.union_all(shapely.buffer(discs, random.random(5) * 6 + 0.5, quad_segs=3))
    geometry = shapely.transform(geometry, lambda xy: xy + ORIGIN)
    # Triangles of a face with collinear corners may skip one, so that a mesh of them has gaps where its block has none.
    meshes, area = blocks(geometry)
    assert_volume(meshes, area)
    assert area == pytest.approx(geometry.area, abs=0.05)


def test_slivers_and_flat_blocks_are_no_blocks():
    """A gap between outlines is no roof, and nothing has no height."""
    assert outlines_of(shapely.box(0, 0, 30, SLIVER_M / 2)) == []
    assert outlines_of(shapely.Polygon()) == []
    assert block_of(SQUARE, 10.0, 10.0, Vertices(np.zeros(3))) is None

"""Validity and normal form of outlines: kernels say what GEOS says, and leave to it what they are not sure of."""

from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from support.sizes import sample

from msbdb.database.runs.normalform import normal_form
from msbdb.database.runs.wkbrings import are_valid, as_multipolygons, surely_valid

VALID = (
    "POLYGON ((0 0, 4 0, 4 4, 0 4, 0 0))",
    "POLYGON ((0 0, 9 0, 9 9, 0 9, 0 0), (1 1, 1 2, 2 2, 2 1, 1 1), (3 3, 3 4, 4 4, 4 3, 3 3))",
    "POLYGON ((0 0, 9 0, 9 9, 0 9, 0 0), (1 1, 1 2, 2 2, 2 1, 1 1), (2 2, 2 3, 3 3, 3 2, 2 2))",
    "MULTIPOLYGON (((0 0, 1 0, 1 1, 0 1, 0 0)), ((1 1, 2 1, 2 2, 1 2, 1 1)))",
    "MULTIPOLYGON (((0 0, 9 0, 9 9, 0 9, 0 0), (1 1, 1 8, 8 8, 8 1, 1 1)), ((3 3, 5 3, 5 5, 3 5, 3 3)))",
)
"""Shapes about which the kernel is sure: holes, touching holes, touching polygons, and a polygon in a hole."""

BROKEN = (
    "POLYGON ((0 0, 4 4, 4 0, 0 4, 0 0))",
    "POLYGON ((0 0, 4 0, 2 0, 2 4, 0 0))",
    "POLYGON ((0 0, 4 0, 4 4, 2 0, 0 4, 0 0))",
    "POLYGON ((0 0, 2 2, 4 0, 4 4, 2 2, 0 4, 0 0))",
    "POLYGON ((0 0, 4 0, 4 4, 0 4, 0 0), (5 5, 6 5, 6 6, 5 6, 5 5))",
    "POLYGON ((0 0, 9 0, 9 9, 0 9, 0 0), (1 1, 8 1, 8 8, 1 8, 1 1), (2 2, 3 2, 3 3, 2 3, 2 2))",
    "POLYGON ((0 0, 2 0, 4 2, 4 4, 2 4, 0 2, 0 0), (2 0, 4 4, 0 2, 2 0))",
    "POLYGON ((0 0, 4 0, 8 4, 8 8, 0 8, 0 0), (4 0, 4 4, 8 4, 4 0))",
    "MULTIPOLYGON (((0 0, 4 0, 4 4, 0 4, 0 0)), ((1 1, 2 1, 2 2, 1 2, 1 1)))",
    "MULTIPOLYGON (((0 0, 4 0, 4 4, 0 4, 0 0)), ((2 2, 6 2, 6 6, 2 6, 2 2)))",
    "MULTIPOLYGON (((0 0, 4 0, 4 4, 0 4, 0 0)), ((4 0, 8 0, 8 4, 4 4, 4 0)))",
    "MULTIPOLYGON (((0 0, 4 0, 4 4, 0 4, 0 0)), ((4 4, 8 2, 2 1, 8 0, 4 4)))",
)
"""Crossings, spikes, rings that touch themselves, holes outside or nested, cut interiors, overlaps, shared edges."""


def wkb(shapes: Any) -> NDArray[np.object_]:
    """Return geometries as multipolygons in WKB."""
    return as_multipolygons(shapely.to_wkb(np.array(shapes, dtype=object), byte_order=1))


@st.composite
def areas(draw: st.DrawFn) -> shapely.Geometry:
    """Return the outline of cells, which touch at corners, somewhere in the world; sometimes a vertex is moved."""
    side = draw(st.integers(2, 12))
    cells = np.array(draw(st.lists(st.booleans(), min_size=side**2, max_size=side**2))).reshape(side, side)
    cells[0, 0] = True
    rows, columns = np.nonzero(cells)
    size, east = draw(st.sampled_from(((1.0, 0.0), (0.6, 811993.2), (0.5, -3.25))))
    shape = shapely.union_all(shapely.box(columns, rows, columns + 1, rows + 1)).simplify(0)
    moved = draw(st.integers(-1, 40))
    vertices = shapely.get_coordinates(shape)
    if 0 <= moved < len(vertices):
        own = (vertices == vertices[moved]).all(axis=1)
        vertices[own] += draw(st.sampled_from(((1, 0), (0.5, 0.5), (-1, 1), (0, -2.0), (0.25, 0))))
    turned = shapely.set_coordinates(shape, vertices * size + east)
    return shapely.reverse(turned) if draw(st.booleans()) else turned


@pytest.mark.parametrize("words", sample(VALID, 3))
def test_the_kernel_accepts_valid_outlines(words):
    """GEOS is not asked about holes, touching rings and polygons in holes."""
    assert surely_valid(wkb([shapely.from_wkt(words)])).tolist() == [True]


@pytest.mark.parametrize("words", BROKEN)
def test_the_kernel_accepts_no_broken_outline(words):
    """Each kind of fault is refused, also far away from the origin."""
    shape = shapely.from_wkt(words)
    far = shapely.transform(shape, lambda xy: xy * 0.6 + (811993.2, 6305046.6))
    assert not shapely.is_valid(shape)
    assert are_valid(wkb([shape, far])).tolist() == [False, False]


def test_what_is_no_polygon_is_decided_by_geos():
    """Points, lines, empty polygons and numbers that are none do not disturb their neighbours."""
    words = ("POINT (1 2)", "POLYGON EMPTY", VALID[0], "LINESTRING (0 0, 1 1)", "POINT (NaN 1)", BROKEN[0], VALID[1])
    shapes = [*map(shapely.from_wkt, words), shapely.polygons([(0, 0), (1, 0), (np.inf, 1), (0, 0)])]
    assert are_valid(wkb(shapes)).tolist() == shapely.is_valid(shapes).tolist()


@given(st.lists(areas(), min_size=1, max_size=4))
def test_outlines_are_valid_as_geos_says(shapes):
    """The same answer for outlines of cells, whole and broken."""
    assert are_valid(wkb(shapes)).tolist() == shapely.is_valid(shapes).tolist()


@given(st.lists(areas(), min_size=1, max_size=4))
def test_the_normal_form_is_that_of_geos(shapes):
    """The same bytes for all valid outlines, in whatever order and direction their rings are."""
    own = wkb([shape for shape in shapes if shapely.is_valid(shape)])
    expected = shapely.to_wkb(shapely.normalize(shapely.from_wkb(own)), byte_order=1)
    assert normal_form(own) == b"".join(expected)


def repeated(shape: shapely.Geometry, random: np.random.Generator) -> shapely.Geometry:
    """Return a shape some vertices of which are there twice, the first and last ones too."""

    def twice(ring: shapely.LinearRing) -> list[tuple[float, float]]:
        return [place for place in ring.coords for _ in range(random.integers(1, 3))]

    parts = [
        shapely.Polygon(twice(part.exterior), [twice(hole) for hole in part.interiors])
        for part in shapely.get_parts(shape)
    ]
    return shapely.MultiPolygon(parts)


@given(st.lists(areas(), min_size=1, max_size=6), st.integers(0, 2**32 - 1))
def test_the_normal_form_of_repeated_vertices_is_that_of_geos(shapes, seed):
    """GEOS leaves some of them out, between shapes that keep their length."""
    random = np.random.default_rng(seed)
    valid = [shape for shape in shapes if shapely.is_valid(shape)]
    own = wkb([repeated(shape, random) if random.random() < 0.5 else shape for shape in valid])
    expected = shapely.to_wkb(shapely.normalize(shapely.from_wkb(own)), byte_order=1)
    assert normal_form(own) == b"".join(expected)


def test_points_are_in_normal_form():
    """Their bytes stay."""
    points = shapely.to_wkb(shapely.points([[1.5, 2.0], [-3.0, 4.0]]), byte_order=1)
    assert normal_form(points) == b"".join(points)

"""Simplified outlines keep what the zig-zag hid: shape, neighbours, every part."""

import numpy as np
import pytest
import shapely
from affine import Affine
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from pyproj import CRS
from shapely import affinity
from support.sizes import examples

from msbdb.errors import InputError, ParameterError
from msbdb.grid import GridSpec
from msbdb.outline.polygons import polygonise, rasterise
from msbdb.outline.simplification import simplify_coverage

RD = CRS.from_epsg(28992)

label_arrays = hnp.arrays(np.int32, hnp.array_shapes(min_dims=2, max_dims=2, max_side=12), elements=st.integers(0, 3))


def outlines(labels, cell_m=1.0):
    """Polygonise labels on a lattice far from the origin."""
    spec = GridSpec(labels.shape, Affine(cell_m, 0, 85_000.0, 0, -cell_m, 447_000.0), RD)
    return polygonise(labels, spec, int(labels.max()))


def rotated_row(angle, houses=3):
    """Return true outlines of a rotated row of houses, and their labels on a 1 m lattice."""
    spec = GridSpec((90, 90), Affine(1, 0, 85_000.0, 0, -1, 447_000.0), RD)
    row = [shapely.box(16 * i, 0, 16 * (i + 1), 12) for i in range(houses)]
    centre = shapely.Point(24, 6)
    truth = [affinity.translate(affinity.rotate(house, angle, origin=centre), 85_021.3, 446_949.6) for house in row]
    return truth, rasterise(truth, spec), spec


def boundary_distance(polygon, other):
    """Return how far the vertices of one outline lie from the other outline at most."""
    vertices = shapely.points(shapely.get_coordinates(polygon))
    return float(shapely.distance(vertices, other.boundary).max())


@examples(100)
@given(label_arrays, st.sampled_from([0.5, 1.0, 2.5, 20.0]))
def test_any_labels_stay_a_coverage(labels, tolerance):
    """Whatever the tolerance: valid, no overlap, no ring lost, no vertex farther than the tolerance."""
    raw = outlines(labels)
    simple = simplify_coverage(raw, tolerance)
    assert shapely.is_valid(simple).all()
    assert not len(simple) or shapely.coverage_is_valid(simple)
    for before, after in zip(raw, simple, strict=True):
        assert len(shapely.get_rings(before)) == len(shapely.get_rings(after))
        if not before.is_empty:
            assert boundary_distance(before, after) <= tolerance + 1e-9
            assert shapely.get_num_coordinates(after) <= shapely.get_num_coordinates(before)


@pytest.mark.parametrize("angle", [0, 8, 30, 45, 77])
def test_the_zig_zag_of_a_rotated_row_is_removed(angle):
    """At a tolerance of one cell few vertices remain, near the truth, at about its area."""
    truth, labels, spec = rotated_row(angle)
    raw = polygonise(labels, spec, 3)
    simple = simplify_coverage(raw, 1.0)
    assert (shapely.get_num_coordinates(simple) <= 14).all()
    assert (shapely.hausdorff_distance(simple, np.array(truth)) < 2.0).all()
    assert abs(shapely.area(simple).sum() / shapely.area(raw).sum() - 1) < 0.05
    assert (np.abs(shapely.area(simple) / shapely.area(truth) - 1) < 0.09).all()


def test_simplified_outlines_are_nearer_to_the_truth_than_the_cells():
    """Over all angles, IoU with the true houses grows, the sum of areas stays, and a quarter of the vertices does."""
    overlap, area, vertices = np.zeros(2), np.zeros(2), np.zeros(2)
    for angle in range(3, 90, 6):
        truth, labels, spec = rotated_row(angle, houses=1)
        raw = polygonise(labels, spec, 1)
        for side, outline in enumerate((raw[0], simplify_coverage(raw, 1.0)[0])):
            overlap[side] += outline.intersection(truth[0]).area / outline.union(truth[0]).area
            area[side] += outline.area
            vertices[side] += shapely.get_num_coordinates(outline)
    assert overlap[1] > overlap[0]
    assert area[1] == pytest.approx(area[0], rel=0.015)
    assert vertices[1] < 0.25 * vertices[0]


@pytest.mark.parametrize("angle", [8, 30, 45])
def test_neighbours_keep_one_wall(angle):
    """The walls between the houses of a row are the same line from both sides, and leave no gap."""
    _, labels, spec = rotated_row(angle)
    raw = polygonise(labels, spec, 3)
    first, second, third = simplify_coverage(raw, 1.0)
    for a, b, before in ((first, second, raw[:2]), (second, third, raw[1:])):
        wall = shapely.intersection(a, b)
        assert wall.area == 0
        assert wall.length == pytest.approx(12, abs=2.5)
        assert shapely.union(a, b).geom_type == "Polygon"
        assert len(shapely.get_rings(shapely.union(a, b))) == len(shapely.get_rings(shapely.union(*before)))


def test_a_house_in_a_courtyard_shares_the_ring():
    """A part that fills another's hole keeps filling it exactly."""
    rows, cols = np.mgrid[:40, :40]
    inner = np.hypot(rows - 20, cols - 20) < 8
    labels = np.where(inner, 2, np.where(np.hypot(rows - 20, cols - 20) < 18, 1, 0)).astype(np.int32)
    ring, filling = simplify_coverage(outlines(labels), 1.0)
    (hole,) = ring.geoms[0].interiors
    assert shapely.equals(shapely.Polygon(hole), filling)
    assert shapely.get_num_coordinates(filling) < 20


def test_a_single_cell_survives_a_coarse_tolerance():
    """Where the outline would collapse it keeps its vertices."""
    labels = np.zeros((3, 3), dtype=np.int32)
    labels[1, 1] = 1
    raw = outlines(labels)
    assert simplify_coverage(raw, 50.0)[0].area == 1.0


def test_one_fault_does_not_bring_back_the_whole_outline():
    """A courtyard one cell behind a slanting wall is drawn finely where it would cross it; the walls stay simple."""
    truth = affinity.translate(affinity.rotate(shapely.box(-30, -30, 30, 30), 20), 85_050, 446_950)
    spec = GridSpec((100, 100), Affine(1, 0, 85_000.0, 0, -1, 447_000.0), RD)
    labels = rasterise([truth], spec)
    wall = np.flatnonzero(labels[50])[0]
    labels[50, wall + 1 : wall + 4] = 0
    raw = polygonise(labels, spec, 1)
    (simple,) = simplify_coverage(raw, 4.0)
    assert simple.is_valid
    assert len(simple.geoms[0].interiors) == 1
    assert shapely.get_num_coordinates(simple) < 0.25 * shapely.get_num_coordinates(raw[0])


def test_order_of_the_parts_does_not_matter():
    """Each part gets the same outline wherever it stands in the array."""
    _, labels, spec = rotated_row(30)
    raw = polygonise(labels, spec, 3)
    there, back = simplify_coverage(raw, 1.0), simplify_coverage(raw[::-1].copy(), 1.0)[::-1]
    assert shapely.equals_exact(there, back, tolerance=0).all()


def test_empty_outlines_and_zero_tolerance_change_nothing():
    """Empty geometries stay in their place, and 0 returns the input."""
    labels = np.array([[0, 3, 3], [0, 3, 0]], dtype=np.int32)
    raw = outlines(labels)
    assert shapely.equals_exact(simplify_coverage(raw, 0.0), raw, tolerance=0).all()
    assert simplify_coverage(raw, 1.0)[:2].tolist() == raw[:2].tolist()
    assert simplify_coverage(raw[:2], 1.0).tolist() == raw[:2].tolist()
    assert simplify_coverage(raw[:0], 1.0).shape == (0,)


def test_plain_polygons_are_accepted():
    """Polygons come back as multipolygons."""
    (simple,) = simplify_coverage(np.array([shapely.box(0, 0, 4, 4)]), 1.0)
    assert simple.geom_type == "MultiPolygon"
    assert simple.area == 16


def test_overlaps_lines_and_negative_tolerances_are_refused():
    """What is no coverage, no polygon or no tolerance is an error that says so."""
    overlapping = np.array([shapely.box(0, 0, 4, 4), shapely.box(1, 1, 6, 6)])
    with pytest.raises(InputError, match="2 of 2 do not"):
        simplify_coverage(overlapping, 1.0)
    with pytest.raises(InputError, match="got linestring"):
        simplify_coverage(np.array([shapely.LineString([(0, 0), (1, 1)])]), 1.0)
    with pytest.raises(ParameterError, match="got -1"):
        simplify_coverage(overlapping, -1.0)
    with pytest.raises(ParameterError, match="got nan"):
        simplify_coverage(overlapping, float("nan"))

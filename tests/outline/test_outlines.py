"""Outlines of points: the shapes that are known, the laws of alpha shapes, and points that span no shape."""

from itertools import combinations

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial import Delaunay

from msbdb.errors import InputError, ParameterError
from msbdb.outline import alphashape
from msbdb.outline.alphashape import alpha_shapes, enclosed
from msbdb.outline.pointoutlines import outline_points, outline_regions, without_residuals
from msbdb.outline.thinning import thinned
from msbdb.params import VectorParams

METHODS = ("alpha", "hull")

clouds = hnp.arrays(
    np.float64, st.tuples(st.integers(1, 40), st.just(2)), elements=st.integers(0, 24).map(lambda value: value / 2)
)


def scattered(shape, *, spacing_m=0.5, seed=1):
    """Return points of a jittered grid inside of a shape."""
    west, south, east, north = shape.bounds
    x, y = np.meshgrid(np.arange(west, east, spacing_m), np.arange(south, north, spacing_m))
    jitter = np.random.default_rng(seed).uniform(0, spacing_m, (2, x.size))
    x, y = x.ravel() + jitter[0], y.ravel() + jitter[1]
    inside = shapely.contains_xy(shape, x, y)
    return x[inside], y[inside]


def outline(x, y, labels=None, **options):
    """Return outlines; one region of all points unless labels are given."""
    labels = np.ones(len(x), dtype=np.int32) if labels is None else np.asarray(labels, dtype=np.int32)
    given_options = {"method": "alpha", "spacing_m": 0.5, "simplify_m": 0.25} | options
    return outline_points(np.asarray(x), np.asarray(y), labels, int(labels.max()), **given_options)


def overlap(one, other):
    """Return intersection over union."""
    return shapely.area(shapely.intersection(one, other)) / shapely.area(shapely.union(one, other))


ROOF = shapely.box(0, 0, 20, 12)
ELL = shapely.difference(ROOF, shapely.box(8, 5, 20, 12))
COURT = shapely.difference(shapely.box(0, 0, 24, 24), shapely.box(8, 8, 16, 16))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("shape", [ROOF, ELL], ids=["rectangle", "L"])
def test_a_roof_gets_its_outline_back(method, shape):
    """A rectangle and an L are found to nearly a spacing along the edge, with few vertices."""
    (found,) = outline(*scattered(shape), method=method)
    assert overlap(found, shape) > 0.9
    assert len(shapely.get_coordinates(found)) < 90
    assert found.geom_type == "MultiPolygon"
    assert found.is_valid


def test_growth_gives_a_roof_the_edge_that_its_points_do_not_reach():
    """Without growth the outline lies inside of the roof; by half a spacing it has the roof's area."""
    x, y = scattered(ROOF)
    (bare,), (grown,) = outline(x, y, grow_m=0.0), outline(x, y, grow_m=0.25)
    assert shapely.within(bare, shapely.buffer(ROOF, 1e-6))
    assert shapely.area(bare) < 0.97 * ROOF.area
    assert abs(shapely.area(grown) / ROOF.area - 1) < 0.03


def test_a_courtyard_stays_open():
    """The hole of a courtyard is a hole of the outline."""
    (found,) = outline(*scattered(COURT), method="alpha")
    assert sum(len(part.interiors) for part in found.geoms) == 1
    assert overlap(found, COURT) > 0.9


def test_the_hull_has_no_holes_but_bays():
    """A concave hull closes the courtyard and keeps the L."""
    (court,) = outline(*scattered(COURT), method="hull")
    assert all(not part.interiors for part in court.geoms)
    assert shapely.area(court) > 0.95 * 24 * 24
    (ell,) = outline(*scattered(ELL), method="hull")
    assert shapely.area(ell) < 0.8 * ROOF.area


def test_small_holes_and_pieces_are_residuals():
    """A gap of a skylight is filled and a stray piece left out, as the residual area says."""
    skylight = shapely.box(5, 5, 7.5, 7.5)
    piece = shapely.box(40, 0, 42.4, 2.4)
    shape = shapely.union(shapely.difference(ROOF, skylight), piece)
    x, y = scattered(shape)
    (kept,) = outline(x, y, residual_m2=1.0)
    (clean,) = outline(x, y, residual_m2=9.0)
    assert len(kept.geoms) == 2
    assert len(clean.geoms) == 1
    assert sum(len(part.interiors) for part in kept.geoms) == 1
    assert sum(len(part.interiors) for part in clean.geoms) == 0


def test_the_largest_piece_is_never_a_residual():
    """An outline that is all smaller than the residual area stays."""
    square = np.array([shapely.multipolygons([shapely.box(0, 0, 1, 1), shapely.box(5, 5, 5.5, 5.5)])])
    (found,) = without_residuals(square, 100.0)
    assert shapely.area(found) == 1


@pytest.mark.parametrize("method", METHODS)
def test_neighbouring_roofs_do_not_overlap(method):
    """Touching roofs, and a house in the bay of an L, share no more than rounding."""
    shapes = [ELL, shapely.box(8.6, 5.6, 20, 12), shapely.box(20, 0, 30, 12)]
    parts = [scattered(shape, seed=7) for shape in shapes]
    x, y = (np.concatenate([part[axis] for part in parts]) for axis in (0, 1))
    labels = np.repeat([1, 2, 3], [len(part[0]) for part in parts])
    found = outline(x, y, labels, method=method, grow_m=0.5)
    for one in range(3):
        assert overlap(found[one], shapes[one]) > 0.8
        for other in range(one):
            assert shapely.area(shapely.intersection(found[one], found[other])) < 1e-4


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    "points",
    [
        [(0, 0)],
        [(0, 0), (0, 0), (0, 0)],
        [(0, 0), (1, 0)],
        [(0, 0), (1, 1), (2, 2), (9, 9)],
        [(0, 0), (50, 0), (0, 50)],
        [(0, 0), (0.3, 0), (0, 0.3)],
    ],
    ids=["one", "one thrice", "two", "on a line", "far apart", "a small triangle"],
)
def test_points_that_span_no_shape_have_an_outline(method, points):
    """Outlines are valid, of an area, and hold all the points; far points do not enclose what lies between."""
    x, y = np.array(points, dtype=np.float64).T + 1e6
    (found,) = outline(x, y, method=method, residual_m2=0.0)
    assert found.is_valid
    assert shapely.area(found) > 0
    assert shapely.intersects_xy(shapely.buffer(found, 0.01), x, y).all()
    assert shapely.area(found) < 20


def test_holes_that_touch_at_a_corner_stay_open():
    """Two holes with a common corner, one of them touching the shell, are holes, and an island in a hole is solid."""
    rings = [shapely.box(0, 0, 8, 8), shapely.box(1, 1, 3, 3), shapely.box(3, 3, 6, 6), shapely.box(4, 4, 5, 5)]
    rings.append(shapely.Polygon([(8, 8), (7, 8 - 1e-3), (7, 7)]))
    coords = [shapely.get_coordinates(ring) for ring in rings]
    start, end = (np.concatenate([ring[cut] for ring in coords]) for cut in (slice(None, -1), slice(1, None)))
    (found,) = enclosed(start, end, np.ones(len(start), dtype=np.int32), 1)
    assert found.is_valid
    assert found.area == pytest.approx(64 - 4 - 9 + 1 - rings[-1].area)


@pytest.mark.parametrize("method", METHODS)
def test_far_offsets_and_far_islands_change_nothing(method):
    """A region of two islands 8000 km apart has both their shapes, at coordinates of ten million metres."""
    x, y = scattered(ROOF)
    (near,) = outline(x, y, method=method, simplify_m=0.0)
    far_x, far_y = np.concatenate((x + 1e7, x + 2e6)), np.concatenate((y + 1e7, y + 2e6))
    if method == "hull":
        found = outline(far_x, far_y, np.repeat([1, 2], len(x)), method=method, simplify_m=0.0)
        areas = shapely.area(found)
    else:
        (found,) = outline(far_x, far_y, method=method, simplify_m=0.0)
        areas = np.array([part.area for part in found.geoms])
    assert len(areas) == 2
    assert np.allclose(areas, shapely.area(near), rtol=1e-4)


def test_the_order_of_points_does_not_matter():
    """Shuffled points give the same outlines, vertex by vertex."""
    x, y = scattered(COURT)
    labels = np.where(x < 12, 1, 2)
    order = np.random.default_rng(3).permutation(len(x))
    for method in METHODS:
        one, other = outline(x, y, labels, method=method), outline(x[order], y[order], labels[order], method=method)
        assert (shapely.to_wkb(one) == shapely.to_wkb(other)).all()


def test_points_of_no_region_are_ignored():
    """Label 0, wherever it lies, changes nothing."""
    x, y = scattered(ROOF)
    (alone,) = outline(x, y)
    labels = np.concatenate((np.ones(len(x)), np.zeros(3)))
    (found,) = outline(np.append(x, [5.0, np.nan, 1e9]), np.append(y, [5.0, 0.0, 0.0]), labels)
    assert shapely.to_wkb(found) == shapely.to_wkb(alone)


def test_no_region_gives_no_outline():
    """An empty cloud has none."""
    assert len(outline_points(np.zeros(0), np.zeros(0), np.zeros(0, np.int32), 0, **SOME)) == 0


SOME = {"method": "alpha", "spacing_m": 0.5, "simplify_m": 0.25}


@pytest.mark.parametrize(
    ("given_points", "options", "error", "words"),
    [
        (([0.0, np.nan], [1, 1], 1), {}, InputError, "finite"),
        (([0.0, 1.0], [1], 1), {}, InputError, "a label a point"),
        (([0.0, 1.0], [1, 1], 2), {}, InputError, "each with a point"),
        (([0.0, 1.0], [1, 3], 2), {}, InputError, "each with a point"),
        (([0.0, 1.0], [1, -1], 1), {}, InputError, "each with a point"),
        (([0.0, 1.0], [1, 1], 1), {"method": "disc"}, ParameterError, "methods are"),
        (([0.0, 1.0], [1, 1], 1), {"spacing_m": 0.0}, ParameterError, "above 0"),
        (([0.0, 1.0], [1, 1], 1), {"simplify_m": -1.0}, ParameterError, "0 or more"),
        (([0.0, 1.0], [1, 1], 1), {"radius_m": np.nan}, ParameterError, "above 0"),
    ],
)
def test_bad_input_is_refused(given_points, options, error, words):
    """The message says what is wrong."""
    x, labels, count = given_points
    x = np.array(x)
    with pytest.raises(error, match=words):
        outline_points(x, np.zeros(len(x)), np.array(labels, dtype=np.int32), count, **(SOME | options))


@given(clouds)
def test_a_small_alpha_gives_the_convex_hull(points):
    """With 1/alpha beyond all circumradii, the alpha shape is the convex hull."""
    hull = shapely.convex_hull(shapely.MultiPoint(points))
    (found,) = alpha_shapes(*points.T, np.ones(len(points), dtype=np.int32), 1, np.inf)
    if shapely.area(hull) == 0:
        assert found is None
    else:
        assert shapely.area(shapely.symmetric_difference(found, hull)) < 1e-9


@given(clouds, st.floats(0.3, 5), st.floats(1.1, 4))
def test_alpha_shapes_grow_with_the_radius_up_to_the_hull(points, radius_m, factor):
    """A larger radius never gives a smaller alpha shape, and none exceeds the convex hull."""
    labels = np.ones(len(points), dtype=np.int32)
    hull = shapely.area(shapely.convex_hull(shapely.MultiPoint(points)))
    areas = [shapely.area(alpha_shapes(*points.T, labels, 1, r)[0]) for r in (radius_m, radius_m * factor)]
    small, large = np.nan_to_num(areas)
    assert small <= large + 1e-9 <= hull + 2e-9


@given(clouds, st.sampled_from(METHODS))
def test_an_outline_holds_its_points(points, method):
    """All points of one dense piece lie in or near their outline; it is valid and never empty."""
    (found,) = outline(*points.T, method=method, simplify_m=0.0, radius_m=30.0, residual_m2=0.0)
    assert found.is_valid
    assert shapely.area(found) > 0
    assert shapely.intersects_xy(shapely.buffer(found, 0.3), *points.T).all()


@settings(max_examples=10)
@given(st.integers(0, 10**6), st.floats(0.5, 0.9), st.sampled_from([0.0, 3.0, 40.0]))
def test_thinning_changes_no_outline(seed, radius_m, apart_m):
    """The alpha shape of the points that thinning keeps is that of all points, triangle by triangle at its rim."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, 12, (2, 1600))
    hole = np.hypot(x - 8, y - 7) > 2
    x, y = x[hole], y[hole]
    x += np.where(x > 5, apart_m, 0)
    labels = np.where(y < 6, 1, 2).astype(np.int32)
    kept, deep = thinned(x, y, labels, radius_m)
    assert len(kept) < len(x)
    assert deep.any()
    found = alpha_shapes(x, y, labels, 2, radius_m)
    simplices = Delaunay(np.column_stack((x, y))).simplices
    corners = np.stack((x[simplices], y[simplices]), axis=2)
    taken = circumradius(corners) < radius_m
    for label in (1, 2):
        own = (labels[simplices] == label).all(axis=1)
        naive = shapely.union_all(shapely.polygons(corners[taken & own]))
        assert shapely.area(shapely.symmetric_difference(naive, found[label - 1])) < 1e-6


@settings(max_examples=10)
@given(st.integers(0, 10**6), st.floats(0.3, 0.6))
def test_batches_of_clusters_change_no_outline(seed, radius_m):
    """Small clusters triangulated by themselves have the outlines of one triangulation of all points."""
    x, y = np.random.default_rng(seed).uniform(0, 20, (2, 900))
    street = (x % 5 < 2.5) & (y % 5 < 2.5)
    x, y = x[street], y[street]
    labels = np.where(y < 10, 1, 2).astype(np.int32)
    whole = alpha_shapes(x, y, labels, 2, radius_m)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(alphashape, "BATCH", 1)
        cut = alphashape.batches(x, y, radius_m)
        apart = alpha_shapes(x, y, labels, 2, radius_m)
    assert len(cut) > 3
    assert np.array_equal(np.sort(np.concatenate(cut)), np.arange(len(x)))
    places = [shapely.MultiPoint(np.column_stack((x[one], y[one]))) for one in cut]
    pairs = [shapely.distance(one, other) for one, other in combinations(places, 2)]
    assert min(pairs) > 2 * radius_m
    assert (shapely.to_wkb(whole) == shapely.to_wkb(apart)).all()


def test_an_outline_does_not_depend_on_regions_far_away():
    """Vertex by vertex it is the same with another region ten metres off, and without."""
    x, y = scattered(ELL)
    (alone,) = outline(x, y)
    both = outline(np.concatenate((x - 30, x)), np.concatenate((y, y)), np.repeat([1, 2], len(x)))
    assert shapely.to_wkb(both[1]) == shapely.to_wkb(alone)
    assert shapely.equals_exact(both[0], shapely.transform(alone, lambda xy: xy - [30, 0]), 1e-9)


def test_of_points_at_one_place_the_lowest_label_counts():
    """A second echo of another region beneath a roof's corner takes nothing from the roof."""
    x, y = np.array([0.0, 0, 1, 1, 1, 2, 2, 3, 3]), np.array([0.0, 1, 0, 1, 1, 1, 2, 1, 2])
    labels = np.array([1, 1, 1, 1, 2, 2, 2, 2, 2], dtype=np.int32)
    assert shapely.area(alpha_shapes(x, y, labels, 2, 1.0)) == pytest.approx([1.0, 1.0])


def circumradius(corners):
    """Return abc / 4A of triangles of (T, 3, 2) corners."""
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).prod(axis=1)
    (ux, uy), (vx, vy) = (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T
    return sides / np.maximum(2 * np.abs(ux * vy - uy * vx), 1e-12)


def test_parameters_choose_the_method_and_scale_with_the_spacing():
    """A build's parameters give what the plain call gives."""
    x, y = scattered(ELL)
    labels = np.ones(len(x), dtype=np.int32)
    params = VectorParams(
        outline="hull", alpha_factor=3.0, outline_simplify=1.0, outline_grow=0.5, residual_m2=2.0, alpha_least_m=0.1
    )
    (found,) = outline_regions(x, y, labels, 1, spacing_m=0.5, params=params)
    (wanted,) = outline(x, y, method="hull", radius_m=1.5, simplify_m=0.5, grow_m=0.25, residual_m2=2.0)
    assert shapely.to_wkb(found) == shapely.to_wkb(wanted)


def test_thousands_of_small_regions_are_outlined_together():
    """Every one of many small regions has its own outline, apart from the others."""
    rng = np.random.default_rng(5)
    labels = np.repeat(np.arange(1, 2_001, dtype=np.int32), 9)
    place = np.divmod(labels - 1, 50)
    x, y = (3.0 * side + rng.uniform(0, 1.5, labels.size) for side in place)
    found = outline_points(x, y, labels, 2_000, **SOME)
    assert shapely.is_valid(found).all()
    assert (shapely.area(found) > 0.1).all()
    assert (shapely.area(found) < 9).all()

"""Fitted outlines: straight walls where they are, round ones where they are, and neighbours that share them."""

from dataclasses import replace

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

from msbdb.grid import GridSpec
from msbdb.outline.arcs import Soundness
from msbdb.outline.fitting import fit_coverage, outline_labels
from msbdb.outline.polygons import polygonise, rasterise
from msbdb.params import VectorParams

RD = CRS.from_epsg(28992)
WEST, NORTH = 85_000.0, 447_000.0

label_arrays = hnp.arrays(np.int32, hnp.array_shapes(min_dims=2, max_dims=2, max_side=14), elements=st.integers(0, 3))
angles = st.floats(0, 90, exclude_max=True)


def lattice_of(shape=(90, 90), cell_m=1.0):
    """Return a lattice far from the origin."""
    return GridSpec(shape, Affine(cell_m, 0, WEST, 0, -cell_m, NORTH), RD)


def turned(shape, angle):
    """Return a shape around (0, 0) turned and moved to the middle of the lattice."""
    return affinity.translate(affinity.rotate(shape, angle, origin=(0, 0)), WEST + 45.3, NORTH - 44.7)


def fitted(shapes, spec=None):
    """Return the fitted outlines of shapes on the lattice."""
    spec = spec or lattice_of()
    outlines, sound = fit_coverage(polygonise(rasterise(shapes, spec), spec, len(shapes)), spec)
    assert shapely.is_valid(outlines).all()
    assert shapely.coverage_is_valid(outlines)
    return outlines, sound


def corners(outline):
    """Return the corners of an outline of one ring."""
    (ring,) = shapely.get_rings(shapely.get_parts(outline))
    return shapely.points(shapely.get_coordinates(ring)[:-1])


@examples(100)
@given(label_arrays, st.sampled_from([0.0, 2.0, 6.0]))
def test_any_labels_stay_a_coverage(labels, court_m2):
    """Valid, without overlap, every label there, and no ring below the least area that was not there before."""
    spec = lattice_of(labels.shape)
    count = int(labels.max())
    outlines, sound = outline_labels(labels, count, spec, VectorParams(court_m2=court_m2))
    assert len(outlines) == len(sound) == count
    assert shapely.is_valid(outlines).all()
    assert not count or shapely.coverage_is_valid(outlines)
    assert (shapely.is_empty(outlines) == ~np.isin(np.arange(1, count + 1), labels)).all()
    holes = [shapely.Polygon(hole) for part in shapely.get_parts(outlines) for hole in part.interiors]
    inside = shapely.area(np.array(holes)) if holes else np.empty(0)
    # A hole that holds another region is no court.
    filled = [shapely.area(shapely.intersection(outlines, hole)).sum() for hole in holes]
    assert (inside[np.isclose(filled, 0)] >= min(court_m2, 1.0) - 1e-6).all()


@examples(100)
@given(label_arrays)
def test_neighbours_neither_overlap_nor_gape(labels):
    """The outlines add up to the area of their union, and the union has no hole that the cells have not."""
    spec = lattice_of(labels.shape)
    cells = polygonise(labels, spec, int(labels.max()))
    outlines, _ = fit_coverage(cells, spec)
    union = shapely.union_all(outlines)
    assert shapely.area(outlines).sum() == pytest.approx(union.area, abs=1e-6)
    ring_count = [len(shapely.get_rings(shapely.get_parts(shape))) for shape in (union, shapely.union_all(cells))]
    assert ring_count[0] <= ring_count[1]


@examples(60)
@given(angles, st.floats(14, 34), st.floats(10, 24))
def test_a_rectangle_at_any_angle_has_four_corners(angle, width, depth):
    """Within a cell of the true ones, and at right angles."""
    truth = turned(shapely.box(-width / 2, -depth / 2, width / 2, depth / 2), angle)
    (outline,), (sound,) = fitted([truth])
    found = corners(outline)
    assert sound
    assert len(found) == 4
    assert shapely.distance(found, shapely.MultiPoint(truth.exterior.coords)).max() <= 1.0
    edges = np.diff(shapely.get_coordinates(outline), axis=0)
    cosines = np.abs((edges * np.roll(edges, 1, axis=0)).sum(axis=1))
    cosines /= np.linalg.norm(edges, axis=1) * np.linalg.norm(np.roll(edges, 1, axis=0), axis=1)
    assert cosines.max() < 0.02


@pytest.mark.parametrize("angle", [0, 7, 23, 38, 45, 61, 84])
def test_an_l_shape_keeps_its_six_corners(angle):
    """The inner corner is there too."""
    truth = turned(shapely.Polygon([(-20, -15), (20, -15), (20, 0), (0, 0), (0, 15), (-20, 15)]), angle)
    (outline,), (sound,) = fitted([truth])
    found = corners(outline)
    assert sound
    assert len(found) == 6
    assert shapely.distance(found, shapely.MultiPoint(truth.exterior.coords)).max() <= 1.2


def test_a_diagonal_wall_stays_diagonal():
    """A long cut corner is one wall, not stairs."""
    truth = turned(shapely.Polygon([(-25, -20), (25, -20), (25, 2), (7, 20), (-25, 20)]), 12)
    (outline,), _ = fitted([truth])
    assert len(corners(outline)) == 5
    assert shapely.hausdorff_distance(outline, truth) < 1.2


@pytest.mark.parametrize("radius", [12.0, 20.0, 35.0])
def test_a_round_building_stays_round(radius):
    """The area is right within 2 %, no wall is off by more than two cells, and it is no square."""
    truth = turned(shapely.Point(0, 0).buffer(radius, 64), 0)
    (outline,), _ = fitted([truth])
    assert outline.area == pytest.approx(truth.area, rel=0.02)
    assert shapely.hausdorff_distance(outline, truth) < 2.0
    assert len(corners(outline)) >= 8


@pytest.mark.parametrize("angle", [0, 8, 30, 45, 77])
def test_a_row_of_houses_has_one_front(angle):
    """Fronts go on beyond the party walls, which are one line from both sides."""
    houses = [turned(shapely.box(16 * i - 24, -6, 16 * i - 8, 6), angle) for i in range(3)]
    outlines, sound = fitted(houses)
    assert sound.all()
    union = shapely.union_all(outlines)
    assert len(corners(shapely.simplify(union, 0.05))) == 4
    for one, other in ((0, 1), (1, 2)):
        wall = shapely.intersection(outlines[one], outlines[other])
        assert wall.area == 0
        assert wall.length == pytest.approx(12, abs=1)


def test_a_court_is_kept_and_a_light_well_closed():
    """Holes of the least area stay, with straight walls; smaller ones go."""
    house = shapely.difference(shapely.box(-30, -20, 30, 20), shapely.box(-20, -8, 0, 8))
    truth = turned(shapely.difference(house, shapely.box(14, -1, 17, 2)), 20)
    spec = lattice_of()
    (outline,), _ = outline_labels(rasterise([truth], spec), 1, spec, VectorParams(court_m2=12.0))
    (court,) = outline.geoms[0].interiors
    assert shapely.Polygon(court).area == pytest.approx(320, rel=0.05)
    assert len(court.coords) == 5


def test_a_building_that_touches_itself_at_corners_is_one_piece():
    """A cell joins two wings that meet at a corner; a loose crumb goes."""
    labels = np.zeros((40, 60), dtype=np.int32)
    labels[5:20, 5:30] = 1
    labels[20:35, 30:55] = 1
    labels[2, 50:53] = 1
    spec = lattice_of(labels.shape)
    (outline,), _ = outline_labels(labels, 1, spec, VectorParams())
    assert len(outline.geoms) == 1


@pytest.mark.parametrize("angle", [1, 3, 10, 40])
def test_a_house_that_the_border_cuts_ends_at_it(angle):
    """The cut is exactly the border, whatever direction the walls have, and no wall leans over it."""
    spec = lattice_of()
    frame = shapely.box(*spec.bounds)
    for place in ((0.6, 45.0), (45.0, 0.4), (89.7, 45.0), (45.0, 89.5)):
        house = affinity.translate(
            affinity.rotate(shapely.box(-9, -14, 9, 14), angle, origin=(0, 0)), WEST + place[0], NORTH - place[1]
        )
        (outline,), (sound,) = fitted([house], spec)
        assert sound
        assert frame.covers(outline)
        cut_m, true_m = (shapely.intersection(shape, frame.exterior).length for shape in (outline, house))
        assert cut_m == pytest.approx(true_m, abs=1.5)


def test_neighbours_that_the_border_cuts_share_their_wall_up_to_it():
    """The border's cut is one line through both, and their wall ends on it."""
    spec = lattice_of()
    houses = [affinity.rotate(shapely.box(16 * i - 20, -12, 16 * i - 4, 12), 20, origin=(0, 0)) for i in range(2)]
    outlines, sound = fitted([affinity.translate(house, WEST + 40, NORTH - 4) for house in houses], spec)
    assert sound.all()
    frame = shapely.box(*spec.bounds)
    assert frame.covers(shapely.union_all(outlines))
    on_border = shapely.intersection(outlines, frame.exterior)
    assert shapely.length(on_border).min() > 5
    assert shapely.intersection(*on_border).geom_type == "Point"


def test_traced_outlines_are_marked():
    """Asked for, they follow the cells within the tolerance of their simplification."""
    spec = lattice_of()
    labels = rasterise([turned(shapely.box(-15, -10, 15, 10), 30)], spec)
    (outline,), (sound,) = outline_labels(labels, 1, spec, VectorParams(walls="traced"))
    assert not sound
    assert shapely.hausdorff_distance(outline, polygonise(labels, spec, 1)[0]) <= 1.0


def town(shape, seed=5):
    """Return the labels of turned houses, some of which touch."""
    rng = np.random.default_rng(seed)
    spec = lattice_of(shape)
    houses = [
        affinity.translate(
            affinity.rotate(shapely.box(0, 0, *rng.uniform(8, 25, 2)), rng.uniform(0, 90)),
            WEST + rng.uniform(10, shape[1] - 30),
            NORTH - rng.uniform(30, shape[0] - 10),
        )
        for _ in range(14)
    ]
    return rasterise(houses, spec), spec


@pytest.mark.parametrize("seed", [3, 4, 10])
def test_walls_that_would_cross_beside_a_corner_stay_walls(seed):
    """Houses that overlap at odd angles: without the steps at corners no arc crosses another, and none is traced."""
    labels, spec = town((150, 150), seed)
    outlines, sound = outline_labels(labels, int(labels.max()), spec, VectorParams())
    assert sound.all()
    assert shapely.is_valid(outlines).all()


@pytest.mark.parametrize("move", [(0, 7), (13, 0), (21, 34)])
def test_whole_cells_of_shift_shift_the_outlines(move):
    """The place on the lattice has no effect."""
    labels = np.pad(town((150, 150))[0], 40)
    here, _ = outline_labels(labels, int(labels.max()), lattice_of(labels.shape), VectorParams())
    moved = np.roll(labels, move, axis=(0, 1))
    there, _ = outline_labels(moved, int(labels.max()), lattice_of(labels.shape), VectorParams())
    back = shapely.transform(there, lambda places: np.add(places, (-move[1], move[0])))
    assert shapely.equals_exact(shapely.normalize(here), shapely.normalize(back), tolerance=1e-9).all()


def test_islands_do_not_know_each_other():
    """Without the others, a touching group has the same outlines, to the bit."""
    labels, spec = town((150, 150))
    together, sound = outline_labels(labels, int(labels.max()), spec, VectorParams())
    islands = polygonise((labels > 0).astype(np.int32), spec, 1)[0]
    assert len(islands.geoms) > 3
    for island in islands.geoms:
        alone = np.where(rasterise([island], spec) > 0, labels, 0)
        outlines, alone_sound = outline_labels(alone, int(labels.max()), spec, VectorParams())
        own = np.unique(alone[alone > 0]) - 1
        assert shapely.equals_exact(outlines[own], together[own], tolerance=0).all()
        assert (alone_sound[own] == sound[own]).all()


def test_a_fit_that_is_off_stays_traced_and_is_marked():
    """A frayed ring of single cells has no walls; its neighbour does not suffer."""
    labels = np.zeros((60, 90), dtype=np.int32)
    labels[10:40, 50:80] = 2
    rng = np.random.default_rng(1)
    labels[10:40, 5:35] = rng.integers(0, 2, (30, 30))
    labels[12:38, 8:32] = 1
    spec = lattice_of(labels.shape)
    outlines, sound = outline_labels(labels, 2, spec, VectorParams(court_m2=1.0))
    assert sound[1]
    assert len(corners(outlines[1])) == 4
    assert shapely.is_valid(outlines).all()


def test_no_labels_give_no_outlines():
    """An empty image, and labels that do not occur."""
    spec = lattice_of((5, 5))
    none = np.zeros((5, 5), dtype=np.int32)
    assert outline_labels(none, 0, spec, VectorParams())[0].shape == (0,)
    outlines, sound = outline_labels(none, 2, spec, replace(VectorParams(), walls="fitted"))
    assert shapely.is_empty(outlines).all()
    assert sound.all()


def test_only_what_changed_is_looked_at_again_and_the_answers_are_those_of_a_look_at_all() -> None:
    """Round by round some outlines change: squares that may overlap, and now and then one that crosses itself."""
    rng = np.random.default_rng(3)
    soundness = Soundness(25)
    west, south = (10.0 * part for part in np.divmod(np.arange(25), 5))
    outlines = shapely.box(west, south, west + 10, south + 10)
    assert not soundness.broken(outlines).any()
    kinds = set()
    for turn in range(60):
        outlines = outlines.copy()
        for moved in rng.choice(25, 2):
            x, y, side = west[moved], south[moved], rng.choice([8, 10, 10, 10, 12])
            crossed = turn % 5 == 0 and moved % 2
            corners = (
                [(0, 0), (side, side), (side, 0), (0, side)]
                if crossed
                else [(0, 0), (side, 0), (side, side), (0, side)]
            )
            outlines[moved] = shapely.Polygon([(x + right, y + up) for right, up in corners])
        invalid = ~shapely.is_valid(outlines)
        overlaps = ~shapely.is_empty(shapely.coverage_invalid_edges(outlines))
        expected = invalid if invalid.any() else overlaps
        assert (soundness.broken(outlines) == expected).all()
        kinds.add(bool(invalid.any()))
    assert kinds == {False, True}

"""The steps of the 3-D area morphology on hand-made points with known answers."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.sizes import examples

from msbdb.detect.area3d.curvature import Reach, grow_regions, measure_structure, smallest_share
from msbdb.detect.area3d.edgelines import main_directions, measure_lines
from msbdb.detect.area3d.heightscales import OnSets, height_scales, histogram_minima
from msbdb.detect.area3d.regionshape import (
    bounding_rectangles,
    find_edges,
    judge,
    measure_shapes,
    perpendicular,
    reasons_against,
)
from msbdb.params import Area3dParams, profile
from msbdb.points.spacing import measure_density

OURS = Area3dParams()
PAPER = profile("cao-wu").area3d


def lattice_points(width_m, height_m, step_m=0.5, turn_deg=0.0):
    """Return the points of a lattice over a rectangle from (0, 0), turned about it."""
    x, y = (v.ravel() for v in np.meshgrid(np.arange(0, width_m, step_m), np.arange(0, height_m, step_m)))
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    return c * x - s * y, s * x + c * y


def shapes_of(x, y, *, step_m=0.5, params=OURS):
    """Measure the shape of one region of lattice points, one a cell."""
    labels = np.ones(len(x), dtype=np.int32)
    return measure_shapes(x, y, labels, 1, area_m2=np.full(len(x), step_m**2), spacing_m=step_m, params=params)


def naive_edges(x, y, labels, radius_m, gap_m):
    """Return the edge points by definition 7, sector by sector."""
    found = np.zeros(len(x), dtype=bool)
    for i in np.flatnonzero(labels > 0):
        east, north = x - x[i], y - y[i]
        distance = np.hypot(east, north)
        others = (labels == labels[i]) & (distance > 0) & (distance <= radius_m)
        sector = np.floor(np.degrees(np.arctan2(north, east)) % 360 / 45).astype(int)
        for s in range(8):
            inside = others & (sector == s)
            found[i] |= not inside.any() or distance[inside].min() > gap_m
    return found


def test_heights_are_the_middles_of_the_gaps_between_storeys():
    """Between the crowded heights of three kinds of roofs the histogram has its local minima."""
    rng = np.random.default_rng(1)
    heights = np.concatenate([rng.normal(m, 0.7, 4000) for m in (0, 5, 10, 15)])
    found = histogram_minima(heights)
    for gap in (2.5, 7.5, 12.5):
        assert min(abs(h - gap) for h in found) < 0.8
    scales = height_scales(heights, replace(OURS, mask_first=False), mask_m=2.0)
    assert len(scales) <= 4
    assert list(scales) == sorted(scales)
    assert min(scales) > 2.0


def test_a_plateau_of_the_histogram_counts_once():
    """Where the sky between two roofs is empty, one height lies in its middle."""
    heights = np.concatenate([np.linspace(0, 3, 1000), np.linspace(9, 12, 1000)])
    assert histogram_minima(heights) == pytest.approx([6.0], abs=0.1)


@pytest.mark.parametrize(
    "heights", [np.zeros(50), np.arange(1000) / 100, np.array([3.0])], ids=["one", "flat", "point"]
)
def test_without_a_local_minimum_the_mask_is_the_only_height(heights):
    """A histogram without a valley gives no height of its own."""
    assert height_scales(heights, PAPER, mask_m=2.0) == (2.0,)


def test_given_heights_and_their_number_decide():
    """Heights that are given are taken as they are, sorted; the single-scale mode takes the lowest."""
    given_heights = replace(OURS, heights_m=(9.0, 3.0, 3.0))
    assert height_scales(np.zeros(3), given_heights, mask_m=2.0) == (3.0, 9.0)
    assert height_scales(np.zeros(3), replace(given_heights, most_heights=1), mask_m=2.0) == (3.0,)


def test_one_bird_does_not_make_the_bars_coarse():
    """The tail keeps a point at 3000 m from making one bar of all roofs."""
    rng = np.random.default_rng(2)
    heights = np.concatenate([rng.normal(m, 0.5, 5000) for m in (0, 6)] + [[3000.0]])
    assert not any(1 < h < 5 for h in histogram_minima(heights))
    assert any(1 < h < 5 for h in histogram_minima(heights, 0.1))


def test_planes_have_no_change_of_curvature_and_crowns_have():
    """COC is 0 on a sloping plane and large in a ball of leaves, also beside each other."""
    rng = np.random.default_rng(3)
    x, y = lattice_points(12, 10)
    roof = np.column_stack([x, y, 5 + 0.7 * x])
    ball = rng.normal([30, 5, 8], 1, (600, 3))
    found = measure_structure(np.concatenate([roof, ball]), None, neighbours=16, thin_m=0)
    assert found.curvature[: len(roof)].max() < 1e-9
    assert np.median(found.curvature[len(roof) :]) > 0.03
    assert (found.echo_share == 0).all()


def test_an_edge_is_as_smooth_as_the_plane_beside_it():
    """The minimum over the neighbours (Eq. 7) keeps the points of a ridge, which by themselves are not smooth."""
    x, y = lattice_points(20, 20)
    z = 10 - np.abs(x - 10)
    found = measure_structure(np.column_stack([x, y, z]), None, neighbours=24, thin_m=0)
    assert found.curvature.max() < 0.02


def test_echoes_are_shared_among_neighbours():
    """The share of several echoes is that of the K nearest points."""
    x, y = lattice_points(20, 4)
    several = x >= 10
    found = measure_structure(np.column_stack([x, y, 0 * x]), several, neighbours=9, thin_m=0)
    assert (found.echo_share[x < 8] == 0).all()
    assert (found.echo_share[x > 12] == 1).all()


def test_noise_makes_no_plane_rough_and_no_crown_smooth():
    """With 0.15 m of noise a roof passes for a crown. What is known of it is taken off, and a ball stays rough."""
    random = np.random.default_rng(4)
    x, y = lattice_points(20, 20)
    roof, ball = np.column_stack([x, y, 5 + 0.3 * x]), random.normal([40, 5, 8], 1.2, (900, 3))
    points = np.concatenate([roof, ball])
    points[:, 2] += random.normal(0, 0.15, len(points))
    seen, known = (
        measure_structure(points, None, noise, neighbours=16, thin_m=0.5).curvature
        for noise in (None, np.full(len(points), 0.15, dtype=np.float32))
    )
    assert np.mean(seen[: len(roof)]) > 2 * np.mean(known[: len(roof)])
    assert np.median(known[len(roof) :]) > 0.02
    assert (known <= seen + 1e-12).all()
    assert (known >= 0).all()
    nothing = measure_structure(points, None, np.zeros(len(points), np.float32), neighbours=16, thin_m=0.5).curvature
    np.testing.assert_allclose(nothing, seen, rtol=1e-9)


def test_thinned_points_get_what_their_cube_gets():
    """Points of one cube have one answer, and on a plane thinning changes nothing."""
    x, y = lattice_points(10, 10, 0.1)
    found = measure_structure(np.column_stack([x, y, 0.2 * x]), None, neighbours=16, thin_m=0.5)
    assert len(found.curvature) == len(x)
    assert found.curvature.max() < 1e-9


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.zeros((1, 3)), np.zeros((40, 3)), np.eye(3)])
def test_few_and_equal_points_have_a_structure(points):
    """No point, one, forty at one place, and fewer than K give finite numbers."""
    found = measure_structure(points, None, neighbours=16, thin_m=0.4)
    assert np.isfinite(found.curvature).all()
    assert len(found.curvature) == len(points)


@given(st.integers(0, 2**32 - 1), st.sampled_from([1e-6, 1.0, 1e6]))
@examples(50)
def test_the_closed_form_agrees_with_lapack(seed, size):
    """The smallest eigenvalue's share is LAPACK's, for flat, long and round neighbourhoods of any size."""
    rng = np.random.default_rng(seed)
    points = rng.normal(0, 1, (20, 6, 3)) * rng.choice([0, 1e-3, 1.0], 3) * size
    points -= points.mean(axis=1, keepdims=True)
    matrix = np.einsum("nki,nkj->nij", points, points)
    values = np.linalg.eigvalsh(matrix)
    total = values.sum(axis=1)
    expected = np.where(total > 0, np.maximum(values[:, 0], 0) / np.where(total > 0, total, 1), 0)
    got = smallest_share(np.stack([matrix[:, i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]))
    assert got == pytest.approx(expected, abs=2e-7)


@given(st.integers(0, 2**32 - 1), st.integers(1, 40))
@examples(60)
def test_edges_are_those_of_the_definition(seed, count):
    """The kernel finds what the eight sectors say, in several regions, with points on sector borders and doubles."""
    rng = np.random.default_rng(seed)
    x, y = (rng.integers(0, 8, count).astype(float) for _ in range(2))
    labels = rng.integers(0, 3, count).astype(np.int32)
    radius, gap = rng.choice([1.0, 1.5, 2.5, 4.0], 2)
    assert (find_edges(x, y, labels, radius_m=radius, gap_m=gap) == naive_edges(x, y, labels, radius, gap)).all()


def test_the_edge_of_a_rectangle_is_its_outermost_points():
    """On a lattice with R of two steps just the outline is edge."""
    x, y = lattice_points(10, 6, 1.0)
    edge = find_edges(x, y, np.ones(len(x), dtype=np.int32), radius_m=2.0, gap_m=2.0)
    outline = (x == 0) | (x == x.max()) | (y == 0) | (y == y.max())
    assert (edge == outline).all()


def test_regions_do_not_see_each_other():
    """Two regions side by side both have an edge between them, and points of no region have none."""
    x, y = lattice_points(12, 6, 1.0)
    labels = np.where(x < 6, 1, 2).astype(np.int32)
    edge = find_edges(x, y, labels, radius_m=2.0, gap_m=2.0)
    assert edge[(x == 5) | (x == 6)].all()
    assert not find_edges(x, y, np.zeros(len(x), dtype=np.int32), radius_m=2.0, gap_m=2.0).any()


@pytest.mark.parametrize("offset", [(0.0, 0.0), (1e7, -1e7)])
def test_a_gap_in_a_roof_is_edge_by_the_second_condition(offset):
    """A court wider than E_s makes edge points of the points around it; one that is narrower does not."""
    x, y = lattice_points(20, 20, 1.0)
    keep = (np.abs(x - 10) > 1) | (np.abs(y - 10) > 1)
    x, y = x[keep] + offset[0], y[keep] + offset[1]
    labels = np.ones(len(x), dtype=np.int32)
    beside = (np.abs(x - offset[0] - 8) < 0.1) & (np.abs(y - offset[1] - 10) < 0.1)
    assert find_edges(x, y, labels, radius_m=6.0, gap_m=2.0)[beside].all()
    assert not find_edges(x, y, labels, radius_m=6.0, gap_m=6.0)[beside].any()


@pytest.mark.parametrize("turn", [0.0, 30.0, 90.0])
def test_a_rectangular_roof_is_rectangular_straight_and_square_cornered(turn):
    """Rectangularity 1, high linearity and two perpendicular directions, however the roof is turned."""
    found = shapes_of(*lattice_points(20, 12, turn_deg=turn))
    assert found.rectangularity[0] == pytest.approx(1, abs=0.08)
    assert found.linearity[0] > 0.45
    off = np.abs((found.directions[0] - [[turn], [turn + 90]] + 90) % 180 - 90)
    assert off.min(axis=1).max() < 5
    assert perpendicular(found.directions, 10.0)[0]
    assert found.points[0] == 40 * 24
    assert found.area_m2[0] == pytest.approx(240)
    assert (judge(found, OURS) == 1).all()
    assert (judge(found, PAPER) == 1).all()


def test_a_disc_fills_a_rectangle_by_a_quarter_of_pi():
    """A disc has rectangularity π/4."""
    x, y = lattice_points(20, 20, 0.2)
    keep = np.hypot(x - 10, y - 10) < 9
    assert shapes_of(x[keep], y[keep], step_m=0.2).rectangularity[0] == pytest.approx(np.pi / 4, abs=0.05)


def test_an_l_shape_needs_rule_2():
    """An L fills too little of its rectangle for rule 1, and its perpendicular walls make it pass rule 2."""
    x, y = lattice_points(24, 24)
    keep = (x < 8) | (y < 8)
    found = shapes_of(x[keep], y[keep])
    assert 0.5 < found.rectangularity[0] < 0.7
    assert (judge(found, PAPER) == 2).all()


def test_compactness_means_the_same_at_any_density():
    """The scaled ratio of a roof changes little with the density; unscaled, it is the ratio as counted."""
    fine = shapes_of(*lattice_points(30, 20, 0.25), step_m=0.25)
    coarse = shapes_of(*lattice_points(30, 20, 0.5), step_m=0.5)
    assert fine.compactness[0] == pytest.approx(coarse.compactness[0], rel=0.1)
    raw = replace(OURS, compactness_density=0.0)
    counted = shapes_of(*lattice_points(30, 20, 0.25), step_m=0.25, params=raw)
    assert counted.compactness[0] == pytest.approx(2400 * 4 / counted.perimeter[0])


@pytest.mark.parametrize(
    ("x", "y", "expected"),
    [
        ([0.0], [0.0], 0.25),
        ([0.0, 4.0], [0.0, 3.0], 2.5),
        ([0.0, 4.0, 4.0], [0.0, 0.0, 3.0], 12.0),
        ([7, 7], [1, 1], 0.25),
    ],
    ids=["point", "line", "triangle", "double"],
)
def test_degenerate_groups_have_a_bounding_rectangle(x, y, expected):
    """Sides count as at least the spacing, so that points in a row have a rectangle."""
    member = np.zeros(len(x), dtype=np.int32)
    area = bounding_rectangles(np.array(x, float), np.array(y, float), member, least_m=0.5)
    assert area == pytest.approx([expected])


def test_walls_have_lines_at_any_angle_and_clouds_have_none():
    """Points on a vertical and a sloping wall have L = 1 and its angle; scattered points have L = 0."""
    step = np.arange(20.0)
    rng = np.random.default_rng(4)
    x = np.concatenate([np.zeros(20), 50 + 0.6 * step, rng.uniform(100, 130, 20)])
    y = np.concatenate([step, 0.8 * step, rng.uniform(0, 30, 20)])
    member = np.repeat(np.arange(3), 20).astype(np.int32)
    linearity, direction = measure_lines(x, y, member, most=8, least=5, tolerance_m=0.05)
    assert linearity[:40] == pytest.approx(1)
    assert direction[:20] == pytest.approx(90)
    assert direction[20:40] == pytest.approx(np.degrees(np.arctan2(0.8, 0.6)))
    assert (linearity[40:] == 0).all()
    assert np.isnan(direction[40:]).all()


def test_a_corner_finds_the_walls_beside_it():
    """Of all windows that hold a corner point those along a wall fit, not the one centred on the corner."""
    step = np.arange(1.0, 15.0)
    x, y = np.concatenate([[0.0], step, 0 * step]), np.concatenate([[0.0], 0 * step, step])
    linearity, _ = measure_lines(x, y, np.zeros(29, dtype=np.int32), most=5, least=5, tolerance_m=0.01)
    assert (linearity == 1).all()


def test_fewer_points_than_a_line_needs_have_no_line():
    """Regions of fewer than n_s edge points have L = 0, also beside a large one."""
    x = np.concatenate([np.arange(10.0), [100, 101]])
    member = np.repeat([0, 1], [10, 2]).astype(np.int32)
    linearity, _ = measure_lines(x, np.zeros(12), member, most=12, least=5, tolerance_m=0.1)
    assert linearity[:10] == pytest.approx(1)
    assert (linearity[10:] == 0).all()


def test_directions_are_found_across_north():
    """Angles around 0 and 180 are one direction; a region without lines has none."""
    angle = np.array([179.0, 1.0, 178.0, 2.0, 91.0, 89.0, np.nan])
    member = np.array([0, 0, 0, 0, 0, 0, 1], dtype=np.int32)
    found = main_directions(angle, member, 2)
    assert min(found[0, 0], 180 - found[0, 0]) < 1
    assert found[0, 1] == pytest.approx(90, abs=1)
    assert np.isnan(found[1]).all()
    assert list(perpendicular(found, 10.0)) == [True, False]


def test_the_rules_are_those_of_the_paper():
    """Each condition of rules 1 and 2 decides by itself, and the reason names the one that failed."""
    base = shapes_of(*lattice_points(20, 12))
    nan = np.array([[np.nan, np.nan]])

    def verdict(rect, comp, line, directions=nan):
        shapes = replace(
            base,
            rectangularity=np.array([rect]),
            compactness=np.array([comp]),
            linearity=np.array([line]),
            directions=directions,
        )
        rule = judge(shapes, PAPER)
        return int(rule[0]), reasons_against(shapes, rule, PAPER)[0]

    assert verdict(0.75, 3.0, 0.0) == (1, "")
    assert verdict(0.74, 3.0, 0.45) == (2, "")
    assert verdict(0.40, 3.0, 0.0, np.array([[10.0, 91.0]])) == (2, "")
    assert verdict(0.40, 3.0, 0.0, np.array([[10.0, 89.0]])) == (0, "neither straight nor perpendicular")
    assert verdict(0.40, 3.0, 0.44) == (0, "neither straight nor perpendicular")
    assert verdict(0.39, 3.0, 1.0) == (0, "not rectangular enough")
    assert verdict(1.0, 2.9, 1.0) == (0, "not compact enough")


@pytest.mark.parametrize("step", [0.2, 0.5, 1.0, 1.8])
def test_areas_sum_up_to_the_covered_ground_at_any_density(step):
    """The spacing of a lattice is found, and the points' areas add up to the scene's."""
    x, y = lattice_points(90, 90, step)
    found = measure_density(x + 1e-3, y + 1e-3, np.ones(len(x), dtype=bool))
    assert found.spacing_m == pytest.approx(step, rel=0.07)
    assert found.area_m2.sum() == pytest.approx(90 * 90, rel=0.08)


def test_a_strip_scanned_twice_has_the_same_area():
    """Doubled points share the ground that one of them would have alone."""
    x, y = lattice_points(40, 40)
    once = measure_density(x, y, np.ones(len(x), dtype=bool)).area_m2.sum()
    east = x >= 20
    x2, y2 = np.concatenate([x, x[east]]), np.concatenate([y, y[east]])
    twice = measure_density(x2, y2, np.ones(len(x2), dtype=bool))
    assert twice.area_m2[(x2 >= 22)].sum() == pytest.approx(18 * 40, rel=0.05)
    assert twice.area_m2.sum() == pytest.approx(once, rel=0.06)


@pytest.mark.parametrize(("dense", "spacing"), [(0.25, 1.0), (0.75, 0.5)])
def test_the_typical_spacing_is_that_of_most_of_the_ground(dense, spacing):
    """A strip with four times the points moves the mean, and the median only where it is most of the ground."""
    x, y = lattice_points(100, 40, 1.0)
    x2, y2 = lattice_points(100, 40, 0.5)
    west = x2 < 100 * dense
    x, y = np.concatenate([x[x >= 100 * dense], x2[west]]), np.concatenate([y[x >= 100 * dense], y2[west]])
    found = measure_density(x + 1e-3, y + 1e-3, np.ones(len(x), dtype=bool))
    assert found.typical_m == pytest.approx(spacing, rel=0.07)
    assert 0.5 < found.spacing_m < 1.0


@pytest.mark.parametrize("degrees", [0, 30])
def test_links_reach_from_one_scan_line_to_the_next(degrees):
    """Points 0.2 m apart on lines 2 m apart: links and areas are those of the lines, whatever their direction."""
    x, y = lattice_points(60, 60, 0.2)
    x, y = x[y % 2 < 0.1], y[y % 2 < 0.1]
    turn = np.deg2rad(degrees)
    east, north = x * np.cos(turn) - y * np.sin(turn), x * np.sin(turn) + y * np.cos(turn)
    found = measure_density(east, north, np.ones(len(x), dtype=bool))
    assert found.spacing_m < 0.75
    assert found.link_m == pytest.approx(2, abs=0.1)
    assert found.step_m > 2 * found.spacing_m
    assert found.area_m2.sum() == pytest.approx(60 * 60, rel=0.15)


ROOF = [[0, 0, 6], [1, 0, 6], [10, 0, 9]]
"""Points of two regions, 1, 1 and 2."""

REACH = Reach(level_m=1.0, step_m=1.0, wall_factor=2.0, mask_m=2.0)


@pytest.mark.parametrize(
    ("place", "several", "expected"),
    [
        ((2.0, 0, 6.9), True, 1),
        ((2.1, 0, 6.9), False, 0),
        ((9.2, 0, 8.0), True, 2),
        ((3.0, 0, 3.0), False, 1),
        ((2.0, 0, 3.0), True, 1),
        ((2.1, 0, 3.0), True, 0),
        ((3.1, 0, 3.0), False, 0),
        ((1.5, 0, 7.9), False, 1),
        ((1.6, 0, 7.9), False, 0),
        ((1.0, 0, 8.1), False, 0),
        ((1.5, 0, 0.5), True, 1),
        ((1.6, 0, 0.5), False, 0),
        ((5.0, 0, 6.0), False, 0),
    ],
)
def test_points_return_by_their_height_and_distance(place, several, expected):
    """Level points return within the reach, walls within twice it, what stands on a roof and feet within half."""
    points = np.array([*ROOF, place], dtype=float)
    labels, free = np.array([1, 1, 2, 0], dtype=np.int32), np.ones(4, dtype=bool)

    def grown(reach=REACH, free=free):
        split = np.array([False, False, False, several])
        return list(grow_regions(points, labels, free, heights=points[:, 2], several=split, reach=reach))

    assert grown() == [1, 1, 2, expected]
    assert grown(replace(REACH, level_m=0.0)) == [1, 1, 2, 0]
    assert grown(free=~free) == [1, 1, 2, 0]


def test_below_the_mask_only_feet_of_walls_return():
    """Beside a low roof a point below the mask is no wall's foot, also where nothing is known of echoes."""
    points = np.array([[0, 0, 2.2], [0.3, 0, 1.5], [0.3, 0, 1.1], [0.8, 0, 1.1]], dtype=float)
    labels = np.array([1, 0, 0, 0], dtype=np.int32)
    found = grow_regions(points, labels, np.ones(4, dtype=bool), heights=points[:, 2], several=None, reach=REACH)
    assert list(found) == [1, 0, 1, 0]


@pytest.mark.parametrize(("spacing_m", "thin_m", "times"), [(0.2, 0.5, 1), (1.0, 0.5, 2), (1.0, 0.0, 1)])
def test_the_threshold_on_crowns_follows_the_spacing(spacing_m, thin_m, times):
    """Where points are twice as far apart as cubes are wide, it is twice as high; as given without cubes."""
    own = replace(OURS, thin_m=thin_m, max_crown=0.003)
    scene = OnSets(None, None, None, spacing_m, 1.0, None, None, own, 2.0)
    assert scene.max_crown == pytest.approx(0.003 * times)


def test_regions_grow_by_metres_and_at_least_by_spacings():
    """The reach is that of `grow_m` where points are dense, of `grow_spacings` where they are not, none as written."""
    dense = OnSets(None, None, None, 0.2, 1.0, None, None, replace(OURS, grow_m=0.6, grow_spacings=1.0), 2.0)
    assert dense.grow_m == 0.6
    assert replace(dense, spacing_m=1.0).grow_m == 1.0
    assert replace(dense, params=PAPER).grow_m == 0.0

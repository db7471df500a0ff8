"""Ground filters on small worlds whose terrain is known, and on a real tile."""

import os
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from affine import Affine
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from pyproj import CRS
from scipy.ndimage import binary_dilation, median_filter, uniform_filter
from support.notices import with_notices

from msbdb.errors import MsbdbWarning, NodataError
from msbdb.grid import Grid, GridSpec, lattice
from msbdb.ground.choice import FILTERS, PIT_M2, POINT_FILTERS, lowest_surface, terrain, with_decks, without_pits
from msbdb.ground.interpolation import NearestGround, interpolate_ground, means_over_windows, refine
from msbdb.ground.progressive import window_radii
from msbdb.ground.trend import known_trend, lower_trend
from msbdb.ground.wavelet import smooth_b3, two_means
from msbdb.io.las import read_points
from msbdb.params import GroundParams, Params, with_values
from msbdb.points.cloud import PointCloud
from msbdb.run.preparation.drafts import build_surface

CRS_M = CRS.from_epsg(32633)
PARAMS = GroundParams()
Array = NDArray[np.float64]
Box = tuple[int, int, int, int, float]
"""First row, first column, rows, columns, and height of the roof above the terrain at its centre."""


def world(relief: Callable[[Array, Array], Array], boxes: tuple[Box, ...], size: int = 160) -> tuple[PointCloud, Array]:
    """Points at cell centres with noise, over a terrain with level roofs, and the terrain itself, (size, size)."""
    row, col = np.indices((size, size))
    ground = relief(col + 0.5, size - row - 0.5)
    top = ground.copy()
    for r, c, height, width, above in boxes:
        top[r : r + height, c : c + width] = ground[r + height // 2, c + width // 2] + above
    z = top + np.random.default_rng(0).normal(0, 0.03, top.shape)
    points = PointCloud(col.ravel() + 0.5, size - row.ravel() - 0.5, z.ravel(), CRS_M)
    return points, ground


def flat(x: Array, y: Array) -> Array:
    """Stay level."""
    return np.full(x.shape, 20.0)


def slope(x: Array, y: Array) -> Array:
    """Rise by 10 % to the east."""
    return 20 + 0.1 * x + 0.02 * y


def hill(x: Array, y: Array) -> Array:
    """Rise to a round hill of 12 m, at most 16 % steep."""
    return 20 + 12 * np.exp(-((x - 80) ** 2 + (y - 80) ** 2) / (2 * 45**2))


HOUSES: tuple[Box, ...] = ((30, 30, 12, 16, 7.0), (70, 40, 20, 14, 12.0), (100, 110, 15, 15, 5.0))
COURTYARD: tuple[Box, ...] = (
    (50, 50, 50, 12, 15.0),
    (50, 88, 50, 12, 15.0),
    (50, 62, 12, 26, 15.0),
    (88, 62, 12, 26, 15.0),
)
LOW_AMONG_TALL: tuple[Box, ...] = (
    (40, 40, 60, 25, 25.0),
    (40, 95, 60, 25, 25.0),
    (80, 65, 20, 30, 20.0),
    (60, 75, 10, 10, 3.0),
)
HILLTOWN = tuple((r, c, 14, 14, 6.0) for r in range(10, 150, 25) for c in range(10, 150, 25))


def ridge(x: Array, y: Array) -> Array:
    """Rise and fall by up to 35 %."""
    return 40 + 8 * np.sin(2 * np.pi * x / 150) * np.cos(2 * np.pi * y / 150)


WORLDS = {
    "flat": (flat, HOUSES),
    "slope of 10 %": (slope, HOUSES),
    "hill": (hill, HOUSES),
    "courtyard": (flat, COURTYARD),
    "low roof among tall roofs": (flat, LOW_AMONG_TALL),
    "hall of 100 m": (flat, ((30, 30, 100, 100, 9.0),)),
    "hall on a slope": (slope, ((40, 40, 80, 60, 9.0),)),
    "nothing": (hill, ()),
}


def errors(points: PointCloud, truth: Array, name: str) -> tuple[Array, Grid]:
    """DTM less terrain, from the named filter."""
    spec = lattice((0.0, 0.1, truth.shape[1] - 0.1, truth.shape[0]), 1.0, CRS_M)
    dtm, used = terrain(points, spec, replace(PARAMS, ground_filter=name))
    assert used == name
    return np.asarray(dtm.values) - truth, dtm


ALL = [*FILTERS, *POINT_FILTERS]
CURVED = {("quadratic", "hill"), ("quadratic", "nothing")}
"""Where a quadratic surface in a window of 60 m, fitted to the lower half, cannot follow the terrain."""


@pytest.mark.parametrize(("name", "case"), [(n, c) for n in ALL for c in WORLDS if (n, c) not in CURVED])
def test_roofs_leave_and_the_terrain_stays(name, case):
    """The DTM keeps within half a metre of open ground, and below every roof by all but a metre of its height."""
    relief, boxes = WORLDS[case]
    points, truth = world(relief, boxes)
    error, dtm = errors(points, truth, name)
    built = np.zeros(truth.shape, dtype=bool)
    for r, c, height, width, above in boxes:
        inside = (slice(r, r + height), slice(c, c + width))
        built[inside] = True
        assert np.abs(error[inside]).max() < min(1.5, above / 2), (r, c)
    assert np.abs(error[~built]).max() < 0.5
    assert dtm.valid.all()


def region_of(heights, row, col, depth):
    """Return the cells that steps below a depth join to one."""
    found, border = {(row, col)}, [(row, col)]
    while border:
        r, c = border.pop()
        for beside in ((r - 1, c), (r + 1, c), (r, c - 1), (r, c + 1)):
            inside = 0 <= beside[0] < heights.shape[0] and 0 <= beside[1] < heights.shape[1]
            if inside and beside not in found and abs(heights[beside] - heights[r, c]) < np.float32(depth):
                found.add(beside)
                border.append(beside)
    return found


@pytest.mark.parametrize("shape", [(1, 7), (2, 2), (9, 1), (20, 30)])
@pytest.mark.parametrize("step_m", [0.0, 4.0])
@pytest.mark.parametrize("cell_m2", [1.0, 4.0])
def test_pits_are_raised_as_by_their_definition(shape, step_m, cell_m2):
    """The median that is sought only where it decides gives the same bytes, also on plateaus and beside the border."""
    rng = np.random.default_rng(5)
    heights = 50 + 20 * rng.random(shape) - 30 * (rng.random(shape) < 0.2)
    heights = np.float32(np.round(heights / step_m) * step_m if step_m else heights)
    for depth in (0.25, 1.0, 4.0):
        floor = median_filter(heights, size=5, mode="nearest") - np.float32(depth)
        expected = heights.copy()
        for place in np.argwhere(floor > heights):
            if len(region_of(heights, *place, depth)) * cell_m2 <= PIT_M2:
                expected[tuple(place)] = floor[tuple(place)]
        assert without_pits(heights, depth, cell_m2).tobytes() == expected.tobytes()


@pytest.mark.parametrize(("lane", "stays"), [(np.s_[10, 5:35], True), (np.s_[10, 5:13], False)])
def test_a_lane_between_roofs_is_no_pit(lane, stays):
    """Most cells around a lane of 1 m are roofs; a shaft of 8 m² is a pit, be it a light well or a false echo."""
    heights = np.full((20, 40), 12, dtype=np.float32)
    heights[lane] = 2
    assert np.array_equal(without_pits(heights, 1.0), np.where(heights == 2, 2 if stays else 11, 12))


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (40, 1), (33, 70), (129, 64)])
@pytest.mark.parametrize("radius", [1, 8, 32])
def test_means_over_windows_are_those_of_scipy_to_the_bit(shape, radius):
    """Windows may be wider than the lattice; cells that are not chosen keep their values."""
    random = np.random.default_rng(radius)
    values, chosen = random.normal(0, 100, shape).astype(np.float32), random.random(shape) < 0.3
    kept = values.copy()
    for asked in (chosen, np.ones_like(chosen), np.zeros_like(chosen)):
        means = np.where(asked, uniform_filter(values, 2 * radius + 1, mode="nearest"), values)
        assert means_over_windows(values, asked, radius).tobytes() == means.tobytes()
    assert values.tobytes() == kept.tobytes()


def test_ground_whose_nearest_cells_are_known_is_interpolated_alike():
    """Finding them once for several purposes changes nothing."""
    random = np.random.default_rng(4)
    spec = lattice((0, 0.1, 49.9, 29.9), 1.0, CRS.from_epsg(2154))
    heights, ground = random.normal(0, 1, spec.shape).astype(np.float32), random.random(spec.shape) < 0.4
    nearest = NearestGround.of(ground)
    expected = interpolate_ground(heights, ground, spec).values
    np.testing.assert_array_equal(interpolate_ground(heights, ground, spec, sources=nearest).values, expected)


@pytest.mark.parametrize("name", list(FILTERS))
def test_the_ground_of_a_courtyard_is_found(name):
    """A yard of 26 m, walled in by roofs of 15 m, is ground and no roof."""
    points, _ = world(flat, COURTYARD)
    surface = lowest_surface(points, lattice((0.0, 0.1, 159.9, 160), 1.0, CRS_M), PARAMS)
    ground = FILTERS[name](surface, PARAMS)
    assert ground[62:88, 62:88].mean() > 0.98
    assert not ground[51:99, 51:61].any()


@pytest.mark.parametrize("name", list(FILTERS))
def test_the_ground_of_turned_data_is_the_ground_turned(name):
    """No filter prefers a direction."""
    points, _ = world(hill, HOUSES)
    surface = lowest_surface(points, lattice((0.0, 0.1, 159.9, 160), 1.0, CRS_M), PARAMS)
    ground = FILTERS[name](surface, PARAMS)
    for turn in (np.rot90, np.flipud):
        turned = Grid(turn(surface.values).copy(), surface.valid, surface.spec)
        assert np.mean(FILTERS[name](turned, PARAMS) != turn(ground)) < 1e-3


@pytest.mark.parametrize("name", ALL)
def test_low_outliers_do_not_pull_the_terrain_down(name):
    """Echoes far below the ground, one at a time, change nothing farther than a metre around."""
    points, truth = world(flat, HOUSES)
    z = points.z.copy()
    z[[5000, 12_345, 20_000]] -= 30.0
    error, _ = errors(replace(points, z=z), truth, name)
    assert np.abs(error).max() < 1.5
    assert np.mean(np.abs(error) > 0.3) < 0.01


@pytest.mark.parametrize("name", ALL)
def test_a_false_echo_in_a_void_is_not_the_ground_of_all_of_it(name):
    """A pond without echoes but for one from 30 m below keeps the level of its banks."""
    points, truth = world(flat, HOUSES)
    row, col = np.indices(truth.shape)
    pond = ((row - 125) ** 2 + (col - 50) ** 2 < 20**2).ravel()
    kept = points.take(~pond | (np.arange(len(points)) == 125 * 160 + 50))
    z = kept.z.copy()
    z[(kept.x == 50.5) & (kept.y == 160 - 125.5)] = -10.0
    error, _ = errors(replace(kept, z=z), truth, name)
    assert np.abs(error).max() < 0.5


def test_scattered_points_all_count():
    """Where every point is alone in its surroundings, none is left out."""
    x, y = (a.ravel() * 10 + 5.5 for a in np.indices((16, 16)))
    points = PointCloud(x, y, np.full(x.size, 20.0), CRS_M)
    surface = lowest_surface(points, lattice((0.0, 0.1, 159.9, 160), 1.0, CRS_M), PARAMS)
    np.testing.assert_array_equal(surface.values, 20.0)


def surveyed(inside):
    """Return the cells of the lowest surface that are no void, of points on a level plane where ``inside`` has any."""
    row, col = (index.ravel() for index in np.nonzero(inside))
    points = PointCloud(col + 0.5, len(inside) - row - 0.5, np.zeros(len(row)), CRS_M)
    rows, cols = inside.shape
    return lowest_surface(points, lattice((0.0, 0.1, cols - 0.1, rows), 1.0, CRS_M), PARAMS).valid


def test_a_survey_ends_with_its_outermost_points():
    """Where its border crosses the lattice at an angle, nothing beyond it is taken for surveyed."""
    row, col = np.indices((160, 160))
    turned = np.abs(row - 80) + np.abs(col - 80) < 70
    np.testing.assert_array_equal(surveyed(turned), turned)


def test_what_no_wide_circle_fits_into_is_no_void():
    """Gaps of 16 m and frames of empty cells along the lattice are surveyed; a pond of 30 m is a void up to its rim."""
    row, col = np.indices((160, 160))
    away = np.hypot(row - 80, col - 80)
    np.testing.assert_array_equal(surveyed(away > 8), np.ones((160, 160), dtype=bool))
    np.testing.assert_array_equal(surveyed(row > 3), np.ones((160, 160), dtype=bool))
    pond = away <= 15
    void = ~surveyed(~pond)
    assert not void[~pond].any()
    assert void[pond].mean() > 0.95


def test_low_houses_among_sparse_points_are_bounded_by_walls():
    """Garages of 2.4 m at 0.25 points a square metre stay above ground, on cells of 2 m."""
    x, y = np.random.default_rng(0).uniform(0, 160, (2, 6400))
    house = (x % 30 > 14) & (y % 30 > 14)
    points = PointCloud(x, y, np.where(house, 22.4, 20.0), CRS_M)
    found, _ = terrain(points, lattice((0.0, 0.0, 160.0, 160.0), 2.0, CRS_M), GroundParams(ground_filter="walls"))
    assert np.abs(np.asarray(found.values) - 20).max() < 0.1


def test_a_mound_without_walls_is_terrain():
    """A mound of 6 m, smooth to all sides, stays; a box as wide and as high beside it goes."""

    def mound(x: Array, y: Array) -> Array:
        return 20 + 6 * np.exp(-((x - 40) ** 2 + (y - 80) ** 2) / (2 * 15**2))

    points, truth = world(mound, ((65, 95, 30, 30, 6.0),))
    for name in FILTERS:
        error, _ = errors(points, truth, name)
        assert np.abs(error).max() < 0.8, name


@pytest.mark.parametrize(("name", "most_m"), [("progressive", 1.0), ("adaptive", 1.2)])
def test_a_town_on_steep_hills_stands_on_its_ground(name, most_m):
    """Slopes of up to 35 % between houses: the filter keeps the streets and loses no roof."""
    points, truth = world(ridge, HILLTOWN)
    error, _ = errors(points, truth, name)
    built = np.zeros(truth.shape, dtype=bool)
    for r, c, height, width, _ in HILLTOWN:
        built[r : r + height, c : c + width] = True
    assert np.abs(error[~built]).max() < most_m
    assert np.quantile(np.abs(error[built]), 0.95) < 1.5


def classified(share: float) -> tuple[PointCloud, Array]:
    """Houses on a slope; the given share of the ground points has class 2, all else class 1."""
    points, truth = world(slope, HOUSES)
    ground = np.abs(points.z - truth.ravel()) < 0.3
    keep = np.random.default_rng(1).random(len(points)) < share
    return replace(points, classification=np.where(ground & keep, 2, 1).astype(np.uint8)), truth


def test_given_ground_is_trusted():
    """Where class 2 is given, 'auto' takes it, and the terrain runs through it even where it is thin."""
    points, truth = classified(0.1)
    spec = lattice((0.0, 0.1, 159.9, 160), 1.0, CRS_M)
    dtm, name = terrain(points, spec, PARAMS)
    assert name == "class2"
    assert np.abs(dtm.values - truth).max() < 1.0
    assert np.sqrt(np.mean((dtm.values - truth) ** 2)) < 0.15


@pytest.mark.parametrize(("share", "expected"), [(0.0, "walls"), (0.01, "walls"), (0.05, "class2")])
def test_a_few_points_of_class_2_are_no_classification(share, expected):
    """'auto' needs 2 % of the points."""
    points, _ = classified(share)
    assert terrain(points, lattice((0, 0, 20, 20), 1.0, CRS_M), PARAMS)[1] == expected


def test_without_classes_auto_filters():
    """A source without the attribute is filtered by the default."""
    points, _ = world(flat, HOUSES)
    assert terrain(points, lattice((0, 0, 20, 20), 1.0, CRS_M), PARAMS)[1] == "walls"


@pytest.mark.parametrize("classes", [None, 1])
def test_class_2_asked_for_and_missing_is_an_error(classes):
    """The message names the filters that need no classes."""
    points, _ = world(flat, ())
    given = None if classes is None else np.full(len(points), classes, dtype=np.uint8)
    with pytest.raises(NodataError, match="progressive"):
        terrain(
            replace(points, classification=given),
            lattice((0, 0, 20, 20), 1.0, CRS_M),
            replace(PARAMS, ground_filter="class2"),
        )


def test_no_ground_at_all_is_an_error():
    """Nothing can be interpolated from nothing."""
    spec = lattice((0, 0, 5, 5), 1.0, CRS_M)
    with pytest.raises(NodataError, match="No ground"):
        interpolate_ground(np.zeros(spec.shape), np.zeros(spec.shape, dtype=bool), spec)


def test_interpolation_keeps_the_ground_and_bridges_a_slope():
    """Ground cells keep their heights; a gap of 30 m on a slope is filled along it."""
    spec = lattice((0, 0, 79.9, 79.9), 1.0, CRS_M)
    values = np.broadcast_to(0.1 * np.arange(spec.shape[1]), spec.shape).astype(np.float32)
    ground = np.ones(spec.shape, dtype=bool)
    ground[25:55, 25:55] = False
    filled = np.asarray(interpolate_ground(np.where(ground, values, 99), ground, spec).values)
    np.testing.assert_array_equal(filled[ground], values[ground])
    assert np.abs(filled - values).max() < 0.5


def test_a_slope_goes_on_where_the_border_cuts_a_block():
    """A corner of a slope of 1 in 4 is hidden, on flat land too; the terrain leaves the ground's range nowhere."""
    rows, cols = np.indices((96, 80))
    slope = (0.2 * rows - 0.15 * cols).astype(np.float32)
    hidden = (rows < 40) & (cols < 50)
    spec = lattice((0, 0, 79, 95), 1.0, CRS_M)
    for heights, most_m in ((slope, 0.7), (0 * slope, 1e-4)):
        found = np.asarray(interpolate_ground(heights, ~hidden, spec).values)
        inside = np.clip(heights, heights[~hidden].min(), heights[~hidden].max())
        assert np.abs(found - inside).max() < most_m
        assert np.array_equal(found[~hidden], heights[~hidden])


def test_a_single_street_does_not_tilt_the_land_beside_it():
    """Kerbs and noise across eight metres say nothing about the terrain sixty metres off."""
    rows, cols = np.indices((128, 128))
    street = (cols >= 60) & (cols < 68)
    noise = 0.03 * ((7 * rows + 13 * cols) % 5 - 2)
    heights = (0.02 * np.abs(cols - 62) + noise).astype(np.float32)
    assert np.abs(known_trend(heights, street)).max() < 0.4


@given(
    origin=st.tuples(st.integers(-99, 99), st.integers(-99, 99)), cut=st.tuples(st.integers(1, 90), st.integers(1, 90))
)
def test_a_part_has_the_trend_of_the_whole(origin, cut):
    """Wherever it begins: through known ground from 108 cells inside, under lowest heights from 120 cells inside."""
    rows, cols = np.indices((300, 320))
    ground = (rows % 50 < 8) | ((cols * 7 + rows) % 90 < 5)
    heights = (3 * np.sin(rows / 40) + 2 * np.cos(cols / 30) + ((rows * 31 + cols * 17) % 10) / 50).astype(np.float32)
    part, inner = np.s_[cut[0] :, cut[1] :], np.s_[120:, 120:]
    first = (origin[0] + cut[0], origin[1] + cut[1])
    whole, own = known_trend(heights, ground, origin), known_trend(heights[part], ground[part], first)
    assert np.abs(whole[part] - own)[108:, 108:].max() < 1e-5
    trends = []
    for values, (row, col) in ((heights, origin), (heights[part], first)):
        spec = GridSpec(values.shape, Affine(1, 0, col, 0, -1, -row), CRS_M)
        trends.append(lower_trend(Grid(values, np.ones(values.shape, dtype=np.bool_), spec), PARAMS))
    assert np.abs(trends[0][part] - trends[1])[inner].max() < 1e-5


def test_the_trend_goes_on_over_a_wide_void():
    """Where the ground is far, wider windows show its slope: over 400 cells, 20 m high, it is met to half a metre."""
    slope = (np.indices((80, 640))[1] * 0.05).astype(np.float32)
    ground = np.indices((80, 640))[1] < 240
    assert np.abs(known_trend(slope, ground) - slope).max() < 0.5


def test_refining_a_plane_gives_the_plane():
    """Bilinear values of a plane are exact between the outermost centres, and held constant beyond."""
    coarse = lattice((0, 0, 19.9, 19.9), 2.0, CRS_M)
    fine = lattice((0, 0, 19.9, 19.9), 0.5, CRS_M)

    def plane(spec: GridSpec) -> NDArray[np.float64]:
        row, col = np.indices(spec.shape)
        east, north = spec.xy(row, col)
        return 0.3 * east - 0.2 * north

    grid = Grid(plane(coarse).astype(np.float32), np.ones(coarse.shape, dtype=bool), coarse)
    found = np.asarray(refine(grid, fine).values)
    inner = (slice(2, -2), slice(2, -2))
    np.testing.assert_allclose(found[inner], plane(fine)[inner], atol=1e-5)
    assert found[0, 0] == found[1, 1] == grid.values[0, 0]
    assert refine(grid, coarse) is grid


def test_windows_grow_to_the_largest():
    """Each half-width is larger than the one before, and none exceeds the largest."""
    for largest in (0.2, 1, 7.5, 80):
        radii = window_radii(largest, 1.05)
        assert radii[0] == 1
        assert all(b > a for a, b in pairwise(radii))
        assert radii[-1] <= max(largest, 1)


def test_the_smoothing_keeps_constants_and_spreads_a_point_as_the_spline():
    """Weights sum to one, and a point becomes (1, 4, 6, 4, 1)/16 along both axes, then with taps twice as far."""
    np.testing.assert_allclose(smooth_b3(np.full((9, 7), 3.5, dtype=np.float32), 3), 3.5, rtol=1e-6)
    point = np.zeros((31, 31), dtype=np.float32)
    point[15, 15] = 1
    spline = np.array([1, 4, 6, 4, 1]) / 16
    np.testing.assert_allclose(smooth_b3(point, 1)[13:18, 13:18], np.outer(spline, spline), atol=1e-7)
    wide = np.zeros(9)
    wide[::2] = spline
    twice = np.convolve(spline, wide)
    np.testing.assert_allclose(smooth_b3(point, 2)[9:22, 9:22], np.outer(twice, twice), atol=1e-7)


def test_two_means_split_as_the_best_threshold_does():
    """The sum of squares within the two groups is that of the best of all thresholds, on well-parted values."""
    rng = np.random.default_rng(3)
    values = np.concatenate([rng.normal(0, 0.3, 70), rng.normal(6, 1.0, 30)])
    low, high = two_means(values)
    ordered = np.sort(values)
    best = min(range(1, 100), key=lambda n: ordered[:n].var() * n + ordered[n:].var() * (100 - n))
    assert (low, high) == pytest.approx((ordered[:best].mean(), ordered[best:].mean()))
    assert two_means(np.full(10, 2.0)) == (2.0, 2.0)


@pytest.mark.data
@pytest.mark.skipif("MSBDB_DATA" not in os.environ, reason="the real tiles are found through MSBDB_DATA")
@pytest.mark.parametrize("name", ["progressive", "wavelet", "adaptive"])
def test_accuracy_floor_on_a_dutch_old_town(name):
    """Without its classes: at most 5 % of the roof echoes come below 2 m, at most 0.5 % of the ground is off."""
    path = Path(os.environ["MSBDB_DATA"]) / "delft" / "delft_1.laz"
    given, _ = with_notices(read_points, [path], crs=CRS.from_epsg(28992))
    params = replace(Params(), ground=GroundParams(ground_filter=name))
    surface = build_surface(replace(given, classification=None), params)
    row, col = surface.dtm.spec.rowcol(given.x, given.y)
    height = given.z - np.asarray(surface.dtm.values)[row, col]
    roofs = (given.classification == 6) & given.first_echo
    ground = given.classification == 2
    assert np.mean(height[roofs] < 2) < 0.05
    assert np.mean(np.abs(height[ground]) > 0.5) < 0.005


def cutting(x: Array, y: Array) -> Array:
    """Return a plane with a cutting of 40 m by 6 m."""
    return np.where(np.abs(x - 80) < 20, 14.0, 20.0)


METRE = with_values(Params(), {"surface": {"cell_m": 1.0}})
DECKS: dict[str, Box] = {"narrow": (70, 60, 4, 40, 6.0), "wide": (70, 60, 12, 40, 6.0)}


def level(values: Array, valid: NDArray[np.bool_] | None = None) -> Grid:
    """Return heights as a grid on cells of 1 m."""
    valid = np.ones(values.shape, dtype=bool) if valid is None else valid
    spec = lattice((0.0, 0.1, values.shape[1] - 0.1, values.shape[0]), 1.0, CRS_M)
    return Grid(np.where(valid, values, 0).astype(np.float32), valid, spec)


def cells_of(box: Box) -> NDArray[np.bool_]:
    """Return the cells of a box."""
    row, col, height, width, _ = box
    inside = np.zeros((160, 160), dtype=bool)
    inside[row : row + height, col : col + width] = True
    return inside


@pytest.mark.parametrize("given", ["class2", "terrain", "build"])
@pytest.mark.parametrize("name", list(DECKS))
def test_a_given_ground_is_raised_to_the_decks_of_bridges(name, given):
    """Class 2 and terrain models leave bridges out; roofs stay above the ground, also one beside the deck.

    Echoes from below divide a narrow deck, and half of a wide one.
    """
    roofs: tuple[Box, ...] = ((20, 20, 12, 16, 7.0), (90, 66, 10, 12, 6.0))
    points, truth = world(cutting, (DECKS[name], *roofs))
    deck = cells_of(DECKS[name])
    row, _, height, _, _ = DECKS[name]
    y = np.repeat(160 - (np.arange(row, row + min(height, 6)) + 0.3), 2)
    below = np.resize([75.5, 76.5], y.size), y, np.full(y.size, 14.0)
    x, y, z = (np.append(*axes) for axes in zip((points.x, points.y, points.z), below, strict=True))
    built = np.logical_or.reduce([cells_of(box) for box in (DECKS[name], *roofs)]).ravel()
    classes = np.append(np.where(built, 1, 2), np.full(len(x) - built.size, 2)).astype(np.uint8)
    every = PointCloud(x, y, z, CRS_M, classification=classes)
    ways: dict[str, Callable[[], Grid]] = {
        "class2": lambda: terrain(every, level(truth).spec, PARAMS)[0],
        "build": lambda: build_surface(every, METRE, lambda _: level(truth)).dtm,
    }
    with pytest.warns(MsbdbWarning, match="leaves out bridges"):
        dtm = ways.get(given, lambda: with_decks(level(truth), every, PARAMS))()
    rows, cols = dtm.spec.rowcol(*level(truth).spec.centres())
    found = np.asarray(dtm.values)[rows, cols]
    assert np.abs(found[deck] - 20).max() < 0.2
    away = ~binary_dilation(deck, iterations=2)
    assert np.abs(found - truth)[away].max() < 0.2


def test_a_deck_as_low_as_no_building_leaves_a_given_ground_alone():
    """A footbridge of 80 cm over a ditch."""
    ditch: Box = (70, 60, 4, 40, 0.8)
    points, truth = world(lambda x, y: 20 - (20 - cutting(x, y)) * 0.8 / 6, (ditch,))
    given = level(truth)
    assert with_decks(given, points, PARAMS) is given


@pytest.mark.parametrize(("relief", "boxes"), [(ridge, HILLTOWN), (flat, HOUSES)], ids=["hills", "flat"])
def test_a_given_ground_without_bridges_stays_as_it_is(relief, boxes):
    """Also one with gaps: what lies in them is no deck that the ground leads to."""
    points, truth = world(relief, boxes)
    for valid in (None, np.indices(truth.shape)[0] > 30):
        given = level(truth, valid)
        assert with_decks(given, points, PARAMS) is given

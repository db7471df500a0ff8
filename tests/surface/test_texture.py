"""Texture: residuals of planes and shares of echoes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from pyproj import CRS

from msbdb.grid import Grid, GridSpec, lattice
from msbdb.points.cloud import PointCloud
from msbdb.surface.gridding import Samples, sample_nearest
from msbdb.surface.heights import surface_from_rasters
from msbdb.surface.texture import (
    JITTER,
    LEAST_SAMPLES,
    NO_PLANE_M,
    STEEPEST,
    Echoes,
    _plane_residual,
    echoes,
    grid_samples,
    roughness,
    scatter,
    window_cells,
)

CRS_M = CRS.from_epsg(32633)


def spec_of(rows: int, cols: int, cell_m: float = 0.5) -> GridSpec:
    """Return a lattice of the shape."""
    return lattice((0, 1e-6, (cols - 0.5) * cell_m, rows * cell_m), cell_m, CRS_M)


def scattered(surface, seed: int = 0, side_m: float = 20.0, density: float = 4.0) -> PointCloud:
    """Echoes of a jittered scan of a square, on a surface z(x, y)."""
    count = round(side_m * np.sqrt(density))
    row, col = np.indices((count, count)).reshape(2, -1)
    jitter = np.random.default_rng(seed).uniform(-0.4, 0.4, (2, row.size))
    x, y = (col + 0.5 + jitter[0]) * side_m / count, (row + 0.5 + jitter[1]) * side_m / count
    return PointCloud(x, y, surface(x, y), CRS_M)


@pytest.mark.parametrize("gradient", [(0.0, 0.0), (0.3, -0.1), (1.0, 1.0), (5.0, -3.0)])
def test_a_plane_of_any_slope_is_smooth(gradient):
    """Heights are those of the echoes' own places, so that slope is no roughness, nor is the edge of the data."""
    points = scattered(lambda x, y: 400 + gradient[0] * x + gradient[1] * y)
    samples = sample_nearest(points, spec_of(40, 40))
    for window in (1.5, 2.5):
        assert roughness(samples, window).max() < 1e-3


def test_a_roof_is_smooth_up_to_its_edges():
    """A step of 10 m between two planes stays sharp: each cell is judged by a window on its own side."""
    points = scattered(lambda x, y: np.where(x < 10, 0.2 * y, 10 - 0.3 * x), density=16)
    samples = sample_nearest(points, spec_of(80, 80, 0.25))
    assert np.quantile(roughness(samples, 1.25), 0.98) < 0.02


def test_a_crown_is_rough():
    """Echoes at random depths of a crown lie far from any plane."""
    rng = np.random.default_rng(1)
    points = scattered(lambda x, _: 10 - rng.exponential(1.0, x.size))
    found = roughness(sample_nearest(points, spec_of(40, 40)), 2.5)
    assert np.median(found) > 0.4


def naive_residual(samples: Samples, half: int) -> NDArray[np.float64]:
    """Fit a plane to each window by numpy's least squares."""
    rows, cols = samples.spec.shape
    out = np.full(samples.spec.shape, NO_PLANE_M)
    row, col = np.indices(samples.spec.shape)
    east = col * samples.spec.cell_m + samples.east
    north = -row * samples.spec.cell_m + samples.north
    for r in range(rows):
        for c in range(cols):
            window = np.s_[max(r - half, 0) : r + half + 1, max(c - half, 0) : c + half + 1]
            seen = samples.observed[window]
            e, n, z = east[window][seen], north[window][seen], samples.z[window][seen]
            if z.size < LEAST_SAMPLES:
                continue
            plane = np.column_stack([np.ones(z.size), e - e.mean(), n - n.mean()])
            moments = plane.T @ plane
            if np.linalg.det(moments[1:, 1:]) <= 1e-4 * (z.size * samples.spec.cell_area_m2) ** 2:
                continue
            fit, *_ = np.linalg.lstsq(plane, z, rcond=None)
            variance, steep = np.sum((z - plane @ fit) ** 2) / (z.size - 3), fit[1] ** 2 + fit[2] ** 2
            unknown = JITTER * samples.within_m**2 / 12 if steep <= STEEPEST else 0.0
            out[r, c] = min(np.sqrt(max(variance - unknown * steep, 0.0)), NO_PLANE_M)
    return out


def naive_best(values: NDArray[np.float64], half: int) -> NDArray[np.float64]:
    """Take the least value of all windows that hold the cell."""
    out = np.empty_like(values)
    for r, c in np.ndindex(values.shape):
        out[r, c] = values[max(r - half, 0) : r + half + 1, max(c - half, 0) : c + half + 1].min()
    return out


@given(
    st.integers(0, 10_000),
    st.sampled_from([(1, 9), (6, 5), (9, 8)]),
    st.sampled_from([1.5, 2.5]),
    st.booleans(),
    st.sampled_from([(3.0, 0.0), (0.2, 0.0), (0.2, 0.5)]),
)
def test_the_kernel_agrees_with_least_squares(seed, shape, window_m, sparse, noise_within):
    """Sums by columns give the residuals of numpy's fit, with gaps, at borders and far from height 0."""
    rng = np.random.default_rng(seed)
    noise_m, within_m = noise_within
    z = 1000 + rng.uniform(-1, 1) * np.indices(shape)[1] + rng.normal(0, noise_m, shape)
    z[rng.random(shape) < (0.7 if sparse else 0.1)] = np.nan
    east, north = rng.uniform(-0.25, 0.25, (2, *shape)).astype(np.float32)
    samples = Samples(z, east, north, spec_of(*shape), within_m)
    half = window_cells(window_m, 0.5) // 2
    expected = naive_best(naive_residual(samples, half), half)
    np.testing.assert_allclose(roughness(samples, window_m), expected, atol=1e-4)


@pytest.mark.parametrize(("half", "seen_share"), [(1, 0.7), (1, 1.0), (2, 0.4), (2, 1.0), (4, 1.0)])
def test_noise_is_as_rough_under_few_samples_as_under_many(half, seen_share):
    """Noise of 0.2 m over a slope has a mean squared residual of 0.04 m2, whatever the number of samples."""
    rng = np.random.default_rng(3)
    cells = np.indices((150, 150)).sum(axis=0)
    z = np.where(rng.random(cells.shape) < seen_share, 0.3 * cells + rng.normal(0, 0.2, cells.shape), np.nan)
    zero = np.zeros(cells.shape, dtype=np.float32)
    residual = _plane_residual(z, (zero, zero, 0.0), 40.0, 0.5, (half, LEAST_SAMPLES))
    assert np.mean(residual[residual < NO_PLANE_M] ** 2) == pytest.approx(0.04, rel=0.05)


def test_without_a_plane_the_largest_roughness_stands():
    """Too few echoes, echoes in a line, and none at all tell no plane."""
    z = np.full((5, 5), np.nan)
    zero = np.zeros((5, 5), dtype=np.float32)
    assert np.all(roughness(Samples(z, zero, zero, spec_of(5, 5)), 1.5) == NO_PLANE_M)
    z[2] = 1.0
    assert np.all(roughness(Samples(z, zero, zero, spec_of(5, 5)), 2.5) == NO_PLANE_M)


def test_four_echoes_tell_no_plane_and_five_do():
    """Four echoes of a crown lie on a plane, or nearly, wherever they are."""
    zero = np.zeros((3, 3), dtype=np.float32)
    corners = np.array([[1, np.nan, 1], [np.nan] * 3, [1, np.nan, 1.0]])
    assert np.all(roughness(Samples(corners, zero, zero, spec_of(3, 3)), 1.5) == NO_PLANE_M)
    corners[1, 1] = 1.0
    assert np.all(roughness(Samples(corners, zero, zero, spec_of(3, 3)), 1.5) == 0)


@pytest.mark.parametrize(("measured", "least", "known"), [(5, 5, True), (4, 5, False), (7, 7, True), (6, 7, False)])
def test_fewer_samples_make_no_plane(measured, least, known):
    """On a plane of 5 by 5 cells; where the samples do not lie on a line."""
    z = np.full((5, 5), np.nan)
    cells = np.random.default_rng(measured).permutation(25)[:measured]
    z.ravel()[cells] = np.indices((5, 5)).sum(axis=0).ravel()[cells]
    zero = np.zeros((5, 5), dtype=np.float32)
    found = roughness(Samples(z, zero, zero, spec_of(5, 5)), 5 * spec_of(5, 5).cell_m, least)
    np.testing.assert_allclose(found, 0.0 if known else NO_PLANE_M, atol=1e-6)


@pytest.mark.parametrize(("slope", "share"), [(0.0, 0.0), (0.5, 0.5), (1.0, 0.5), (2.0, 1.0)])
def test_a_slope_is_rough_where_the_places_of_heights_are_unknown(slope, share):
    """Half of what places by chance make of a roof is left, and all of what they make of a crown's side."""
    rng, cells = np.random.default_rng(1), np.indices((300, 300))[1]
    z = slope * 0.5 * (cells + rng.uniform(-0.5, 0.5, cells.shape))
    grid = Grid(z, np.ones(z.shape, dtype=np.bool_), spec_of(*z.shape))
    inside = scatter(grid_samples(grid, 0.5), 1.5)[1:-1, 1:-1]
    variance = np.mean(inside**2)
    assert variance == pytest.approx(share * slope**2 * 0.5**2 / 12, rel=0.1, abs=1e-9)


@pytest.mark.parametrize(("cell_m", "within_m"), [(0.25, 0.25), (1.0, 1.0), (2.0, 0.0)])
def test_places_in_rasters_are_unknown(cell_m, within_m):
    """Up to cells of a metre, beyond which a window of the texture is wider than a roof's side."""
    spec = spec_of(4, 4, cell_m)
    flat = Grid(np.zeros(spec.shape, dtype=np.float32), np.ones(spec.shape, dtype=np.bool_), spec)
    assert surface_from_rasters(flat, flat).samples.within_m == within_m


def test_a_raster_is_sampled_at_its_centres():
    """Its cells that are not valid are no samples."""
    valid = np.array([[True, False], [True, True]])
    samples = grid_samples(Grid(np.array([[1, 0], [3, 4]], dtype="f4"), valid, spec_of(2, 2)))
    np.testing.assert_array_equal(samples.observed, valid)
    assert not samples.east.any()
    assert not samples.north.any()


ECHO_SPEC = spec_of(6, 7, 1.0)


def echo_scene(seed: int) -> tuple[PointCloud, Grid, Grid]:
    """Random pulses of one to three echoes over random heights and a tilted terrain."""
    rng = np.random.default_rng(seed)
    count = 200
    of = rng.integers(1, 4, count).astype(np.uint8)
    number = np.minimum(rng.integers(1, 4, count), of).astype(np.uint8)
    x, y = rng.uniform(0, 6.4, count), rng.uniform(0.1, 5.9, count)
    ground = np.broadcast_to(np.linspace(10, 12, ECHO_SPEC.shape[1], dtype=np.float32), ECHO_SPEC.shape).copy()
    height = rng.uniform(0, 12, ECHO_SPEC.shape).astype(np.float32)
    points = PointCloud(x, y, rng.uniform(8, 26, count), CRS_M, None, None, number, of)
    valid = np.ones(ECHO_SPEC.shape, dtype=bool)
    return points, Grid(height, valid, ECHO_SPEC), Grid(ground, valid, ECHO_SPEC)


def naive_share(part: NDArray[np.bool_], whole: NDArray[np.bool_], cells: NDArray[np.int64], size: int) -> NDArray:
    """Count the points of each window one window at a time."""
    half = size // 2
    shares = np.zeros(ECHO_SPEC.shape)
    for r, c in np.ndindex(shares.shape):
        near = (np.abs(cells[0] - r) <= half) & (np.abs(cells[1] - c) <= half)
        shares[r, c] = np.count_nonzero(part & whole & near) / max(np.count_nonzero(whole & near), 1)
    return shares


@given(st.integers(0, 10_000))
def test_the_shares_of_echoes_are_those_counted_by_hand(seed):
    """Split first echoes and stopped last ones, by window, each from its own points."""
    points, ndsm, dtm = echo_scene(seed)
    found = echoes(points, ndsm, dtm, small_m=3.0, wide_m=5.0, mask_m=2.0)
    assert isinstance(found, Echoes)
    cells = np.array(ECHO_SPEC.rowcol(points.x, points.y))
    above = (points.z - np.asarray(dtm.values)[tuple(cells)]).astype(np.float32)
    surface = np.asarray(ndsm.values)
    first, last = (points.return_number == 1) & (above > 2), points.return_number == points.number_of_returns
    stops = above > np.maximum(2, surface[tuple(cells)] / 2)
    small = naive_share(points.number_of_returns > 1, first, cells, 3)
    wide = naive_share(points.number_of_returns > 1, first, cells, 5)
    solid = naive_share(stops, last, cells, 5)
    np.testing.assert_allclose(found.split, small, atol=1e-5)
    np.testing.assert_allclose(found.split_best, naive_best(np.where(surface > 2, small, 1), 1), atol=1e-5)
    np.testing.assert_allclose(found.split_wide, naive_best(np.where(surface > 2, wide, 1), 2), atol=1e-5)
    np.testing.assert_allclose(found.solid, -naive_best(-solid, 2), atol=1e-5)


@pytest.mark.parametrize("returns", [None, 1])
def test_a_source_without_echoes_tells_nothing(returns):
    """Neither without the attributes nor where every pulse has one echo."""
    points, ndsm, dtm = echo_scene(0)
    number = None if returns is None else np.ones(len(points), dtype=np.uint8)
    bare = PointCloud(points.x, points.y, points.z, CRS_M, None, None, number, number)
    assert echoes(bare, ndsm, dtm, small_m=3.0, wide_m=5.0, mask_m=2.0) is None


def test_windows_are_odd_and_hold_their_cell():
    """At least three cells, however small the window."""
    for window in (0.1, 1.0, 2.6, 9.0):
        cells = window_cells(window, 0.5)
        assert cells % 2 == 1
        assert cells >= 3
        assert abs(cells * 0.5 - window) <= 1.5

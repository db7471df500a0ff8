"""Gridding: nearest, lowest, density, cell size and the filling of gaps."""

from decimal import Decimal
from math import floor

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from pyproj import CRS
from scipy import ndimage

from msbdb.errors import NodataError
from msbdb.grid import GridSpec, lattice
from msbdb.params import Params, profile
from msbdb.points.cellindex import cell_place, index_cells
from msbdb.points.cloud import PointCloud
from msbdb.surface.gaps import fill_gaps, nearest_cells
from msbdb.surface.gridding import (
    CELL_LADDER_M,
    Samples,
    cell_size,
    count_first,
    density,
    lowest,
    sample_nearest,
)
from msbdb.surface.heights import grid_surface

CRS_M = CRS.from_epsg(32633)
SPEC = lattice((0.0, 0.0, 3.9, 3.9), 1.0, CRS_M)

EIGHTHS = st.integers(0, 31).map(lambda n: n / 8)
POINTS = st.lists(
    st.tuples(EIGHTHS, EIGHTHS, st.integers(-3, 3).map(float), st.integers(1, 2)), min_size=1, max_size=40
)


def cloud(rows: list[tuple[float, ...]]) -> PointCloud:
    """Points of x, y, z and, where given, their return number of two."""
    table = np.array([(*row, 1) if len(row) == 3 else row for row in rows], dtype=np.float64)
    number = table[:, 3].astype(np.uint8)
    return PointCloud(table[:, 0], table[:, 1], table[:, 2], CRS_M, None, None, number, np.full(len(table), 2, "u1"))


def grid_points(side_m: float, spacing_m: float) -> PointCloud:
    """Points at the centres of square cells over a square."""
    at = np.arange(spacing_m / 2, side_m, spacing_m)
    x, y = (a.ravel() for a in np.meshgrid(at, at))
    return PointCloud(x, y, np.zeros(x.size), CRS_M)


def naive_nearest(points: PointCloud, spec: GridSpec, parts: int = 1, below_m: float = np.inf) -> NDArray[np.float64]:
    """Sort the first echoes near the tops of their squares by distance and height, and take each cell's first."""
    z = np.full(spec.shape, np.nan)
    row, col = spec.rowcol(points.x, points.y)
    east, north = spec.xy(row, col)
    distance = (points.x - east) ** 2 + (points.y - north) ** 2
    right, down = (np.floor((off / spec.cell_m + 0.5) * parts) for off in (points.x - east, north - points.y))
    for r in range(spec.shape[0]):
        for c in range(spec.shape[1]):
            here = [
                (d, h, place)
                for d, h, *at, place, n in zip(
                    distance, points.z, row, col, zip(right, down, strict=True), points.return_number, strict=True
                )
                if at == [r, c] and n == 1
            ]
            near = [
                (d, h) for d, h, place in here if h >= max(top for _, top, other in here if other == place) - below_m
            ]
            if near:
                z[r, c] = min(near)[1]
    return z


@given(POINTS)
def test_each_cell_takes_the_first_echo_nearest_to_its_centre(rows):
    """The kernel agrees with a sort by distance and height; later echoes play no part."""
    points = cloud(rows)
    samples = sample_nearest(points, SPEC)
    np.testing.assert_array_equal(samples.z, naive_nearest(points, SPEC))
    np.testing.assert_array_equal(samples.observed, np.isfinite(samples.z))


@pytest.mark.parametrize(("cell_m", "parts", "below_m"), [(0.5, 2, 0.25), (0.5, 2, 1.5), (1.0, 3, 0.5), (1.0, 3, 1.5)])
def test_a_roof_goes_on_over_the_wall_below_its_edge(cell_m, parts, below_m):
    """The kernel agrees with a sort of the echoes at the tops of their squares, where these are far above and go on."""
    raised = kept = 0
    for seed in range(20):
        random = np.random.default_rng(seed)
        place, number = random.integers(0, 32, (300, 2)), random.integers(1, 3, 300)
        height = random.choice([0.0, 0.5, 1.25, 1.5, 2.0, 2.0, 2.0], 300)
        points = cloud(np.column_stack((place / 8 + (300, 600), height, number)))
        spec = lattice((300.0, 600.0, 303.9, 603.9), cell_m, CRS_M)
        nearest, high = naive_nearest(points, spec), naive_nearest(points, spec, parts, 0.5)
        around = sliding_window_view(np.pad(nearest, 1, constant_values=np.nan), (3, 3))
        level = (np.abs(around - high[..., None, None]) <= 0.5).sum(axis=(2, 3)) - (np.abs(nearest - high) <= 0.5)
        above = high - nearest > below_m
        samples = sample_nearest(points, spec, below_m)
        np.testing.assert_array_equal(samples.z, np.where(above & (level >= 3), high, nearest))
        raised, kept = raised + np.count_nonzero(above & (level >= 3)), kept + np.count_nonzero(above & (level < 3))
        east, north = spec.xy(*np.nonzero(samples.observed))
        at = np.column_stack((east + samples.east[samples.observed], north + samples.north[samples.observed]))
        of_points = np.column_stack((points.x, points.y, points.z))[points.first_echo].tolist()
        assert all(row in of_points for row in np.column_stack((at, samples.z[samples.observed])).tolist())
    assert min(raised, kept) > 5


def test_echoes_on_a_wall_do_not_fray_the_edge_of_a_roof():
    """On the surface a level roof ends at its wall, whatever the wall's echoes and the ground beside its foot are."""
    random = np.random.default_rng(3)
    x, y = random.uniform(0, 12, (2, 12_000))
    roof = x < 6
    wall = np.column_stack([random.uniform(low, high, 900) for low, high in ((5.8, 5.99), (0, 12), (0, 6))])
    points = PointCloud(*np.vstack((np.column_stack((x, y, 6.0 * roof)), wall)).T, CRS_M)
    spec = lattice((0.0, 0.0, 11.9, 11.9), 0.3, CRS_M)
    # Vu et al. take the nearest echo of all.
    frayed, sharp = (grid_surface(points, spec, params)[0].values for params in (profile("vu2009"), Params()))
    edge = spec.rowcol(np.array([5.95]), np.array([6.0]))[1][0]
    assert (frayed[:, : edge + 1] < 4.5).any(axis=1).mean() > 0.4
    assert (sharp[:, : edge + 1] < 4.5).any(axis=1).mean() < 0.05
    assert (sharp[:, edge + 2 :] == 0).all()


def test_ties_go_to_the_lower_point():
    """Of two first echoes equally far from the centre the lower one counts, whichever comes first."""
    rows = [(0.25, 0.5, 5.0), (0.75, 0.5, 3.0)]
    for order in (rows, rows[::-1]):
        assert sample_nearest(cloud(order), SPEC).z[3, 0] == 3.0


def test_the_offset_leads_from_the_centre_to_the_echo():
    """Easting and northing of the sample are those of the point."""
    spec = lattice((0, 0.1, 0.9, 1.0), 1.0, CRS_M)
    samples = sample_nearest(cloud([(0.75, 0.125, 1.0)]), spec)
    row, col = spec.rowcol(np.array([0.75]), np.array([0.125]))
    assert (samples.east[row, col], samples.north[row, col]) == (0.25, -0.375)


@given(POINTS, st.randoms(use_true_random=False))
def test_the_order_of_the_points_does_not_matter(rows, random):
    """Shuffled points give the same samples, lowest heights and density, bit for bit."""
    shuffled = rows.copy()
    random.shuffle(shuffled)
    one, other = cloud(rows), cloud(shuffled)
    for below_m in (0.0, 1.0):
        a, b = sample_nearest(one, SPEC, below_m), sample_nearest(other, SPEC, below_m)
        for name in ("z", "east", "north"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    np.testing.assert_array_equal(lowest(one, SPEC).values, lowest(other, SPEC).values)
    if one.first_echo.any():
        assert density(one) == density(other)


@given(POINTS)
def test_the_lowest_point_of_a_cell_is_its_value(rows):
    """All echoes count, or the chosen ones; cells without one are not valid and hold 0."""
    points = cloud(rows)
    for chosen in (None, points.z > 0):
        found = lowest(points, SPEC, chosen)
        expected = np.full(SPEC.shape, np.inf)
        keep = np.ones(len(points), dtype=bool) if chosen is None else chosen
        row, col = SPEC.rowcol(points.x[keep], points.y[keep])
        np.minimum.at(expected, (row, col), points.z[keep])
        np.testing.assert_array_equal(found.valid, np.isfinite(expected))
        np.testing.assert_array_equal(found.values, np.where(found.valid, expected, 0))


def test_points_outside_of_the_lattice_are_left_out():
    """A smaller lattice takes its own points alone."""
    points = cloud([(-5.0, 2.0, 1.0), (2.0, 99.0, 2.0), (1.5, 1.5, 3.0)])
    assert np.count_nonzero(sample_nearest(points, SPEC).observed) == 1
    assert np.count_nonzero(lowest(points, SPEC).valid) == 1


def test_density_counts_first_echoes_on_covered_ground():
    """Empty ground between two fields does not thin the density; later echoes do not thicken it."""
    field = grid_points(20, 0.5)
    x = np.concatenate([field.x, field.x + 200, field.x])
    y = np.concatenate([field.y, field.y, field.y])
    number = np.repeat([1, 1, 2], len(field)).astype(np.uint8)
    points = PointCloud(x, y, np.zeros(x.size), CRS_M, None, None, number, number)
    assert density(points) == pytest.approx(4.0)


def test_the_density_of_sparse_points_is_their_own():
    """Single points do not count as ground of 2 m each, which would bound the density from below."""
    assert density(grid_points(200, 10)) == pytest.approx(1 / 100, rel=0.15)


@pytest.mark.parametrize("points_m2", [0.3, 0.5, 0.8])
def test_cells_that_random_points_miss_are_covered_as_well(points_m2):
    """Of the cells of 2 m a third has no point at 0.3 points a square metre; the ground is covered all the same."""
    x, y = np.random.default_rng(3).uniform(0, 200, (2, round(points_m2 * 200**2)))
    assert density(PointCloud(x, y, np.zeros(x.size), CRS_M)) == pytest.approx(points_m2, rel=0.06)


@pytest.mark.parametrize("away_m", [1e3, 1e5, 1e7])
def test_islands_far_apart_have_the_density_of_one(away_m):
    """Nothing between them counts, however far they are: two fields of 4 points/m2 have 4 points/m2."""
    field = grid_points(20, 0.5)
    x, y = np.concatenate([field.x, field.x + away_m]), np.concatenate([field.y, field.y + away_m])
    assert density(PointCloud(x, y, np.zeros(x.size), CRS_M)) == pytest.approx(4.0)


def test_without_first_echoes_there_is_no_surface():
    """The message names what is missing."""
    with pytest.raises(NodataError, match="first echo"):
        density(cloud([(1, 1, 1, 2), (2, 2, 2, 2)]))


@pytest.mark.parametrize(
    ("points_m2", "cell_m"), [(1.0, 1.0), (4.0, 0.5), (11.0, 0.3), (0.25, 2.0), (400, 0.3), (1e-4, 5)]
)
def test_the_cell_is_the_mean_spacing_on_the_ladder(points_m2, cell_m):
    """1/sqrt(density), snapped to the nearest round value (V14)."""
    assert cell_size(points_m2) == cell_m


@given(st.floats(1e-3, 1e3))
def test_no_cell_of_the_ladder_is_nearer_to_the_spacing(points_m2):
    """The nearest by ratio is taken."""
    spacing = points_m2**-0.5
    ratios = {cell: abs(np.log(cell / spacing)) for cell in CELL_LADDER_M}
    assert ratios[cell_size(points_m2)] == pytest.approx(min(ratios.values()))


def samples_of(
    values: NDArray, observed: NDArray, east: NDArray | float = 0.0, north: NDArray | float = 0.0
) -> Samples:
    """Return samples of 1 m cells, at their centres unless offsets are given."""
    spec = lattice((0, 0.1, values.shape[1] - 0.1, values.shape[0]), 1.0, CRS_M)
    zero = np.zeros(values.shape, dtype=np.float32)
    z = np.where(observed, values, np.nan).astype(np.float64)
    return Samples(z, (zero + east).astype("f4"), (zero + north).astype("f4"), spec)


def test_a_gap_takes_the_echo_that_is_really_nearest():
    """Of four cells around a gap the one whose echo leans towards it counts, in any direction."""
    observed = np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]], dtype=bool)
    values = np.arange(9.0).reshape(3, 3)
    for at, east, north in (((0, 1), 0, -0.4), ((2, 1), 0, 0.4), ((1, 0), 0.4, 0), ((1, 2), -0.4, 0)):
        offsets = np.zeros((2, 3, 3))
        offsets[:, at[0], at[1]] = east, north
        filled, _ = fill_gaps(samples_of(values, observed, *offsets), 1.0)
        assert filled[1, 1] == values[at]


def test_of_samples_equally_near_the_lower_one_counts():
    """So a raster's gaps are filled alike whichever way it is turned."""
    observed = np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]], dtype=bool)
    values = np.array([[0, 7, 0], [3, 0, 5], [0, 4, 0]], dtype=np.float64)
    for turn in range(4):
        filled, _ = fill_gaps(samples_of(np.rot90(values, turn), np.rot90(observed, turn)), 1.0)
        assert filled[1, 1] == 3.0


def naive_fill(samples: Samples, reach: float) -> tuple[NDArray, NDArray]:
    """Look at every observed cell for every empty one."""
    rows, cols = np.nonzero(samples.observed)
    z = samples.z[rows, cols]
    filled, valid = np.where(samples.observed, samples.z, 0.0), samples.observed.copy()
    for row, col in np.argwhere(~samples.observed):
        near = np.hypot(rows - row, cols - col) <= reach
        if near.any():
            east = cols - col + samples.east[rows, cols].astype(np.float64)
            north = row - rows + samples.north[rows, cols].astype(np.float64)
            order = np.lexsort((z, east**2 + north**2))
            filled[row, col] = z[order[near[order]][0]]
            valid[row, col] = True
    return filled, valid


@given(
    st.lists(st.sampled_from([False, False, True]), min_size=42, max_size=42),
    st.sampled_from([0.0, 1.0, 2.0, 2.5, 3.4, 100.0]),
    st.integers(0, 1000),
)
def test_gaps_agree_with_a_search_of_all_samples(bits, reach, seed):
    """Cells farther than the reach stay invalid and hold 0; observed cells keep their value.

    All echoes of a column lean alike, since the kernel looks at the nearest observed cells of a column alone.
    """
    rng = np.random.default_rng(seed)
    observed = np.array(bits).reshape(6, 7)
    samples = samples_of(rng.integers(0, 9, (6, 7)), observed, rng.integers(-3, 4, (1, 7)) / 8)
    filled, valid = fill_gaps(samples, reach)
    expected, reached = naive_fill(samples, reach)
    np.testing.assert_array_equal(valid, reached)
    np.testing.assert_array_equal(filled, expected)


@given(POINTS)
def test_first_echoes_are_counted_by_cell(rows: list[tuple[float, ...]]) -> None:
    """One by one; second echoes do not count."""
    points = cloud(rows)
    expected = np.zeros(SPEC.shape, dtype=np.int64)
    for row, col, first in zip(*SPEC.rowcol(points.x, points.y), points.first_echo, strict=True):
        expected[row, col] += int(first)
    np.testing.assert_array_equal(count_first(points, SPEC), expected)


def test_counts_stop_at_what_they_hold() -> None:
    """They do not start again at 0."""
    many = PointCloud(np.full(70_000, 0.5), np.full(70_000, 0.5), np.zeros(70_000), CRS_M)
    assert count_first(many, SPEC).max() == 65_535


def on_edges(numbers: list[tuple[int, int, int]], cell_m: float, first: int) -> tuple[NDArray[np.int64], Decimal]:
    """Return places in whole millimetres on the edges of cells, and a few beside them; and the cell exactly."""
    cell = Decimal(str(cell_m))
    beside = np.array([(first + number) * int(cell * 1000) + shift for number, shift, _ in numbers])
    return beside, cell


@given(
    st.lists(st.tuples(st.integers(0, 40), st.integers(-1, 1), st.integers(0, 40)), min_size=1, max_size=30),
    st.sampled_from(CELL_LADDER_M),
    st.tuples(st.integers(-9_000_000, 9_000_000), st.integers(-9_000_000, 9_000_000)),
    st.data(),
)
def test_no_window_changes_the_cell_of_a_point(numbers, cell_m, first, data):
    """A point has the cell of exact arithmetic, on edges too, whichever points are gridded with it."""
    x_mm, cell = on_edges(numbers, cell_m, first[0])
    y_mm, _ = on_edges([number[::-1] for number in numbers], cell_m, first[1])
    y_mm += np.array([shift for _, shift, _ in numbers])
    exact = [
        (floor(-Decimal(int(y)) / 1000 / cell), floor(Decimal(int(x)) / 1000 / cell))
        for x, y in zip(x_mm, y_mm, strict=True)
    ]
    x, y = x_mm * 0.001, y_mm * 0.001
    chosen = np.array(data.draw(st.lists(st.booleans(), min_size=len(x), max_size=len(x))))
    chosen[data.draw(st.integers(0, len(x) - 1))] = True
    window = PointCloud(x[chosen], y[chosen], np.zeros(np.count_nonzero(chosen)), CRS_M)
    spec = lattice(window.bounds, cell_m, CRS_M)
    expected = [place for place, own in zip(exact, chosen, strict=True) if own]
    row, col = spec.rowcol(window.x, window.y)
    assert list(zip(row + spec.origin[0], col + spec.origin[1], strict=True)) == expected
    assert spec.inside(row, col).all()
    held = np.argwhere(count_first(window, spec)) + spec.origin
    assert set(map(tuple, held.tolist())) == set(expected)
    index = index_cells(window.x, window.y, cell_m)
    for cell_number in range(index.keys.size):
        north, east = cell_place(index, cell_number)
        own = index.order[index.starts[cell_number] : index.starts[cell_number + 1]]
        assert {expected[point][1] for point in own} == {east + round(index.west / cell_m)}
        exact_north = {floor(Decimal(int(y_mm[chosen][point])) / 1000 / cell) for point in own}
        assert exact_north == {north + round(index.south / cell_m)}


@given(POINTS, st.data())
def test_no_window_changes_the_samples_of_a_cell(rows, data):
    """Heights and offsets of the nearest echoes are the same to the last bit, also of points as far from the centre."""
    table = np.array(rows)
    # Eighths become tenths of a metre, so that edges and ties of cells of 0.3 m are met.
    x, y = np.round(table[:, :2].T * 8) * 0.1 + np.array([[100_000.0], [5_000_000.0]])
    points = PointCloud(x, y, table[:, 2], CRS_M)
    cell_m, below_m = data.draw(st.sampled_from([(0.3, 0.0), (0.6, 1.0)]))
    whole = sample_nearest(points, lattice(points.bounds, cell_m, CRS_M), below_m)
    chosen = y >= data.draw(st.sampled_from(y.tolist()))
    chosen &= x <= data.draw(st.sampled_from(x[chosen].tolist()))
    part = points.take(chosen)
    window = sample_nearest(part, lattice(part.bounds, cell_m, CRS_M), below_m)
    row, col = (own - first for own, first in zip(window.spec.origin, whole.spec.origin, strict=True))
    cells = np.s_[row : row + window.spec.shape[0], col : col + window.spec.shape[1]]
    full = window.observed & (count_first(part, window.spec) == count_first(points, whole.spec)[cells])
    if below_m > 0:
        # The neighbours have a say. What lies beyond the window has none, so it must be empty.
        alike = np.pad(count_first(part, window.spec), ((row, 0), (col, 0)))
        alike = np.pad(alike, [(0, total - own) for total, own in zip(whole.spec.shape, alike.shape, strict=True)])
        full &= ndimage.minimum_filter(alike == count_first(points, whole.spec), 3, mode="nearest")[cells]
    for own, all_of_them in ((window.z, whole.z), (window.east, whole.east), (window.north, whole.north)):
        np.testing.assert_array_equal(own[full], all_of_them[cells][full])


@given(st.integers(1, 9), st.integers(1, 9), st.sampled_from([0.0, 1.0, 1.5, 3.0, np.inf]), st.integers(0, 2**32 - 1))
def test_nearest_cells_are_those_of_a_distance_transform(height: int, width: int, reach: float, seed: int) -> None:
    """Ties too; what lies beyond the reach is not found, nor anything where no cell is known."""
    random = np.random.default_rng(seed)
    known = random.random((height, width)) < random.random()
    wanted = np.flatnonzero(random.random((height, width)) < 0.7)
    found = nearest_cells(known, wanted, reach)
    if not known.any():
        assert (found == -1).all()
        return
    distance, (row, col) = ndimage.distance_transform_edt(~known, return_indices=True)
    expected = np.where(distance <= reach, row * width + col, -1)
    np.testing.assert_array_equal(found, expected.ravel()[wanted])

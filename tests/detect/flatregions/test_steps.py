"""Each step of the detector of flat regions as a claim on a small array, and against its definition."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from affine import Affine
from hypothesis import given
from hypothesis import strategies as st
from pyproj import CRS
from scipy import ndimage
from skimage.measure import perimeter_crofton
from support.sizes import examples

from msbdb.detect.flatregions.binarisation import binarise, gradient_of, ratio_at
from msbdb.detect.flatregions.initialisation import denoise, fill_by_idw, find_outliers, initialise, window_px
from msbdb.detect.flatregions.recognition import FlatRegionLedger, clean, grow, measure_shapes, most_frequent_zone
from msbdb.errors import NodataError, ParameterError, TableError
from msbdb.grid import Grid, GridSpec
from msbdb.params import FlatRegionParams, profile
from msbdb.points.cloud import PointCloud

UTM = CRS.from_epsg(32633)
EIGHT = np.ones((3, 3))
PAPER = profile("mongus2013").flatregions


def spec_of(shape, cell_m=1.0):
    """Return a lattice of a shape."""
    return GridSpec(shape, Affine(cell_m, 0, 389_000.0, 0, -cell_m, 5_821_000.0), UTM)


def grid(values, valid=None, cell_m=1.0):
    """Return a grid of heights."""
    values = np.array(values, dtype=np.float32)
    valid = np.ones(values.shape, dtype=bool) if valid is None else np.array(valid, dtype=bool)
    return Grid(values, valid, spec_of(values.shape, cell_m))


def cloud(*points):
    """Return points given as (row, col, height) of cells of 1 m, from their upper left corner."""
    row, col, z = np.array(points, dtype=np.float64).T
    return PointCloud(x=389_000.0 + col, y=5_821_000.0 - row, z=z, crs=UTM)


# Initialisation


def test_the_lowest_point_of_a_cell_counts():
    """Of several points the lowest stands for the cell, whatever their order (M8)."""
    points = [(0.5, 0.5, 9.0), (0.2, 0.7, 3.0), (0.5, 1.5, 7.0), (0.9, 1.1, 8.0)]
    for order in (points, points[::-1]):
        g = initialise(cloud(*order), spec_of((1, 2)))
        assert g.values.tolist() == [[3.0, 7.0]]
        assert g.values.dtype == np.float32


def naive_idw(values, known, target):
    """Weigh the three nearest known cells, and all that are as near as the third, by 1/d² (Eq. 6)."""
    found = sorted((int(((cell - target) ** 2).sum()), values[tuple(cell)]) for cell in np.argwhere(known))
    limit = found[min(3, len(found)) - 1][0]
    near = [(1 / d, z) for d, z in found if d <= limit]
    return sum(w * z for w, z in near) / sum(w for w, _ in near)


@examples(50)
@given(st.integers(0, 2**32 - 1), st.integers(1, 9), st.integers(1, 9), st.floats(0.05, 0.95))
def test_empty_cells_are_weighted_means_of_the_nearest(seed, rows, cols, share):
    """Eq. 6 by its definition, with one known cell or many; known cells stay (M8)."""
    rng = np.random.default_rng(seed)
    values, known = rng.normal(size=(rows, cols)), rng.random((rows, cols)) < share
    known.flat[rng.integers(known.size)] = True
    filled = fill_by_idw(values, known, ~known)
    assert (filled[known] == values[known]).all()
    for cell in np.argwhere(~known):
        assert filled[tuple(cell)] == pytest.approx(naive_idw(values, known, cell))


def test_cells_far_from_all_are_filled_by_the_same_rule():
    """Beyond the reach of the search cell by cell the KD-tree takes over, with the same definition."""
    rng = np.random.default_rng(3)
    values, known = rng.normal(size=(30, 30)), np.zeros((30, 30), dtype=bool)
    known[:2, :3], known[-1, -2:] = True, True
    filled = fill_by_idw(values, known, ~known)
    for cell in ([15, 15], [29, 0], [3, 3], [1, 9], [20, 25]):
        assert filled[tuple(cell)] == pytest.approx(naive_idw(values, known, np.array(cell)))


def test_interpolation_prefers_no_direction():
    """A turned or mirrored grid gives the turned or mirrored result: equally near cells all count."""
    rng = np.random.default_rng(1)
    values, known = rng.normal(size=(12, 12)), rng.random((12, 12)) < 0.3
    filled = fill_by_idw(values, known, ~known)
    for turn in (np.rot90, np.flipud, np.transpose):
        assert turn(filled) == pytest.approx(fill_by_idw(turn(values), turn(known), ~turn(known)))


def test_far_cells_stay_open_unless_all_are_to_be_filled():
    """Beyond the gap a cell is invalid and 0; with 0 every cell of the box gets a value, as in the paper."""
    points = cloud(*[(0.5, c + 0.5, 5.0) for c in range(3)], (0.5, 11.5, 9.0))
    near = initialise(points, spec_of((1, 12)), max_gap_m=2.0)
    assert near.valid.tolist() == [[True] * 5 + [False] * 4 + [True] * 3]
    assert (near.values[~near.valid] == 0).all()
    everywhere = initialise(points, spec_of((1, 12)))
    assert everywhere.valid.all()
    assert ((everywhere.values >= 5) & (everywhere.values <= 9)).all()


def test_points_beyond_the_lattice_are_refused_when_none_is_left():
    """A lattice of another place is named."""
    with pytest.raises(NodataError, match="lattice"):
        initialise(cloud((50.5, 50.5, 1.0)), spec_of((3, 3)))
    with pytest.raises(NodataError, match="No cell has a value"):
        fill_by_idw(np.zeros((2, 2)), np.zeros((2, 2), dtype=bool), np.ones((2, 2), dtype=bool))


# Removal of outliers


@pytest.mark.parametrize(("size", "cell", "cells"), [(3, 0.3, 11), (3, 1, 3), (3, 0.5, 7), (1.5, 0.6, 3), (0.4, 1, 1)])
def test_windows_are_odd(size, cell, cells):
    """S in whole cells, and one more where that is even (M11)."""
    assert window_px(size, cell) == cells


@pytest.mark.parametrize(
    ("step", "peak", "valley"),
    [(3.9, False, False), (4.0, True, False), (-1.9, False, False), (-2.0, False, True), (-3.9, False, True)],
)
def test_peaks_from_four_cells_and_valleys_from_two(step, peak, valley):
    """The threshold is 4 R_g on peaks and 2 R_g in valleys, reached included (Eq. 9, 10; M10, M12)."""
    values = np.full((9, 9), 10.0)
    values[4, 4] += step
    peaks, valleys = find_outliers(grid(values), PAPER)
    assert (peaks[4, 4], valleys[4, 4]) == (peak, valley)
    assert np.count_nonzero(peaks | valleys) == peak + valley


@pytest.mark.parametrize("cell_m", [0.5, 1.0, 1.2, 2.0])
def test_a_peak_of_one_cell_is_found_on_cells_of_any_size(cell_m):
    """On cells above 1 m the least window of 3 cells is wider than S_I; without S_I there is none."""
    values = np.zeros((9, 9))
    values[4, 4] = 4 * cell_m
    found, _ = find_outliers(grid(values, cell_m=cell_m), FlatRegionParams(s_max_m=1.5, peak_factor=4.0))
    assert found[4, 4]
    found, _ = find_outliers(grid(values, cell_m=cell_m), FlatRegionParams(s_max_m=0.0, peak_factor=4.0))
    assert not found.any()


def test_what_is_wider_than_the_largest_window_stays():
    """A house of 4 m keeps its height, a chimney of 2 m does not (S_I = 3 m; M11)."""
    values = np.zeros((16, 16))
    values[2:6, 2:6], values[10:12, 10:12] = 8.0, 8.0
    clean_grid = denoise(grid(values), PAPER)
    assert clean_grid.peaks.sum() == 4
    assert clean_grid.peaks[10:12, 10:12].all()
    assert (clean_grid.grid.values[2:6, 2:6] == 8).all()
    assert (clean_grid.grid.values[9:, 9:] == 0).all()


def naive_outliers(values, cell_m, size_m=3.0):
    """Return peaks and valleys by Eq. 1, 4, 7 to 10 with scipy's openings."""

    def response(surface):
        levels = [surface]
        for window in range(3, window_px(size_m, cell_m) + 1, 2):
            low = ndimage.minimum_filter(surface, window, mode="constant", cval=np.inf)
            levels.append(ndimage.maximum_filter(low, window, mode="constant", cval=-np.inf))
        return np.max([a - b for a, b in pairwise(levels)], axis=0)

    up, down = response(values), response(-values)
    return (up > down) & (up >= 4 * cell_m), (up < down) & (down >= 2 * cell_m)


@examples(30)
@given(st.integers(0, 2**32 - 1))
def test_outliers_are_those_of_the_definition(seed):
    """Eq. 7 to 10 on random surfaces of whole metres."""
    rng = np.random.default_rng(seed)
    values = rng.integers(0, 8, (14, 11)).astype(np.float64)
    found = find_outliers(grid(values, cell_m=0.5), PAPER)
    for got, wanted in zip(found, naive_outliers(values, 0.5), strict=True):
        assert (got == wanted).all()


def test_outliers_are_refilled_from_the_others_only():
    """A peak beside another one takes nothing from it (M12)."""
    values = np.zeros((9, 9))
    values[4, 4:6] = 50.0
    assert (denoise(grid(values), PAPER).grid.values == 0).all()


def test_a_factor_of_zero_keeps_its_kind():
    """Without a factor for valleys a pit stays, while a peak goes."""
    values = np.zeros((9, 9))
    values[2, 2], values[6, 6] = 9.0, -9.0
    kept = denoise(grid(values), replace(PAPER, valley_factor=0.0)).grid.values
    assert (kept[2, 2], kept[6, 6]) == (0.0, -9.0)


# Binarisation


def naive_attribute_opening(values, weight, threshold):
    """Give each cell the highest level whose component around it has enough weight; the lowest level else."""
    result = np.full_like(values, values.min())
    for level in np.unique(values):
        labels, count = ndimage.label(values >= level, EIGHT)
        total = np.bincount(labels.ravel(), weights=weight.ravel(), minlength=count + 1)
        result[(labels > 0) & (total >= threshold)[labels]] = level
    return result


def naive_flat(values, weight, params, cell_area):
    """Return G by Eq. 12 to 14 and the last zone of each cell, zone by zone."""
    inner = np.arange(params.lambda_min_m2, params.lambda_max_m2, params.lambda_step_m2)
    limits = [0.0, *inner, params.lambda_max_m2]
    flat = np.zeros(values.shape, dtype=bool)
    previous = values
    for upper in limits[1:]:
        opened = naive_attribute_opening(values, weight * cell_area, upper)
        labels, count = ndimage.label(previous - opened > 0, EIGHT)
        area = np.bincount(labels.ravel(), minlength=count + 1) * cell_area
        flat |= (labels > 0) & (area >= params.ratio * upper)[labels]
        previous = opened
    return flat


@examples(60)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["surface", "ndsm"]))
def test_flat_regions_are_the_union_of_zonewise_area_openings(seed, on):
    """Eq. 11 to 14 by threshold decomposition, zone by zone, for the raw surface and for heights above ground."""
    rng = np.random.default_rng(seed)
    values = ndimage.zoom(rng.integers(0, 5, (4, 4)), 3, order=0) * 2.0
    values += rng.integers(0, 2, values.shape) * (rng.random(values.shape) < 0.2)
    params = replace(PAPER, on=on, lambda_min_m2=2.0, lambda_max_m2=60.0, lambda_step_m2=5.0)
    g = grid(values)
    found = binarise(g, g, params)
    weight = gradient_of(g, params)
    framed = np.pad(values, 1) if on == "ndsm" else values
    weight = np.pad(weight, 1) if on == "ndsm" else weight
    naive = naive_flat(framed, weight, params, 1.0)
    assert (found.flat == (naive[1:-1, 1:-1] if on == "ndsm" else naive)).all()
    assert ((found.zones > 0) == found.flat).all()


def test_a_flat_roof_is_found_and_a_rough_one_is_not():
    """Of two squares of one size the smooth one is flat, of the rough one at most some tips; the ground is not."""
    rng = np.random.default_rng(0)
    values = np.zeros((40, 60))
    values[5:25, 5:25] = 6.0
    values[5:25, 35:55] = 6.0 + rng.uniform(0, 8, (20, 20))
    g = grid(values)
    found = binarise(g, g, replace(FlatRegionParams(), gradient_cap_m=0.0, ratio=3.4))  # R = 2 in cells of a metre
    assert found.flat[5:25, 5:25].all()
    assert found.flat[5:25, 35:55].sum() < 60
    assert found.risen.sum() == 800
    assert not found.flat[~found.risen].any()


def test_lambda_of_cells_is_as_many_cell_areas():
    """With λ in cells of 0.5 m the regions are those of a quarter of λ in m2 (A13)."""
    rng = np.random.default_rng(3)
    g = grid(np.kron(rng.integers(0, 6, (8, 8)), np.ones((5, 5))), cell_m=0.5)
    of_cells, of_m2 = (
        binarise(g, g, replace(PAPER, lambda_min_m2=low, lambda_step_m2=step, lambda_max_m2=high, lambda_unit=unit))
        for unit, low, step, high in (("px", 40.0, 80.0, 4000.0), ("m2", 10.0, 20.0, 1000.0))
    )
    assert of_cells.flat.any()
    assert not of_cells.flat.all()
    np.testing.assert_array_equal(of_cells.zones, of_m2.zones)
    np.testing.assert_array_equal(of_cells.thresholds, of_m2.thresholds)


def test_r_falls_with_the_window_of_the_gradients():
    """R holds up to cells of 0.35 m, falls with the root of the window beyond, and is one in the paper's profile."""
    own = FlatRegionParams()
    assert [ratio_at(cell_m, own) for cell_m in (0.2, 0.3, 0.35)] == [own.ratio] * 3
    assert ratio_at(1.4, own) == pytest.approx(own.ratio / 2)
    assert ratio_at(1.4, replace(own, gradient_window_m=9.8)) == own.ratio
    assert ratio_at(1.4, PAPER) == PAPER.ratio


def test_regions_larger_than_the_limit_are_terrain():
    """The same roof is none when it is larger than what may be a building."""
    values = np.zeros((30, 30))
    values[5:25, 5:25] = 6.0
    g = grid(values)
    assert binarise(g, g, replace(FlatRegionParams(), largest_m2=400.0)).flat.sum() == 400
    assert binarise(g, g, replace(FlatRegionParams(), largest_m2=399.0)).flat.sum() == 0


def test_a_roof_that_fills_the_tile_rises_from_the_ground_beyond():
    """On heights above ground the border is ground; the raw surface has nothing that the roof rises from."""
    g = grid(np.full((20, 20), 7.0))
    assert binarise(g, g, FlatRegionParams()).flat.all()
    assert not binarise(g, g, replace(FlatRegionParams(), on="surface")).flat.any()


def test_gradients_are_capped():
    """The foot of a tower counts as half a storey; without a cap as all of the tower."""
    values = np.zeros((9, 9))
    values[:, 5:] = 30.0
    assert gradient_of(grid(values), FlatRegionParams()).max() == 1.5
    assert gradient_of(grid(values), PAPER).max() == 30.0


@pytest.mark.parametrize("change", [{"lambda_max_m2": 10.0}, {"lambda_step_m2": 0.0}, {"lambda_min_m2": 0.0}])
def test_zones_that_make_no_sense_are_refused(change):
    """λ_max below λ_min, λ_Δ of 0 and λ_min of 0 are named."""
    g = grid(np.zeros((5, 5)))
    with pytest.raises(ParameterError, match="λ_min"):
        binarise(g, g, replace(FlatRegionParams(), **change))


# Recognition


def test_thin_extensions_go_and_holes_are_filled():
    """A wall of 1 m on a roof goes, and so does a hole of 1 m in it; corners stay (M19)."""
    flat = np.zeros((30, 30), dtype=bool)
    flat[5:20, 5:20] = True
    solid = flat.copy()
    flat[10, 10] = False
    flat[12, 20:28] = True
    assert (clean(flat, 3.0, 1.0) == solid).all()


def test_opening_and_closing_are_those_of_scipy():
    """Away from the border, Φ(Γ(G)) is scipy's."""
    rng = np.random.default_rng(2)
    flat = np.pad(ndimage.zoom(rng.random((9, 9)) < 0.6, 4, order=0) & (rng.random((36, 36)) < 0.97), 8)
    square = np.ones((3, 3))
    naive = ndimage.binary_closing(ndimage.binary_opening(flat, square), square)
    assert (clean(flat, 3.0, 1.0) == naive).all()


def test_a_roof_at_the_border_is_no_thinner_for_it():
    """A strip of 2 m along the border is part of a wider roof beyond; a strip of 2 m inside is thin."""
    flat = np.zeros((20, 20), dtype=bool)
    flat[:2], flat[10:12] = True, True
    kept = clean(flat, 3.0, 1.0)
    assert kept[:2].all()
    assert not kept[2:].any()


def test_perimeters_are_corrected_at_any_angle():
    """P of turned squares and of discs is within 6 %, and that of scikit-image; Ψ' is near 1.27 and 1 (A9, M20)."""
    row, col = np.indices((120, 120)) - 60
    shapes = [(np.hypot(row, col) <= 40, 2 * np.pi * 40, 1.0)]
    for angle in np.deg2rad([0, 15, 30, 45]):
        along, across = col * np.cos(angle) + row * np.sin(angle), row * np.cos(angle) - col * np.sin(angle)
        shapes.append(((np.abs(along) <= 25) & (np.abs(across) <= 25), 4 * 50.0, 4 / np.pi))
    for mask, perimeter, compactness in shapes:
        table = measure_shapes(mask.astype(np.int32), 0.5)
        assert table["perimeter_m"][0] == pytest.approx(perimeter_crofton(mask) * 0.5)
        assert table["perimeter_m"][0] == pytest.approx(perimeter * 0.5, rel=0.06)
        assert table["compactness"][0] == pytest.approx(compactness, rel=0.13)
        assert table["area_m2"][0] == mask.sum() * 0.25


def test_the_paper_wall_is_too_long_and_its_house_is_not():
    """A wall of 3 m by 90 m has Ψ' of about 10, a house of 10 m by 20 m of 1.4 (M20)."""
    labels = np.zeros((100, 40), dtype=np.int32)
    labels[5:95, 2:5], labels[20:40, 20:30] = 1, 2
    wall, house = measure_shapes(labels, 1.0)["compactness"]
    assert 9 < wall < 11
    assert 1.2 < house < 1.6


def test_growth_gives_edges_back_but_climbs_and_joins_nothing():
    """Rings of cells of about the same height are added, up to the mask, a step, or another region."""
    heights = np.full((7, 14), 6.0)
    heights[:, 0] = 1.0
    heights[0] = 9.0
    labels = np.zeros((7, 14), dtype=np.int32)
    labels[3:5, 3:5], labels[3:5, 7:9] = 1, 2
    grown = grow(labels, grid(heights), steps=2, step_m=1.0, least_m=2.0)
    assert (grown[1:7, 1:6] == 1).all()
    assert (grown[1:7, 6:11] == 2).all()
    assert not grown[0].any()
    assert not grown[:, 0].any()
    assert (grow(labels, grid(heights), steps=0, step_m=1.0, least_m=2.0) == labels).all()


def test_the_zone_of_a_region_is_that_of_most_of_its_cells():
    """Of equal numbers the larger zone counts; cells without a zone do not."""
    labels = np.array([[1, 1, 1, 1, 2, 2, 3, 3]], dtype=np.int32)
    zones = np.array([[2, 2, 5, 0, 1, 4, 0, 0]], dtype=np.int32)
    assert most_frequent_zone(labels, zones, 3).tolist() == [2, 4, 0]


def test_ledgers_must_balance():
    """A stage whose numbers do not add up, or that dropped a region without a row, is an error of ours."""
    ledger = FlatRegionLedger(spec_of((3, 3)), "test", 2.0)
    assert ledger.reject("ratio", "rough", np.eye(3, dtype=bool)) == 1
    ledger.count("ratio", 3, 2, 1)
    with pytest.raises(TableError, match="does not balance"):
        ledger.count("ratio", 3, 2, 2)
    with pytest.raises(TableError, match="dropped 3 regions, but wrote 1 rows"):
        ledger.count("ratio", 4, 2, 2)

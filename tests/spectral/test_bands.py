"""Gridding of colours and intensity, stacking, and scaling of bands (V20, V21)."""

from dataclasses import replace

import numpy as np
import pytest
from pyproj import CRS
from simulated import scenes

from msbdb.errors import GridMismatchError, InputError
from msbdb.grid import Bands, lattice
from msbdb.points.cloud import PointCloud
from msbdb.spectral.colours import fit_scaling, grid_colours, grid_intensity, spectral_bands, stack

UTM = CRS.from_epsg(32633)


def _points(x, y, **attributes):
    """Points at the height zero."""
    x, y = np.array(x, dtype=float), np.array(y, dtype=float)
    return PointCloud(x, y, np.zeros(x.size), UTM, **attributes)


def _spec(width=4, height=3):
    """Return a lattice of 1 m cells whose first cell has its centre at (0.5, height - 0.5)."""
    return lattice((0.1, 0.1, width - 0.1, height - 0.1), 1.0, UTM)


def test_colour_of_a_cell_is_the_mean_of_its_first_echoes():
    """Later echoes do not count, and points off the lattice are ignored."""
    points = _points(
        [0.2, 0.8, 0.5, 9.0],
        [2.5, 2.5, 2.5, 2.5],
        return_number=np.array([1, 1, 2, 1], dtype=np.uint8),
        colours=np.array([[10, 1], [30, 3], [999, 999], [500, 500]], dtype=np.uint16),
        colour_names=("red", "nir"),
    )
    bands = grid_colours(points, _spec(), max_gap_m=0.0)
    assert bands.names == ("red", "nir")
    assert bands.values[:, 0, 0].tolist() == [20, 2]
    assert bands.valid.sum() == 1


def test_gaps_take_the_nearest_colour_up_to_the_largest_gap():
    """A cell farther from any measured one stays invalid, and is zero."""
    points = _points([0.5, 3.5], [2.5, 2.5], colours=np.array([[7], [9]], dtype=np.uint16), colour_names=("red",))
    bands = grid_colours(points, _spec(), max_gap_m=1.0)
    np.testing.assert_array_equal(bands.values[0], [[7, 7, 9, 9], [7, 0, 0, 9], [0, 0, 0, 0]])
    np.testing.assert_array_equal(bands.valid, bands.values[0] > 0)


def test_intensity_is_bilinear():
    """A point gives its value to the four cell centres around it; a cell's value is the weighted mean."""
    at_centre = _points([0.5, 1.5], [2.5, 2.5], intensity=np.array([10, 20], dtype=np.uint16))
    np.testing.assert_array_equal(grid_intensity(at_centre, _spec(), max_gap_m=0.0).values[0, 0], [10, 20, 0, 0])
    between = _points([0.5, 0.75], [2.5, 2.5], intensity=np.array([10, 20], dtype=np.uint16))
    values = grid_intensity(between, _spec(), max_gap_m=0.0).values[0, 0]
    assert values[0] == pytest.approx((10 + 0.75 * 20) / 1.75)
    assert values[1] == pytest.approx(20)


def test_intensity_of_an_even_field_is_even_to_the_border():
    """Weights are normalised, so a constant stays the same constant everywhere."""
    scene = scenes.flat_field(density=1.0)
    even = replace(scene.points, intensity=np.full(len(scene.points), 321, dtype=np.uint16))
    bands = grid_intensity(even, scene.spec, max_gap_m=5.0)
    assert bands.valid.all()
    assert (bands.values == 321).all()


def test_order_of_points_does_not_matter():
    """Shuffled points give the very same bands, to the last bit."""
    scene = scenes.under_trees()
    shuffled = scene.points.take(np.random.default_rng(3).permutation(len(scene.points)))
    first = spectral_bands(None, scene.points, scene.spec, max_gap_m=2.0)
    again = spectral_bands(None, shuffled, scene.spec, max_gap_m=2.0)
    assert first.names == ("red", "green", "blue", "nir", "intensity")
    np.testing.assert_array_equal(first.values, again.values)


def test_points_without_colours_or_intensity_give_nothing():
    """What the source does not have is not made up."""
    points = _points([0.5], [0.5])
    assert grid_colours(points, _spec(), max_gap_m=1.0) is None
    assert grid_intensity(points, _spec(), max_gap_m=1.0) is None
    assert spectral_bands(None, points, _spec(), max_gap_m=1.0) is None


def test_points_all_off_the_lattice_give_invalid_bands():
    """Nothing measured is nowhere valid, and no error."""
    points = _points([50.0], [50.0], intensity=np.array([5], dtype=np.uint16))
    assert not grid_intensity(points, _spec(), max_gap_m=1.0).valid.any()


def _constant(names, value, spec, valid=None):
    """Bands of one value."""
    valid = np.ones(spec.shape, dtype=bool) if valid is None else valid
    return Bands(np.full((len(names), *spec.shape), value, dtype=np.float32) * valid, names, valid, spec)


def test_ortho_goes_before_point_colours_and_intensity_joins():
    """The image's colours are taken, not the points'."""
    scene = scenes.under_trees()
    ortho = _constant(("red", "green"), 5, scene.spec)
    bands = spectral_bands(ortho, scene.points, scene.spec, max_gap_m=2.0)
    assert bands.names == ("red", "green", "intensity")
    assert (bands.values[:2] == 5).all()


def test_stack_keeps_the_first_of_a_name_and_the_common_cells():
    """A second red is dropped; a cell is valid where all parts are."""
    spec = _spec()
    half = np.zeros(spec.shape, dtype=bool)
    half[:, :2] = True
    bands = stack(_constant(("red", "green"), 1, spec), _constant(("nir", "red"), 2, spec, half))
    assert bands.names == ("red", "green", "nir")
    np.testing.assert_array_equal(bands.valid, half)
    assert bands.values[:, 0, 0].tolist() == [1, 1, 2]
    assert not bands.values[:, ~half].any()


def test_stack_refuses_other_lattices_and_nothing():
    """The message says what to do."""
    with pytest.raises(GridMismatchError, match="resample"):
        stack(_constant(("red",), 1, _spec()), _constant(("nir",), 1, _spec(5)))
    with pytest.raises(InputError, match="at least one"):
        stack()


def test_scaling_maps_the_percentiles_to_0_and_1_and_clips():
    """An outlier does not squeeze the rest, and a constant band becomes 0."""
    sample = np.column_stack([np.append(np.linspace(0, 100, 101), 1e6), np.full(102, 7.0)])
    scaling = fit_scaling(sample, ("red", "flat"), 2.0)
    scaled = scaling.apply(sample)
    assert scaled.min() == 0.0
    assert scaled.max() == 1.0
    assert scaled[50, 0] == pytest.approx(0.5, abs=0.02)
    assert not scaled[:, 1].any()

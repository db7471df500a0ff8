"""Differential morphological profiles and gradients equal their definitions, beside gaps and edges too."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage
from support import oracles
from support.strategies import surfaces

from msbdb.errors import InputError, ParameterError
from msbdb.morphology import external_gradient, internal_gradient, second_order_gradient, window_profile
from msbdb.morphology.windows import BLOCK, dilation, erosion

WINDOWS = st.lists(st.integers(1, 5), min_size=1, max_size=4, unique=True).map(
    lambda halves: [2 * half + 1 for half in sorted(halves)]
)


def naive_zones(values, valid, windows):
    """Return the responses of all windows, by one opening for each."""
    surface = np.where(valid, values, 0).astype(float)
    opened = [surface, *(oracles.window_opening(surface, valid, window) for window in windows)]
    return [finer - coarser for finer, coarser in pairwise(opened)]


@given(surfaces(), WINDOWS, st.booleans())
def test_theta_is_the_largest_response_of_all_windows(surface, windows, valleys):
    """Response and zone (M2, M5, M9) equal those of the naive openings, of g and of -g; invalid cells have none."""
    values, valid = surface
    zones = naive_zones(-values.astype(float) if valleys else values, valid, windows)
    assert min(zone.min() for zone in zones) >= 0
    response, zone = window_profile(values, windows, valid, valleys=valleys)
    expected, largest = oracles.theta(zones)
    np.testing.assert_array_equal(response, expected)
    np.testing.assert_array_equal(zone, largest)
    assert response.dtype == np.float64


@given(surfaces(), WINDOWS)
def test_the_paper_s_negative_is_the_profile_of_valleys(surface, windows):
    """θ(-g) of a negated surface is θ(g)."""
    values, valid = surface
    negated = -np.where(valid, values, 0).astype(np.float64)
    for one, other in zip(
        window_profile(negated, windows, valid, valleys=True), window_profile(values, windows, valid), strict=True
    ):
        np.testing.assert_array_equal(one, other)


@given(surfaces())
def test_gradients_are_their_definitions(surface):
    """The highest cell around less the cell, the cell less the lowest one, among valid cells; 0 in others (M13)."""
    values, valid = surface
    heights = np.where(valid, values, 0).astype(np.float64)
    lowest, highest = oracles.window_extremes(heights, valid, 3)
    external = external_gradient(heights, valid)
    np.testing.assert_array_equal(external, highest - heights)
    np.testing.assert_array_equal(internal_gradient(heights, valid), heights - lowest)
    expected = external - oracles.window_extremes(external, valid, 3)[0]
    np.testing.assert_array_equal(second_order_gradient(heights, valid), expected)


@given(surfaces(), st.sampled_from([3, 5]))
def test_no_gradient_is_negative(surface, window):
    """That makes their sum an increasing attribute (M13); what lies under the mask does not count."""
    values, valid = surface
    for gradient in (external_gradient, internal_gradient, second_order_gradient):
        result = gradient(values, valid, window_px=window)
        assert result.dtype == np.result_type(values.dtype, np.float32)
        assert (result >= 0).all()
        assert not result[~valid].any()
        hidden = np.where(valid, values, values.dtype.type(99))
        np.testing.assert_array_equal(gradient(hidden, valid, window_px=window), result)


@given(surfaces(), st.tuples(st.integers(0, 3), st.booleans()))
def test_turns_and_mirrors_commute(surface, motion):
    """No direction of the lattice is preferred."""
    values, valid = surface
    turns, mirror = motion

    def move(array):
        return np.rot90(array.T if mirror else array, turns)

    np.testing.assert_array_equal(
        second_order_gradient(move(values), move(valid)), move(second_order_gradient(values, valid))
    )
    for moved, straight in zip(
        window_profile(move(values), [3, 7], move(valid)), window_profile(values, [3, 7], valid), strict=True
    ):
        np.testing.assert_array_equal(moved, move(straight))


def test_the_second_order_marks_the_lower_side_of_an_edge():
    """A roof's edge is marked outside of the roof, next to it; flat and evenly sloped ground are not."""
    roof = np.zeros((12, 12))
    roof[4:8, 4:8] = 5.0
    ring = np.zeros((12, 12), dtype=bool)
    ring[3:9, 3:9] = True
    ring[4:8, 4:8] = False
    np.testing.assert_array_equal(second_order_gradient(roof), np.where(ring, 5.0, 0.0))
    slope = np.tile(np.arange(20.0), (5, 1))
    assert not second_order_gradient(slope)[:, :-2].any()


def test_a_pole_is_a_peak_and_a_shaft_is_a_valley_of_its_own_scale():
    """A pole of one cell responds at the first window, a hut of 4 x 4 at the first that is wider, a hall not."""
    surface = np.zeros((60, 60), dtype=np.float32)
    surface[5, 5] = 9.0
    surface[20:24, 20:24] = 3.0
    surface[30:55, 30:55] = 4.0
    surface[40, 40] = -6.0
    response, zone = window_profile(surface, [3, 5, 7, 9])
    assert (response[5, 5], zone[5, 5]) == (9.0, 1)
    assert (response[22, 22], zone[22, 22]) == (3.0, 2)
    assert response[50, 50] == zone[50, 50] == 0
    depth, scale = window_profile(surface, [3, 5, 7, 9], valleys=True)
    assert (depth[40, 40], scale[40, 40]) == (10.0, 1)
    assert not depth[5, 5]


def test_the_extremes_of_16_bits_differ_without_overflow():
    """Differences of 16-bit integers may exceed 16 bits; so does the negative of the lowest."""
    image = np.full((5, 5), -32768, dtype=np.int16)
    image[2, 2] = 32767
    assert window_profile(image, [3])[0].max() == external_gradient(image).max() == 65535
    assert window_profile(image, [7], valleys=True)[0].max() == 65535


@pytest.mark.parametrize("image", [np.array([[3]], dtype=np.int16), np.full((4, 4), 7.0), np.full((2, 3), np.nan)])
def test_where_nothing_differs_all_is_zero(image):
    """One pixel, one value, and no valid cell."""
    valid = np.isfinite(image)
    assert not window_profile(image, [3, 5], valid).response.any()
    assert not window_profile(image, [3, 5], valid, valleys=True).zone.any()
    assert not second_order_gradient(image, valid).any()


@pytest.mark.parametrize("windows", [[], [1, 3], [3, 3], [5, 3], [3, 6], [3.0]])
def test_windows_that_are_no_granulometry_are_refused(windows):
    """They are odd and increase from 3."""
    with pytest.raises(ParameterError, match="window"):
        window_profile(np.zeros((4, 4)), windows)


def test_a_surface_without_differences_is_refused():
    """Infinite or undefined heights in valid cells."""
    for bad, message in ((np.inf, "infinite in 1 valid"), (np.nan, "1 NaN")):
        image = np.zeros((3, 3))
        image[1, 1] = bad
        for function in (external_gradient, lambda values: window_profile(values, [3])):
            with pytest.raises(InputError, match=message):
                function(image)
    with pytest.raises(ParameterError, match="odd number of cells"):
        external_gradient(np.zeros((3, 3)), window_px=2)


@pytest.mark.parametrize("window", [3, 5, 9, 31, 65])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_extremes_of_windows_are_those_of_scipy(window, dtype):
    """Also over the borders of blocks of rows, and in windows larger than the array."""
    values = np.random.default_rng(window).normal(size=(2 * BLOCK + 7, 40)).astype(dtype)
    lowest, highest = erosion(values, window, None), dilation(values, window, None)
    assert lowest.dtype == highest.dtype == dtype
    np.testing.assert_array_equal(lowest, ndimage.minimum_filter(values, window, mode="nearest"))
    np.testing.assert_array_equal(highest, ndimage.maximum_filter(values, window, mode="nearest"))

"""Granulometry finds the sizes of buildings in an image (V8)."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support import oracles
from support.strategies import images

from msbdb.errors import InputError, ParameterError
from msbdb.morphology import find_scales, opening_areas
from msbdb.params import GranulometryParams


def field(*buildings, shape=(120, 160)):
    """Empty ground with buildings given as row, column, height, width and storeys."""
    level = np.zeros(shape, dtype=np.int16)
    for row, col, height, width, storeys in buildings:
        level[row : row + height, col : col + width] = storeys
    return level


def houses(count, side, gap, row):
    """Square houses of one storey in a row."""
    return [(row, gap + i * (side + gap), side, side, 1) for i in range(count)]


@given(images(largest=10))
def test_a_cell_survives_just_the_openings_up_to_its_area(image):
    """The area is the longest horizontal segment that leaves the cell as it is, times the longest vertical one."""

    def longest(values):
        lengths = np.zeros(values.shape, dtype=int)
        for length in range(1, values.shape[1] + 1):
            lengths[oracles.linear_opening(values, length) == values] = length
        return lengths

    np.testing.assert_array_equal(opening_areas(image), longest(image) * longest(image.T).T)


def test_a_rectangle_along_the_lattice_has_its_own_area():
    """A long block counts with length times width, and a tower on it with the tower's."""
    level = field((10, 10, 6, 40, 2), (11, 20, 4, 5, 9))
    areas = opening_areas(level)
    assert (areas[level == 9] == 20).all()
    assert (areas[level == 2] == 240).all()


@pytest.mark.parametrize("dtype", ["?", "u1", ">i2", "<u4", "f2", ">f4", "f8"])
def test_every_dtype_gives_the_same_areas(dtype):
    """Width, sign and byte order of the numbers do not matter."""
    level = field((2, 3, 4, 5, 1), shape=(9, 9)).astype(dtype)
    assert (opening_areas(level)[level > 0] == 20).all()


def test_two_sizes_of_buildings_are_two_scales():
    """Houses give the finest scale, halls the coarsest."""
    level = field(*houses(9, 8, 4, 2), *houses(3, 30, 12, 40))
    assert find_scales(level, 1.0) == (64.0, 900.0)


def test_a_size_between_is_a_peak_of_the_spectrum():
    """Between the smallest and the biggest buildings the frequent sizes are scales."""
    level = field(*houses(10, 6, 4, 2), *houses(6, 14, 6, 14), *houses(2, 40, 12, 60))
    assert find_scales(level, 1.0) == (36.0, 196.0, 1600.0)


def test_one_size_is_one_scale():
    """The smallest building is the biggest."""
    assert find_scales(field(*houses(6, 10, 5, 3)), 1.0) == (100.0,)


def test_scales_are_in_square_metres():
    """The same buildings on cells of half a metre have a quarter of the area."""
    level = field(*houses(8, 12, 4, 2), *houses(3, 36, 6, 60))
    assert find_scales(level, 1.0) == (144.0, 1296.0)
    assert find_scales(level, 0.25) == (36.0, 324.0)


def test_a_mask_gives_scales_too():
    """A mask is a level of one storey."""
    level = field(*houses(9, 8, 4, 2), *houses(3, 30, 12, 40))
    assert find_scales(level > 0, 1.0) == find_scales(level, 1.0)


def test_trees_leave_the_scales_of_buildings_in_place():
    """Ragged crowns are of small sizes, most of them below the bounds; no scale of the buildings goes."""
    level = field(*houses(9, 8, 4, 2), *houses(3, 30, 12, 40))
    level[90:110] = np.random.default_rng(5).integers(0, 9, (20, 160))
    scales = find_scales(level, 1.0)
    for size in (64.0, 900.0):
        assert any(scale == pytest.approx(size, rel=0.05) for scale in scales)


def test_an_empty_field_has_the_smallest_scale():
    """Without a building in the bounds there is still one scale to run on."""
    assert find_scales(field(), 1.0) == (20.0,)
    assert find_scales(field((5, 5, 2, 2, 1)), 1.0, GranulometryParams(smallest_m2=30.0)) == (30.0,)


def test_the_highest_peaks_stay_when_there_are_too_many():
    """The finest and the coarsest scale always stay."""
    level = field(*houses(18, 5, 3, 2), *houses(9, 10, 6, 10), *houses(2, 20, 10, 24), (50, 10, 60, 60, 1))
    assert find_scales(level, 1.0) == (25.0, 100.0, 400.0, 3600.0)
    assert find_scales(level, 1.0, GranulometryParams(most=3)) == (25.0, 100.0, 3600.0)
    assert find_scales(level, 1.0, GranulometryParams(most=2)) == (25.0, 3600.0)


@given(images(low=-1, largest=40), st.floats(0.05, 30.0), st.integers(2, 8))
def test_scales_ascend_within_their_bounds(image, cell_area_m2, most):
    """Any image gives one to `most` ascending scales within the bounds."""
    params = GranulometryParams(smallest_m2=3.0, largest_m2=700.0, most=most)
    scales = find_scales(image, cell_area_m2, params)
    assert 1 <= len(scales) <= most
    assert list(scales) == sorted(set(scales))
    assert scales[0] >= 3.0
    assert scales[-1] <= 700.0
    if scales != (3.0,):
        cells = np.array(scales) / cell_area_m2
        np.testing.assert_allclose(cells, np.round(cells), rtol=1e-12)


@given(images(low=-1, largest=30))
def test_turning_the_image_changes_no_scale(image):
    """Rows and columns count alike."""
    params = GranulometryParams(smallest_m2=2.0)
    assert find_scales(np.rot90(image), 1.0, params) == find_scales(image, 1.0, params)


@pytest.mark.parametrize("cell_area_m2", [0.0, -1.0, np.inf, np.nan])
def test_a_cell_without_an_area_is_refused(cell_area_m2):
    """Sizes need a unit."""
    with pytest.raises(ParameterError, match="area of a cell"):
        find_scales(field(), cell_area_m2)


@pytest.mark.parametrize("bounds", [(0.0, 50.0), (50.0, 50.0), (90.0, 50.0), (20.0, np.inf)])
def test_bounds_without_a_scale_are_refused(bounds):
    """The error names both parameters."""
    params = GranulometryParams(smallest_m2=bounds[0], largest_m2=bounds[1])
    with pytest.raises(ParameterError, match=r"granulometry\.smallest_m2 .* granulometry\.largest_m2"):
        find_scales(field(), 1.0, params)


def test_what_is_no_image_is_refused():
    """NaN belongs into the validity mask."""
    with pytest.raises(InputError, match="NaN"):
        find_scales(np.array([[np.nan, 1.0]]), 1.0)

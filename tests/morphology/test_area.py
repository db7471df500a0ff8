"""Area openings and closings obey their laws and equal the naive definitions."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from support import oracles
from support.strategies import CONNECTIVITIES, THRESHOLDS, images, integer_images

from msbdb.errors import InputError, ParameterError
from msbdb.morphology import area_closing, area_open_close, area_opening
from msbdb.morphology.area import find_runs
from msbdb.morphology.blockwise import filter_blockwise

FILTERS = st.sampled_from([area_opening, area_closing, area_open_close])


@given(images(), THRESHOLDS, CONNECTIVITIES)
def test_opening_is_the_naive_definition(image, threshold, connectivity):
    """The kernel gives what threshold decomposition gives (V4), bit by bit and of the same dtype."""
    result = area_opening(image, threshold, connectivity=connectivity)
    expected = oracles.area_opening(image, threshold, connectivity)
    assert result.dtype == image.dtype
    np.testing.assert_array_equal(result, expected)


@given(images(), THRESHOLDS, CONNECTIVITIES)
def test_closing_is_the_naive_definition(image, threshold, connectivity):
    """The kernel gives what threshold decomposition of the complement gives (V3, V4)."""
    result = area_closing(image, threshold, connectivity=connectivity)
    assert result.dtype == image.dtype
    np.testing.assert_array_equal(result, oracles.area_closing(image, threshold, connectivity))


@given(images(), THRESHOLDS, CONNECTIVITIES)
def test_open_close_opens_first(image, threshold, connectivity):
    """AOC is an opening and then a closing with the same s (V5)."""
    result = area_open_close(image, threshold, connectivity=connectivity)
    np.testing.assert_array_equal(result, oracles.area_open_close(image, threshold, connectivity))


@given(images(st.sampled_from([np.int16, np.uint8, np.float32])), THRESHOLDS, CONNECTIVITIES, st.integers(1, 6))
def test_blocks_of_any_side_give_the_naive_definition(image, threshold, connectivity, side):
    """Components over borders and corners of blocks, within one block, and over many."""
    opened = filter_blockwise(image, threshold, connectivity, from_top=True, side=side)
    closed = filter_blockwise(image, threshold, connectivity, from_top=False, side=side)
    assert opened.dtype == closed.dtype == image.dtype
    np.testing.assert_array_equal(opened, oracles.area_opening(image, threshold, connectivity))
    np.testing.assert_array_equal(closed, oracles.area_closing(image, threshold, connectivity))


@pytest.mark.parametrize("threshold", [30, 3000])
def test_large_heights_are_filtered_in_blocks_as_in_runs(threshold):
    """Several blocks in both directions; columns that are doubled make runs of two cells."""
    heights = np.random.default_rng(4).normal(size=(600, 700)).astype(np.float32)
    in_blocks = area_open_close(heights, threshold)
    doubled = np.repeat(heights, 2, axis=1)
    assert find_runs(doubled, 8).values.size * 2 == doubled.size
    in_runs = area_open_close(doubled, 2 * threshold)
    assert (in_blocks != heights).any()
    np.testing.assert_array_equal(np.repeat(in_blocks, 2, axis=1), in_runs)


def test_blocks_refuse_what_32_bits_cannot_order():
    """Floats of 64 bits are filtered by runs."""
    with pytest.raises(InputError, match="float64"):
        filter_blockwise(np.zeros((3, 3)), 2, 8, from_top=True)


@given(images(st.just(np.bool_), 0, 1), THRESHOLDS, CONNECTIVITIES)
def test_masks_follow_the_binary_definition(mask, threshold, connectivity):
    """On a mask the opening keeps the components of at least s cells (V2), the closing fills smaller pits (V3)."""
    # A grey filter is flat at the extreme value where no component of the array is large enough.
    assume(threshold <= mask.size)
    opened = area_opening(mask, threshold, connectivity=connectivity)
    closed = area_closing(mask, threshold, connectivity=connectivity)
    assert opened.dtype == closed.dtype == np.bool_
    if not mask.all():
        np.testing.assert_array_equal(opened, oracles.binary_area_opening(mask, threshold, connectivity))
    if mask.any():
        np.testing.assert_array_equal(closed, oracles.binary_area_closing(mask, threshold, connectivity))


@given(images(), THRESHOLDS, CONNECTIVITIES, st.data())
def test_every_threshold_set_of_an_opening_is_the_opened_threshold_set(image, threshold, connectivity, data):
    """T_h of the opening is the binary opening of T_h, above the minimum."""
    level = data.draw(st.sampled_from(list(np.unique(image))))
    assume(level > image.min())
    opened = area_opening(image, threshold, connectivity=connectivity)
    expected = oracles.binary_area_opening(image >= level, threshold, connectivity)
    np.testing.assert_array_equal(opened >= level, expected)


@given(images(), THRESHOLDS, CONNECTIVITIES)
def test_opening_lowers_and_closing_raises(image, threshold, connectivity):
    """An opening is anti-extensive, a closing extensive."""
    assert (area_opening(image, threshold, connectivity=connectivity) <= image).all()
    assert (area_closing(image, threshold, connectivity=connectivity) >= image).all()


@given(images(), THRESHOLDS, CONNECTIVITIES, FILTERS)
def test_a_second_pass_changes_nothing(image, threshold, connectivity, area_filter):
    """Opening, closing and AOC are idempotent."""
    once = area_filter(image, threshold, connectivity=connectivity)
    np.testing.assert_array_equal(area_filter(once, threshold, connectivity=connectivity), once)


@given(integer_images(), THRESHOLDS, CONNECTIVITIES, FILTERS, st.integers(0, 2**32 - 1))
def test_a_higher_image_gives_a_higher_result(image, threshold, connectivity, area_filter, seed):
    """Opening, closing and AOC are increasing."""
    raised = (image + np.random.default_rng(seed).integers(0, 3, image.shape)).astype(image.dtype)
    low = area_filter(image, threshold, connectivity=connectivity)
    high = area_filter(raised, threshold, connectivity=connectivity)
    assert (low <= high).all()


@given(images(), THRESHOLDS, THRESHOLDS, CONNECTIVITIES, st.sampled_from([area_opening, area_closing]))
def test_the_larger_threshold_absorbs_the_smaller(image, one, other, connectivity, area_filter):
    """γ_a γ_b = γ_max(a, b), in either order, and likewise for closings."""
    twice = area_filter(area_filter(image, one, connectivity=connectivity), other, connectivity=connectivity)
    np.testing.assert_array_equal(twice, area_filter(image, max(one, other), connectivity=connectivity))


@given(images(), THRESHOLDS, CONNECTIVITIES)
def test_closing_is_the_dual_of_opening(image, threshold, connectivity):
    """φ_s(f) = -γ_s(-f)."""
    dual = -area_opening(-image, threshold, connectivity=connectivity)
    np.testing.assert_array_equal(area_closing(image, threshold, connectivity=connectivity), dual)


@given(images(), CONNECTIVITIES, FILTERS)
def test_a_threshold_of_one_cell_changes_nothing(image, connectivity, area_filter):
    """Every component has at least one cell; and the result is an array of its own."""
    result = area_filter(image, 1, connectivity=connectivity)
    np.testing.assert_array_equal(result, image)
    assert not np.shares_memory(result, image)


@given(integer_images(), THRESHOLDS, CONNECTIVITIES, FILTERS, st.integers(-1000, 1000))
def test_adding_a_constant_commutes(image, threshold, connectivity, area_filter, constant):
    """Only the order of the values counts, not where zero is."""
    shift = image.dtype.type(constant)
    shifted = area_filter(image + shift, threshold, connectivity=connectivity)
    np.testing.assert_array_equal(shifted, area_filter(image, threshold, connectivity=connectivity) + shift)


@given(images(), THRESHOLDS, CONNECTIVITIES, FILTERS, st.tuples(st.integers(0, 3), st.booleans()))
def test_turns_and_mirrors_commute(image, threshold, connectivity, area_filter, motion):
    """No direction of the lattice is preferred (D4)."""
    turns, mirror = motion

    def move(array):
        return np.rot90(array.T if mirror else array, turns)

    moved = area_filter(move(image), threshold, connectivity=connectivity)
    np.testing.assert_array_equal(moved, move(area_filter(image, threshold, connectivity=connectivity)))


@given(images(), THRESHOLDS, CONNECTIVITIES, FILTERS)
def test_the_input_stays_as_it_is_and_gives_all_values(image, threshold, connectivity, area_filter):
    """A filter works on read-only arrays and invents no value."""
    before = image.copy()
    image.flags.writeable = False
    result = area_filter(image, threshold, connectivity=connectivity)
    np.testing.assert_array_equal(image, before)
    assert np.isin(result, before).all()


def test_a_component_of_exactly_s_cells_stays():
    """The threshold is at least s (V2, V7), not more than s."""
    image = np.zeros((8, 9), dtype=np.int16)
    image[2:5, 2:6] = 7
    np.testing.assert_array_equal(area_opening(image, 12), image)
    assert not area_opening(image, 13).any()


def test_diagonal_neighbours_are_joined_by_8_only():
    """Connectivity 8 counts two cells that touch at a corner as one component, 4 as two."""
    image = np.eye(2, dtype=np.int16)
    np.testing.assert_array_equal(area_opening(image, 2, connectivity=8), image)
    assert not area_opening(image, 2, connectivity=4).any()


def test_rows_do_not_wrap_around():
    """The end of a row does not touch the start of the next."""
    image = np.zeros((5, 4), dtype=np.int16)
    image[1, 3] = image[2, 0] = image[4, 0] = 1
    for connectivity in (4, 8):
        assert not area_opening(image, 2, connectivity=connectivity).any()


def test_the_last_cell_is_filtered_like_any_other():
    """A lone peak or pit goes in each corner of the array."""
    for corner in ((0, 0), (0, -1), (-1, 0), (-1, -1)):
        image = np.full((5, 6), 4, dtype=np.int16)
        image[corner] = 9
        assert (area_opening(image, 2) == 4).all()
        image[corner] = 1
        assert (area_closing(image, 2) == 4).all()


def test_a_threshold_beyond_the_array_flattens_it():
    """No component holds s cells: openings are flat at the minimum, closings at the maximum."""
    image = np.arange(12).reshape(3, 4)
    for threshold in (13, 10**12):
        assert (area_opening(image, threshold) == 0).all()
        assert (area_closing(image, threshold) == 11).all()
    assert area_opening(image, 12).max() == 0


@pytest.mark.parametrize("dtype", ["u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8"])
def test_integers_of_every_kind_and_range_are_ordered_right(dtype):
    """The extremes of a dtype beside middling values, with few levels and with a range too wide for buckets."""
    info = np.iinfo(dtype)
    random = np.random.default_rng(1)
    for levels in ([info.max - 2, info.max - 1, info.max], [info.min, info.min + 1], [info.min, 7, 90, info.max]):
        image = random.choice(np.array(levels, dtype=dtype), size=(20, 20))
        np.testing.assert_array_equal(area_opening(image, 5), oracles.area_opening(image, 5, 8))
        np.testing.assert_array_equal(area_closing(image, 5), oracles.area_closing(image, 5, 8))


@pytest.mark.parametrize("dtype", ["?", ">i2", "<u4", "f2", ">f4"])
def test_every_dtype_stays_itself(dtype):
    """Width and byte order of the numbers do not matter, and come out as they went in."""
    image = np.array([[0, 1, 0, 1, 1]], dtype=dtype)
    result = area_opening(image, 2)
    assert result.dtype == image.dtype
    np.testing.assert_array_equal(result, np.array([[0, 0, 0, 1, 1]], dtype=dtype))


def test_infinite_floats_have_an_order():
    """Infinities are the lowest and the highest value."""
    image = np.array([[1.0, np.inf, 1.0, -np.inf, -np.inf]])
    np.testing.assert_array_equal(area_opening(image, 2), [[1.0, 1.0, 1.0, -np.inf, -np.inf]])


def test_views_and_strides_do_not_matter():
    """A transposed, stepped view is filtered like its copy."""
    view = np.random.default_rng(2).integers(0, 4, (40, 30)).astype(np.int16).T[::2, ::-3]
    np.testing.assert_array_equal(area_open_close(view, 6), area_open_close(view.copy(), 6))


@pytest.mark.parametrize("threshold", [0, -3, 2.0, True, "9"])
def test_a_threshold_that_is_no_number_of_cells_is_refused(threshold):
    """A threshold s is a whole number from 1."""
    with pytest.raises(ParameterError, match="whole number of cells from 1"):
        area_opening(np.zeros((3, 3)), threshold)


def test_another_connectivity_is_refused():
    """There are two neighbourhoods."""
    with pytest.raises(ParameterError, match="must be 4 or 8; got 6"):
        area_opening(np.zeros((3, 3)), 2, connectivity=6)


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.zeros(5), "two dimensions"),
        (np.zeros((0, 4)), "two dimensions"),
        (np.zeros((2, 2, 2)), "two dimensions"),
        (np.array([[1.0, np.nan]]), "1 NaN"),
        (np.array([["a", "b"]]), "booleans, integers or floats"),
        (np.array([[1j]]), "booleans, integers or floats"),
    ],
)
def test_what_is_no_image_is_refused(image, message):
    """NaN has no order, and a filter of area needs two dimensions."""
    with pytest.raises(InputError, match=message):
        area_closing(image, 2)

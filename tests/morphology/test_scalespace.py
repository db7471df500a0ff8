"""The scale-space is fed from scale to scale, its zones only merge, and islands are independent."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage
from support import oracles
from support.strategies import CONNECTIVITIES, images, integer_images

from msbdb.errors import InputError, ParameterError
from msbdb.labels import label_zones
from msbdb.morphology import ScaleSpace, area_open_close, build_scale_space

LADDERS = st.sets(st.integers(1, 40), min_size=1, max_size=5).map(sorted)


def storeys(low=0):
    """Draw storeys, of which 0 is the background."""
    return integer_images(low=low, high=4)


@given(images(), LADDERS, CONNECTIVITIES)
def test_each_scale_is_fed_by_the_one_before(image, thresholds, connectivity):
    """SP_i = φ_i(γ_i(SP_{i-1})), finest first (Eq. 6, V6)."""
    space = build_scale_space(image, thresholds, connectivity=connectivity)
    assert space.thresholds_px == tuple(thresholds)
    assert space.levels.dtype == image.dtype
    expected = image
    for level, threshold in zip(space.levels, thresholds, strict=True):
        expected = oracles.area_open_close(expected, threshold, connectivity)
        np.testing.assert_array_equal(level, expected)


def test_the_ladder_is_not_the_filter_of_the_image_itself():
    """Skipping the finer scale gives another result: the feeding of Eq. 6 is not a detail."""
    image = np.array([[0, 5, 0, 5, 0, 5, 0, 0, 0, 0]], dtype=np.int16)
    ladder = build_scale_space(image, [2, 3]).levels[-1]
    assert not ladder.any()
    image = np.array([[4, 4, 0, 4, 4, 0, 0, 0]], dtype=np.int16)
    ladder = build_scale_space(image, [2, 5]).levels[-1]
    np.testing.assert_array_equal(ladder, [[4, 4, 4, 4, 4, 4, 4, 4]])
    assert not area_open_close(image, 5).any()


@given(storeys(), LADDERS, CONNECTIVITIES)
def test_zones_only_merge(image, thresholds, connectivity):
    """Every flat zone of a finer scale, the background too, lies in one flat zone of the next (V10, V11)."""
    space = build_scale_space(image, thresholds, connectivity=connectivity)
    # Shifted by one, the background is labelled like any other zone.
    labels = [label_zones(level + 1, connectivity=connectivity)[0] for level in (image, *space.levels)]
    for finer, coarser in pairwise(labels):
        pairs = np.unique(np.stack([finer.ravel(), coarser.ravel()]), axis=1)
        assert len(pairs[0]) == finer.max()


@given(storeys(), LADDERS, CONNECTIVITIES)
def test_every_peak_and_pit_has_at_least_s_cells(image, thresholds, connectivity):
    """On every scale, each flat zone that is higher, or lower, than all around it has s cells or more (V7).

    Zones on the way from a pit to a peak may be smaller, as the next test shows.
    """
    thresholds = [threshold for threshold in thresholds if threshold <= image.size] or [1]
    space = build_scale_space(image, thresholds, connectivity=connectivity)
    for level, threshold in zip(space.levels, thresholds, strict=True):
        labels, count = label_zones(level + 1, connectivity=connectivity)
        for zone in range(1, count + 1):
            inside = labels == zone
            around = level[ndimage.binary_dilation(inside, oracles.STRUCTURES[connectivity]) & ~inside]
            here = level[inside][0]
            if (around < here).all() or (around > here).all():
                assert np.count_nonzero(inside) >= threshold


def test_a_zone_between_pit_and_peak_may_have_fewer_cells():
    """A stair of one cell leads up to a roof: opening and closing keep it on every scale.

    With ``merge_small`` they join a neighbour on every scale (`test_smallzones`).
    """
    image = np.zeros((6, 12), dtype=np.int16)
    image[1:5, 6:10] = 2
    image[2, 5] = 1
    space = build_scale_space(image, [4, 12])
    for level in space.levels:
        assert np.count_nonzero(level == 1) == 1


@given(storeys(), st.sets(st.integers(1, 30), min_size=1, max_size=3).map(sorted))
def test_islands_are_filtered_independently(image, thresholds):
    """An 8-connected island with all that it encloses comes out alone as it does among the others (V12)."""
    # A ring of ground around all is the outer background of at least s cells.
    image = np.pad(image, 8)
    whole = build_scale_space(image, thresholds).levels
    filled = ndimage.binary_fill_holes(image > 0)
    islands, count = ndimage.label(filled, oracles.STRUCTURES[8])
    apart = np.zeros_like(whole)
    for island in range(1, count + 1):
        alone = np.where(islands == island, image, 0)
        apart += build_scale_space(alone, thresholds).levels
    np.testing.assert_array_equal(apart, whole)


def test_a_small_house_vanishes_and_a_courtyard_is_closed():
    """Podium, house and courtyard each change on the scale of their own area."""
    image = np.zeros((30, 30), dtype=np.int16)
    image[2:12, 2:12] = 3
    image[4:7, 4:7] = 0
    image[20:24, 20:25] = 1
    space = build_scale_space(image, [9, 20, 21, 150])
    assert (space.levels[0] == image).all()
    assert (space.levels[1][4:7, 4:7] == 3).all()
    assert (space.levels[1][20:24, 20:25] == 1).all()
    assert not space.levels[2][20:24, 20:25].any()
    assert (space.levels[2][2:12, 2:12] == 3).all()
    assert not space.levels[3].any()


def test_levels_are_read_only_and_apart_from_the_input():
    """A scale-space is a value: neither it nor its input can change under the other's hands."""
    image = np.ones((4, 4), dtype=np.int16)
    space = build_scale_space(image, [1])
    image[:] = 9
    assert (space.levels == 1).all()
    with pytest.raises(ValueError, match="read-only"):
        space.levels[0, 0, 0] = 5


@pytest.mark.parametrize("thresholds", [[], [5, 5], [9, 4], [0, 3], [2.5]])
def test_thresholds_must_ascend_from_one_cell(thresholds):
    """Scales are whole numbers of cells in strictly rising order."""
    with pytest.raises(ParameterError, match=r"ascending|from 1"):
        build_scale_space(np.zeros((3, 3), dtype=np.int16), thresholds)


def test_levels_and_thresholds_must_agree():
    """A scale-space of two levels has two thresholds; an image has two dimensions."""
    with pytest.raises(InputError, match="one level a threshold"):
        ScaleSpace(np.zeros((2, 3, 3)), (4,))
    with pytest.raises(InputError, match="two dimensions"):
        build_scale_space(np.zeros(3), [1])

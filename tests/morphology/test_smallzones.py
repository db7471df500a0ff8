"""Small zones join the neighbour that they rise or fall to least."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage
from support import oracles
from support.strategies import CONNECTIVITIES, integer_images

from msbdb.labels import label_zones
from msbdb.morphology import build_scale_space, merge_small_zones

IMAGES = integer_images(low=0, high=5)


def test_the_nearest_value_takes_a_small_zone():
    """A wall cell of 2 between 0, 3 and 6 becomes 3, and the ground stays ground."""
    level = np.array([[0, 0, 0, 0, 0], [0, 3, 3, 3, 3], [0, 2, 6, 6, 6], [0, 2, 6, 6, 6]])
    assert merge_small_zones(level, 3).tolist() == [[0] * 5, [0, 3, 3, 3, 3], [0, 3, 6, 6, 6], [0, 3, 6, 6, 6]]


def test_the_longer_edge_decides_between_equal_steps():
    """A cell of 2 lies beside one cell of 1 and beside three of 3."""
    level = np.array([[1, 1, 1, 1], [1, 1, 1, 1], [3, 3, 2, 1], [3, 3, 3, 3]])
    assert merge_small_zones(level, 2, connectivity=4)[2, 2] in (1, 3)
    level = np.array([[1, 0, 3, 3], [1, 2, 3, 3], [1, 0, 3, 3]])
    assert merge_small_zones(level, 2, connectivity=8)[1].tolist() == [1, 1, 3, 3]
    level = np.array([[0, 0, 3, 3], [1, 2, 3, 3], [1, 0, 3, 3]])
    assert merge_small_zones(level, 2, connectivity=8)[1].tolist() == [1, 3, 3, 3]


def test_an_island_alone_stays():
    """Where there is nothing to join, nothing changes; two small zones join each other."""
    assert merge_small_zones(np.array([[1, 0, 5, 5, 5]]), 3).tolist() == [[1, 0, 5, 5, 5]]
    assert merge_small_zones(np.array([[1, 2, 0, 5, 5, 5]]), 3).tolist() == [[2, 2, 0, 5, 5, 5]]


def test_zones_that_meet_with_one_value_are_one():
    """The cell of 2 joins both zones of 3 at once."""
    merged = merge_small_zones(np.array([[3, 3, 2, 3, 3, 9, 9, 9]]), 3)
    assert merged.tolist() == [[3, 3, 3, 3, 3, 9, 9, 9]]


def test_a_level_without_small_zones_is_returned_as_it_is():
    """There is nothing to do."""
    level = np.array([[1, 1, 0, 2, 2]], dtype=np.uint16)
    assert merge_small_zones(level, 2) is level


@given(IMAGES, st.integers(1, 30), CONNECTIVITIES)
def test_no_zone_is_small_that_has_a_neighbour(image, least, connectivity):
    """Zones only merge, the ground stays, and what is small afterwards is an island (V7, V11)."""
    merged = merge_small_zones(image, least, connectivity=connectivity)
    assert merged.dtype == image.dtype
    assert ((merged == 0) == (image == 0)).all()
    before, _ = label_zones(image, connectivity=connectivity)
    labels, count = label_zones(merged, connectivity=connectivity)
    pairs = np.unique(np.stack([before[before > 0], labels[before > 0]]), axis=1)
    assert len(pairs[0]) == before.max()
    for zone in range(1, count + 1):
        inside = labels == zone
        around = ndimage.binary_dilation(inside, oracles.STRUCTURES[connectivity]) & ~inside
        assert np.count_nonzero(inside) >= least or not merged[around].any()


@given(IMAGES, st.integers(1, 30), CONNECTIVITIES)
def test_islands_are_merged_independently(image, least, connectivity):
    """An island alone comes out as it does among the others, wherever it lies (V12)."""
    merged = merge_small_zones(image, least, connectivity=connectivity)
    islands, count = label_zones(image > 0, connectivity=connectivity)
    for island in range(1, count + 1):
        alone = np.pad(np.where(islands == island, image, 0), ((2, 0), (3, 1)))
        there = merge_small_zones(alone, least, connectivity=connectivity)[2:, 3:-1]
        np.testing.assert_array_equal(there[islands == island], merged[islands == island])


@given(IMAGES, st.sets(st.integers(1, 40), min_size=1, max_size=5).map(sorted), CONNECTIVITIES, st.booleans())
def test_every_zone_of_every_scale_has_at_least_s_cells(image, thresholds, connectivity, keep_ground):
    """With ``merge_small`` V7 holds on each scale, and zones only merge, or vanish with their island."""
    space = build_scale_space(image, thresholds, connectivity=connectivity, merge_small=True, keep_ground=keep_ground)
    finer = None
    for level, threshold in zip(space.levels, thresholds, strict=True):
        labels, count = label_zones(level, connectivity=connectivity)
        assert (np.bincount(labels.ravel(), minlength=count + 1)[1:] >= min(threshold, image.size)).all()
        if finer is not None:
            pairs = np.unique(np.stack([finer[finer > 0], labels[finer > 0]]), axis=1)
            assert len(pairs[0]) == finer.max()
        finer = labels
        if keep_ground:
            assert not level[space.levels[0] == 0].any()


@pytest.mark.parametrize("keep_ground", [False, True])
def test_a_house_in_a_yard_is_not_joined_to_the_ring_around(keep_ground):
    """The closing at 70 fills yard and house; with the ground kept, the yard stays open and the house is too small."""
    image = np.zeros((16, 16), dtype=np.int64)
    image[1:15, 1:15] = 2
    image[4:12, 4:12] = 0
    image[6:10, 6:10] = 1
    space = build_scale_space(image, [4, 70], merge_small=True, keep_ground=keep_ground)
    assert (space.levels[1][6:10, 6:10] == (0 if keep_ground else 2)).all()
    assert (space.levels[1][4, 4:12] == (0 if keep_ground else 2)).all()

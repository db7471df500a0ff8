"""Level zones are those of their definition, and hold no large step and no large spread."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy import ndimage
from support import oracles
from support.strategies import CONNECTIVITIES

from msbdb.errors import ParameterError
from msbdb.morphology import label_level_zones

HEIGHTS = hnp.arrays(
    np.int32, hnp.array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=9), elements=st.integers(0, 12)
)


def by_definition(heights, inside, step, spread, connectivity):
    """Return the largest α-zones with α up to the step whose spread is small enough, each by its first cell."""
    place = np.where(inside, np.cumsum(inside).reshape(inside.shape), 0)
    found = place.copy()
    for alpha in range(step + 1):
        zones = place.copy()
        changed = True
        while changed:
            before = zones.copy()
            for row, col in np.argwhere(inside):
                for r, c in np.argwhere(inside):
                    far = abs(row - r) + abs(col - c) if connectivity == 4 else max(abs(row - r), abs(col - c))
                    if far == 1 and abs(int(heights[row, col]) - int(heights[r, c])) <= alpha:
                        zones[row, col] = min(zones[row, col], zones[r, c])
            changed = (zones != before).any()
        for zone in np.unique(zones[inside]):
            cells = zones == zone
            if np.ptp(heights[cells]) <= spread:
                found[cells] = zone
    return found


@given(HEIGHTS, st.integers(0, 4), st.integers(0, 8), CONNECTIVITIES, st.randoms(use_true_random=False))
def test_zones_are_those_of_the_definition(heights, step, spread, connectivity, random):
    """Fast and plain agree, with cells left out."""
    heights = heights[:5, :5]
    inside = np.array([random.random() < 0.85 for _ in range(heights.size)]).reshape(heights.shape)
    found = label_level_zones(heights, inside, step=step, spread=spread, connectivity=connectivity)
    np.testing.assert_array_equal(found, by_definition(heights, inside, step, spread, connectivity))


@given(HEIGHTS, st.integers(0, 4), st.integers(0, 8), CONNECTIVITIES)
def test_zones_are_connected_and_do_not_spread(heights, step, spread, connectivity):
    """Each zone is one piece, and its heights differ by no more than the spread."""
    labels = label_level_zones(heights, heights > 0, step=step, spread=spread, connectivity=connectivity)
    assert ((labels > 0) == (heights > 0)).all()
    for zone in np.unique(labels[labels > 0]):
        inside = labels == zone
        assert ndimage.label(inside, oracles.STRUCTURES[connectivity])[1] == 1
        assert np.ptp(heights[inside]) <= spread


@given(HEIGHTS, st.integers(0, 4), st.integers(0, 8), st.integers(1, 3))
def test_turned_heights_give_turned_zones(heights, step, spread, turn):
    """No order of the cells has a part in it."""
    here = label_level_zones(heights, heights > 0, step=step, spread=spread)
    turned = np.rot90(heights, turn)
    there = np.rot90(label_level_zones(turned, turned > 0, step=step, spread=spread), -turn)
    pairs = np.unique(np.stack([here.ravel(), there.ravel()]), axis=1)
    assert len(np.unique(pairs[0])) == len(np.unique(pairs[1])) == len(pairs[0])


def test_a_ramp_does_not_join_two_levels():
    """A roof with noise of 1 stays whole beside a ramp of steps of 3 to another, which it reaches by steps of 3 too."""
    heights = np.array([[50, 51, 50, 51, 54, 57, 60, 63, 66, 69, 70, 69, 70]], dtype=np.int32)
    labels = label_level_zones(heights, heights > 0, step=5, spread=15)[0]
    assert len(set(labels[:4])) == 1
    assert len(set(labels[9:])) == 1
    assert labels[0] != labels[-1]


def test_small_steps_connect_whatever_the_spread():
    """A slow rise is one zone; without the free step it falls apart where it leaves the spread."""
    heights = np.arange(10, 40, 2, dtype=np.int32)[None]
    assert len(np.unique(label_level_zones(heights, heights > 0, step=5, spread=10, free_step=2))) == 1
    assert len(np.unique(label_level_zones(heights, heights > 0, step=5, spread=10, free_step=1))) == 15


@pytest.mark.parametrize("wrong", [{"step": -1, "spread": 1}, {"step": 1, "spread": -1}])
def test_negative_limits_are_refused(wrong):
    """The message names both."""
    with pytest.raises(ParameterError, match="0 or more"):
        label_level_zones(np.zeros((2, 2), np.int32), np.ones((2, 2), bool), **wrong)

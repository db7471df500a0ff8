"""Work on a list of cells gives what work on the image gives, in which all other cells are 0."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from msbdb.labels import CellList, label_zones, measure

SHAPES = st.tuples(st.integers(1, 9), st.integers(1, 9))
DTYPES = st.sampled_from([np.bool_, np.uint8, np.uint16, np.int32, np.int64])


def listed(seed, shape, dtype=np.int32, share=0.7):
    """Return a random image of few values, and a list of its cells with all that are not 0 and some others."""
    rng = np.random.default_rng(seed)
    image = (rng.integers(1, 4, shape) * (rng.random(shape) < share)).astype(dtype)
    return image, CellList.covering((image != 0) | (rng.random(shape) < 0.3))


@given(st.integers(0, 2**32 - 1), SHAPES)
def test_an_image_of_values_has_these_values_in_its_cells(seed, shape):
    """What is listed comes back, and all else is 0."""
    image, cells = listed(seed, shape)
    np.testing.assert_array_equal(cells.image(cells.of(image)), image)
    assert cells.places(cells.numbers).tolist() == list(range(cells.numbers.size))


@pytest.mark.parametrize("connectivity", [4, 8])
def test_zones_and_measures_are_those_of_the_image(connectivity):
    """Labels, their number and their order, in lattices of one row, one column and more, sparse and dense."""
    for seed in range(1500):
        rng = np.random.default_rng([seed, connectivity])
        shape = tuple(rng.integers(1, 9, 2))
        image, cells = listed(seed, shape, share=rng.choice([0.2, 0.5, 0.8, 1.0]))
        labels, count = cells.zones(cells.of(image), connectivity=connectivity)
        expected, expected_count = label_zones(image, connectivity=connectivity)
        assert count == expected_count
        np.testing.assert_array_equal(cells.image(labels), expected)
        assert cells.measure(labels, count).equals(measure(expected, count))


@given(st.integers(0, 2**32 - 1), SHAPES, DTYPES)
def test_every_dtype_gives_the_same_zones(seed, shape, dtype):
    """Booleans and whole numbers of any size."""
    image, cells = listed(seed, shape, dtype)
    labels, count = cells.zones(cells.of(image))
    expected = label_zones(image)
    assert (cells.image(labels).tolist(), count) == (expected[0].tolist(), expected[1])


@given(hnp.arrays(np.int32, SHAPES, elements=st.integers(0, 3)))
def test_regions_of_several_pieces_are_measured_as_in_the_image(image):
    """Labels need not be connected."""
    cells = CellList.covering(image > 0)
    labels = np.unique(image[image > 0], return_inverse=True)[1].reshape(-1).astype(np.int32) + 1
    count = int(labels.max(initial=0))
    assert cells.measure(labels, count).equals(measure(cells.image(labels), count))


def test_an_empty_list_has_no_zone():
    """No cell is off the ground."""
    cells = CellList.covering(np.zeros((3, 4), dtype=np.bool_))
    assert cells.zones(np.zeros(0, dtype=np.int32))[1] == 0
    assert cells.measure(np.zeros(0, dtype=np.int32), 0).empty
    assert not cells.image(np.zeros(0, dtype=np.int32)).any()

"""Flat zones are numbered in row-major order, without the background."""

import numpy as np
import pytest
from hypothesis import given
from support import oracles
from support.strategies import CONNECTIVITIES, images

from msbdb.errors import InputError, ParameterError
from msbdb.labels import label_zones


@given(images(), CONNECTIVITIES)
def test_zones_are_the_naive_definition(image, connectivity):
    """Zones are the components of each value, numbered by their first cells (V22, V25)."""
    labels, count = label_zones(image, connectivity=connectivity)
    assert labels.dtype == np.int32
    assert labels.max() == count
    np.testing.assert_array_equal(labels, oracles.flat_zones(image, connectivity))


def test_a_spiral_is_one_zone():
    """Arms that meet late get the number of the first cell, and no number is left out."""
    image = np.array(
        [
            [1, 1, 1, 1, 1, 1, 1],
            [1, 0, 0, 0, 0, 0, 1],
            [1, 0, 1, 0, 1, 0, 1],
            [1, 0, 1, 1, 1, 0, 1],
            [1, 0, 0, 0, 0, 0, 1],
            [2, 0, 3, 1, 1, 1, 1],
        ]
    )
    labels, count = label_zones(image, connectivity=4)
    assert count == 4
    assert (labels[image == 0] == 0).all()
    assert set(labels[0]) == {1}
    assert (labels[3, 2:5] == 2).all()
    assert labels[2, 2] == labels[2, 4] == 2
    assert (labels[5] == [3, 0, 4, 1, 1, 1, 1]).all()


def test_diagonal_cells_share_a_zone_with_8_only():
    """The connectivity is the caller's."""
    image = np.eye(4, dtype=np.int16)
    assert label_zones(image, connectivity=8)[1] == 1
    assert label_zones(image, connectivity=4)[1] == 4


def test_zones_do_not_wrap_around_rows():
    """The end of a row does not touch the start of the next."""
    image = np.array([[0, 0, 0, 6], [6, 0, 0, 0], [0, 0, 0, 0], [6, 0, 0, 0]])
    assert label_zones(image)[1] == 3


def test_an_empty_field_has_no_zone():
    """Background alone gives no cluster (V25)."""
    labels, count = label_zones(np.zeros((4, 5), dtype=np.int16))
    assert count == 0
    assert not labels.any()


@pytest.mark.parametrize("values", [[0.1, 0.1 + 2**-50], [2**53, 2**53 + 1], [2**64 - 1, 2**64 - 2]])
def test_the_smallest_difference_parts_zones(values):
    """Values are compared as they are, never rounded to another dtype."""
    dtype = np.uint64 if values[0] > 2**63 else None
    assert label_zones(np.array([values], dtype=dtype))[1] == 2


@pytest.mark.parametrize("dtype", ["?", "u1", ">i2", "<u4", "f2", ">f4", "f8"])
def test_every_dtype_gives_the_same_zones(dtype):
    """Width, sign and byte order of the numbers do not matter."""
    image = np.array([[1, 1, 0, 1], [0, 0, 1, 0]], dtype=dtype)
    np.testing.assert_array_equal(label_zones(image, connectivity=4)[0], [[1, 1, 0, 2], [0, 0, 3, 0]])


def test_what_is_no_image_is_refused():
    """The checks are those of the area filters."""
    with pytest.raises(InputError, match="NaN"):
        label_zones(np.array([[np.nan]]))
    with pytest.raises(ParameterError, match="4 or 8"):
        label_zones(np.zeros((2, 2)), connectivity=2)

"""The nearest cell of a set."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage
from support.sizes import examples

from msbdb.errors import NodataError
from msbdb.morphology import nearest_cells


@examples(200)
@given(
    st.integers(1, 25),
    st.integers(1, 25),
    st.sampled_from([0.0, 0.02, 0.1, 0.4, 0.95]),
    st.integers(0, 2**32 - 1),
)
def test_the_nearest_cells_are_those_of_scipy(height, width, share, seed):
    """Ties too: the western, then the northern of cells equally near; and the distances to the last bit."""
    rng = np.random.default_rng(seed)
    known = rng.random((height, width)) < share
    known[rng.integers(height), rng.integers(width)] = True
    distance, (rows, cols) = ndimage.distance_transform_edt(~known, return_indices=True)
    found, far = nearest_cells(known)
    np.testing.assert_array_equal(found, rows.astype(np.int64) * width + cols)
    np.testing.assert_array_equal(far, distance)


@pytest.mark.parametrize("shape", [(1, 40_000), (40_000, 1)])
def test_distances_along_a_line_are_exact(shape):
    """Squares of this length need more than 32 bits."""
    known = np.zeros(shape, dtype=np.bool_)
    known.ravel()[0] = True
    found, far = nearest_cells(known)
    assert not found.any()
    np.testing.assert_array_equal(far.ravel(), np.arange(40_000))


def test_without_a_known_cell_none_is_nearest():
    """There is an error, and no number."""
    with pytest.raises(NodataError, match="No cell is known"):
        nearest_cells(np.zeros((2, 3), dtype=np.bool_))

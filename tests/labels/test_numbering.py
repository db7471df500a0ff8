"""Numbers, sizes, sums and overlaps of labelled regions: laws that hold for any label image."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from support import oracles

from msbdb.labels import (
    EIGHT,
    boxes,
    by_three,
    chosen_cells,
    join_cells,
    label_zones,
    neighbours,
    renumber,
    reorder,
    shared_cells,
    sizes,
    small_zones,
    sums,
)

COUNT = 6
IMAGES = hnp.arrays(np.int32, st.tuples(st.integers(1, 8), st.integers(1, 8)), elements=st.integers(0, COUNT))
CHOICES = hnp.arrays(np.bool_, COUNT)


@given(IMAGES, st.integers(0, 2**32 - 1))
def test_sizes_and_sums_are_counted_cell_by_cell(labels, seed):
    """Of labels without a cell they are 0; with the background, sizes add up to the image."""
    values = np.random.default_rng(seed).integers(-99, 99, labels.shape)
    numbers = range(1, COUNT + 1)
    assert sizes(labels, COUNT).tolist() == [np.count_nonzero(labels == i) for i in numbers]
    assert sums(labels, values, COUNT).tolist() == [values[labels == i].sum() for i in numbers]
    assert sums(labels, labels > 0, COUNT).tolist() == sizes(labels, COUNT).tolist()
    assert sizes(labels, COUNT).sum() == labels.size - np.count_nonzero(labels == 0)


@given(IMAGES, CHOICES)
def test_chosen_regions_and_the_others_share_out_the_labelled_cells(labels, chosen):
    """Each cell of a region is in one of both, and no cell beside."""
    one, other = chosen_cells(labels, chosen), chosen_cells(labels, ~chosen)
    assert not (one & other).any()
    np.testing.assert_array_equal(one | other, labels > 0)
    np.testing.assert_array_equal(one, np.isin(labels, np.flatnonzero(chosen) + 1))


@given(IMAGES, CHOICES)
def test_renumbered_regions_keep_their_cells_and_order(labels, keep):
    """Labels are 1 to the count without a gap; what is not kept becomes background."""
    found, count = renumber(labels, keep)
    assert found.dtype == np.int32
    assert count == keep.sum()
    for new, old in enumerate(np.flatnonzero(keep) + 1, start=1):
        np.testing.assert_array_equal(found == new, labels == old)
    np.testing.assert_array_equal(found > 0, chosen_cells(labels, keep))


@given(IMAGES, st.permutations(range(COUNT)), st.integers(0, COUNT))
def test_a_new_order_moves_labels_with_their_rows(labels, order, left):
    """Values looked up by the new labels in the new table are those of the old labels in the old one."""
    rows = np.array(order[:left], dtype=np.int64)
    table = np.arange(10, 10 + COUNT)
    found = reorder(labels, rows, COUNT)
    inside = found > 0
    np.testing.assert_array_equal(table[rows][found[inside] - 1], table[labels[inside] - 1])
    np.testing.assert_array_equal(inside, np.isin(labels, rows + 1))


@given(IMAGES, st.permutations(range(COUNT)))
def test_the_inverse_order_gives_the_labels_back(labels, order):
    """Renumbering all regions loses none."""
    rows = np.array(order)
    np.testing.assert_array_equal(reorder(reorder(labels, rows, COUNT), np.argsort(rows), COUNT), labels)


@given(IMAGES, st.integers(0, 2**32 - 1))
def test_shared_cells_are_those_of_a_cross_table(one, seed):
    """In order of both labels; the cells of a region in an image without background add up to its size."""
    other = np.random.default_rng(seed).integers(0, 5, one.shape).astype(np.int32)
    first, second, cells = shared_cells(one, other)
    table = np.zeros((COUNT + 1, 5), dtype=np.int64)
    np.add.at(table, (one, other), 1)
    expected = [(i, j, table[i, j]) for i in range(1, COUNT + 1) for j in range(1, 5) if table[i, j]]
    assert list(zip(first.tolist(), second.tolist(), cells.tolist(), strict=True)) == expected
    mirrored = shared_cells(other, one)
    assert sorted(zip(*mirrored[:2], strict=True)) == sorted(zip(second, first, strict=True))
    first, _, cells = shared_cells(one, other + 1)
    np.testing.assert_array_equal(np.bincount(first, cells, COUNT + 1)[1:], sizes(one, COUNT))


@given(IMAGES)
def test_a_box_is_the_least_that_holds_a_label(labels):
    """Labels without cells have none."""
    found = boxes(labels)
    assert list(found) == np.unique(labels[labels > 0]).tolist()
    for number, (rows, cols) in found.items():
        row, col = np.nonzero(labels == number)
        assert (rows.start, rows.stop, cols.start, cols.stop) == (row.min(), row.max() + 1, col.min(), col.max() + 1)


@pytest.mark.parametrize("connectivity", [4, 8])
@given(labels=IMAGES)
def test_zones_of_zones_are_the_same_zones(connectivity, labels):
    """Labelling is idempotent, and a mask's zones are those of its numbers."""
    zones, count = label_zones(labels, connectivity=connectivity)
    again, number = label_zones(zones, connectivity=connectivity)
    np.testing.assert_array_equal(again, zones)
    assert count == number
    mask = labels > 0
    of_mask, of_numbers = (label_zones(image, connectivity=connectivity)[0] for image in (mask, mask.astype("f4") * -2))
    np.testing.assert_array_equal(of_mask, of_numbers)


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.1, 0.25, 0.5, 1.25, 9.0]))
def test_joined_cells_are_the_components_of_the_small_steps(seed, step):
    """SciPy finds the same regions, in the same order; a step of just so much joins nothing."""
    rng = np.random.default_rng(seed)
    shape = (int(rng.integers(1, 12)), 12)
    heights = rng.choice(np.float32([0.0, 0.1, 0.25, 0.5, 0.75, 2.0, np.nan]), shape)
    among = rng.random(shape) < 0.8
    node, ends = np.arange(heights.size).reshape(heights.shape), []
    for one, other in neighbours(heights.shape):
        small = (np.abs(heights[other] - heights[one]) < np.float32(step)) & among[one] & among[other]
        ends.append((node[one][small], node[other][small]))
    first, second = (np.concatenate(each) for each in zip(*ends, strict=True))
    graph = coo_array((np.ones(first.size), (first, second)), shape=(heights.size, heights.size))
    expected, numbers = connected_components(graph, directed=False)
    regions, count = join_cells(heights, among, step)
    assert count == expected
    np.testing.assert_array_equal(regions, numbers.reshape(heights.shape))


@pytest.mark.parametrize("connectivity", [4, 8])
@given(
    mask=hnp.arrays(np.bool_, st.tuples(st.integers(1, 8), st.integers(1, 8))),
    cells=st.integers(0, 12) | st.floats(0, 12),
)
def test_small_zones_are_what_an_opening_removes(connectivity, mask, cells):
    """Components of fewer cells, and no component of just so many, nor of more."""
    opened = oracles.binary_area_opening(mask, cells, connectivity)
    np.testing.assert_array_equal(small_zones(mask, cells, connectivity=connectivity), mask & ~opened)


@given(hnp.arrays(np.bool_, st.tuples(st.integers(1, 8), st.integers(1, 8))))
def test_three_by_three_cells_are_combined_as_by_scipy(mask):
    """Erosion and dilation with nothing beyond the lattice, and sums where the outermost cells go on."""
    eroded = by_three(np.logical_and, mask, beyond=np.False_)
    np.testing.assert_array_equal(eroded, ndimage.binary_erosion(mask, EIGHT))
    np.testing.assert_array_equal(by_three(np.logical_or, mask), ndimage.binary_dilation(mask, EIGHT))
    numbers = mask.astype(np.int64) * 7
    np.testing.assert_array_equal(by_three(np.add, numbers), ndimage.convolve(numbers, EIGHT, mode="nearest"))

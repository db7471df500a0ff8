"""Area filters and flat zones equal those of other libraries, on images too large for the naive definitions."""

import numpy as np
import pytest
from scipy import ndimage
from support.trees import opened

from msbdb.morphology import (
    area_closing,
    area_opening,
    areas,
    build_profile,
    build_tree,
    second_order_gradient,
    sums,
    window_profile,
)

THRESHOLDS = [2, 9, 60, 700]


def storeys(seed):
    """Blocks of storeys on empty ground, with noise like that of trees."""
    random = np.random.default_rng(seed)
    image = np.zeros((150, 170), dtype=np.int16)
    for _ in range(60):
        row, col = random.integers(0, 150, 2)
        height, width = random.integers(2, 30, 2)
        image[row : row + height, col : col + width] = random.integers(0, 21)
    noisy = random.random(image.shape) < 0.1
    image[noisy] = random.integers(0, 21, noisy.sum())
    return image


def relief(seed):
    """Smooth ground: each cell has a value of its own."""
    return ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=(150, 170)), 3.0).astype(np.float32)


def noise(seed):
    """Nothing but noise, as an image band of bytes."""
    return np.random.default_rng(seed).integers(0, 256, (150, 170)).astype(np.uint8)


IMAGES = pytest.mark.parametrize("image", [storeys(1), relief(2), noise(3)], ids=["storeys", "relief", "noise"])


@IMAGES
@pytest.mark.parametrize("threshold", THRESHOLDS)
@pytest.mark.parametrize("connectivity", [4, 8])
def test_openings_and_closings_are_those_of_diplib(image, threshold, connectivity):
    """DIPlib's connectivity 1 and 2 are 4 and 8 neighbours; it too keeps components of exactly s cells."""
    dip = pytest.importorskip("diplib")
    neighbours = {4: 1, 8: 2}[connectivity]
    opened = np.asarray(dip.AreaOpening(dip.Image(image), filterSize=threshold, connectivity=neighbours))
    closed = np.asarray(dip.AreaClosing(dip.Image(image), filterSize=threshold, connectivity=neighbours))
    np.testing.assert_array_equal(area_opening(image, threshold, connectivity=connectivity), opened)
    np.testing.assert_array_equal(area_closing(image, threshold, connectivity=connectivity), closed)


@IMAGES
@pytest.mark.parametrize("threshold", THRESHOLDS)
@pytest.mark.parametrize("connectivity", [4, 8])
def test_openings_and_closings_are_those_of_higra(image, threshold, connectivity):
    """A cell takes the altitude of the smallest node around it of at least s cells, in the max-tree or min-tree."""
    higra = pytest.importorskip("higra")
    graphs = {4: higra.get_4_adjacency_graph, 8: higra.get_8_adjacency_graph}
    graph = graphs[connectivity](image.shape)

    def without_small_nodes(component_tree):
        tree, altitudes = component_tree(graph, image)
        return higra.reconstruct_leaf_data(tree, altitudes, higra.attribute_area(tree) < threshold)

    opened = without_small_nodes(higra.component_tree_max_tree)
    closed = without_small_nodes(higra.component_tree_min_tree)
    np.testing.assert_array_equal(area_opening(image, threshold, connectivity=connectivity), opened)
    np.testing.assert_array_equal(area_closing(image, threshold, connectivity=connectivity), closed)


def town(seed):
    """Blocks and rough crowns on smooth ground: floats with plateaus and ties."""
    return (relief(seed) * 4 + storeys(seed) * np.float32(0.5)).round(2).astype(np.float32)


SURFACES = pytest.mark.parametrize("image", [storeys(5), relief(6), town(7)], ids=["storeys", "relief", "town"])


def higra_tree(image, connectivity):
    """Return Higra, its max-tree of an image, and the level of each node."""
    higra = pytest.importorskip("higra")
    graphs = {4: higra.get_4_adjacency_graph, 8: higra.get_8_adjacency_graph}
    return higra, *higra.component_tree_max_tree(graphs[connectivity](image.shape), image)


@SURFACES
@pytest.mark.parametrize("connectivity", [4, 8])
def test_the_component_tree_is_that_of_higra(image, connectivity):
    """Nodes have the same levels, areas, sums, extremes, and levels of their parents, whatever their numbers."""
    field = np.random.default_rng(8).integers(0, 50, image.shape)
    higra, tree, altitudes = higra_tree(image, connectivity)
    inner = np.arange(tree.num_leaves(), tree.num_vertices())

    def accumulated(accumulator):
        return higra.accumulate_sequential(tree, field, accumulator)[inner]

    expected = [
        altitudes[inner],
        altitudes[tree.parents()[inner]],
        higra.attribute_area(tree)[inner],
        accumulated(higra.Accumulators.sum),
    ]
    own = build_tree(image, connectivity=connectivity)
    found = [own.level, own.around(own.level), areas(own), sums(own, field)]
    assert own.size == inner.size
    np.testing.assert_array_equal(in_order(found), in_order(expected))


def in_order(columns):
    """Return rows of attributes, sorted."""
    rows = np.column_stack([np.asarray(column, dtype=np.float64) for column in columns])
    return rows[np.lexsort(rows.T)]


@SURFACES
@pytest.mark.parametrize("connectivity", [4, 8])
def test_the_nodes_of_higher_zones_are_higras_attribute_openings(image, connectivity):
    """Without the zones up to i, by the sum of gradients, the tree is the opening by λ_i read from Higra's tree."""
    higra, tree, altitudes = higra_tree(image, connectivity)
    # Whole numbers, so that the order of adding them does not matter.
    gradient = np.round(second_order_gradient(image) * 64)
    attribute = higra.accumulate_sequential(tree, gradient.astype(np.float64), higra.Accumulators.sum)
    thresholds = [0, 40, 400, 4000, 40000]
    openings = [higra.reconstruct_leaf_data(tree, altitudes, attribute < threshold) for threshold in thresholds]
    own = build_tree(image, connectivity=connectivity)
    profile = build_profile(own, sums(own, gradient), thresholds)
    for i, opening in enumerate(openings):
        np.testing.assert_array_equal(opened(own, profile.zone > i), opening)


@SURFACES
@pytest.mark.parametrize("threshold", THRESHOLDS)
@pytest.mark.parametrize("connectivity", [4, 8])
def test_area_openings_of_the_tree_are_those_of_diplib(image, threshold, connectivity):
    """One tree gives the openings of all areas, bit by bit."""
    dip = pytest.importorskip("diplib")
    expected = dip.AreaOpening(dip.Image(image), filterSize=threshold, connectivity={4: 1, 8: 2}[connectivity])
    tree = build_tree(image, connectivity=connectivity)
    np.testing.assert_array_equal(opened(tree, areas(tree) >= threshold), np.asarray(expected))


@SURFACES
@pytest.mark.parametrize("connectivity", [4, 8])
def test_supports_filtered_by_area_are_labels_filtered_by_size(image, connectivity):
    """The nodes kept are the large regions that scikit-image labels in each {δ_i > 0}."""
    measure = pytest.importorskip("skimage.measure")
    tree = build_tree(image, connectivity=connectivity)
    profile = build_profile(tree, sums(tree, second_order_gradient(image)), [0, 5, 20, 80, 400])
    least = 1.5 * profile.thresholds
    kept = profile.filter_supports(areas(tree), least)
    union = np.zeros(image.shape, dtype=bool)
    for i in range(1, profile.zones + 1):
        support = opened(tree, profile.zone > i - 1) > opened(tree, profile.zone > i)
        labels = measure.label(support, connectivity=connectivity // 4)
        large = (np.bincount(labels.ravel()) >= least[i])[labels] & (labels > 0)
        found = tree.paint(tree.outermost(kept & (profile.zone == i)), fill=-1) >= 0
        np.testing.assert_array_equal(found, large)
        union |= large
    np.testing.assert_array_equal(profile.union(kept) >= 0, union)


@SURFACES
@pytest.mark.parametrize("window", [3, 9])
def test_openings_by_windows_are_those_of_scipy_within_the_edges(image, window):
    """Away from the edge, where the libraries' border rules cannot matter, the first zone is g less scipy's opening."""
    response, zone = window_profile(image, [window])
    expected = image.astype(np.float64) - ndimage.grey_opening(image, size=(window, window))
    inside = np.s_[window:-window, window:-window]
    np.testing.assert_array_equal(response[inside], expected[inside])
    np.testing.assert_array_equal(zone[inside], expected[inside] > 0)

"""Area filters and flat zones equal those of other libraries, on images too large for the naive definitions."""

import numpy as np
import pytest
from scipy import ndimage

from msbdb.morphology import area_closing, area_opening, label_zones

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


@pytest.mark.parametrize("connectivity", [4, 8])
def test_flat_zones_are_those_of_scikit_image(connectivity):
    """scikit-image labels zones of equal integers, in row-major order too."""
    measure = pytest.importorskip("skimage.measure")
    image = storeys(4)
    labels, count = label_zones(image, connectivity=connectivity)
    expected, number = measure.label(image, background=0, return_num=True, connectivity=connectivity // 4)
    assert count == number
    np.testing.assert_array_equal(labels, expected)

"""The component tree is the tree of all components of all threshold sets, with their attributes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support import oracles
from support.strategies import CONNECTIVITIES, fields, images, surfaces
from support.trees import innermost, opened

from msbdb.errors import InputError, ParameterError
from msbdb.morphology import area_opening, areas, build_tree, is_increasing, sums

SEEDS = st.integers(0, 2**32 - 1)


def masks_of(tree):
    """Return the cells of each node: its own, and those of all nodes in it."""
    masks = np.zeros((tree.size, *tree.node_of.shape), dtype=bool)
    for node in range(tree.size):
        inside = innermost(tree, np.arange(tree.size) == node) == node
        masks[node] = tree.paint(inside)
    return masks


@given(surfaces(), CONNECTIVITIES)
def test_the_nodes_are_the_components_of_all_threshold_sets(surface, connectivity):
    """Each component is one node, at its lowest value; there is no other node."""
    values, valid = surface
    tree = build_tree(values, valid, connectivity=connectivity)
    expected = {mask.tobytes(): level for mask, level in oracles.components(values, valid, connectivity)}
    found = {mask.tobytes(): level for mask, level in zip(masks_of(tree), tree.level, strict=True)}
    assert found == expected
    assert len(found) == tree.size
    assert tree.level.dtype == values.dtype


@given(surfaces(), CONNECTIVITIES)
def test_a_parent_is_the_next_larger_component_and_comes_first(surface, connectivity):
    """Parents have smaller numbers and levels, their children's cells, and nothing lies between; roots are own."""
    values, valid = surface
    tree = build_tree(values, valid, connectivity=connectivity)
    masks = masks_of(tree)
    for node, parent in enumerate(tree.parent):
        around = [
            other
            for other in range(tree.size)
            if (masks[other] > masks[node]).any() and (masks[other] >= masks[node]).all()
        ]
        if tree.is_root[node]:
            assert not around
        else:
            assert parent < node
            assert tree.level[parent] < tree.level[node]
            assert parent == min(around, key=lambda other: masks[other].sum())


@given(surfaces(), CONNECTIVITIES)
def test_descendants_follow_a_node_without_a_gap(surface, connectivity):
    """The nodes within a node have the numbers next to it."""
    tree = build_tree(*surface, connectivity=connectivity)
    for node in range(tree.size):
        inside = np.flatnonzero(innermost(tree, np.arange(tree.size) == node) == node)
        np.testing.assert_array_equal(inside, np.arange(node, node + inside.size))


@given(surfaces(), CONNECTIVITIES)
def test_each_cell_has_the_node_of_its_own_value(surface, connectivity):
    """Painting the levels gives the image back; invalid cells have no node."""
    values, valid = surface
    tree = build_tree(values, valid, connectivity=connectivity)
    np.testing.assert_array_equal(tree.paint(tree.level)[valid], values[valid])
    np.testing.assert_array_equal(tree.node_of == -1, ~valid)
    assert (tree.paint(tree.level, fill=7)[~valid] == 7).all()


@given(surfaces(), CONNECTIVITIES, SEEDS)
def test_attributes_are_those_of_the_components(surface, connectivity, seed):
    """Area and sum of a field equal what is counted in each component's cells."""
    values, valid = surface
    field = np.where(valid, fields(values.shape, seed), np.nan)
    tree = build_tree(values, valid, connectivity=connectivity)
    masks = masks_of(tree)
    np.testing.assert_array_equal(areas(tree), masks.sum(axis=(1, 2)))
    np.testing.assert_array_equal(sums(tree, field), [field[mask].sum() for mask in masks])


@given(surfaces(), CONNECTIVITIES, SEEDS)
def test_sums_of_what_is_not_negative_are_increasing(surface, connectivity, seed):
    """A component has no more than the one around it (M4), in rounded numbers too; unlike its mean."""
    values, valid = surface
    tree = build_tree(values, valid, connectivity=connectivity)
    assert is_increasing(tree, areas(tree))
    assert is_increasing(tree, sums(tree, np.random.default_rng(seed).random(values.shape) * 1e-3))
    assert not is_increasing(tree, tree.level) or tree.is_root.all()


@given(surfaces(), CONNECTIVITIES, SEEDS)
def test_the_outermost_is_the_last_on_the_way_to_the_root(surface, connectivity, seed):
    """It is found by walking up, the node itself included; -1 where no selected node is met."""
    tree = build_tree(*surface, connectivity=connectivity)
    selected = np.random.default_rng(seed).random(tree.size) < 0.4
    outer = tree.outermost(selected)
    for node in range(tree.size):
        way = [node]
        while tree.parent[way[-1]] != way[-1]:
            way.append(tree.parent[way[-1]])
        met = [other for other in way if selected[other]]
        assert outer[node] == (met[-1] if met else -1)


@given(images(), CONNECTIVITIES, st.integers(1, 30))
def test_the_area_opening_of_the_tree_is_that_of_the_other_kernel(image, connectivity, threshold):
    """Two algorithms, by flood and by union-find, give the same opening."""
    tree = build_tree(image, connectivity=connectivity)
    found = opened(tree, areas(tree) >= threshold)
    assert found.dtype == image.dtype
    np.testing.assert_array_equal(found, area_opening(image, threshold, connectivity=connectivity))


@given(surfaces(), CONNECTIVITIES, st.tuples(st.integers(0, 3), st.booleans()))
def test_turns_and_mirrors_give_the_same_components(surface, connectivity, motion):
    """No direction of the lattice is preferred: areas and levels are the same."""
    values, valid = surface
    turns, mirror = motion

    def described(move):
        tree = build_tree(move(values), move(valid), connectivity=connectivity)
        return sorted(zip(areas(tree).tolist(), tree.level.tolist(), strict=True))

    assert described(lambda array: np.rot90(array.T if mirror else array, turns)) == described(lambda array: array)


def test_values_under_the_mask_do_not_count():
    """Whatever invalid cells hold, the tree is the same, and no component reaches across them."""
    values = np.array([[1.0, 5.0, 5.0, 5.0, 2.0]])
    valid = np.array([[True, True, False, True, True]])
    for hidden in (np.nan, 5.0, -99.0, np.inf):
        values[0, 2] = hidden
        tree = build_tree(values, valid)
        assert tree.is_root.sum() == 2
        assert sorted(areas(tree)) == [1, 1, 2, 2]


def test_an_image_of_one_value_is_one_node():
    """A plateau is one component; so is one pixel, whatever its dtype."""
    for image in (np.full((30, 40), 3.5, dtype=np.float32), np.array([[-7]], dtype=np.int16), np.ones((3, 1), bool)):
        tree = build_tree(image)
        assert tree.size == 1
        assert tree.is_root.all()
        assert areas(tree) == [image.size]
        assert tree.level == image.ravel()[:1]


def test_without_any_valid_cell_there_is_no_node():
    """The tree is empty, and so is all that is read from it."""
    image = np.full((4, 5), np.nan)
    tree = build_tree(image, np.zeros((4, 5), dtype=bool))
    assert tree.size == areas(tree).size == sums(tree, image).size == 0
    assert not tree.paint(tree.level).any()
    assert not opened(tree, areas(tree) > 2).any()


def test_the_corners_of_16_bits_are_in_order():
    """The extremes of integers are levels like any other."""
    image = np.array([[-32768, 32767, 0, -1]], dtype=np.int16)
    tree = build_tree(image)
    np.testing.assert_array_equal(tree.level, np.array([-32768, -1, 0, 32767]))


def test_zeros_of_both_signs_are_one_plateau():
    """Minus zero is zero."""
    assert build_tree(np.array([[0.0, -0.0, 0.0]], dtype=np.float32)).size == 1


@pytest.mark.parametrize("dtype", ["?", "u1", "i2", "<u4", ">i4", "u8", "f2", ">f4", "f8"])
def test_every_dtype_is_ordered_and_stays_itself(dtype):
    """Width and byte order of the numbers do not matter; the levels come out as they went in."""
    image = np.array([[0, 1, 0, 1, 1]], dtype=dtype)
    tree = build_tree(image)
    assert tree.size == 3
    assert tree.level.dtype == dtype
    assert sorted(areas(tree)) == [1, 2, 5]


def test_views_and_strides_do_not_matter():
    """A transposed, stepped view has the tree of its copy."""
    view = np.random.default_rng(2).integers(0, 4, (40, 30)).astype(np.int16).T[::2, ::-3]
    one, other = build_tree(view), build_tree(view.copy())
    np.testing.assert_array_equal(one.parent, other.parent)
    np.testing.assert_array_equal(one.node_of, other.node_of)


def test_a_tree_larger_than_a_word_of_words_is_right():
    """The queue has several levels of words: an image of 90 000 cells, each of another value, in a known tree."""
    image = np.random.default_rng(5).permutation(90_000).reshape(300, 300).astype(np.float32)
    image[:, 150] = -1
    tree = build_tree(image)
    assert tree.size == 90_000 - 299
    for threshold in (3, 40, 44_700, 44_701):
        np.testing.assert_array_equal(opened(tree, areas(tree) >= threshold), area_opening(image, threshold))


def test_the_tree_cannot_be_changed():
    """Its arrays are read-only, and the image is left alone."""
    image = np.arange(6.0).reshape(2, 3)
    before = image.copy()
    tree = build_tree(image)
    for array in (tree.parent, tree.level, tree.node_of):
        with pytest.raises(ValueError, match="read-only"):
            array.flat[0] = 0
    np.testing.assert_array_equal(image, before)
    assert image.flags.writeable


def test_what_is_no_surface_is_refused():
    """NaN in valid cells, a mask of another shape or kind, another neighbourhood, and a strange field."""
    image = np.ones((3, 4))
    with pytest.raises(InputError, match="NaN"):
        build_tree(np.full((3, 4), np.nan))
    with pytest.raises(InputError, match=r"of the image's shape \(3, 4\); got bool of \(4, 3\)"):
        build_tree(image, np.ones((4, 3), dtype=bool))
    with pytest.raises(InputError, match="must be of booleans"):
        build_tree(image, np.ones((3, 4)))
    with pytest.raises(ParameterError, match="must be 4 or 8; got 6"):
        build_tree(image, connectivity=6)
    tree = build_tree(image)
    with pytest.raises(InputError, match="of the tree's shape"):
        sums(tree, np.ones((3, 3)))
    with pytest.raises(InputError, match="not finite in 12 valid cells"):
        sums(tree, np.full((3, 4), np.inf))
    with pytest.raises(InputError, match="One value a node"):
        tree.paint(np.ones(5))

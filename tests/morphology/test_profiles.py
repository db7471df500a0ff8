"""Differential attribute profiles: the zones of one tree equal one opening and one filter a zone."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support import oracles
from support.strategies import CONNECTIVITIES, fields, integer_images, surfaces
from support.trees import opened

from msbdb.errors import InputError, ParameterError
from msbdb.morphology import (
    area_opening,
    areas,
    build_profile,
    build_tree,
    second_order_gradient,
    sums,
    zone_thresholds,
)

SEEDS = st.integers(0, 2**32 - 1)
THRESHOLDS = st.lists(st.integers(1, 120), min_size=1, max_size=6, unique=True).map(
    lambda quarters: np.array([0, *sorted(quarters)]) * 0.25
)
RATIO = 1.5


class Drawn:
    """A surface with the sum of a field as its attribute: the profile, and the naive definitions of the same."""

    def __init__(self, surface, connectivity, seed, thresholds):
        self.values, self.valid = surface
        self.connectivity = connectivity
        self.field = fields(self.values.shape, seed)
        self.tree = build_tree(self.values, self.valid, connectivity=connectivity)
        self.attribute = sums(self.tree, self.field)
        self.thresholds = thresholds
        self.profile = build_profile(self.tree, self.attribute, thresholds)

    def opening(self, threshold):
        """Open by threshold decomposition."""
        return oracles.attribute_opening(
            np.where(self.valid, self.values, self.values.dtype.type(0)),
            self.valid,
            self.connectivity,
            lambda mask: self.field[mask].sum(),
            threshold,
        )

    def zones(self):
        """Return the responses of all zones, by an opening for each."""
        opened = [self.opening(threshold).astype(float) for threshold in self.thresholds]
        return [finer - coarser for finer, coarser in pairwise(opened)]


DRAWN = st.builds(Drawn, surfaces(), CONNECTIVITIES, SEEDS, THRESHOLDS)


@given(DRAWN)
def test_openings_are_the_naive_definition(drawn):
    """The nodes of higher zones are the opening by threshold decomposition, bit by bit and of the same dtype."""
    for i, threshold in enumerate(drawn.thresholds):
        found = opened(drawn.tree, drawn.profile.zone > i)
        assert found.dtype == drawn.values.dtype
        np.testing.assert_array_equal(found, drawn.opening(threshold))


@given(DRAWN)
def test_supports_filtered_by_area_equal_one_binary_opening_a_zone(drawn):
    """The union of the nodes kept is that of the area openings of each {δ_i > 0} (Eq. 14; M16 to M18)."""
    profile = drawn.profile
    least = RATIO * drawn.thresholds
    kept = profile.filter_supports(areas(drawn.tree), least)
    union = np.zeros(drawn.values.shape, dtype=bool)
    for i, zone in enumerate(drawn.zones(), start=1):
        union |= oracles.binary_area_opening(zone > 0, least[i], drawn.connectivity)
    np.testing.assert_array_equal(profile.union(kept) != -1, union)


@given(DRAWN)
def test_each_component_of_the_union_is_one_node(drawn):
    """Cells of the union have the same node when they are connected in it, and else not."""
    least = RATIO * drawn.thresholds
    nodes = drawn.profile.union(drawn.profile.filter_supports(areas(drawn.tree), least))
    zones = oracles.flat_zones(nodes != -1, drawn.connectivity)
    pairs = {pair for pair in zip(zones.ravel().tolist(), nodes.ravel().tolist(), strict=True) if pair[0]}
    assert len(pairs) == len({zone for zone, _ in pairs}) == len({node for _, node in pairs})
    for zone, node in pairs:
        assert areas(drawn.tree)[node] == (zones == zone).sum()
        assert drawn.attribute[node] == drawn.field[zones == zone].sum()


@given(DRAWN)
def test_the_components_are_those_of_the_supports(drawn):
    """Each zone's support has as many components as nodes that are marked for it."""
    marked = drawn.profile.components()
    for i, zone in enumerate(drawn.zones(), start=1):
        count = oracles.flat_zones(zone > 0, drawn.connectivity).max()
        assert (marked & (drawn.profile.zone == i)).sum() == count


@given(DRAWN, st.integers(0, 40), st.integers(0, 40))
def test_attribute_openings_lower_are_idempotent_and_absorb(drawn, one, other):
    """γ_a ≤ g, γ_a γ_a = γ_a, and γ_a γ_b = γ_max(a, b) for any two thresholds (M28)."""

    def opening(values, threshold):
        tree = build_tree(values, drawn.valid, connectivity=drawn.connectivity)
        return opened(tree, sums(tree, drawn.field) >= threshold)

    first = opening(drawn.values, one)
    assert (first[drawn.valid] <= drawn.values[drawn.valid]).all()
    np.testing.assert_array_equal(opening(first, one), first)
    np.testing.assert_array_equal(opening(first, other), opening(drawn.values, max(one, other)))


@given(integer_images(), CONNECTIVITIES, st.integers(0, 40), SEEDS)
def test_a_higher_surface_has_a_higher_opening(image, connectivity, threshold, seed):
    """With the field as it is, the opening is increasing (M28)."""
    field = fields(image.shape, seed)
    raised = (image + np.random.default_rng(seed).integers(0, 3, image.shape)).astype(image.dtype)

    def opening(values):
        tree = build_tree(values, connectivity=connectivity)
        return opened(tree, sums(tree, field) >= threshold)

    # Flat at the minimum where nothing is large enough, which a raise of the minimum alone raises too.
    assert (opening(image) <= opening(raised)).all()


@given(surfaces(), CONNECTIVITIES)
def test_the_sum_of_second_order_gradients_makes_a_profile(surface, connectivity):
    """Λ of the paper (Eq. 11; M14) is increasing on any surface; zone i has the nodes of λ_{i-1} ≤ Λ < λ_i."""
    values, valid = surface
    tree = build_tree(values, valid, connectivity=connectivity)
    attribute = sums(tree, second_order_gradient(values, valid))
    limits = np.array([0, 0.5, 2, 9])
    profile = build_profile(tree, attribute, limits)
    inner = ~tree.is_root
    np.testing.assert_array_equal(profile.zone[inner], (attribute[inner, None] >= limits).sum(axis=1))
    assert (profile.zone[tree.is_root] == 4).all()


@given(surfaces(), CONNECTIVITIES, SEEDS)
def test_a_filter_of_any_criterion_takes_the_nearest_kept_node(surface, connectivity, seed):
    """The direct rule: the highest level of a kept component around each cell, or its area's lowest value."""
    values, valid = surface
    tree = build_tree(values, valid, connectivity=connectivity)
    keep = (areas(tree) + tree.level.astype(float) * 8).astype(int) % 2 == seed % 2
    expected = oracles.attribute_opening(
        np.where(valid, values, values.dtype.type(0)),
        valid,
        connectivity,
        lambda mask: int(mask.sum() + float(values[mask].min()) * 8) % 2 == seed % 2,
        True,
    )
    np.testing.assert_array_equal(opened(tree, keep), expected)


def test_a_flat_roof_is_kept_and_a_rough_crown_is_not():
    """Both have a large sum of gradients at their edge; a crown has one on its top also, in much less area for it."""
    surface = np.zeros((40, 60))
    surface[5:30, 5:30] = 6.0
    crown = np.random.default_rng(0).uniform(4, 16, (10, 10))
    surface[10:20, 45:55] = crown
    tree = build_tree(surface)
    gradient = second_order_gradient(surface)
    profile = build_profile(tree, sums(tree, gradient), zone_thresholds(30, 2000, 250))
    kept = profile.filter_supports(areas(tree), RATIO * profile.thresholds)
    union = profile.union(kept)
    assert (union[5:30, 5:30] >= 0).all()
    assert (union[:, 40:] == -1).all()
    node = union[10, 10]
    assert areas(tree)[node] == 625
    assert tree.level[node] == 6


def test_the_profile_by_area_agrees_with_area_openings():
    """On an image of thousands of cells, each support is where two openings by the other kernel differ."""
    image = np.random.default_rng(7).normal(size=(90, 80)).astype(np.float32).cumsum(axis=0).cumsum(axis=1)
    thresholds = zone_thresholds(5, 2000, 60)
    tree = build_tree(image)
    profile = build_profile(tree, areas(tree), thresholds)
    openings = [area_opening(image, max(int(threshold), 1)).astype(float) for threshold in thresholds]
    supports = [finer > coarser for finer, coarser in pairwise(openings)]
    kept = profile.components()
    for i, support in enumerate(supports, start=1):
        np.testing.assert_array_equal(tree.paint(tree.outermost(kept & (profile.zone == i)), fill=-1) >= 0, support)


@pytest.mark.parametrize("image", [np.full((5, 6), 2.5, dtype=np.float32), np.array([[-9]], dtype=np.int16)])
def test_a_surface_of_one_value_has_no_response(image):
    """One plateau, or one pixel: no zone responds, and the residual is all there is."""
    tree = build_tree(image)
    profile = build_profile(tree, areas(tree), [0, 3, 99])
    assert (profile.zone == 3).all()
    assert not profile.components().any()
    assert (profile.union(profile.components()) == -1).all()


def test_without_any_valid_cell_the_profile_is_empty():
    """No node, no component."""
    tree = build_tree(np.full((3, 4), np.nan), np.zeros((3, 4), dtype=bool))
    profile = build_profile(tree, areas(tree), [0, 5])
    assert profile.zone.size == 0
    assert (profile.union(profile.filter_supports(areas(tree), np.array([0.0, 1.0]))) == -1).all()


def test_each_connected_area_of_valid_cells_is_a_surface_of_its_own():
    """An island in a gap is no component of a support, nor does it change the others."""
    image = np.zeros((5, 9), dtype=np.int16)
    image[1:4, 1:3] = 4
    valid = np.ones(image.shape, dtype=bool)
    valid[:, 5] = False
    image[:, 6:] = 9
    tree = build_tree(image, valid)
    profile = build_profile(tree, areas(tree), [0, 7, 100])
    np.testing.assert_array_equal(profile.union(profile.components()) != -1, image == 4)


def test_thresholds_are_those_of_the_paper():
    """Eq. 12 with the values of Fig. 2 and Table 1 (M15, M23); the last one is always λ_max."""
    np.testing.assert_array_equal(zone_thresholds(50, 25000, 50), np.arange(0, 25001, 50))
    data_set_3 = zone_thresholds(20, 40000, 300)
    assert data_set_3.size == 136
    np.testing.assert_array_equal(data_set_3[[0, 1, 2, -2, -1]], [0, 20, 320, 39920, 40000])
    np.testing.assert_array_equal(zone_thresholds(30, 30, 250), [0, 30])
    assert zone_thresholds(0.1, 0.7, 0.2).size == 5


@pytest.mark.parametrize(
    ("least", "most", "step"), [(0, 9, 1), (30, 20, 5), (30, 90, 0), (30, 90, -5), (1, np.inf, 1), (np.nan, 9, 1)]
)
def test_zones_that_cannot_be_are_refused(least, most, step):
    """λ_Δ of zero, λ_max below λ_min, and what is not finite."""
    with pytest.raises(ParameterError, match="need 0 < λ_min ≤ λ_max and a step λ_Δ above 0"):
        zone_thresholds(least, most, step)


def test_too_many_zones_are_refused():
    """Zones are counted in 16 bits."""
    with pytest.raises(ParameterError, match="at most 32766 zones"):
        zone_thresholds(1, 1e9, 1e-3)


@pytest.mark.parametrize("thresholds", [[], [0], [1, 2], [0, 2, 2], [0, 3, 1], [0, np.nan], [[0, 1]]])
def test_thresholds_that_make_no_zones_are_refused(thresholds):
    """They start at 0 and increase."""
    tree = build_tree(np.eye(3))
    with pytest.raises(ParameterError, match="from 0 up"):
        build_profile(tree, areas(tree), thresholds)


def test_an_attribute_that_cannot_make_a_profile_is_refused():
    """A mean is not increasing (M4); an attribute needs a value a node, none below 0, and levels to be finite."""
    tree = build_tree(np.eye(3))
    with pytest.raises(InputError, match="must be increasing"):
        build_profile(tree, tree.level, [0, 1])
    with pytest.raises(InputError, match="must not be negative; got -9"):
        build_profile(tree, areas(tree) - 12, [0, 1])
    with pytest.raises(InputError, match="one value a node, of 2"):
        build_profile(tree, np.ones(3), [0, 1])
    infinite = build_tree(np.array([[0.0, np.inf]]))
    with pytest.raises(InputError, match="infinite"):
        build_profile(infinite, areas(infinite), [0, 1])


def test_a_filter_without_a_value_for_each_zone_is_refused():
    """One value a zone, after one for position 0."""
    tree = build_tree(np.eye(3))
    profile = build_profile(tree, areas(tree), [0, 1, 5])
    with pytest.raises(InputError, match="each of 2 zones"):
        profile.filter_supports(areas(tree), np.ones(2))

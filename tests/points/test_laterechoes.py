"""Later echoes among points without numbers."""

from dataclasses import replace

import numpy as np
import pytest
from simulated import scenes

from msbdb.points.laterechoes import numbered_by_place, under_distance


@pytest.fixture(scope="module")
def trees():
    """Return a simulated town under trees: its points with all their echoes."""
    return scenes.under_trees(density=4.0).points


def unnumbered(cloud):
    """Return a cloud that does not know its echoes."""
    return replace(cloud, return_number=None, number_of_returns=None)


def test_later_echoes_are_noticed_where_they_are(trees):
    """All echoes without numbers hold later ones; the first ones alone, and numbered ones, need no search."""
    assert under_distance(trees) == 0
    assert 0.5 < under_distance(unnumbered(trees)) < 1.5
    assert under_distance(unnumbered(trees.take(trees.first_echo))) == 0


def test_what_lies_under_others_is_mostly_a_later_echo(trees):
    """Most later echoes are found, few first ones are lost, and the echoes hold no information."""
    found = numbered_by_place(unnumbered(trees), under_distance(unnumbered(trees)))
    first = trees.first_echo
    assert np.mean(found.first_echo[~first]) < 0.4
    assert np.mean(found.first_echo[first]) > 0.9
    assert not found.has_echoes


def test_the_order_of_points_has_no_effect(trees):
    """Shuffled points are told apart as before, and the decision is the same."""
    order = np.random.default_rng(0).permutation(len(trees))
    cloud = unnumbered(trees)
    around_m = under_distance(cloud)
    assert under_distance(cloud.take(order)) == around_m
    np.testing.assert_array_equal(
        numbered_by_place(cloud.take(order), around_m).first_echo, numbered_by_place(cloud, around_m).first_echo[order]
    )


def test_ground_beside_a_wall_is_a_first_echo():
    """Higher points on one side alone, in front of a wall or of its corner, cover nothing."""
    x, y = (place.ravel() for place in np.meshgrid(np.arange(-5, 5, 0.5), np.arange(-5, 5, 0.5)))
    cloud = scenes.under_trees(density=4.0).points
    for roof in (x > 0, (x > 0) & (y > 0)):
        z = np.where(roof, 6.0, 0.0)
        wall = replace(unnumbered(cloud.take(np.arange(len(x)))), x=x, y=y, z=z)
        assert numbered_by_place(wall, 1.0).first_echo.all()

"""Thinning of dense surveys: no denser than asked, evenly, and alike in every part and order."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import CRS
from simulated import scenes

from msbdb.points.cloud import PointCloud
from msbdb.points.lots import CELL_M, drawn, thinned
from msbdb.run.preparation.pointfacts import with_facts

METRES = CRS.from_epsg(32633)


def cloud_of(count, seed, side=20.0):
    """Return points by chance over a square, some of them second echoes."""
    random = np.random.default_rng(seed)
    x, y = np.round(random.uniform(0, side, (2, count)) + 1e5, 3)
    number = random.integers(1, 3, count).astype(np.uint8)
    return PointCloud(x, y, np.round(random.uniform(0, 9, count), 3), METRES, None, None, number, np.maximum(number, 1))


def rows(cloud):
    """Return the places of a cloud's points, sorted."""
    return sorted(zip(cloud.x.tolist(), cloud.y.tolist(), cloud.z.tolist(), strict=True))


@settings(deadline=None, max_examples=30)
@given(st.integers(1, 4000), st.integers(0, 2**32 - 1), st.floats(0.5, 20))
def test_parts_and_orders_keep_the_same_points(count, seed, most):
    """A part that ends on whole cells keeps what the whole keeps there, in any order of points."""
    cloud = cloud_of(count, seed)
    whole = thinned(cloud, most)
    west = cloud.x < 1e5 + 5 * CELL_M
    part = cloud.take(np.random.default_rng(seed).permutation(np.flatnonzero(west)))
    assert rows(thinned(part, most)) == rows(whole.take(whole.x < 1e5 + 5 * CELL_M))


def test_dense_places_become_as_dense_as_asked():
    """Of a strip that was flown three times about as many points stay as of the others; sparse cells lose none."""
    once, thrice = cloud_of(16_000, 1), cloud_of(48_000, 2)
    x = np.concatenate([once.x, thrice.x + 20])
    both = PointCloud(x, np.concatenate([once.y, thrice.y]), np.concatenate([once.z, thrice.z]), METRES)
    found = thinned(both, 30.0)
    west = found.x < 1e5 + 20
    assert np.count_nonzero(west) == pytest.approx(30 * 400, rel=0.03)
    assert np.count_nonzero(~west) == pytest.approx(30 * 400, rel=0.03)
    sparse = cloud_of(4000, 3)
    assert thinned(sparse, 30.0) is sparse
    assert thinned(both, 0.0) is both


def test_later_echoes_keep_their_share():
    """All echoes are drawn alike, so that crowns have as many of them as before."""
    cloud = cloud_of(60_000, 4)
    before, after = np.mean(cloud.return_number == 2), np.mean(thinned(cloud, 10.0).return_number == 2)
    assert after == pytest.approx(before, abs=0.02)


def test_lots_are_even():
    """A tenth of the points is a tenth in each quarter of a place."""
    cloud = cloud_of(80_000, 5)
    chosen = drawn(cloud, 0.1)
    for quarter in (cloud.x < 1e5 + 10, cloud.x >= 1e5 + 10, cloud.y < 1e5 + 10, cloud.y >= 1e5 + 10):
        assert np.mean(chosen[quarter]) == pytest.approx(0.1, abs=0.01)


def test_a_survey_knows_its_density_before_and_after():
    """The plan has both; a survey that is sparse enough keeps all points."""
    dense = scenes.courtyard(density=60.0).points
    facts = with_facts(dense, 30.0).facts
    assert facts.all_density == pytest.approx(60, rel=0.1)
    assert facts.density == pytest.approx(30, rel=0.1)
    all_of_them = with_facts(dense, 0.0)
    assert len(all_of_them) == len(dense)
    assert all_of_them.facts.density == all_of_them.facts.all_density
    again = with_facts(replace(dense, facts=facts), 30.0)
    assert rows(again) == rows(with_facts(dense, 30.0))

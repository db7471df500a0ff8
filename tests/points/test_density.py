"""How points are spread: which ones are lone."""

import numpy as np

from msbdb.points.lonepoints import lone_values


def test_loneness_depends_on_values_alone():
    """Small groups behind a gap are lone in any order; large ones are not."""
    rng = np.random.default_rng(3)
    values = np.concatenate([rng.uniform(0, 100, 500), [900.0, 901.0], [-900.0], rng.uniform(2000, 2100, 100)])
    lone = lone_values(values, 500.0)
    np.testing.assert_array_equal(np.flatnonzero(lone), [500, 501, 502])
    order = rng.permutation(len(values))
    np.testing.assert_array_equal(lone_values(values[order], 500.0), lone[order])
    assert not lone_values(np.array([0.0, 1e6]), 500.0).any()

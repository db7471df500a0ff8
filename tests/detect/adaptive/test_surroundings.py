"""Planes and means around points against their definitions, point by point."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from msbdb.detect.adaptive.surroundings import LEAST_POINTS, SHARING, means_around, plane_residuals


def clouds(seed: int, count: int, side_m: float) -> NDArray[np.float64]:
    """Return points at random, a third of them in a heap, so that cells hold from none to many."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-side_m, side_m, (count, 3)) * (1, 1, 0.1)
    points[: count // 3] *= 0.05
    return points


@given(st.integers(0, 2**32 - 1), st.integers(0, 120), st.sampled_from([2.0, 6.0, 30.0]))
@settings(max_examples=40, deadline=None)
def test_the_plane_is_that_of_the_neighbours(seed: int, count: int, side_m: float) -> None:
    """The residual is that of the best plane through the neighbours in a sphere."""
    points, radius_m = clouds(seed, count, side_m), 1.3
    found = plane_residuals(*points.T, radius_m)
    for point, residual in zip(points, found, strict=True):
        near = points[((points - point) ** 2).sum(axis=1) <= radius_m**2]
        if len(near) < LEAST_POINTS:
            assert residual == np.inf
        else:
            least = np.linalg.eigvalsh(np.cov((near - point).T, bias=True))[0]
            wanted = np.sqrt(max(least, 0) * len(near) / (len(near) - 3))
            assert residual == pytest.approx(wanted, rel=1e-4, abs=1e-6)


@given(st.integers(0, 2**32 - 1), st.integers(0, 120), st.sampled_from([2.0, 6.0, 30.0]))
@settings(max_examples=40, deadline=None)
def test_the_means_are_those_of_a_disc_around_the_cell(seed: int, count: int, side_m: float) -> None:
    """The means are over the disc around the mean place of a cell's points."""
    points, radius_m = clouds(seed, count, side_m), 2.0
    values = np.random.default_rng(seed).random((count, 3)).astype(np.float32)
    found = means_around(points[:, 0].copy(), points[:, 1].copy(), values.copy(), radius_m)
    cells = np.floor(points[:, :2] / (radius_m / SHARING))
    for number in range(count):
        centre = points[(cells == cells[number]).all(axis=1), :2].mean(axis=0)
        near = ((points[:, :2] - centre) ** 2).sum(axis=1) <= radius_m**2
        np.testing.assert_allclose(found[number], values[near].mean(axis=0), rtol=1e-5)

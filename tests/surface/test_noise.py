"""Noise of the heights: it is measured on bare ground, and taken from the roughness of roofs."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from pyproj import CRS
from simulated import scenes

from msbdb.grid import Grid, GridSpec, lattice
from msbdb.morphology.windows import dilation
from msbdb.params import Params, with_values
from msbdb.run.preparation.drafts import build_surface
from msbdb.surface import cover_from_surface
from msbdb.surface.gridding import Samples
from msbdb.surface.noise import height_noise, without_noise
from msbdb.surface.texture import NO_PLANE_M, roughness

PARAMS = with_values(Params(), {"surface": {"cell_m": 0.5}})
NOISE_M = 0.15


def heights_of(spec: GridSpec, roof_m: float = 6.0) -> Grid:
    """Return level ground with a square roof in the middle."""
    high = np.zeros(spec.shape, dtype=np.float32)
    rows, cols = (slice(count // 3, 2 * count // 3) for count in spec.shape)
    high[rows, cols] = roof_m
    return Grid(high, np.ones(spec.shape, dtype=bool), spec)


def noise_of(rough: NDArray[np.float32], ndsm: Grid) -> NDArray[np.float32]:
    """Return the noise by windows of 1.5 m, beside a mask of 2 m."""
    return height_noise(rough, ndsm, window_m=1.5, mask_m=2.0)


@pytest.mark.parametrize("noise_m", [0.1, 0.15, 0.2])
def test_noise_of_level_ground_is_that_of_roofs(noise_m):
    """On noise alone, half of the cells of a roof are left with a third of the noise, and few with all of it."""
    spec = lattice((0, 0, 99.9, 99.9), 0.5, CRS.from_epsg(2154))
    ndsm = heights_of(spec)
    shaken = np.random.default_rng(2).normal(0, noise_m, spec.shape)
    still = np.zeros(spec.shape, dtype=np.float32)
    rough = roughness(Samples(shaken, still, still, spec), 1.5)
    found = noise_of(rough, ndsm)
    roof = np.asarray(ndsm.values) > 0
    left = without_noise(rough, found)[roof]
    assert 0 < found.min() <= found.max() < noise_m
    assert np.median(left) == pytest.approx(found[roof].mean() / 3, rel=0.2)
    assert np.quantile(left, 0.95) < noise_m


def test_smooth_ground_changes_nothing():
    """Where bare ground is as smooth as a precise scanner sees it, all roughness stays, bit for bit."""
    spec = lattice((0, 0, 59.9, 59.9), 0.5, CRS.from_epsg(2154))
    rough = np.random.default_rng(3).uniform(0, 1, spec.shape).astype(np.float32)
    ndsm = heights_of(spec)
    rough[np.asarray(ndsm.values) == 0] = 0.019
    found = noise_of(rough, ndsm)
    assert not found.any()
    np.testing.assert_array_equal(without_noise(rough, found), rough)


def test_hardly_any_bare_ground_and_cells_without_a_plane_say_nothing():
    """Without ground that has planes no noise is known, and cells without a plane keep their mark."""
    spec = lattice((0, 0, 39.9, 39.9), 0.5, CRS.from_epsg(2154))
    rough = np.full(spec.shape, 0.1, dtype=np.float32)
    roofs = Grid(np.full(spec.shape, 6, dtype=np.float32), np.ones(spec.shape, dtype=bool), spec)
    assert not noise_of(rough, roofs).any()
    rough[:] = NO_PLANE_M
    assert not noise_of(rough, heights_of(spec)).any()
    noise = np.full(spec.shape, 0.1, dtype=np.float32)
    np.testing.assert_array_equal(without_noise(rough, noise), rough)


@pytest.mark.parametrize("every", [2, 4])
def test_bare_cells_among_crowns_say_nothing_of_noise(every):
    """Ground beside crowns is rough by these: only where nothing is raised in its window does it count."""
    spec = lattice((0, 0, 59.9, 59.9), 0.5, CRS.from_epsg(2154))
    high = np.zeros(spec.shape, dtype=np.float32)
    high[::every, ::every] = 8
    ndsm = Grid(high, np.ones(spec.shape, dtype=bool), spec)
    open_ground = dilation(high, 3, None) == 0
    rough = np.where(open_ground, np.float32(0.012), np.float32(0.3))
    assert not noise_of(rough, ndsm).any()
    rough[open_ground] = 0.1
    assert noise_of(rough, ndsm).any() == (every == 4)


def test_a_tile_sees_the_noise_of_the_whole():
    """Cells farther than 50 m from the edge of a window have the noise that the whole survey gives them."""
    whole = lattice((30.0, 10.0, 329.9, 309.9), 0.5, CRS.from_epsg(2154))
    rough = np.random.default_rng(4).gamma(2, 0.03, whole.shape).astype(np.float32)
    ndsm = heights_of(whole)
    rows, cols = slice(77, 509), slice(131, 600)
    part = Grid(np.asarray(ndsm.values)[rows, cols], ndsm.valid[rows, cols], whole.crop(rows, cols))
    inner = slice(100, -100)
    found = noise_of(rough[rows, cols], part)[inner, inner]
    np.testing.assert_array_equal(found, noise_of(rough, ndsm)[rows, cols][inner, inner])
    assert len(np.unique(found)) > 1


@pytest.mark.parametrize("name", ["podium_tower", "row_houses"])
def test_noisy_roofs_are_as_smooth_as_before(name):
    """With 15 cm of noise on all points, most cells of roofs stay as smooth as roofs are."""
    scene = scenes.SCENES[name]()
    shaken = scene.points.z + np.random.default_rng(5).normal(0, NOISE_M, len(scene.points))
    points = replace(scene.points, z=shaken)
    surface = build_surface(points, PARAMS)
    found = cover_from_surface(surface, points, PARAMS)
    roof = np.asarray(surface.ndsm.values) > 2.5
    assert np.mean(found.roughness_m[roof] < 0.08) > 0.6
    noisy = roughness(surface.samples, PARAMS.cover.window_m)
    assert np.mean(found.roughness_m[roof] < 0.08) > np.mean(noisy[roof] < 0.08) + 0.1

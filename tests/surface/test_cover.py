"""Structural cover on simulated scenes: roofs and crowns, with echoes and without."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from simulated import scenes

from msbdb.errors import GridMismatchError
from msbdb.grid import Grid, lattice
from msbdb.params import Params, with_values
from msbdb.points.cloud import PointCloud
from msbdb.run.preparation.drafts import build_surface
from msbdb.surface import cover_from_surface, cover_with_colours, normalise, surface_from_rasters
from msbdb.surface.gridding import Samples
from msbdb.surface.structure import ROOF, VEGETATION, leaf_share, rough_cells, smooth_shares, structural_cover
from msbdb.surface.texture import (
    LEAST_SAMPLES,
    NO_PLANE_M,
    WIDEST_SAMPLES,
    Echoes,
    Texture,
    roughness,
    widest_window_m,
)

Scene = scenes.Scene
PARAMS = with_values(Params(), {"surface": {"cell_m": 0.5}})


def without_echoes(points: PointCloud) -> PointCloud:
    """Return the first echoes as a source that holds nothing else."""
    return replace(points.take(points.first_echo), return_number=None, number_of_returns=None)


def found_roofs(scene: Scene, points: PointCloud) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Roofs found and true, on the scene's lattice; border cells of the lattice excepted."""
    surface = build_surface(points, PARAMS)
    cover = cover_from_surface(surface, points, PARAMS).cover
    row, col = np.indices(scene.spec.shape)
    r, c = surface.dsm.spec.rowcol(*scene.spec.xy(row, col))
    inside = (r >= 0) & (c >= 0) & (r < cover.spec.shape[0]) & (c < cover.spec.shape[1])
    roofs = np.zeros(scene.spec.shape, dtype=bool)
    roofs[inside] = cover.labelled("building")[r[inside], c[inside]]
    return roofs, scene.buildings > 0


@pytest.mark.parametrize("echoed", [True, False])
@pytest.mark.parametrize("name", ["podium_tower", "row_houses", "under_trees", "courtyard", "green_roof"])
def test_roofs_are_found_with_and_without_echoes(name, echoed):
    """Roofs and truth overlap by most of their union; crowns over a roof may take their share."""
    scene = scenes.SCENES[name]()
    points = scene.points if echoed else without_echoes(scene.points)
    found, true = found_roofs(scene, points)
    true &= scene.cover != scenes.VEGETATION
    found &= scene.cover != scenes.VEGETATION
    assert np.count_nonzero(found & true) / np.count_nonzero(found | true) > 0.85


@pytest.mark.parametrize("echoed", [True, False])
def test_crowns_are_no_roofs(echoed):
    """Of the crowns apart from the house, next to nothing is taken for roof; they are vegetation."""
    scene = scenes.under_trees()
    points = scene.points if echoed else without_echoes(scene.points)
    found, true = found_roofs(scene, points)
    crowns = (scene.cover == scenes.VEGETATION) & ~true
    assert np.mean(found[crowns]) < (0.05 if echoed else 0.2)


def test_every_cell_above_the_mask_has_a_class_and_no_other():
    """Building or vegetation above 2 m; nothing below it, nor where there is no height."""
    scene = scenes.under_trees()
    surface = build_surface(scene.points, PARAMS)
    found = cover_from_surface(surface, scene.points, PARAMS)
    cover, rough = found.cover, found.roughness_m
    raised = surface.ndsm.valid & (np.asarray(surface.ndsm.values) >= PARAMS.surface.mask_m)
    np.testing.assert_array_equal(cover.index > 0, raised)
    assert set(np.unique(cover.index)) <= {0, ROOF, VEGETATION}
    assert rough.dtype == np.float32
    assert np.isfinite(rough).all()


def test_the_order_of_the_points_does_not_matter():
    """Shuffled points give the same surfaces and the same cover, bit for bit."""
    points = scenes.under_trees().points
    shuffled = points.take(np.random.default_rng(5).permutation(len(points)))
    one, other = build_surface(points, PARAMS), build_surface(shuffled, PARAMS)
    for name in ("dsm", "dtm", "ndsm"):
        np.testing.assert_array_equal(getattr(one, name).values, getattr(other, name).values)
        np.testing.assert_array_equal(getattr(one, name).valid, getattr(other, name).valid)
    a, b = cover_from_surface(one, points, PARAMS), cover_from_surface(other, shuffled, PARAMS)
    np.testing.assert_array_equal(a.cover.index, b.cover.index)
    np.testing.assert_array_equal(a.roughness_m, b.roughness_m)
    np.testing.assert_array_equal(a.roof_probability, b.roof_probability)


def test_roughness_that_is_known_changes_nothing_and_counts_for_its_window_alone():
    """The cover is that of roughness measured anew, also in other windows than those of the surface."""
    points = scenes.under_trees().points
    surface = build_surface(points, PARAMS)
    wider = with_values(PARAMS, {"cover": {"window_m": 2.5}})
    widest_m = widest_window_m(PARAMS.cover.wide_window_m, surface.dsm.spec.cell_m)
    as_wide_as_the_widest = with_values(PARAMS, {"cover": {"window_m": widest_m}})
    windows = ((PARAMS.cover.window_m, LEAST_SAMPLES), (PARAMS.cover.wide_window_m, LEAST_SAMPLES))
    assert set(surface.roughness) == {*windows, (widest_m, WIDEST_SAMPLES)}
    for params in (PARAMS, as_wide_as_the_widest, wider):
        known, anew = (cover_from_surface(each, points, params) for each in (surface, replace(surface, roughness={})))
        np.testing.assert_array_equal(known.roughness_m, anew.roughness_m)
        np.testing.assert_array_equal(known.cover.index, anew.cover.index)
    assert (known.roughness_m != cover_from_surface(surface, points, PARAMS).roughness_m).any()


def test_the_surfaces_are_those_of_the_scene():
    """Roofs stand at their height above the ground, and the ground at 0, whatever their slope."""
    scene = scenes.podium_tower()
    surface = build_surface(scene.points, PARAMS)
    row, col = scene.spec.rowcol(*surface.dsm.spec.xy(*np.indices(surface.dsm.spec.shape)))
    inside = (row >= 0) & (col >= 0) & (row < scene.spec.shape[0]) & (col < scene.spec.shape[1])
    error = np.asarray(surface.ndsm.values)[inside] - scene.heights[row[inside], col[inside]]
    assert np.median(np.abs(error)) < 0.05
    assert np.quantile(np.abs(error), 0.95) < 0.3
    assert surface.ground_filter == "walls"
    assert surface.density == pytest.approx(4.0, rel=0.1)


def test_the_cell_follows_the_density_unless_given():
    """V14: 4 points a square metre make cells of 0.5 m."""
    points = scenes.flat_field().points
    assert build_surface(points, Params()).dsm.spec.cell_m == 0.5
    assert build_surface(points, with_values(Params(), {"surface": {"cell_m": 1.5}})).dsm.spec.cell_m == 1.5


def test_the_cell_as_printed_is_one_over_the_density():
    """R_g = 1/D of Mongus et al.: 4 points a square metre make cells of 0.25 m (M7, A10)."""
    points = scenes.flat_field().points
    params = with_values(Params(), {"surface": {"cell_rule": "literal"}})
    assert build_surface(points, params).dsm.spec.cell_m == pytest.approx(0.25, abs=0.01)


def test_an_empty_field_has_no_roofs():
    """Nothing stands above the mask, so nothing is classified."""
    points = scenes.flat_field().points
    assert not cover_from_surface(build_surface(points, PARAMS), points, PARAMS).cover.index.any()


def test_rasters_make_a_surface_of_their_own():
    """A DSM and a DTM give the heights of their difference, and roofs without echoes."""
    scene = scenes.podium_tower()
    given = build_surface(scene.points, PARAMS)
    surface = surface_from_rasters(given.dsm, given.dtm)
    np.testing.assert_array_equal(surface.ndsm.values, given.ndsm.values)
    assert surface.ground_filter == "given"
    assert surface.density == 4.0
    cover = cover_from_surface(surface, None, PARAMS).cover
    assert np.count_nonzero(cover.labelled("building")) * 0.25 == pytest.approx(1200, rel=0.1)


def test_heights_need_one_lattice():
    """A DTM on other cells is refused."""
    spec, other = lattice((0, 0, 9, 9), 1.0, scenes.UTM33), lattice((1, 0, 10, 9), 1.0, scenes.UTM33)
    dsm, dtm = (Grid(np.zeros(s.shape, dtype="f4"), np.ones(s.shape, dtype=bool), s) for s in (spec, other))
    with pytest.raises(GridMismatchError, match="lattice"):
        normalise(dsm, dtm)


def test_smoothing_counts_raised_cells_alone():
    """The mean beside a wall is that of the roof, not of roof and ground."""
    raised = np.zeros((20, 20), dtype=bool)
    raised[5:15, 5:15] = True
    [share] = smooth_shares((np.where(raised, np.float32(0.98), np.float32(0.01)),), raised, 2.0)
    np.testing.assert_allclose(share[raised], 0.98, rtol=1e-4)


@pytest.mark.parametrize("echoed", [True, False])
def test_each_cell_s_own_probability_tells_roofs_from_crowns(echoed):
    """Before any smoothing it is a probability, high on the roof and low on the crowns beside it, in the mean."""
    scene = scenes.under_trees()
    points = scene.points if echoed else without_echoes(scene.points)
    surface = build_surface(points, PARAMS)
    found = cover_from_surface(surface, points, PARAMS).roof_probability
    assert found.dtype == np.float32
    assert ((found >= 0) & (found <= 1)).all()
    row, col = surface.dsm.spec.rowcol(*scene.spec.xy(*np.indices(scene.spec.shape)))
    inside = (row >= 0) & (col >= 0) & (row < found.shape[0]) & (col < found.shape[1])
    own = np.full(scene.spec.shape, np.nan)
    own[inside] = found[row[inside], col[inside]]
    crowns = scene.cover == scenes.VEGETATION
    assert np.nanmean(own[(scene.buildings > 0) & ~crowns]) > 0.75
    assert np.nanmean(own[crowns & (scene.buildings == 0)]) < 0.4


@pytest.mark.parametrize(("rough_m", "expected"), [(0.03, ROOF), (0.4, VEGETATION)])
def test_split_echoes_of_a_plane_are_glass_and_those_of_a_rough_surface_leaves(rough_m, expected):
    """A roof of 10 x 10 m of which each pulse is split, by how far its echoes scatter."""
    spec = lattice((0, 0, 20, 20), 0.5, scenes.UTM33)
    heights = np.zeros(spec.shape, dtype=np.float32)
    heights[10:30, 10:30] = 6.0
    one = np.ones_like(heights)
    rough = np.float32(rough_m) * one
    split = np.where(heights > 0, one, 0)
    echoes = Echoes(split, split, split, one)
    ndsm = Grid(heights, np.ones(spec.shape, dtype=bool), spec)
    found = structural_cover(Texture(ndsm, rough, rough, echoes, 2.0), None, PARAMS.cover)
    assert set(np.unique(found.cover.index[heights > 0])) == {expected}


@pytest.mark.parametrize("echoed", [True, False])
@pytest.mark.parametrize(("wide_m", "expected"), [(0.03, ROOF), (0.6, VEGETATION)])
def test_where_samples_are_too_few_the_wide_window_decides(wide_m, expected, echoed):
    """A roof or a crown of 10 x 10 m with hardly a plane in the small window, as where one strip alone has seen it."""
    spec = lattice((0, 0, 20, 20), 0.5, scenes.UTM33)
    heights = np.zeros(spec.shape, dtype=np.float32)
    heights[10:30, 10:30] = 6.0
    raised, one = heights > 0, np.ones_like(heights)
    rough = np.where(raised, np.float32(NO_PLANE_M), np.float32(0.02))
    rough[12::6, 12::6] = wide_m
    split = np.float32(0.25 if expected == VEGETATION else 0.1) * raised
    echoes = Echoes(split, split, split, one) if echoed else None
    ndsm = Grid(heights, np.ones(spec.shape, dtype=bool), spec)
    found = structural_cover(Texture(ndsm, rough, np.float32(wide_m) * one, echoes, 2.0), None, PARAMS.cover)
    assert set(np.unique(found.cover.index[raised])) == {expected}
    assert (found.roughness_m == rough).all()


@pytest.mark.parametrize(("widest_m", "expected"), [(0.03, ROOF), (0.6, VEGETATION)])
def test_where_the_wide_window_has_too_few_samples_the_widest_decides(widest_m, expected):
    """A roof or a crown of 10 x 10 m without a plane in the small and the wide window, and without echoes or trust."""
    spec = lattice((0, 0, 20, 20), 0.5, scenes.UTM33)
    heights = np.zeros(spec.shape, dtype=np.float32)
    heights[10:30, 10:30] = 6.0
    ndsm = Grid(heights, np.ones(spec.shape, dtype=bool), spec)
    one = np.ones_like(heights)
    none = np.where(heights > 0, np.float32(NO_PLANE_M), np.float32(0.02))
    texture = Texture(ndsm, none, none, None, 2.0, widest_roughness_m=np.float32(widest_m) * one)
    for without_trust in (texture, replace(texture, echoes=Echoes(0 * one, 0 * one, 0 * one, one))):
        found = structural_cover(without_trust, None, PARAMS.cover, recorded=0 * one)
        assert set(np.unique(found.cover.index[heights > 0])) == {expected}
        np.testing.assert_array_equal(found.roughness_m, none)
    assert rough_cells(texture, PARAMS.cover)[heights > 0].all() == (expected == VEGETATION)
    known = replace(texture, roughness_m=0.05 * one, wide_roughness_m=0.05 * one)
    assert set(np.unique(structural_cover(known, None, PARAMS.cover).cover.index[heights > 0])) == {ROOF}


def test_a_plane_in_the_widest_window_alone_is_no_glass():
    """A roof of which most pulses are split is glass where the wide window has a plane, and leaves where none is."""
    spec = lattice((0, 0, 20, 20), 0.5, scenes.UTM33)
    heights = np.zeros(spec.shape, dtype=np.float32)
    heights[10:30, 10:30] = 6.0
    one = np.ones_like(heights)
    split = np.where(heights > 0, one, 0)
    texture = Texture(
        Grid(heights, np.ones(spec.shape, dtype=bool), spec),
        0.02 * one,
        0.02 * one,
        Echoes(split, split, split, one),
        2.0,
        widest_roughness_m=0.02 * one,
    )
    for wide_m, expected in ((0.02, ROOF), (NO_PLANE_M, VEGETATION)):
        found = structural_cover(replace(texture, wide_roughness_m=wide_m * one), None, PARAMS.cover)
        assert set(np.unique(found.cover.index[heights > 0])) == {expected}


@pytest.mark.parametrize("seed", range(3))
def test_roofs_between_strips_that_do_not_overlap_are_found(seed):
    """Two houses and a clump of crowns on cells of 1 m, of which a third was measured, without echoes."""
    spec = lattice((0.0, 0.0, 79.9, 59.9), 1.0, scenes.UTM33)
    random = np.random.default_rng(seed)
    east, north = spec.xy(*np.indices(spec.shape))
    across = np.minimum(abs(east - 14), abs(east - 46))
    houses = (across < 5) & (abs(north - 40) < 10)
    crowns = (east - 62) ** 2 + (north - 18) ** 2 < 12**2
    heights = np.where(houses, 5 + 0.6 * (5 - across), 0.0)
    heights[crowns] = random.uniform(3, 12, np.count_nonzero(crowns))
    measured = random.random(spec.shape) < 1 / 3
    zero = np.zeros(spec.shape, dtype=np.float32)
    samples = Samples(np.where(measured, heights, np.nan), zero, zero, spec)
    dsm = Grid(heights.astype(np.float32), np.ones(spec.shape, dtype=bool), spec)
    surface = surface_from_rasters(dsm, dsm.with_values(zero))
    inner = houses & (across < 4) & (abs(north - 40) < 9)
    assert (roughness(samples, 3.0)[inner] == NO_PLANE_M).mean() > 0.3
    roofs = cover_from_surface(replace(surface, samples=samples), None, Params()).cover.labelled("building")
    assert roofs[inner].mean() > 0.9
    assert roofs[crowns].mean() < 0.15


def test_the_share_of_leaves_rises_between_its_limits_which_grow_with_the_cell():
    """0 up to glass_m, 1 from leaf_m on, never falling; on cells of 2 m at twice the roughness."""
    params = PARAMS.cover
    rough = np.geomspace(0.001, 5, 200).astype(np.float32)
    for cell_m, factor in ((0.3, 1.0), (1.0, 1.0), (2.0, 2.0)):
        share = leaf_share(rough, cell_m, params)
        assert (np.diff(share) >= 0).all()
        assert (share[rough <= 0.999 * factor * params.glass_m] == 0).all()
        assert (share[rough >= 1.001 * factor * params.leaf_m] == 1).all()
        between = (rough > 1.01 * factor * params.glass_m) & (rough < 0.99 * factor * params.leaf_m)
        assert ((share[between] > 0) & (share[between] < 1)).all()


@pytest.mark.parametrize(("cell_m", "half_m"), [(0.5, 4), (1.0, 4), (1.5, 3), (2.0, 4), (2.0, 5)])
def test_gabled_roofs_are_no_crowns_on_coarse_cells(cell_m, half_m):
    """Two houses of 20 m with ridges, 35 degrees steep, and a clump of crowns 24 m wide, without echoes."""
    spec = lattice((0.0, 0.0, 59.9, 59.9), cell_m, scenes.UTM33)
    east, north = spec.xy(*np.indices(spec.shape))
    houses = (np.minimum(abs(east - 12), abs(east - 48)) < half_m) & (abs(north - 40) < 10)
    crowns = (east - 30) ** 2 + (north - 14) ** 2 < 12**2
    heights = np.where(houses, 5 + 0.7 * (half_m - np.minimum(abs(east - 12), abs(east - 48))), 0.0)
    heights[crowns] = np.random.default_rng(2).uniform(3, 12, np.count_nonzero(crowns))
    dsm = Grid(heights.astype(np.float32), np.ones(spec.shape, dtype=bool), spec)
    surface = surface_from_rasters(dsm, dsm.with_values(np.zeros(spec.shape, dtype=np.float32)))
    roofs = cover_from_surface(surface, None, Params()).cover.labelled("building")
    assert roofs[houses].mean() > 0.9
    assert roofs[crowns].mean() < 0.1


def _roofs_and_crowns() -> tuple[Grid, NDArray[np.float32], NDArray[np.uint8]]:
    """Return a smooth house, a rough one and a crown as rough: heights, roughness, and colours 1, 1, 2."""
    spec = lattice((0, 0, 60, 20), 0.5, scenes.UTM33)
    heights = np.zeros(spec.shape, dtype=np.float32)
    rough = np.full(spec.shape, 0.02, dtype=np.float32)
    index = np.zeros(spec.shape, dtype=np.uint8)
    for first, rough_m, colour in ((10, 0.02, 1), (50, 0.3, 1), (90, 0.3, 2)):
        here = np.s_[10:30, first : first + 20]
        heights[here], rough[here], index[here] = 6.0, rough_m, colour
    return Grid(heights, np.ones(spec.shape, dtype=bool), spec), rough, index


def test_a_rough_roof_has_the_colour_of_smooth_ones():
    """By roughness alone the rough house is a crown; its colour says a roof."""
    ndsm, rough, index = _roofs_and_crowns()
    alone = structural_cover(Texture(ndsm, rough, rough, None, 2.0), None, PARAMS.cover)
    assert [alone.cover.index[20, col] for col in (20, 60, 100)] == [ROOF, VEGETATION, VEGETATION]
    with_colours = cover_with_colours(alone, ndsm, index, np.array([-0.6, 2.0, -2.5]), PARAMS.cover)
    assert [with_colours.index[20, col] for col in (20, 60, 100)] == [ROOF, ROOF, VEGETATION]


def test_classes_that_say_nothing_change_nothing():
    """Even odds of all classes, and cells without a class, give the cover of the structure alone."""
    ndsm, rough, index = _roofs_and_crowns()
    rough = np.random.default_rng(5).uniform(0.02, 0.5, rough.shape).astype(np.float32)
    alone = structural_cover(Texture(ndsm, rough, rough, None, 2.0), None, PARAMS.cover)
    for classes, odds in ((index, np.zeros(3)), (np.zeros_like(index), np.array([-0.6, 2.0, -2.5]))):
        found = cover_with_colours(alone, ndsm, classes, odds, PARAMS.cover)
        np.testing.assert_array_equal(found.index, alone.cover.index)

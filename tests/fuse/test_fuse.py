"""Footprints of parts and flat regions together."""

from dataclasses import replace

import numpy as np
import pytest
from affine import Affine
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from pyproj import CRS
from scipy.ndimage import label
from support.sizes import examples

from msbdb.errors import GridMismatchError, ParameterError
from msbdb.fuse.footprints import RoofEvidence, fuse_footprints
from msbdb.grid import Grid, GridSpec
from msbdb.params import Params, with_values

SHAPE = (60, 60)
HOUSE = np.s_[10:50, 10:40]
"""A house of 300 m2 at cells of 0.5 m, label 7."""


def evidence(heights, roughness=0.02, probability=0.9, valid=None, cell_m=0.5):
    """Return evidence; plain numbers stand for whole images."""
    heights = np.asarray(heights, dtype=np.float32)
    spec = GridSpec(heights.shape, Affine(cell_m, 0, 0, 0, -cell_m, 0), CRS.from_epsg(28992))
    valid = np.ones(heights.shape, dtype=np.bool_) if valid is None else valid
    full = [np.broadcast_to(np.asarray(v, dtype=np.float32), heights.shape).copy() for v in (roughness, probability)]
    return RoofEvidence(Grid(heights, valid, spec), *full)


def house(cut=None, beside=None):
    """Return roots and regions of a flat house; the parts alone have ``beside``, and the regions lack ``cut``."""
    roots, regions = np.zeros(SHAPE, dtype=np.int32), np.zeros(SHAPE, dtype=np.int32)
    roots[HOUSE], regions[HOUSE] = 7, 3
    if beside is not None:
        roots[beside] = 7
    if cut is not None:
        regions[cut] = 0
    return roots, regions


def image(value, elsewhere, where):
    """Return an image with another value in some cells."""
    result = np.full(SHAPE, elsewhere, dtype=np.float32)
    result[where] = value
    return result


PIECE = np.s_[20:30, 40:48]
"""20 m2 beside the house."""


def test_where_both_agree_the_parts_stand():
    """Without a disputed cell the labels stay, however rough and low all is."""
    roots, regions = house()
    fused = fuse_footprints(roots, regions, evidence(np.zeros(SHAPE), 1.0, 0.0), Params())
    np.testing.assert_array_equal(fused, roots)
    assert fused is not roots


def test_a_light_well_that_the_flat_region_leaves_open_is_cut():
    """A piece on the ground inside of a seen building is dropped, and all around it stays."""
    well = np.s_[25:31, 20:26]
    roots, regions = house(cut=well)
    fused = fuse_footprints(roots, regions, evidence(image(0.1, 6.0, well)), Params())
    assert not fused[well].any()
    assert np.count_nonzero(fused) == np.count_nonzero(roots) - 36


def test_a_crown_that_leans_on_a_roof_is_cut():
    """A rough piece with leafy echoes beside a flat roof is dropped; the roof is untouched."""
    roots, regions = house(beside=PIECE)
    seen = evidence(np.full(SHAPE, 6.0), image(0.2, 0.02, PIECE), image(0.5, 0.9, PIECE))
    fused = fuse_footprints(roots, regions, seen, Params())
    np.testing.assert_array_equal(fused, house()[0])


@pytest.mark.parametrize(("roughness", "probability"), [(0.02, 0.5), (0.2, 0.6)])
def test_a_piece_stays_when_one_measure_makes_it_a_roof(roughness, probability):
    """Beside a roof, a smooth piece stays whatever its echoes, and a rough one with a roof's echoes."""
    roots, regions = house(beside=PIECE)
    seen = evidence(np.full(SHAPE, 6.0), image(roughness, 0.02, PIECE), image(probability, 0.9, PIECE))
    np.testing.assert_array_equal(fuse_footprints(roots, regions, seen, Params()), roots)


@pytest.mark.parametrize(("roughness", "stays"), [(0.02, True), (0.2, False)])
def test_a_small_building_without_flat_region_stays_when_it_is_smooth(roughness, stays):
    """Below the least area of flat regions the roughness decides, whatever the echoes."""
    roots, regions = np.zeros(SHAPE, dtype=np.int32), np.zeros(SHAPE, dtype=np.int32)
    roots[20:30, 20:32] = 4
    fused = fuse_footprints(roots, regions, evidence(np.full(SHAPE, 3.0), roughness, 0.9), Params())
    np.testing.assert_array_equal(fused, roots if stays else 0 * roots)


def test_a_dropped_building_leaves_no_crumbs():
    """Its thin twigs go with it, and a thin building of its own beside it stays as the parts say."""
    roots, regions = np.zeros(SHAPE, dtype=np.int32), np.zeros(SHAPE, dtype=np.int32)
    roots[20:30, 20:30], roots[24, 30:40] = 4, 5
    roots[50, 20:40] = 6
    fused = fuse_footprints(roots, regions, evidence(np.full(SHAPE, 3.0), 0.2, 0.9), Params())
    np.testing.assert_array_equal(fused, np.where(roots == 6, 6, 0))


def test_pieces_of_the_least_area_of_flat_regions_stay():
    """From R λ_min on, 40 m2, the parts' word stands."""
    roots, regions = np.zeros(SHAPE, dtype=np.int32), np.zeros(SHAPE, dtype=np.int32)
    roots[20:30, 20:36] = 4
    leafy = evidence(np.full(SHAPE, 3.0), 1.0, 0.1)
    np.testing.assert_array_equal(fuse_footprints(roots, regions, leafy, Params()), roots)
    roots[20:30, 35] = 0
    assert not fuse_footprints(roots, regions, leafy, Params()).any()


def test_silence_of_flat_regions_that_see_little_of_a_building_tells_nothing():
    """Where flat regions cover less of the building than the share, pieces that they leave out stay."""
    roots, regions = house(beside=PIECE)
    leafy = evidence(np.full(SHAPE, 6.0), image(0.2, 0.02, PIECE), image(0.1, 0.9, PIECE))
    assert not fuse_footprints(roots, regions, leafy, Params())[PIECE].any()
    regions[:30] = 0
    np.testing.assert_array_equal(fuse_footprints(roots, regions, leafy, Params()), roots)


def test_edges_are_no_pieces():
    """Strips up to a metre wide stay as the parts say, on both sides."""
    roots, regions = house()
    regions[10:12] = 0
    regions[10:50, 40:42] = 3
    seen = evidence(np.full(SHAPE, 6.0), image(1.0, 0.02, np.s_[:12]), 0.9)
    np.testing.assert_array_equal(fuse_footprints(roots, regions, seen, Params()), roots)


def annexed(roughness=0.02, probability=0.9, height=3.0):
    """Return what becomes of a flat region's extension beyond the parts."""
    roots, regions = house()
    regions[PIECE] = 3
    measures = (image(v, w, PIECE) for v, w in ((height, 6.0), (roughness, 0.02), (probability, 0.9)))
    return roots, fuse_footprints(roots, regions, evidence(*measures), Params())


def test_an_annex_of_a_flat_region_gets_its_buildings_label():
    """A smooth piece of a flat region beside a building joins it."""
    _, fused = annexed()
    np.testing.assert_array_equal(fused, house(beside=PIECE)[0])


@pytest.mark.parametrize("doubt", [{"roughness": 0.2}, {"probability": 0.5}, {"height": 1.9}])
def test_an_annex_needs_all_measures(doubt):
    """A rough, leafy or low piece of a flat region is not added."""
    roots, fused = annexed(**doubt)
    np.testing.assert_array_equal(fused, roots)


def test_an_annex_goes_to_the_building_beside_most_of_it():
    """Between two buildings the longer common side decides; of equal ones, the smaller label."""
    roots, regions = house()
    roots[20:30, 48:58] = 2
    regions[roots > 0] = 3
    regions[PIECE] = 3
    good = evidence(np.full(SHAPE, 6.0))
    assert (fuse_footprints(roots, regions, good, Params())[PIECE] == 7).all()
    roots[10:20, 40:58] = 2
    assert (fuse_footprints(roots, regions, good, Params())[PIECE] == 2).all()
    roots, regions = np.zeros((2, *SHAPE), dtype=np.int32)
    roots[20:30, 10:20], roots[20:30, 28:38], regions[20:30, 10:38] = 9, 5, 1
    assert (fuse_footprints(roots, regions, good, Params())[20:30, 20:28] == 5).all()


def test_a_flat_region_beside_no_building_stays_unexplained():
    """What touches no building is not added."""
    roots, regions = house()
    regions[20:30, 45:55] = 4
    np.testing.assert_array_equal(fuse_footprints(roots, regions, evidence(np.full(SHAPE, 6.0)), Params()), roots)


def test_invalid_cells_have_no_say():
    """A piece is judged by its valid cells, and one without any stays as the parts say."""
    well = np.s_[25:31, 20:26]
    roots, regions = house(cut=well)
    unknown = image(False, True, well).astype(np.bool_)
    kept = fuse_footprints(roots, regions, evidence(image(0.1, 6.0, well), valid=unknown), Params())
    np.testing.assert_array_equal(kept, roots)
    heights, valid = image(0.1, 6.0, np.s_[30, 20:26]), image(False, True, np.s_[25:30, 20:26]).astype(np.bool_)
    assert not fuse_footprints(roots, regions, evidence(heights, valid=valid), Params())[well].any()


def test_a_piece_at_the_border_is_no_thinner_for_it():
    """A light well that the border cuts is a piece, though a strip of it is left."""
    roots = np.full(SHAPE, 7, dtype=np.int32)
    regions = np.full(SHAPE, 3, dtype=np.int32)
    well = np.s_[:2, 20:30]
    regions[well] = 0
    assert not fuse_footprints(roots, regions, evidence(image(0.0, 6.0, well)), Params())[well].any()


def test_roughness_is_allowed_to_grow_with_large_cells():
    """On cells of 2 m a window spans several planes: twice the roughness is smooth."""
    roots, regions = np.zeros((2, 12, 12), dtype=np.int32)
    roots[4:7, 4:7] = 1
    for roughness, stays in ((0.11, True), (0.13, False)):
        seen = evidence(np.full((12, 12), 5.0), roughness, 0.9, cell_m=2.0)
        assert fuse_footprints(roots, regions, seen, Params()).any() == stays


images = arrays(np.int32, (24, 24), elements=st.integers(0, 1))


@st.composite
def scenes(draw):
    """Draw blocky roots of up to three labels, blocky regions, and evidence."""
    grown = [np.kron(draw(arrays(np.int32, (6, 6), elements=st.integers(0, 3))), np.ones((4, 4), int)) for _ in "ab"]
    noise = [draw(images) for _ in "ab"]
    roots, regions = (np.where(n, 0, g).astype(np.int32) for g, n in zip(grown, noise, strict=True))
    fields = [np.kron(draw(arrays(np.float32, (6, 6), elements=st.sampled_from(v))), np.ones((4, 4)))
              for v in ([0.0, 3.0, 6.0], [0.01, 0.3], [0.1, 0.9])]  # fmt: skip
    return roots, regions, fields


@given(scenes())
@examples(60)
def test_fusing_keeps_to_what_either_system_found(scene):
    """No label is new; cells of both keep their root; cells of neither stay empty; what is kept keeps its label."""
    roots, regions, fields = scene
    fused = fuse_footprints(roots, regions, evidence(*fields), Params())
    assert set(np.unique(fused)) <= set(np.unique(roots)) | {0}
    both, neither = (roots > 0) & (regions > 0), (roots == 0) & (regions == 0)
    np.testing.assert_array_equal(fused[both], roots[both])
    assert not fused[neither].any()
    kept = (fused > 0) & (roots > 0)
    np.testing.assert_array_equal(fused[kept], roots[kept])


@given(scenes(), st.sampled_from([np.flipud, np.fliplr, np.transpose, np.rot90]))
@examples(60)
def test_fusing_does_not_depend_on_the_direction(scene, turn):
    """Turned scenes give turned footprints, with their labels."""
    roots, regions, fields = scene
    fused = fuse_footprints(roots, regions, evidence(*fields), Params())
    turned = fuse_footprints(turn(roots), turn(regions), evidence(*(turn(f) for f in fields)), Params())
    np.testing.assert_array_equal(turned, turn(fused))


@given(scenes())
@examples(40)
def test_without_doubt_all_of_the_parts_stay(scene):
    """High, smooth and solid: nothing is dropped, and what is added lies beside a building."""
    roots, regions, _ = scene
    fused = fuse_footprints(roots, regions, evidence(np.full(roots.shape, 6.0)), Params())
    np.testing.assert_array_equal(fused[roots > 0], roots[roots > 0])
    blocks, _ = label(fused > 0, np.ones((3, 3)))
    assert set(np.unique(blocks)) == set(np.unique(blocks[roots > 0])) | ({0} if (fused == 0).any() else set())


def test_images_of_different_shapes_are_refused():
    """The message names every shape."""
    roots, regions = house()
    with pytest.raises(GridMismatchError, match=r"flat regions \(59, 60\)"):
        fuse_footprints(roots, regions[1:], evidence(np.zeros(SHAPE)), Params())
    good = evidence(np.zeros(SHAPE))
    with pytest.raises(GridMismatchError, match=r"roughness \(60, 59\)"):
        fuse_footprints(roots, regions, replace(good, roughness_m=good.roughness_m[:, 1:]), Params())


def test_values_out_of_bounds_are_refused():
    """The message names the value, its bounds and its unit."""
    with pytest.raises(ParameterError, match=r"fuse\.smooth_m must lie between 0\.001 and 5 m; got 0"):
        with_values(Params(), {"fuse": {"smooth_m": 0}})

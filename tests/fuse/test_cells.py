"""The votes of the detectors for each cell, and the cut along the steps of height."""

import numpy as np
import pytest
from pyproj import CRS
from scipy.ndimage import maximum_filter, minimum_filter, uniform_filter

from msbdb.detect.scene import Regions
from msbdb.fuse import cells
from msbdb.fuse.cells import count_votes, fuse_cells, is_fused
from msbdb.grid import Grid, lattice
from msbdb.labels import label_zones
from msbdb.params import DETECTORS, FuseParams

PARAMS = FuseParams()
SHAPE = (40, 60)


def grid(heights, valid=None):
    """Heights on cells of 1 m."""
    spec = lattice((0, 0.1, SHAPE[1] - 0.1, SHAPE[0]), 1.0, CRS.from_epsg(2154))
    return Grid(heights.astype(np.float32), np.ones(SHAPE, dtype=bool) if valid is None else valid, spec)


def box(rows, cols):
    """Return a mask of a block of cells."""
    mask = np.zeros(SHAPE, dtype=bool)
    mask[slice(*rows), slice(*cols)] = True
    return mask


def fused(heights, masks, params=PARAMS, valid=None):
    """Fuse masks, one a detector."""
    votes = {str(n): Regions(str(n), mask.astype(np.int32), None, None, {}) for n, mask in enumerate(masks)}
    return fuse_cells(grid(heights, valid), votes, params, mask_m=2.0)


HOUSE = box((10, 30), (10, 30))
HEIGHTS = np.where(HOUSE, 6.0, 0.0)
NONE = np.zeros(SHAPE, dtype=bool)


@pytest.mark.parametrize(
    ("votes", "of", "kept"), [(1, 4, False), (2, 4, True), (1, 3, False), (2, 3, True), (4, 4, True)]
)
def test_half_of_the_votes_make_a_building(votes, of, kept):
    """Two of four and two of three are enough, one is not."""
    found = fused(HEIGHTS, [HOUSE] * votes + [NONE] * (of - votes))
    np.testing.assert_array_equal(found, HOUSE if kept else NONE)


@pytest.mark.parametrize(
    ("names", "kept", "with_imagery"),
    [
        ("multiscale", False, True),
        ("multiscale flatregions", False, True),
        ("multiscale area3d", True, True),
        ("multiscale adaptive", True, True),
        ("flatregions area3d adaptive", False, False),
        ("multiscale flatregions area3d adaptive", True, True),
    ],
)
def test_on_rasters_a_detector_on_points_confirms_the_multiscale_one(names, kept, with_imagery):
    """More than half of the four votes that there are; flat regions have none. With imagery it has three of five."""
    votes = {
        name: Regions(name, (HOUSE if name in names.split() else NONE).astype(np.int32), None, None, {})
        for name in DETECTORS
    }
    for coloured, is_kept, number in ((False, kept, 4), (True, with_imagery, 5)):
        found = fuse_cells(grid(HEIGHTS), votes, PARAMS, mask_m=2.0, of_points=False, coloured=coloured)
        np.testing.assert_array_equal(found, HOUSE if is_kept else NONE)
        cast, every, enough = count_votes(votes, of_points=False, coloured=coloured)
        assert (every, enough) == (number, 3)
        assert ((cast >= enough) == (HOUSE if is_kept else NONE)).all()
    assert count_votes(votes, of_points=True, coloured=True)[1:] == (4, 2)


def test_on_rasters_the_multiscale_detector_decides_without_one_of_the_others():
    """Of it, the flat regions and one detector on points it has two votes of three."""
    votes = {
        name: Regions(name, (HOUSE if name == "multiscale" else NONE).astype(np.int32), None, None, {})
        for name in ("multiscale", "flatregions", "area3d")
    }
    np.testing.assert_array_equal(fuse_cells(grid(HEIGHTS), votes, PARAMS, mask_m=2.0, of_points=False), HOUSE)
    np.testing.assert_array_equal(fuse_cells(grid(HEIGHTS), votes, PARAMS, mask_m=2.0), NONE)


def test_the_edge_follows_the_step_of_height():
    """A ragged rim on the ground, which half of the detectors add, stays without costs of edges and goes with them."""
    ragged = HOUSE.copy()
    ragged[12:28, 30] = np.tile([True, True, False, False], 4)
    votes = [HOUSE, HOUSE, ragged, ragged]
    np.testing.assert_array_equal(fused(HEIGHTS, votes, FuseParams(edge_cost=0.0)), ragged)
    np.testing.assert_array_equal(fused(HEIGHTS, votes, FuseParams(edge_cost=0.5)), HOUSE)


def test_bumps_and_notches_of_a_cell_go_and_corners_stay():
    """Of single cells at the edge, the nine cells around decide; wings and recesses of three cells keep their shape."""
    shape = HOUSE | box((14, 17), (30, 34))
    shape &= ~box((10, 14), (18, 22))
    rough = shape.copy()
    rough[9, 14] = rough[25, 30] = True
    rough[20, 10] = rough[29, 22] = False
    heights = np.where(rough | shape, 6.0, 0.0)
    found = fused(heights, [rough] * 4, FuseParams(edge_cost=0.0))
    np.testing.assert_array_equal(found, shape)


def test_houses_beside_a_lane_stay_apart():
    """Two detectors take a lane of 2 m between two houses, in which no echo is above the mask."""
    other = box((10, 30), (32, 50))
    heights = np.where(HOUSE | other, 6.0, 0.0)
    lane = box((10, 30), (30, 32))
    both = HOUSE | other | lane
    found = fused(heights, [both, both, HOUSE | other, HOUSE | other])
    np.testing.assert_array_equal(found, HOUSE | other)


def test_an_edge_below_the_mask_belongs_to_its_house():
    """Echoes beside a wall that hit the ground: where most detectors see the wall, it is the house's."""
    rim = box((10, 30), (10, 31))
    found = fused(HEIGHTS, [rim, rim, rim, HOUSE])
    np.testing.assert_array_equal(found, rim)


def test_small_holes_are_filled_and_crumbs_dropped():
    """A hole of 9 m² and a piece of 9 m² go, those of 16 m² stay."""
    mask = HOUSE.copy()
    mask[12:15, 12:15] = False
    mask[20:24, 20:24] = False
    mask[2:5, 40:43] = True
    mask[2:6, 50:54] = True
    found = fused(np.where(mask | HOUSE, 6.0, 0.0), [mask] * 4)
    expected = mask.copy()
    expected[12:15, 12:15] = True
    expected[2:5, 40:43] = False
    np.testing.assert_array_equal(found, expected)


def test_invalid_cells_are_no_building():
    """Cells without a height stay out, also where they are a hole."""
    valid = ~box((15, 17), (15, 17))
    found = fused(HEIGHTS, [HOUSE] * 4, valid=valid)
    np.testing.assert_array_equal(found, HOUSE & valid)


def test_the_order_and_the_names_of_the_detectors_do_not_matter():
    """Votes are counted."""
    masks = [HOUSE, HOUSE, box((5, 35), (5, 35)), NONE]
    np.testing.assert_array_equal(fused(HEIGHTS, masks), fused(HEIGHTS, masks[::-1]))


def test_two_detectors_and_the_papers_profiles_leave_it_to_the_multiscale_one():
    """Two have no majority."""
    three = {
        name: Regions(name, NONE.astype(np.int32), None, None, {}) for name in ("area3d", "adaptive", "multiscale")
    }
    assert is_fused(three, FuseParams())
    assert not is_fused({name: three[name] for name in ("area3d", "multiscale")}, FuseParams())
    assert not is_fused(three, FuseParams(votes=False))


@pytest.mark.parametrize("seed", range(4))
def test_edges_are_tidied_as_by_filters_of_all_cells(seed):
    """The majority, the opening and the closing, and the owners of low cells, are those of SciPy's filters."""
    random = np.random.default_rng(seed)
    decided = random.random(SHAPE) < 0.6
    high = decided & (random.random(SHAPE) < 0.7)
    most = uniform_filter(decided.astype(np.float64), 3, mode="nearest") > 0.5
    opened = maximum_filter(minimum_filter(decided, 3, mode="nearest"), 3, mode="nearest")
    closed = minimum_filter(maximum_filter(decided, 3, mode="nearest"), 3, mode="nearest")
    np.testing.assert_array_equal(cells._straight(decided), (most | opened) & closed)

    def extremes(labels):
        above = np.where(labels > 0, labels, 9999)
        return maximum_filter(labels, 3, mode="nearest"), minimum_filter(above, 3, mode="nearest")

    labels = label_zones(high)[0]
    highest, lowest = extremes(labels)
    rim = decided & ~high & (highest == lowest)
    highest, lowest = extremes(np.where(rim, highest, labels))
    np.testing.assert_array_equal(cells._apart(decided, high), high | (rim & (highest == lowest)))

"""Halls and lower parts of roofs are buildings; bridges are ground, and long things that look like them are not."""

from dataclasses import replace

import numpy as np
import pytest
from pyproj import CRS
from scipy.ndimage import distance_transform_edt

from msbdb.grid import Grid, lattice
from msbdb.ground import regions
from msbdb.ground.regions import bridges, with_narrow_bridges
from msbdb.ground.walls import walled_ground
from msbdb.params import GroundParams

PARAMS = GroundParams()
SIDE, SPAN, DEPTH_M = 160, 60.0, 5.0
"""A square of so many metres, and a river as wide and as deep across it."""


def lowest(x, y, z):
    """Return the lowest heights of points on cells of 1 m; empty cells take those of the nearest one."""
    spec = lattice((0, 0, SIDE - 1, SIDE - 1), 1.0, CRS.from_epsg(2154))
    heights = np.full(spec.shape, np.inf)
    np.minimum.at(heights, (np.floor(y).astype(int), np.floor(x).astype(int)), z)
    nearest = distance_transform_edt(np.isinf(heights), return_distances=False, return_indices=True)
    surface = heights[tuple(nearest)].astype(np.float32)
    return Grid(surface, np.ones(spec.shape, dtype=bool), spec)


def river(width_m, degrees, density=4.0, length_m=SPAN, height_m=0.0):
    """Scan a river between banks, and a deck over it whose ends lie so far above them; return the deck's cells, too."""
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0, SIDE, (2, int(density * SIDE**2)))
    cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    along, across = (x - SIDE / 2) * cos + (y - SIDE / 2) * sin, (y - SIDE / 2) * cos - (x - SIDE / 2) * sin
    z = 10 + DEPTH_M * np.clip((np.abs(along) - SPAN / 2) / 4, -1, 0)
    deck = (np.abs(across) < width_m / 2) & (np.abs(along) < length_m / 2 + 1)
    arch = 1.5 * np.cos(np.clip(2 * along / SPAN, -1, 1) * np.pi / 2)
    z = np.where(deck, 10 + height_m + arch, z) + rng.normal(0, 0.03, len(x))
    surface = lowest(x, y, z)
    on_deck = np.zeros(surface.values.shape, dtype=bool)
    on_deck[np.floor(y[deck]).astype(int), np.floor(x[deck]).astype(int)] = True
    return surface, on_deck & (surface.values > 9.9 + height_m)


@pytest.mark.parametrize("degrees", [0, 15, 30, 45, 90])
@pytest.mark.parametrize("width_m", [3, 4, 6, 12])
def test_a_bridge_between_banks_is_ground(width_m, degrees):
    """Of any width and direction, on cells of 1 m."""
    surface, deck = river(width_m, degrees)
    assert walled_ground(surface, PARAMS, 4.0)[deck].mean() > 0.95


@pytest.mark.parametrize("changed", [{"length_m": 40.0}, {"height_m": 2.0}], ids=["ends in the river", "ends above it"])
def test_a_long_thing_that_meets_no_bank_is_above_ground(changed):
    """A pier that ends in the water, and a deck 2 m above both banks, as a roof is."""
    surface, deck = river(4, 30, **changed)
    assert walled_ground(surface, PARAMS, 4.0)[deck].mean() < 0.05


@pytest.mark.parametrize("degrees", [0, 15, 45, 90])
@pytest.mark.parametrize("width_m", [3, 6, 12, 30, 80])
def test_bridges_above_a_known_ground_are_found(width_m, degrees):
    """Of any width and direction, longer than wide or not; all else is the ground."""
    surface, deck = river(width_m, degrees)
    terrain = np.asarray(river(0, degrees)[0].values)
    above = np.asarray(surface.values) - terrain
    decks = bridges(surface, terrain, above < PARAMS.height_m, 1.0, PARAMS)
    assert decks[deck & (above > 1)].mean() > 0.95
    assert not decks[above < PARAMS.height_m].any()


def known(heights):
    """Return the bridges in heights on cells of 1 m above a level ground of 0 m."""
    terrain = np.zeros(heights.shape, dtype=np.float32)
    spec = lattice((0, 0, heights.shape[1] - 1, heights.shape[0] - 1), 1.0, CRS.from_epsg(2154))
    surface = Grid(heights.astype(np.float32), np.ones(heights.shape, dtype=bool), spec)
    return bridges(surface, terrain, heights < PARAMS.height_m, 1.0, PARAMS)


def test_a_hill_of_asphalt_is_a_bridge_and_a_stand_is_none():
    """Both rise evenly from the ground; but the stand ends at a wall, and its other ends are walls, too."""
    rise = np.clip(np.arange(60) - 20, 0, 20) * 0.25
    both, stand = (np.zeros((60, 60)) for _ in range(2))
    both[24:36] = np.minimum(rise, rise[::-1])
    stand[20:40] = np.where(np.arange(60) < 40, rise, 0)
    assert known(both)[24:36, 24:36].all()
    assert not known(stand).any()
    # A wall of houses along both sides of the ramps leaves no bridge, either.
    both[18:24], both[36:42] = 9, 9
    assert not known(both).any()


def cutting():
    """Return the heights and the ground of a cutting between two levels, with a deck of 4 m along its middle."""
    heights = np.full((60, 60), 4.0, dtype=np.float32)
    heights[10:50] = 0
    heights[10:50, 28:32] = 4
    ground = heights == 4
    ground[10:50] = heights[10:50] == 0
    return heights, ground


def found(heights, ground, valid=None):
    """Return the cells of 1 m that bridges change."""
    spec = lattice((0, 0, heights.shape[1] - 1, heights.shape[0] - 1), 1.0, CRS.from_epsg(2154))
    valid = np.ones(heights.shape, dtype=bool) if valid is None else valid
    return with_narrow_bridges(Grid(heights, valid, spec), ground & valid, 1.0, PARAMS) != (ground & valid)


def test_echoes_from_below_do_not_divide_a_deck():
    """Six of its cells have the water's height, and passed for ground; the deck covers them."""
    heights, ground = cutting()
    deck = ~ground
    heights[25, 28:32] = heights[26, 28:30] = 0
    ground[25, 28:32] = ground[26, 28:30] = True
    assert np.array_equal(found(heights, ground), deck)


def test_a_row_of_annexes_behind_houses_is_no_bridge():
    """It is as slender, and level with the ground at both ends; but houses stand along one side of it."""
    heights, ground = cutting()
    heights[10:50, 32:42], ground[10:50, 32:42] = 9, False
    assert not found(heights, ground).any()


def test_a_roof_whose_side_lies_on_a_slope_is_no_bridge():
    """The ground is as high as the roof all along one side."""
    heights, ground = cutting()
    heights[10:50, 32:], ground[10:50, 32:] = 4, True
    assert not found(heights, ground).any()


def test_a_bridge_needs_ground_at_its_ends():
    """Level cells of 60 m² at one end are a roof's, which passed for ground."""
    heights, ground = cutting()
    heights[:10] = 0
    heights[4:10, 25:35] = 4
    assert not found(heights, ground).any()


def test_the_border_may_cut_one_end_of_a_bridge():
    """Be it that of the survey or a void; what is cut at both ends stays above ground."""
    heights, ground = cutting()
    row = np.indices(heights.shape)[0]
    assert np.array_equal(found(heights, ground, row >= 15), ~ground & (row >= 15))
    assert np.array_equal(found(heights[15:], ground[15:]), ~ground[15:])
    assert not found(heights, ground, (row >= 15) & (row < 45)).any()
    assert not found(heights[15:45], ground[15:45]).any()


def test_a_bridge_meets_the_ground_along_half_of_its_width():
    """A roof that the border cuts does so where a bush stands at its end, or a corner of it lies on a bank."""
    heights, ground = cutting()
    row, col = np.indices(heights.shape)
    for first, bridge in ((29, False), (31, True)):
        partly = np.where((row >= 50) & (col >= first), 0, heights)
        assert found(partly[15:], ground[15:]).any() == bridge


def exact(heights):
    """Heights on cells of 1 m."""
    rows, cols = heights.shape
    spec = lattice((0, 0.1, cols - 0.1, rows), 1.0, CRS.from_epsg(2154))
    return Grid(heights.astype(np.float32), np.ones(heights.shape, dtype=bool), spec)


def half_known(size=100):
    """Return the heights of a hall of 8 m, and ground in which a half of it is ground and the other half is not."""
    heights = np.zeros((size + 40, size + 40), dtype=np.float32)
    heights[20 : 20 + size, 20 : 20 + size] = 8
    ground = heights == 0
    ground[20 : 20 + size, 20 : 20 + size // 2] = True
    return heights, ground


def halls(heights, ground):
    """Return what is taken out of the ground, on cells of 1 m without voids; what is above 0 is raised."""
    return regions.halls(exact(heights), ground, heights > 0, 1.2, PARAMS)


@pytest.mark.parametrize("cols", [slice(20, 70), slice(20, 118), slice(118, 120)])
def test_the_rest_of_a_hall_of_which_a_part_is_known_is_a_building(cols):
    """The border between both parts is level, and no edge."""
    heights, _ = half_known()
    ground = heights == 0
    ground[20:120, cols] = True
    assert np.array_equal(halls(heights, ground), ground & (heights > 0))


@pytest.mark.parametrize("cut", [False, True])
@pytest.mark.parametrize(("step_m", "wide"), [(1.0, 1), (0.7, 3)])
def test_stairs_at_a_wall_do_not_join_a_wide_hall_to_the_ground(step_m, wide, cut):
    """It is wider than the windows; at one wall low steps lead down. The border may cut it at another one."""
    heights, _ = half_known(200)
    down = np.arange(8 - step_m, 0, -step_m)
    heights[100 : 100 + wide, 220 : 220 + len(down)] = down
    heights = heights[20:] if cut else heights
    ground = walled_ground(exact(heights), PARAMS)
    assert not ground[heights == 8].any()
    assert ground[heights == 0].all()


def test_a_yard_on_a_plateau_between_houses_is_ground():
    """Walls bound the block, but the yard looks up at them nearly all around."""
    heights, _ = half_known()
    heights[20:40, 20:120] = heights[100:120, 20:120] = heights[20:120, 20:40] = heights[20:120, 104:120] = 14
    assert not halls(heights, heights < 14).any()
    heights[20:120, 104:120] = 8
    assert np.array_equal(halls(heights, heights < 14), heights == 8)


def test_a_knoll_that_falls_in_steps_is_ground():
    """Its flanks are walls, but fall by 1.8 m from cell to cell; a hall falls by all of its height at once."""
    row, col = np.indices((140, 140))
    heights = np.clip(1.8 * (40 - np.maximum(abs(row - 70), abs(col - 70))), 0, 9.0)
    assert not halls(heights, np.ones(heights.shape, dtype=bool)).any()
    heights = np.where(heights == 9, heights, 0)
    assert halls(heights, np.ones(heights.shape, dtype=bool))[heights == 9].all()


@pytest.mark.parametrize("side", [50, 40, 8])
def test_ground_on_the_roof_of_a_known_hall_is_a_building(side):
    """It is as high as the hall around it, which is known."""
    heights, ground = half_known()
    ground[20:120, 20:120] = False
    middle = np.s_[40 : 40 + side, 40 : 40 + side]
    ground[middle] = True
    found = halls(heights, ground)
    assert found[middle].all()
    assert not found[heights == 0].any()


@pytest.mark.parametrize("cut", [False, True])
@pytest.mark.parametrize("lowest", [6, 3])
def test_the_levels_of_a_hall_are_one_building(lowest, cut):
    """Each part is 1.5 m higher than the one around it. Cut by the border, the lowest one must be as high as a hall."""
    heights = np.zeros((200, 200), dtype=np.float32)
    for inside, step in enumerate((lowest, 1.5, 1.5)):
        heights[40 + 15 * inside : 160 - 15 * inside, 40 + 15 * inside :] += step
    heights = heights if cut else np.hstack([heights, np.zeros((200, 40), dtype=np.float32)])
    found = halls(heights, np.ones(heights.shape, dtype=bool))
    is_building = lowest >= regions.HALL_M or not cut
    assert np.array_equal(found, (heights > 0) & is_building)


@pytest.mark.parametrize(("floor", "is_roof"), [(0, False), (3, False), (6, True)])
@pytest.mark.parametrize("slope", [0, 0.2])
def test_a_part_of_a_roof_that_higher_parts_surround_is_no_court(floor, is_roof, slope):
    """Of a block of 100 m on a slope: a court may lie above the street, but not by 6 m."""
    terrain = np.indices((200, 200))[1] * slope
    heights = terrain.copy()
    heights[50:150, 50:150] = terrain[50:150, 50:150] + 12
    court = np.s_[70:130, 70:130]
    heights[court] = terrain[court] + floor
    ground = heights < terrain + 12
    found = regions.sunk_roofs(exact(heights), ground)
    assert found[court].all() == is_roof
    assert found.sum() == is_roof * 3600


@pytest.mark.parametrize(("cols", "void", "is_roof"), [(40, 60, True), (50, 60, False), (38, 48, False)])
def test_a_court_that_the_border_cuts_stays(cols, void, is_roof):
    """Nothing shows that the street does not enter it beyond the border, nor beyond a void."""
    heights, ground = np.full((60, 60), 12.0), np.zeros((60, 60), dtype=bool)
    court = np.s_[40:50, cols : cols + 10]
    for part, level in ((np.s_[:, :10], 0), (court, 6)):
        heights[part], ground[part] = level, True
    surface = exact(heights)
    valid = np.indices(heights.shape)[1] < void
    found = regions.sunk_roofs(replace(surface, valid=valid), ground & valid)
    assert found[court][ground[court] & valid[court]].all() == is_roof
    assert found.sum() == is_roof * 100

"""The ground by its walls, on small worlds in which filters with windows fail."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from pyproj import CRS

from msbdb.grid import Grid, lattice
from msbdb.ground import walls
from msbdb.ground.trend import lower_trend
from msbdb.ground.walls import walled_ground
from msbdb.params import GroundParams

PARAMS = GroundParams()


def grid(heights):
    """Heights on cells of 1 m, with a little noise."""
    rows, cols = heights.shape
    noisy = heights + np.random.default_rng(0).normal(0, 0.03, heights.shape)
    spec = lattice((0, 0.1, cols - 0.1, rows), 1.0, CRS.from_epsg(2154))
    return Grid(noisy.astype(np.float32), np.ones(heights.shape, dtype=bool), spec)


def terraced(rows=160, cols=160, tread=16, wall=3.0):
    """Treads that rise by walls to the east, with a slope as a way up along the southern side."""
    level = np.arange(cols) // tread * wall
    heights = np.tile(level.astype(float), (rows, 1))
    heights[-20:] = np.arange(cols) * wall / tread
    return heights


def test_terraces_are_ground_and_houses_on_them_are_not():
    """Ten treads, one above the other, with a house on three of them."""
    heights = terraced()
    houses = np.zeros(heights.shape, dtype=bool)
    for col in (34, 82, 130):
        houses[60:72, col : col + 10] = True
    heights[houses] += 5
    ground = walled_ground(grid(heights), PARAMS)
    assert not ground[houses].any()
    assert ground[~houses].mean() > 0.97


@pytest.mark.parametrize("guess", [-1000, 0, 1000])
def test_what_a_void_is_filled_with_decides_nothing(guess):
    """A lake cuts the terraces, and a corner of the survey is missing: the rest is found as if both were a border."""
    heights = terraced()
    houses = np.zeros(heights.shape, dtype=bool)
    houses[60:72, 34:44] = True
    heights[houses] += 5
    row, col = np.indices(heights.shape)
    void = ((row - 95) ** 2 + (col - 80) ** 2 < 30**2) | (row + 2 * col < 90)
    heights[void] = guess
    surface = grid(heights)
    ground = walled_ground(replace(surface, valid=~void), PARAMS)
    assert not ground[houses | void].any()
    assert ground[~houses & ~void].mean() > 0.97


def test_what_a_void_is_filled_with_decides_no_trend():
    """The trend of a slope goes on over a void that nothing is known of, however wide it is."""
    heights = np.indices((100, 500))[1] * 0.2
    surface = grid(np.where(np.arange(500) < 100, heights, -500))
    trend = lower_trend(replace(surface, valid=np.tile(np.arange(500) < 100, (100, 1))), PARAMS)
    assert np.isfinite(trend).all()
    assert np.ptp((trend - heights)[:, :100]) < 0.5


def test_a_steep_knoll_that_two_sides_lead_up_to_is_ground():
    """A plateau of 6 m with cliffs on two sides and slopes of 1 in 3 on the others; a house of that size is none."""
    heights = np.zeros((160, 200))
    heights[40:90, 30:80] = 6
    heights[40:90, 80:98] = np.linspace(6, 0, 18)
    heights[90:108, 30:80] = np.linspace(6, 0, 18)[:, None]
    heights[40:90, 130:180] = 6
    ground = walled_ground(grid(heights), PARAMS)
    assert ground[40:90, 30:98].mean() > 0.97
    assert not ground[40:90, 130:180].any()


def plateau_among_trees(*, knoll):
    """Return a plateau of 50 m and 5 m high with trees along a side, a part of them lower than itself, and these.

    All of its edge is a wall; of a ``knoll`` one side is a slope.
    """
    heights = np.zeros((150, 150))
    heights[50:100, 50:100] = 5
    if knoll:
        heights[50:100, 100:110] = np.linspace(5, 0, 10)
    trees = np.zeros(heights.shape, dtype=bool)
    trees[100:110, 50:100] = True
    heights[100:110, 50:80], heights[100:110, 80:100] = 9, 2.5
    return heights, trees


def test_a_knoll_whose_flank_hides_under_trees_is_ground():
    """Walls are two thirds of what is seen of its edge; to stand above lower trees would speak for a roof."""
    heights, trees = plateau_among_trees(knoll=True)
    ground = walled_ground(grid(heights), PARAMS)
    assert not ground[trees].any()
    assert ground[~trees].mean() > 0.98


def test_a_knoll_whose_flanks_are_steep_all_around_is_ground():
    """A rock of 60 m and 6 m high whose flanks rise by 1.8 m a metre; a hall of that size, 2.4 m high, is none."""
    row, col = np.indices((160, 220))
    rock = np.clip(1.8 * (30 - np.hypot(row - 80, col - 60)), 0, 6)
    hall = 2.4 * ((abs(row - 80) < 28) & (abs(col - 160) < 28))
    ground = walled_ground(grid(rock + hall), PARAMS)
    assert ground[rock == 6].all()
    assert ground[rock > 0].mean() > 0.9
    assert not ground[hall > 0].any()


@pytest.mark.parametrize("cut_by", ["border", "void"])
def test_a_knoll_that_is_cut_is_as_large_as_its_whole(cut_by):
    """Half of a rock with steep flanks is ground, 1,600 m². So large a whole one may be a low hall among few echoes."""
    row, col = np.indices((160, 240))
    half, whole = (
        np.clip(1.8 * away, 0, 6) for away in (33 - np.hypot(row, col - 50), 25 - np.hypot(row - 90, col - 150))
    )
    hall = 6.0 * ((row < 28) & (abs(col - 180) < 28))
    surface = grid(half + whole + hall)
    if cut_by == "void":
        framed, inside = np.pad(half + whole + hall, 30), np.pad(np.ones(row.shape, dtype=bool), 30)
        surface = replace(grid(framed), valid=inside)
    ground = walled_ground(surface, PARAMS)[surface.valid].reshape(row.shape)
    assert ground[half > 0].mean() > 0.9
    assert not ground[whole == 6].any()
    assert not ground[hall > 0].any()


@pytest.mark.parametrize(("cliff", "is_ground"), [(0.4, True), (0.6, False)])
def test_the_edge_of_a_knoll_may_fall_at_once_along_three_fifths(cliff, is_ground):
    """A rock of 60 m, part of whose flanks is a cliff of 6 m; the others rise by 1.8 m a metre."""
    row, col = np.indices((160, 160))
    away = np.hypot(row - 80, col - 80)
    cliffs = np.abs(np.arctan2(row - 80, col - 80)) < cliff * np.pi
    rock = np.where(cliffs, 6.0 * (away < 27), np.clip(1.8 * (30 - away), 0, 6))
    ground = walled_ground(grid(rock), PARAMS)
    assert ground[away < 25].all() == is_ground
    assert ground[away > 32].mean() > 0.97


def test_a_hall_among_trees_is_a_building():
    """All that is seen of its edge is a wall."""
    heights, _ = plateau_among_trees(knoll=False)
    ground = walled_ground(grid(heights), PARAMS)
    assert not ground[50:100, 50:100].any()
    assert ground[heights == 0].mean() > 0.98


def test_treads_of_a_hillside_that_rows_of_houses_part_are_ground():
    """Six treads of 25 m behind walls of 5 m, with houses of 4 m against each wall and gaps of 6 m between them."""
    row, col = np.indices((160, 220))
    step = np.clip((col - 30) // 25 + 1, 0, 6)
    houses = (row % 26 < 20) & (col >= 30) & (col < 180) & ((col - 30) % 25 >= 15)
    ground = walled_ground(grid(step * 5.0 + 4 * houses), PARAMS)
    assert not ground[houses].any()
    assert ground[~houses].mean() > 0.98


@pytest.mark.parametrize(
    ("length", "higher", "heap"),
    [
        (60, [np.s_[100:160, 160:190]], 30),
        (60, [np.s_[100:160, 160:190], np.s_[70:100, 100:190]], 20),
        (36, [np.s_[100:136, 160:190], np.s_[100:136, 70:100]], 25),
    ],
    ids=["a higher part", "higher parts on two sides", "narrow between higher parts"],
)
def test_a_hall_with_a_higher_part_and_a_heap_at_its_wall_is_a_building(length, higher, heap):
    """The opening lowers no cell of it, as none of a hillside's treads; a heap of earth hides a part of its walls."""
    heights = np.zeros((300, 300))
    heights[100 : 100 + length, 100:160] = 10
    for part in higher:
        heights[part] = 13
    hall = heights > 0
    for step in range(1, 13):
        heights[99 + length + step, 100 : 100 + heap] = 10 - 0.8 * step
    ground = walled_ground(grid(heights), PARAMS)
    assert not ground[hall].any()
    assert ground[heights == 0].mean() > 0.99


def test_a_court_below_the_street_does_not_lift_the_street():
    """A court of 40 m lies 5 m below a street that surrounds it; a building stands beside both."""
    heights = np.full((320, 320), 5.0)
    heights[140:180, 140:180] = 0
    heights[155:160, 180:210] = np.linspace(0, 5, 30)
    heights[100:125, 120:200] = 17
    ground = walled_ground(grid(heights), PARAMS)
    built = heights == 17
    assert not ground[built].any()
    assert ground[~built].mean() > 0.98


@pytest.mark.parametrize("side", [120, 250])
def test_a_podium_wider_than_the_windows_is_a_building(side):
    """A building of 8 m and of up to 250 m, walled all around, is above ground, and so is a tower on it."""
    heights = np.zeros((side + 80, side + 80))
    heights[40 : 40 + side, 40 : 40 + side] = 8
    heights[80:100, 80:100] = 40
    ground = walled_ground(grid(heights), PARAMS)
    built = heights > 0
    assert not ground[built].any()
    assert ground[~built].mean() > 0.99


def halls_at_the_border():
    """Yield heights and the cells of a hall: on one side, on two, in a corner with a higher part and lanterns."""
    for part in (np.s_[100:250, :150], np.s_[170:, :100], np.s_[:200, :120]):
        heights = np.zeros((250, 300))
        heights[part] = 8
        hall = heights > 0
        heights[30:40, 180:290:30] = 5
        yield heights, hall
    heights[20:70, 30:90] = 13
    heights[100:104, 20:110], heights[120:124, 20:110] = 10, 10
    yield heights, hall


@pytest.mark.parametrize("number", range(4))
def test_a_hall_that_the_border_cuts_is_a_building(number):
    """Nothing is known of it beyond the border; walls bound the rest. A void cuts it as the border does."""
    heights, hall = list(halls_at_the_border())[number]
    ground = walled_ground(grid(heights), PARAMS)
    assert not ground[hall].any()
    assert ground[heights == 0].mean() > 0.97
    framed, inside = np.pad(heights, 30), np.pad(np.ones(heights.shape, dtype=bool), 30)
    ground = walled_ground(replace(grid(framed), valid=inside), PARAMS)
    assert not ground[30:-30, 30:-30][hall].any()


@pytest.mark.parametrize(("level", "houses"), [(3.5, False), (8.0, True)])
def test_a_plateau_that_the_border_cuts_is_ground(level, houses):
    """A terrace is lower than a hall; a plateau above a quarry carries houses and trees, of which a hall has none."""
    heights = np.zeros((250, 300))
    heights[:200, :120] = level
    if houses:
        for row, col in product(range(10, 190, 25), range(10, 110, 25)):
            heights[row : row + 10, col : col + 10] += 5
    ground = walled_ground(grid(heights), PARAMS)
    assert ground[(heights == level) | (heights == 0)].mean() > 0.95


def test_a_hall_on_three_sides_of_a_tile_is_ground():
    """A known limit: nothing tells it from a plateau with a cliff."""
    heights = np.zeros((250, 300))
    heights[:100] = 8
    assert walled_ground(grid(heights), PARAMS).mean() > 0.97


def test_a_ramp_between_walls_is_ground():
    """A way up of 1 in 8 between walls, 40 m wide, leads to a terrace: both are ground."""
    heights = np.zeros((120, 180))
    heights[:, 100:] = 6
    heights[40:80, 52:100] = np.linspace(0, 6, 48)
    assert walled_ground(grid(heights), PARAMS).mean() > 0.98


def test_a_tile_with_hardly_any_ground_keeps_it():
    """Roofs of three storeys cover all but two lanes of 4 m."""
    heights = np.full((120, 120), 9.0)
    heights[:, 40:44] = 0
    heights[70:74] = 0
    ground = walled_ground(grid(heights), PARAMS)
    assert ground[heights == 0].mean() > 0.95
    assert ground[heights > 0].mean() < 0.02


def test_the_trend_follows_a_slope_under_a_dense_town():
    """Blocks of 40 m with streets of 10 m on a slope of 1 in 4: the trend keeps within 2 m of the slope."""
    row, col = np.indices((300, 300))
    slope = col * 0.25
    built = (row % 50 < 40) & (col % 50 < 40)
    trend = lower_trend(grid(slope + 12 * built), PARAMS)
    assert np.abs(trend - slope)[20:-20, 20:-20].max() < 3


def test_the_kind_of_a_cell_does_not_depend_on_the_height_of_the_tile():
    """Heights of 2,000 m above sea give the same ground."""
    heights = terraced()
    low, high = (walled_ground(grid(heights + above), PARAMS) for above in (0, 2000))
    assert np.mean(low != high) < 1e-3


@pytest.mark.parametrize(("wide", "leads"), [(0, False), (1, False), (6, True)])
def test_a_terrace_is_ground_where_a_way_leads_up(wide, leads):
    """Walls of 4 m bound a terrace of 40 m but for a way up of 1 in 5, which is wide enough to walk or not."""
    heights = np.zeros((120, 140))
    heights[40:80, 80:120] = 4
    heights[60 : 60 + wide, 60:80] = np.linspace(0, 4, 20)
    ground = walled_ground(grid(heights), PARAMS)
    assert ground[41:79, 81:119].all() == leads
    assert ground[41:79, 81:119].any() == leads


def test_a_way_makes_ground_of_the_cells_that_it_leads_to():
    """Of a terrace between walls, half is overgrown, so that the way up covers less of it than three quarters."""
    heights = np.zeros((120, 140))
    heights[40:80, 80:120] = 4
    heights[60:66, 60:80] = np.linspace(0, 4, 20)
    heights[40:80, 98:120] += np.random.default_rng(1).uniform(0, 1.2, (40, 22))
    ground = walled_ground(grid(heights), PARAMS)
    assert ground[41:79, 81:96].all()
    assert not ground[41:79, 101:119].any()


def test_a_hillside_too_steep_for_an_even_way_is_ground():
    """On a slope of 60 % a row of houses and a ditch before it part the terrain from border to border."""
    row, col = np.indices((200, 70))
    heights = 0.48 * col + 0.36 * (200 - row)
    below = row - 0.6 * col - 70
    heights[(below >= 0) & (below < 16)] -= 4
    houses = (below > -14) & (below < 0)
    for west in range(0, 70, 12):
        house = houses & (col >= west) & (col < west + 12)
        heights[house] = heights[house].mean() + 9
    ground = walled_ground(grid(heights), PARAMS)
    assert not ground[houses].any()
    assert ground[~houses].mean() > 0.99


def test_a_level_roof_that_touches_a_slope_is_a_building():
    """On a slope of 30 %, the uphill edge of a roof meets the terrain; its other sides are walls."""
    col = np.indices((120, 160))[1]
    heights = 0.3 * col
    heights[50:60, 52:82] = 0.3 * 81
    ground = walled_ground(grid(heights), PARAMS)
    assert not ground[51:59, 53:74].any()
    assert ground[:45].mean() > 0.98


def test_a_level_roof_into_which_a_bank_runs_is_a_building():
    """Its rear meets the bank, without a step, and is ground by its edges; so no way leads from there to the rest."""
    row = np.indices((120, 120))[0]
    heights = np.clip(0.4 * (70 - row), 0, 8.0)
    heights[53:73, 48:72] = 7.0
    ground = walled_ground(grid(heights), PARAMS)
    assert not ground[60:72, 49:71].any()
    assert ground[80:].all()
    assert ground[:45].all()


@pytest.mark.parametrize(("floor", "is_ground"), [(0.0, True), (9.0, False)])
def test_a_well_in_a_roof_is_ground_only_where_it_reaches_down_to_the_terrain(floor, is_ground):
    """A block of 14 m on a slope, with a well of five metres; the walls around it look the same in both."""
    slope = 0.15 * np.indices((160, 160))[1]
    heights = slope.copy()
    block = np.s_[40:120, 50:130]
    heights[block] += 14
    heights[78:83, 90:95] = slope[78:83, 90:95] + floor
    ground = walled_ground(grid(heights), PARAMS)
    assert ground[80, 92] == is_ground
    ground[78:83, 90:95] = False
    assert not ground[block].any()
    assert ground[:30].mean() > 0.98


def gardens(shed):
    """Return a plain with two rows of houses, and between them a shed behind shrubs that make up a slope to it."""
    heights = np.zeros((80, 120))
    heights[20:30], heights[60:70] = 8, 8
    heights[40:45, 40:45] = shed
    for step in range(1, 4):
        heights[40 - step, 40:45] = heights[44 + step, 40:45] = shed - 0.8 * step
        heights[40:45, 40 - step] = heights[40:45, 44 + step] = shed - 0.8 * step
    return grid(np.maximum(heights, 0))


@pytest.mark.parametrize("side", [1, 3])
def test_a_light_well_is_no_ground_though_the_border_hides_that_roofs_are_high(side):
    """The trend follows the roof of a block at the corner of the tile, so that a well in it looks like terrain."""
    heights = np.zeros((160, 160))
    block = np.s_[90:, 90:]
    heights[block] = 14
    heights[125 : 125 + side, 130 : 130 + side] = 9
    ground = walled_ground(grid(heights), PARAMS)
    assert not ground[block].any()
    assert ground[:85].all()


def test_a_terrace_of_which_little_is_sure_is_no_light_well():
    """High above all other ground, as a hillside behind a row of houses; a small court as high is a well."""
    heights = np.full((80, 80), 20.0)
    heights[:, :30], heights[:, 60:], heights[40:43, 44:47] = 0, 15, 15
    ground = heights < 20
    sure = ground.copy()
    sure[:, 60:] = False
    sure[10:12, 70:72] = True
    wells = walls._wells(grid(heights), ground, sure, PARAMS)
    assert wells[40:43, 44:47].all()
    assert wells.sum() == 9


def test_a_shed_behind_shrubs_is_no_ground_where_echoes_are_few():
    """Steps of 0.8 m are no walls, so that the shed counts as a knoll. Few echoes do not tell knolls from sheds."""
    surface, shed = gardens(2.8), np.s_[40:45, 40:45]
    assert walled_ground(surface, PARAMS)[shed].all()
    few = walled_ground(surface, PARAMS, 0.5)
    assert not few[shed].any()
    assert few[:18].all()
    assert few[72:].all()


def test_a_small_piece_of_a_terrace_is_ground_though_echoes_are_few():
    """Walls part a yard of 64 m² from the rest of its terrace, which no progressive filter is sure of."""
    heights = terraced()
    yard = np.s_[60:68, 100:108]
    heights[58:70, 98:110] += 5
    heights[yard] -= 5
    surface = grid(heights)
    many, few = walled_ground(surface, PARAMS), walled_ground(surface, PARAMS, 0.5)
    assert many[yard].all()
    assert np.array_equal(many, few)


def narrow_tile(pits):
    """Return a small tile with two rows of houses across it; some squares of the plain lie 6 m deeper."""
    heights = np.zeros((150, 72))
    heights[30:42], heights[110:122] = 9, 9
    for row, col, side in pits:
        heights[row : row + side, col : col + side] = -6
    return heights


@pytest.mark.parametrize("pits", [[(65, 26, 20)], [(50, 10, 4), (70, 60, 4), (75, 30, 5), (98, 12, 4), (60, 45, 4)]])
def test_pits_and_false_echoes_do_not_lift_the_terrain_around_them(pits):
    """An excavation of 20 m, or clusters of echoes from below, in the plain between two rows of houses."""
    heights = narrow_tile(pits)
    ground = walled_ground(grid(heights), PARAMS)
    assert not ground[heights == 9].any()
    assert ground[heights == 0].mean() > 0.97


@pytest.mark.parametrize("share", [0.0, 0.25])
def test_courts_below_flat_roofs_are_no_hollows(share):
    """Nothing stands on the roofs of a town, on which its trend lies: its courts and lanes stay the ground."""
    heights = np.full((120, 120), 9.0)
    heights[:, 40:44], heights[70:74] = 0, 0
    for row, col in [(15, 15), (20, 80), (95, 20), (100, 90)]:
        heights[row : row + 6, col : col + 6] = 0
    ground = walled_ground(grid(heights), replace(PARAMS, hollow_share=share))
    assert ground[heights == 0].mean() > 0.9
    assert ground[heights == 9].mean() < 0.02

"""Ground, eaves, ridge and storeys of buildings, on simulated roofs whose levels are exact."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from pyproj import CRS
from simulated.roofs import SIDE_M, errors_of, houses, measured
from simulated.scenes import DATUM_M, Block, Tree, World
from support.sizes import sample

from msbdb.detect.scene import Elevations
from msbdb.fuse import roofheights
from msbdb.fuse.roofheights import measure_heights, roofs_of
from msbdb.grid import Grid, lattice
from msbdb.labels import boxes
from msbdb.params import HeightParams, Params

UTM = CRS.from_epsg(32633)


def heights_of(
    surface: NDArray[np.floating],
    labels: NDArray[np.integer],
    *,
    terrain: NDArray[np.floating] | float | None = 100.0,
    valid: NDArray[np.bool_] | None = None,
    echoes: NDArray[np.integer] | None = None,
    of_points: bool = True,
    cell_m: float = 0.5,
) -> pd.DataFrame:
    """Measure buildings on heights above ground; the terrain is a level or one a cell, and not known if None."""
    spec = lattice((0, 0.01, surface.shape[1] * cell_m - 0.01, surface.shape[0] * cell_m), cell_m, UTM)
    valid = np.ones(surface.shape, dtype=np.bool_) if valid is None else valid
    ndsm = Grid(surface.astype(np.float32), valid, replace(spec, shape=surface.shape))
    counts = np.ones(surface.shape, dtype=np.uint16) if echoes is None else echoes.astype(np.uint16)
    above = None if terrain is None else np.broadcast_to(np.rint(100 * np.asarray(terrain)), surface.shape)
    known = Elevations(None if above is None else above.astype(np.int32), counts, of_points)
    count, params = int(labels.max(initial=0)), Params()
    return measure_heights(labels.astype(np.int32), count, ndsm, known, params=params.heights, surface=params.surface)


def box(height: float, shape: tuple[int, int] = (60, 60)) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return heights and labels of a house of 20 x 20 cells in the middle."""
    labels = np.zeros(shape, dtype=np.int32)
    labels[20:40, 20:40] = 1
    return np.where(labels > 0, height, 0.0), labels


@pytest.mark.parametrize(
    ("density", "eaves_m", "ridge_m"), sample([(4.0, 0.2, 0.3), (1.0, 0.3, 0.35), (16.0, 0.1, 0.25)], 3)
)
def test_roofs_of_all_forms_have_their_eaves_ridge_and_storeys(density: float, eaves_m: float, ridge_m: float) -> None:
    """Root mean squares of the errors of flat, gabled, hipped, shed and pyramid roofs, along the cells and turned."""
    errors = errors_of(density)
    assert np.sqrt((errors["ground"] ** 2).mean()) < 0.1
    assert np.sqrt((errors["eaves"] ** 2).mean()) < eaves_m
    assert np.sqrt((errors["ridge"] ** 2).mean()) < ridge_m
    assert (errors["storeys"] == 0).all()


def test_a_house_on_a_slope_is_level_and_its_ground_is_not() -> None:
    """The ground is that around the house; the storeys of its downhill side may be more."""
    house = next(one for one in houses() if one.name.startswith("flat 20"))
    house = replace(house, level_m=DATUM_M + 0.2 * SIDE_M / 2 + 8.5)
    world = World("slope", (SIDE_M, SIDE_M), (house,), relief=lambda x, _: DATUM_M + 0.2 * np.asarray(x))
    found = measured(house, 4.0, world=world)
    assert found["z_ground"] == pytest.approx(DATUM_M + 0.2 * SIDE_M / 2, abs=0.25)
    assert found["z_ground_max"] - found["z_ground_min"] == pytest.approx(0.2 * 23, abs=0.6)
    assert found["z_eaves"] == pytest.approx(house.level_m, abs=0.1)
    assert found["eaves"] == pytest.approx(8.5, abs=0.3)
    assert (found["storeys_min"], found["storeys"], found["storeys_max"]) == (2, 3, 4)


def test_a_tower_on_a_podium_gives_the_highest_storeys_and_the_ridge() -> None:
    """Eaves and storeys are those of most of the roof; the lift house has no weight."""
    surface, labels = box(6.5)
    surface[22:32, 22:32] = 30.5
    surface[24:28, 24:28] = 33.5
    found = heights_of(surface, labels).iloc[0]
    assert (found["eaves"], found["ridge"], found["z_ridge"]) == (6.5, 30.5, 130.5)
    assert (found["storeys"], found["storeys_top"]) == (2, 10)
    assert found["floor_area_m2"] == (300 * 2 + 100 * 10) / 4


@pytest.mark.parametrize(
    ("columns", "eaves", "storeys"), [(5, 6.5, 2), (9, 16.1, 2), (10, 18.5, 2), (11, 20.9, 10), (15, 30.5, 10)]
)
def test_eaves_are_the_mean_of_the_middle_half_and_storeys_those_of_one_roof(
    columns: int, eaves: float, storeys: int
) -> None:
    """A column more of the tower changes the eaves by little; storeys exist, of equal halves those of the lower one."""
    surface, labels = box(6.5)
    surface[20:40, 20 : 20 + columns] = 30.5
    found = heights_of(surface, labels).iloc[0]
    assert (found["eaves"], found["storeys"], found["storeys_top"]) == (eaves, storeys, 10)


def test_dormers_count_for_the_roof_on_which_they_stand() -> None:
    """Without their cells the larger roof would be the smaller one: 12 of 20 columns are of it."""
    surface, labels = box(6.5)
    surface[:, 28:] = np.where(labels[:, 28:] > 0, 12.5, 0.0)
    for row in (21, 28, 34):
        surface[row : row + 5, 30:36] = 15.0
    found = heights_of(surface, labels).iloc[0]
    assert np.count_nonzero(surface == 12.5) < 20 * 8
    assert (found["eaves"], found["storeys"]) == (10.7, 4)


@pytest.mark.parametrize("seed", range(3))
def test_a_steep_roof_of_chance_points_is_one_roof(seed: int) -> None:
    """A gable of 60 degrees, 4 m wide, with an annex: the points of cells lie up to a cell beside their middle."""
    row, col = np.indices((45, 45))
    across, along = (row - col) / np.sqrt(2), (row + col) / np.sqrt(2) - 8
    annex = (across > 3.5) & (across <= 11.5) & (along >= 0) & (along <= 8)
    gable = (np.abs(across) <= 3.5) & (along >= 0) & (along <= 28)
    off = np.random.default_rng(seed).uniform(-1, 1, (2, 45, 45))
    there = np.abs(across + (off[0] - off[1]) / np.sqrt(2))
    rise = np.sqrt(3) * 0.6 * np.maximum(3.5 - there, -0.5)
    surface = np.where(annex, 3.0, np.where(gable, 8.5 + rise, 0.0))
    found = heights_of(surface, (annex | gable).astype(np.int32), cell_m=0.6).iloc[0]
    assert found["eaves"] == pytest.approx(8.5, abs=0.5), "three quarters of the area are of the gable"
    assert found["ridge"] == pytest.approx(8.5 + 0.6 * 3.5 * np.sqrt(3), abs=0.3)
    assert found["storeys"] == 3


def test_a_wall_that_crosses_cells_is_a_wall() -> None:
    """Cells that lie on a step of 2.2 m have a level in between; a slope with the same two steps is none."""
    surface, labels = box(6.0)
    surface[20:40, 30] = 7.1
    surface[20:40, 31:40] = 8.2
    slope = np.where(labels > 0, 6.0 + 1.1 * np.maximum(np.arange(60) - 20, 0), 0.0)
    for heights, number in ((surface, 2), (slope, 1)):
        level = Grid(heights, np.ones(heights.shape, dtype=np.bool_), lattice((0, 0.1, 35.9, 36), 0.6, UTM))
        assert np.count_nonzero(roofs_of(labels, level, HeightParams()).area_m2 > 50) == number


def test_a_strip_beside_a_wall_is_no_ridge() -> None:
    """Echoes of the neighbour's wall, 12 m2 of them at 7 to 9 m, lie in the cells of a level roof of 6 m."""
    surface, labels = box(6.0)
    labels[39, 12:60] = 1
    surface[39, 12:60] = 8 + np.sin(5.0 * np.arange(48))
    found = heights_of(surface, labels).iloc[0]
    assert found["eaves"] == 6.0
    assert found["ridge"] < 7.5


def test_chimneys_antennas_and_dormers_do_not_change_the_levels() -> None:
    """They are small, and none of them is at the rim's low side."""
    surface, labels = box(6.0)
    surface[20:40, 20:40] += np.minimum(np.arange(20), np.arange(20)[::-1])[:, None] * 0.5
    plain = heights_of(surface, labels).iloc[0]
    surface[29, 24] += 1.5
    surface[30, 33] += 9.0
    surface[23:26, 28:31] = surface[26, 29]
    with_more = heights_of(surface, labels).iloc[0]
    assert with_more["eaves"] == pytest.approx(plain["eaves"], abs=0.05)
    assert with_more["ridge"] == pytest.approx(plain["ridge"], abs=0.05)
    assert plain["eaves"] == pytest.approx(6.0, abs=0.3)


def test_a_tree_over_the_edge_does_not_raise_the_eaves() -> None:
    """The crown hides an eighth of the roof."""
    house = next(houses())
    tree = Tree(house.west - 1, house.south - 1, radius=4.5, height=14.0)
    found = measured(house, 8.0, world=World("tree", (SIDE_M, SIDE_M), (house,), trees=(tree,)))
    assert found["eaves"] == pytest.approx(6.5, abs=0.15)
    assert found["ridge"] == pytest.approx(6.5, abs=0.3)
    assert found["z_ground"] == pytest.approx(DATUM_M, abs=0.1)


def test_an_annex_does_not_lower_the_eaves() -> None:
    """Nor does a canopy that the footprint includes."""
    house = next(one for one in houses() if one.name.startswith("hip"))
    annex = Block("annex", house.west + house.width, house.south + 2, 4, 4, DATUM_M + 2.6, 1)
    found = measured(house, 4.0, world=World("annex", (SIDE_M, SIDE_M), (house, annex)))
    assert found["eaves"] == pytest.approx(5.6, abs=0.2)


def test_a_roof_between_higher_neighbours_has_its_own_level() -> None:
    """It has no edge towards open ground, and no wall that goes down."""
    labels = np.zeros((60, 60), dtype=np.int32)
    labels[10:50, 10:25], labels[10:50, 35:50], labels[10:50, 25:35] = 1, 2, 3
    surface = np.array([0.0, 9.5, 12.5, 4.0])[labels]
    surface[10:50, 25:35] = 4.0
    assert heights_of(surface, labels)["eaves"].tolist() == [9.5, 12.5, 4.0]


@pytest.mark.parametrize("along", [True, False])
@pytest.mark.parametrize("width", [10, 12, 20])
def test_a_house_has_the_same_eaves_alone_and_in_a_row(width: int, along: bool) -> None:
    """With ridges along the street, and with gables to it, where the eaves are the gutters between the houses."""
    labels = np.zeros((60, 90), dtype=np.int32)
    for number in range(3):
        labels[20:40, 15 + width * number : 15 + width * (number + 1)] = number + 1
    across = (np.arange(90) - 15) % width
    from_gutter = (
        np.minimum(np.arange(60) - 20, 39 - np.arange(60))[:, None] if along else np.minimum(across, width - 1 - across)
    )
    level = np.array([0, 5.5, 6.0, 5.5])[labels]
    surface = np.where(labels > 0, level + 0.2 + from_gutter * 0.4, 0.0)
    row = heights_of(surface, labels)["eaves"].to_numpy()
    alone = [heights_of(np.where(labels == one, surface, 0), (labels == one) * 1)["eaves"][0] for one in (1, 2, 3)]
    assert row == pytest.approx([5.5, 6.0, 5.5], abs=0.05)
    assert row.tolist() == alone


def test_a_steep_roof_of_large_cells_is_one_roof() -> None:
    """Steps of 1.75 m, one after the other, are no walls; a step of 2.5 m beside level cells is."""
    rise = 1.75 * np.minimum(np.arange(12), np.arange(12)[::-1])
    surface = np.zeros((30, 40))
    surface[9:21, 8:24] = 5.0 + rise[:, None]
    surface[9:21, 24:32] = 2.5
    labels = (surface > 0).astype(np.int32)
    spec = lattice((0, 0.01, 39.99, 30), 1.0, UTM)
    roofs = roofs_of(labels, Grid(surface, np.ones((30, 40), dtype=np.bool_), spec), HeightParams())
    assert roofs.labels[9:21, 8:24].min() == roofs.labels[9:21, 8:24].max()
    assert roofs.labels[10, 28] != roofs.labels[10, 12]


@pytest.mark.parametrize("shift_m", [-120.0, 0.5, 3000.0])
def test_a_shift_of_the_terrain_moves_the_levels_alone(shift_m: float) -> None:
    """Heights above ground, storeys and qualities stay."""
    surface, labels = box(7.25)
    terrain = np.linspace(50, 53, 60)[None, :] + np.zeros((60, 1))
    low, high = (heights_of(surface, labels, terrain=terrain + more) for more in (0.0, shift_m))
    for name in low:
        shift = shift_m if str(name).startswith("z_") else 0.0
        assert high[name].to_numpy() == pytest.approx(low[name].to_numpy() + shift, abs=0.011)


@pytest.mark.parametrize("height_m", [3.625, 5.125])
def test_the_eaves_of_a_level_roof_are_not_above_its_ridge(height_m: float) -> None:
    """By rounding, a mean of equal levels may lie above them, and no database takes eaves above the ridge."""
    labels = np.zeros((37, 35), dtype=np.int32)
    labels[8:29, 8:27] = 1
    for terrain_m in np.arange(0, 300, 7) / 100:
        found = heights_of(height_m * labels, labels, terrain=terrain_m, cell_m=1.0).iloc[0]
        assert found["ridge"] >= found["eaves"]
        assert found["z_ridge"] >= found["z_eaves"]


def test_heights_above_ground_have_no_level_above_sea() -> None:
    """Eaves and ridge are known all the same."""
    surface, labels = box(6.5)
    found = heights_of(surface, labels, terrain=None).iloc[0]
    assert found[["z_ground", "z_ground_min", "z_ground_max", "z_eaves", "z_ridge"]].isna().all()
    assert found[["eaves", "ridge", "storeys"]].tolist() == [6.5, 6.5, 2]


def test_ground_is_sought_farther_off_and_at_last_beneath() -> None:
    """Cars and hedges around the house hide the ground; without any, the terrain beneath it counts."""
    surface, labels = box(6.5)
    terrain = np.where(labels > 0, 100.0, 103.0)
    ring = np.zeros_like(labels, dtype=np.bool_)
    ring[12:48, 12:48] = True
    surface[ring & (labels == 0)] = 1.2
    assert heights_of(surface, labels, terrain=terrain)["z_ground"].tolist() == [103.0]
    surface[labels == 0] = 1.2
    assert heights_of(surface, labels, terrain=terrain)["z_ground"].tolist() == [100.0]


def test_coverage_no_data_and_density_tell_how_well_it_was_seen() -> None:
    """A quarter of the cells has two echoes, the rest none; west of the house is water."""
    surface, labels = box(6.5)
    echoes = np.zeros(surface.shape, dtype=np.int64)
    echoes[::2, ::2] = 2
    valid = np.ones(surface.shape, dtype=np.bool_)
    valid[:, :20] = False
    found = heights_of(surface, labels, echoes=echoes, valid=valid).iloc[0]
    assert (found["coverage"], found["density"]) == (0.25, 2.0)
    assert 4 * 20 / 28**2 <= found["nodata_share"] <= 4 * 28 / (20 * 20 + 4 * 4 * 20)
    assert heights_of(surface, labels).iloc[0]["nodata_share"] == 0.0
    raster = heights_of(surface, labels, of_points=False).iloc[0]
    assert raster["coverage"] == 1.0
    assert np.isnan(raster["density"])


def test_a_house_at_the_border_has_no_data_beside_it() -> None:
    """What lies beyond the survey was not seen."""
    surface, labels = box(6.5)
    cut = np.s_[20:, :]
    inside, at_border = heights_of(surface, labels).iloc[0], heights_of(surface[cut], labels[cut]).iloc[0]
    assert inside["nodata_share"] == 0.0
    assert at_border["nodata_share"] > 0.1
    assert at_border["z_eaves"] == inside["z_eaves"]


def test_cells_without_a_height_do_not_count() -> None:
    """A hole of no data in the roof has any value."""
    surface, labels = box(6.5)
    valid = np.ones(surface.shape, dtype=np.bool_)
    valid[25:30, 25:30] = False
    surface[25:30, 25:30] = 99.0
    found = heights_of(surface, labels, valid=valid).iloc[0]
    assert found[["eaves", "ridge"]].tolist() == [6.5, 6.5]


def test_no_building_gives_no_row() -> None:
    """The columns are there."""
    found = heights_of(np.zeros((5, 5)), np.zeros((5, 5), dtype=np.int32))
    assert len(found) == 0
    assert {"z_ground", "eaves", "ridge", "storeys", "storeys_top", "coverage"} <= set(found)


@pytest.mark.parametrize(
    ("eaves", "expected"),
    [(2.2, (1, 1, 1)), (3.0, (1, 1, 1)), (5.6, (2, 2, 2)), (7.6, (2, 2, 3)), (9.0, (2, 3, 3)), (15.5, (4, 5, 6))],
)
def test_the_range_of_storeys_is_wide_where_the_eaves_leave_a_choice(eaves: float, expected: tuple[int, ...]) -> None:
    """Storeys of 2.5 to 4 m, and a metre of plinth and roof; whole numbers, as a database's columns are."""
    surface, labels = box(eaves)
    found = heights_of(surface, labels)[["storeys_min", "storeys", "storeys_max"]]
    assert set(found.dtypes) == {np.dtype(np.int64)}
    assert tuple(found.iloc[0]) == expected


def test_the_windows_around_islands_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each island of buildings is looked at in a window; windows as large as the lattice give the same roofs."""
    random = np.random.default_rng(5)
    levels = np.repeat(np.repeat(random.choice([0.0, 3.0, 3.3, 6.0, 9.0], (12, 15)), 5, axis=0), 6, axis=1)
    levels += random.normal(0, 0.3, levels.shape)
    labels = np.where(levels > 2, 1 + np.indices(levels.shape)[1] // 30, 0).astype(np.int32)
    spec = replace(lattice((0, 0.01, 44.99, 30), 0.5, UTM), shape=levels.shape)
    level = Grid(levels, random.random(levels.shape) < 0.97, spec)
    found = roofs_of(labels, level, HeightParams())

    def everywhere(islands: NDArray[np.int32]) -> dict[int, tuple[slice, slice]]:
        return {number: (slice(0, islands.shape[0]), slice(0, islands.shape[1])) for number in boxes(islands)}

    monkeypatch.setattr(roofheights, "boxes", everywhere)
    whole = roofs_of(labels, level, HeightParams())
    np.testing.assert_array_equal(found.labels, whole.labels)
    for name in ("building", "area_m2", "eaves", "ridge"):
        np.testing.assert_array_equal(getattr(found, name), getattr(whole, name))
    assert found.labels.max() > 20


@pytest.mark.parametrize("cell_m", [0.5, 3.0])
def test_the_ground_is_that_of_the_cells_whose_nearest_building_it_is(cell_m: float) -> None:
    """All distances between cells, one by one, give the same ground, in the ring, far from it, and beneath."""
    random = np.random.default_rng(3)
    shape, params = (42, 50), HeightParams()
    labels = np.zeros(shape, dtype=np.int32)
    for number, (row, col) in enumerate(((2, 3), (2, 11), (20, 20), (31, 40)), start=1):
        labels[row : row + 7, col : col + 7] = number
    surface = np.where(labels > 0, 6.0, np.where(random.random(shape) < 0.3, 2.0, 0.0))
    surface[14:33, 14:33] = np.maximum(surface[14:33, 14:33], 2.0)  # shrubs: no ground in the ring of the third
    terrain = random.integers(0, 500, shape) / 100
    found = heights_of(surface, labels, terrain=terrain, cell_m=cell_m)

    built = np.argwhere(labels > 0)
    cells = np.argwhere(labels == 0)
    apart = np.sqrt(((cells[:, None] - built) ** 2).sum(axis=2))
    # Of cells equally near, the western counts, then the northern.
    rank = np.lexsort((built[:, 0], built[:, 1]))
    nearest = rank[apart[:, rank].argmin(axis=1)]
    owner, distance_m = labels[tuple(built[nearest].T)], apart.min(axis=1) * cell_m
    bare = surface[labels == 0] <= params.bare_m
    for number in range(1, 5):
        own = [
            bare & (owner == number) & (distance_m <= most) for most in (max(2.0, 2 * cell_m), max(10.0, 2 * cell_m))
        ]
        levels = [terrain[labels == 0][chosen] for chosen in own if np.count_nonzero(chosen) >= params.ground_cells]
        expected = np.median((levels or [terrain[labels == number]])[0])
        assert found["z_ground"][number - 1] == pytest.approx(expected, abs=0.0051)

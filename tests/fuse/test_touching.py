"""Touching houses are divided where there is a reason, and nowhere else."""

import numpy as np
import pytest
from affine import Affine
from pyproj import CRS
from scipy.ndimage import distance_transform_edt, gaussian_filter, median_filter, rotate

from msbdb.fuse.houses import roofpieces, touching
from msbdb.fuse.houses.joining import REASONS
from msbdb.fuse.houses.touching import Division, divide
from msbdb.grid import Grid, GridSpec
from msbdb.labels import boxes, label_zones, sizes
from msbdb.params import TouchingParams
from msbdb.spectral.colours import INTENSITY_STEPS

CELL_M = 0.5
SPACING_M = 0.4
NOISE_M = 0.05
DEFAULT = TouchingParams()


def scene(width_m: float = 60, depth_m: float = 40) -> np.ndarray:
    """Return a flat ground, metres."""
    return np.zeros((round(depth_m / CELL_M), round(width_m / CELL_M)), dtype=np.float32)


def put(heights: np.ndarray, x: float, y: float, roof: np.ndarray) -> None:
    """Set a roof with its upper left corner at x and y, metres."""
    row, col = round(y / CELL_M), round(x / CELL_M)
    heights[row : row + roof.shape[0], col : col + roof.shape[1]] = roof


def flat(width_m: float, depth_m: float, height_m: float) -> np.ndarray:
    """Return a level roof."""
    return np.full((round(depth_m / CELL_M), round(width_m / CELL_M)), height_m, dtype=np.float32)


def gable(width_m: float, depth_m: float, eaves_m: float, slope: float = 0.8, *, along_x: bool = False) -> np.ndarray:
    """Return a roof whose ridge runs in y; ``along_x`` in x."""
    base = flat(width_m, depth_m, 0)
    rows, cols = base.shape
    across = np.arange(rows)[:, None] if along_x else np.arange(cols)[None]
    half = (rows if along_x else cols) / 2
    return (base + eaves_m + slope * CELL_M * (half - np.abs(across + 0.5 - half))).astype(np.float32)


def hipped(width_m: float, depth_m: float, eaves_m: float, slope: float = 0.8) -> np.ndarray:
    """Return a roof that rises from all four walls."""
    base = flat(width_m, depth_m, 0)
    rows, cols = np.indices(base.shape)
    inside = np.minimum.reduce([rows, cols, base.shape[0] - 1 - rows, base.shape[1] - 1 - cols])
    return (eaves_m + slope * CELL_M * (inside + 0.5)).astype(np.float32)


def division(
    heights: np.ndarray,
    params: TouchingParams = DEFAULT,
    parcels: np.ndarray | None = None,
    noise_m: float = NOISE_M,
    intensity: np.ndarray | None = None,
) -> Division:
    """Divide what is higher than 2 m, with a scanner's noise."""
    built = heights > 2
    noisy = heights + np.random.default_rng(1).normal(0, noise_m, heights.shape).astype(np.float32)
    spec = GridSpec(heights.shape, Affine(CELL_M, 0, 0, 0, -CELL_M, 0), CRS.from_epsg(2154))
    grid = Grid(noisy, np.ones(heights.shape, dtype=bool), spec)
    return divide(grid, built, params, spacing_m=SPACING_M, parcels=parcels, intensity=intensity)


def reasons(found: Division) -> set[str]:
    """Return all reasons of a division."""
    return {REASONS[reason] for reason in found.borders.values()}


def areas_m2(found: Division) -> list[float]:
    """Return the area of each house."""
    return (sizes(found.houses, int(found.houses.max())) * CELL_M**2).tolist()


def test_a_row_of_gabled_houses_is_divided_in_its_valleys():
    """Six houses of 6 m, ridges across the row; each has its area."""
    heights = scene()
    for number in range(6):
        put(heights, 10 + 6 * number, 10, gable(6, 11, 6))
    found = division(heights)
    assert areas_m2(found) == pytest.approx([66] * 6, abs=7)
    assert reasons(found) == {"valley"}
    assert len(found.borders) == 5


def test_flat_houses_of_different_heights_are_divided_at_their_steps():
    """Three of 8 m, two of them with equal neighbours beyond the step."""
    heights = scene()
    for number, height in enumerate((6, 9, 6)):
        put(heights, 10 + 8 * number, 10, flat(8, 14, height))
    found = division(heights)
    assert areas_m2(found) == pytest.approx([112] * 3, abs=9)
    assert reasons(found) == {"step"}


def house_with_garage(garage_m: float, height_m: float, *, depth_m: float = 10) -> np.ndarray:
    """Return a level house of 12 m by 10 m and 6 m beside a garage."""
    heights = scene()
    put(heights, 10, 10, flat(12, 10, 6))
    put(heights, 22, 10, flat(garage_m, depth_m, height_m))
    return heights


@pytest.mark.parametrize(
    "heights",
    [house_with_garage(6, 3, depth_m=6), house_with_garage(7, 3), house_with_garage(11, 3), house_with_garage(4, 10)],
    ids=["garage", "wide garage", "low wing", "stair tower"],
)
def test_a_single_house_keeps_its_garage_and_wings(heights: np.ndarray):
    """Whatever step is between them: no two houses of a pair are so unlike."""
    assert reasons(division(heights, TouchingParams(single_m2=0))) == {"step"}
    found = division(heights)
    assert found.houses.max() == 1
    assert not found.borders


def test_a_pair_of_houses_is_divided_at_its_wall_and_a_large_island_at_its_steps():
    """Both halves are alike; and what is larger than a house may be several."""
    pair = scene()
    put(pair, 10, 10, flat(16, 10, 6))
    pair[20:40, 35:37] += 0.6
    assert areas_m2(division(pair)) == pytest.approx([80] * 2, abs=9)
    assert areas_m2(division(house_with_garage(21, 3))) == pytest.approx([120, 210], abs=15)


def test_a_parcel_divides_a_house_from_its_garage():
    """Also where the rest of the island lies in no parcel."""
    heights = house_with_garage(7, 3)
    parcels = np.where(np.arange(heights.shape[1]) < 22 / CELL_M, 1, 2) * np.ones(heights.shape, dtype=np.int32)
    found = division(heights, parcels=parcels.astype(np.int32))
    assert areas_m2(found) == pytest.approx([120, 70], abs=9)
    assert reasons(found) == {"parcel"}


def test_a_wall_between_level_roofs_divides_them():
    """Fire walls of 0.6 m on a flat roof."""
    heights = scene()
    put(heights, 10, 10, flat(24, 10, 7))
    heights[20:40, 35:37] += 0.6
    heights[20:40, 51:53] += 0.6
    found = division(heights)
    assert areas_m2(found) == pytest.approx([80] * 3, abs=9)
    assert reasons(found) == {"wall"}


@pytest.mark.parametrize("storey_m", [2.5, 3.0, 3.5, 4.0])
def test_a_long_level_roof_stays_one_house(storey_m: float):
    """Whatever the height of its storeys, also with chimneys and boxes on it."""
    heights = scene()
    put(heights, 5, 10, flat(48, 12, 3 * storey_m))
    for x in range(10, 50, 8):
        put(heights, x, 14, flat(1.5, 1.5, 3 * storey_m + 1.2))
    put(heights, 20, 15, flat(4, 4, 3 * storey_m + 3))
    found = division(heights)
    assert found.houses.max() == 1
    assert not found.borders


def saw_tooth() -> np.ndarray:
    """Return a factory roof of six teeth, each with a face of 2.4 m."""
    heights = scene()
    for number in range(6):
        tooth = flat(6, 24, 6)
        tooth += np.linspace(0, 2.4, tooth.shape[1], dtype=np.float32)
        put(heights, 10 + 6 * number, 10, tooth)
    return heights


def l_shape(roof: str) -> np.ndarray:
    """Return a house with two wings at a right angle."""
    heights = scene()
    if roof == "flat":
        put(heights, 10, 10, flat(20, 8, 7))
        put(heights, 10, 10, flat(8, 22, 7))
        return heights
    one, other = scene(), scene()
    put(one, 10, 10, hipped(24, 9, 6))
    put(other, 10, 10, hipped(9, 24, 6))
    return np.maximum(one, other)


def t_shape() -> np.ndarray:
    """Return a house with a lower wing whose ridge meets the slope of the main roof."""
    one, other = scene(), scene()
    put(one, 10, 10, gable(26, 10, 6, along_x=True))
    put(other, 19, 10, gable(7, 18, 6))
    return np.maximum(one, other)


def dormers() -> np.ndarray:
    """Return a gable roof with dormers on both slopes."""
    heights = scene()
    put(heights, 10, 10, gable(20, 11, 6, along_x=True))
    for x in (13, 18, 23):
        for y in (11.5, 17):
            put(heights, x, y, flat(2, 2.5, 9))
    return heights


def tower_on_podium() -> np.ndarray:
    """Return a tower that stands in the middle of a low hall."""
    heights = scene()
    put(heights, 5, 5, flat(40, 28, 5))
    put(heights, 18, 13, flat(12, 10, 25))
    return heights


def one(roof: np.ndarray) -> np.ndarray:
    """Return a single roof on the ground."""
    heights = scene()
    put(heights, 10, 10, roof)
    return heights


@pytest.mark.parametrize(
    "heights",
    [
        pytest.param(one(gable(9, 14, 6)), id="gable"),
        pytest.param(one(gable(9, 14, 6, 1.5)), id="steep gable"),
        pytest.param(one(hipped(14, 10, 6)), id="hipped"),
        pytest.param(one(hipped(12, 12, 6)), id="pyramid"),
        pytest.param(l_shape("flat"), id="flat L"),
        pytest.param(l_shape("hipped"), id="hipped L"),
        pytest.param(t_shape(), id="T"),
        pytest.param(saw_tooth(), id="saw tooth"),
        pytest.param(dormers(), id="dormers"),
        pytest.param(tower_on_podium(), id="tower on a podium"),
        pytest.param(rotate(tower_on_podium(), 30, order=0), id="turned tower on a podium"),
        pytest.param(rotate(saw_tooth(), 30, order=0), id="turned saw tooth"),
        pytest.param(rotate(l_shape("hipped"), 30, order=0), id="turned L"),
        pytest.param(rotate(one(gable(9, 14, 6)), 20, order=0), id="turned gable"),
    ],
)
def test_one_house_stays_one(heights: np.ndarray):
    """Whatever its roof."""
    found = division(heights.astype(np.float32))
    assert found.houses.max() == 1
    assert not found.borders


def test_a_tower_that_stands_on_one_roof_is_no_house_of_its_own():
    """Also at the podium's edge, with a fifth of its outline free; it is one beside the podium, or without the rule."""
    heights = scene()
    put(heights, 5, 5, flat(40, 28, 5))
    put(heights, 18, 5, flat(12, 18, 25))
    assert division(heights).houses.max() == 1
    beside = scene()
    put(beside, 5, 5, flat(28, 12, 5))
    put(beside, 33, 5, flat(12, 12, 25))
    assert areas_m2(division(beside)) == pytest.approx([28 * 12, 12 * 12], abs=9)
    off = TouchingParams(enclosed_share=1.1)
    assert division(tower_on_podium(), off).houses.max() == 2


def test_two_halves_of_a_tower_stand_on_one_roof():
    """Less than three quarters of the outline of each half are beside the podium; parcels divide them all the same."""
    heights = scene()
    put(heights, 5, 5, flat(40, 28, 5))
    put(heights, 14, 13, flat(10, 12, 25))
    put(heights, 24, 13, flat(10, 12, 31))
    assert division(heights).houses.max() == 1
    assert division(heights, TouchingParams(enclosed_share=1.1)).houses.max() == 3
    of_halves = np.where(np.arange(heights.shape[1]) < 48, 1, 2) * np.ones(heights.shape, dtype=np.int32)
    assert reasons(division(heights, parcels=of_halves.astype(np.int32))) == {"parcel"}


def terrace(bend_deg: float, *, slope: float = 0.0, turn_deg: float = 0.0) -> np.ndarray:
    """Return a row of two legs, 25 m by 10 m, whose roofs meet at a bend; ``slope`` is that of its gables."""
    heights = scene(70, 70)
    row, col = np.indices(heights.shape)
    x, y = (col + 0.5) * CELL_M - 35, (row + 0.5) * CELL_M - 35
    # The legs are mitred: each has the cells that are nearer to its own axis.
    across = np.full(heights.shape, np.inf)
    for angle in np.radians([180 + turn_deg, bend_deg + turn_deg]):
        along = x * np.cos(angle) + y * np.sin(angle)
        own = (along <= 25) & (along >= -5 * np.tan(np.radians(bend_deg / 2)))
        across = np.minimum(across, np.where(own, np.abs(y * np.cos(angle) - x * np.sin(angle)), np.inf))
    return np.where(across <= 5, 7 + slope * (5 - np.minimum(across, 5)), 0).astype(np.float32)


@pytest.mark.parametrize("slope", [0.0, 0.8])
@pytest.mark.parametrize("turn_deg", [0.0, 17.0])
def test_a_row_is_divided_where_it_bends(slope: float, turn_deg: float):
    """Level or gabled; not where it hardly bends, and not where the rule is off."""
    found = division(terrace(35, slope=slope, turn_deg=turn_deg))
    assert areas_m2(found) == pytest.approx([250, 250], abs=12)
    assert reasons(found) == {"direction"}
    assert division(terrace(15, slope=slope, turn_deg=turn_deg)).houses.max() == 1
    off = TouchingParams(turn_deg=45)
    assert division(terrace(35, slope=slope, turn_deg=turn_deg), off).houses.max() == 1


def test_a_row_along_a_curve_has_no_bend():
    """A level crescent turns by 120 degrees in all, and nowhere by much within a house's width."""
    heights = scene(110, 110)
    row, col = np.indices(heights.shape)
    radius = np.hypot(row, col) * CELL_M
    heights[(radius > 80) & (radius < 90) & (col > row / 4)] = 9
    assert division(heights).houses.max() == 1


def terrace_roof() -> np.ndarray:
    """Return five houses of 6 m under one roof whose ridge runs along the row."""
    heights = scene()
    put(heights, 10, 10, gable(30, 10, 6, along_x=True))
    return heights


def pulses(heights: np.ndarray, factors: np.ndarray, noise: float = 0.15) -> np.ndarray:
    """Return the kept intensity of roofs that return 100 times these factors; ``noise`` is that of its logarithm."""
    logarithm = np.log(100 * factors) + np.random.default_rng(2).normal(0, noise, heights.shape)
    return np.where(heights > 2, 1 + np.rint(INTENSITY_STEPS * logarithm), 0).astype(np.uint8)


def of_houses(heights: np.ndarray) -> np.ndarray:
    """Return a factor of 2 for the second and fourth house of 6 m from x = 10 on."""
    house = (np.arange(heights.shape[1]) * CELL_M - 10) // 6
    return np.where(house % 2 == 1, 2.0, 1.0) * np.ones(heights.shape)


@pytest.mark.parametrize("angle", [0, 30])
def test_a_row_under_one_roof_is_divided_where_its_material_changes(angle: float):
    """Five houses with two kinds of tiles; without intensity, and where the rule is off, they are one."""
    heights = terrace_roof()
    factors = of_houses(heights)
    if angle:
        heights = rotate(heights, angle, order=0)
        factors = np.maximum(rotate(factors, angle, order=0), 0.5)
    intensity = pulses(heights, factors)
    found = division(heights, intensity=intensity)
    assert areas_m2(found) == pytest.approx([60] * 5, abs=9)
    assert reasons(found) == {"material"}
    assert len(found.borders) == 4
    assert division(heights).houses.max() == 1
    assert division(heights, TouchingParams(contrast=20), intensity=intensity).houses.max() == 1


def slopes_of_two_kinds(heights: np.ndarray) -> np.ndarray:
    """Return a factor of 3 for the slope behind the ridge."""
    return np.where(np.arange(heights.shape[0]) < 30, 3.0, 1.0)[:, None] * np.ones(heights.shape)


def panels(heights: np.ndarray) -> np.ndarray:
    """Return a factor of 1/3 for two fields of solar panels on one slope."""
    found = np.ones(heights.shape)
    found[22:26, 28:40] = found[22:26, 50:62] = 1 / 3
    return found


@pytest.mark.parametrize("factors", [slopes_of_two_kinds, panels, np.ones_like])
def test_the_material_of_one_house_does_not_divide_it(factors):
    """Neither two slopes of different intensity, nor solar panels, nor the noise of the pulses."""
    heights = terrace_roof()
    assert division(heights, intensity=pulses(heights, factors(heights))).houses.max() == 1


def test_coarse_cells_do_not_show_materials():
    """On cells of 1 m a side of a line is one cell, which one pulse decides; on cells of 0.75 m it is two."""
    heights = terrace_roof()
    intensity = pulses(heights, of_houses(heights))
    for cell_m, divided in ((0.75, True), (1.0, False)):
        spec = GridSpec(heights.shape, Affine(cell_m, 0, 0, 0, -cell_m, 0), CRS.from_epsg(2154))
        grid = Grid(heights * np.float32(cell_m / CELL_M), np.ones(heights.shape, dtype=bool), spec)
        found = divide(grid, heights > 2, DEFAULT, spacing_m=SPACING_M, intensity=intensity)
        assert ("material" in reasons(found)) == divided


def test_materials_divide_no_level_roof():
    """Gravel beside bitumen is one roof."""
    heights = scene()
    put(heights, 10, 10, flat(30, 10, 7))
    assert division(heights, intensity=pulses(heights, of_houses(heights))).houses.max() == 1


def test_a_parcel_is_not_divided_by_materials():
    """The user's parcel decides."""
    heights = terrace_roof()
    parcels = np.ones(heights.shape, dtype=np.int32)
    assert division(heights, parcels=parcels, intensity=pulses(heights, of_houses(heights))).houses.max() == 1


def arena() -> np.ndarray:
    """Return tiers around a floor, with walls of stairs across them."""
    heights = scene(100, 80)
    row, col = np.indices(heights.shape)
    x, y = col * CELL_M - 50, row * CELL_M - 40
    radius = np.hypot(x / 45, y / 33)
    for inner, level in ((0.5, 5), (0.65, 9), (0.82, 15)):
        heights[(radius >= inner) & (radius <= 1)] = level
    heights[(radius >= 0.5) & (radius <= 1) & (np.minimum(np.abs(x - y), np.abs(x + y)) < 0.8)] += 1
    return heights


def test_a_round_structure_is_one():
    """Its tiers would be houses without the rule; parcels divide it all the same."""
    heights = arena()
    found = division(heights)
    assert found.houses.max() == 1
    assert division(heights, TouchingParams(round_share=1.1)).houses.max() > 4
    halves = np.where(np.arange(heights.shape[1]) < 100, 1, 2) * np.ones(heights.shape, dtype=np.int32)
    given = division(heights, parcels=halves.astype(np.int32))
    assert areas_m2(given) == pytest.approx([areas_m2(found)[0] / 2] * 2, rel=0.05)
    assert reasons(given) == {"parcel"}


def parcels_of(shape: tuple[int, ...], shift_m: float, width_m: float) -> np.ndarray:
    """Return parcels side by side from x = 10 on, over all of y, shifted to the right and down."""
    found = np.zeros(shape, dtype=np.int32)
    rows = slice(round((10 + shift_m) / CELL_M), round((22 + shift_m) / CELL_M))
    for number in range(4):
        left, right = (round((10 + shift_m + width_m * (number + end)) / CELL_M) for end in (0, 1))
        found[rows, left:right] = 1 + number
    return found


@pytest.mark.parametrize("shift_m", [-1.0, -0.5, 0.0, 0.5, 1.0])
def test_parcels_divide_a_level_roof_without_slivers(shift_m: float):
    """Four parcels of 8 m; strips along the walls that lie outside of all parcels go to the house beside them."""
    heights = scene()
    put(heights, 10, 10, flat(32, 12, 7))
    found = division(heights, parcels=parcels_of(heights.shape, shift_m, 8))
    assert areas_m2(found) == pytest.approx([96] * 4, abs=13)
    assert reasons(found) == {"parcel"}
    assert set(found.borders) == {(1, 2), (2, 3), (3, 4)}


@pytest.mark.parametrize("shift_m", [-1.0, 0.5, 1.0])
def test_parcels_that_are_shifted_leave_houses_at_their_walls(shift_m: float):
    """Where there is a step beside the line of the parcel, the step is the border."""
    heights = scene()
    for number, height in enumerate((6, 9, 6, 9)):
        put(heights, 10 + 8 * number, 10, flat(8, 12, height))
    found = division(heights, parcels=parcels_of(heights.shape, shift_m, 8))
    assert areas_m2(found) == pytest.approx([96] * 4, abs=7)
    assert reasons(found) == {"parcel"}


def test_parcels_join_what_the_evidence_would_divide():
    """One parcel of a house with a high and a low wing is one building; the user decides."""
    heights = scene()
    put(heights, 10, 10, flat(16, 12, 6))
    put(heights, 26, 10, flat(16, 12, 12))
    assert division(heights).houses.max() == 2
    parcels = np.ones(heights.shape, dtype=np.int32)
    assert division(heights, parcels=parcels).houses.max() == 1


def test_houses_outside_of_all_parcels_are_divided_by_evidence():
    """Half of a row has parcels; the others have their steps."""
    heights = scene()
    for number, height in enumerate((6, 9, 6, 9)):
        put(heights, 10 + 8 * number, 10, flat(8, 12, height))
    parcels = parcels_of(heights.shape, 0, 8)
    parcels[parcels > 2] = 0
    found = division(heights, parcels=parcels)
    assert areas_m2(found) == pytest.approx([96] * 4, abs=9)
    assert reasons(found) == {"parcel", "step"}


def test_parcels_alone_divide_where_nothing_else_may():
    """The parameter turns the evidence off; parcels that are given still divide."""
    heights = scene()
    for number, height in enumerate((6, 9, 6, 9)):
        put(heights, 10 + 8 * number, 10, flat(8, 12, height))
    off = TouchingParams(divide=False)
    assert division(heights, off).houses.max() == 1
    parcels = (parcels_of(heights.shape, 0, 8) + 1) // 2
    assert areas_m2(division(heights, off, parcels)) == pytest.approx([192, 192], abs=9)


def test_each_house_is_large_and_wide_enough():
    """No piece is left below the least house, whatever stands on the roofs."""
    random = np.random.default_rng(3)
    heights = scene(80, 60)
    put(heights, 10, 10, flat(60, 40, 6))
    for _ in range(60):
        x, y, width, depth = (*random.uniform((12, 12), (60, 40)), *random.uniform(1, 9, 2))
        put(heights, x, y, flat(width, depth, random.uniform(5, 15)))
    found = division(heights)
    assert found.houses.max() > 1
    assert min(areas_m2(found)) >= DEFAULT.house_m2
    assert (found.houses > 0).sum() == (heights > 2).sum()


def test_a_building_names_the_reasons_of_its_own_borders():
    """Of three houses the middle one has two; a house that was dropped gives no reason."""
    houses = np.array([[1, 1, 2, 2, 3, 3]], dtype=np.int32)
    found = Division(houses, {(1, 2): REASONS.index("valley"), (2, 3): REASONS.index("step")})
    assert found.reasons_of(houses, 3).tolist() == ["valley", "step,valley", "step"]
    without = np.array([[1, 1, 2, 2, 0, 0]], dtype=np.int32)
    assert found.reasons_of(without, 2).tolist() == ["valley", "valley"]


def test_the_division_does_not_depend_on_the_place():
    """The same roofs elsewhere on the lattice, beside other houses, are divided alike."""
    heights = scene()
    for number in range(4):
        put(heights, 10 + 6 * number, 10, gable(6, 11, 6))
    larger = np.zeros((heights.shape[0] + 33, heights.shape[1] + 21), dtype=np.float32)
    larger[33:, 21:] = heights
    larger[2:20, 2:30] = 8
    here, there = division(heights, noise_m=0), division(larger, noise_m=0)
    shown = there.houses[33:, 21:]
    assert ((shown > 0) == (here.houses > 0)).all()
    assert len({*zip(shown[shown > 0].tolist(), here.houses[shown > 0].tolist(), strict=True)}) == 4


def test_the_windows_around_islands_change_nothing(monkeypatch):
    """Each island is looked at in a window; windows as large as the lattice give the same heights and pieces."""
    random = np.random.default_rng(3)
    noise = gaussian_filter(random.normal(size=(2, 90, 110)), (0, 3, 3)) * 10
    heights = (6 + noise[0] + random.normal(0, 0.2, noise[0].shape)).astype(np.float32)
    built = noise[1] > 0.3
    strength = (1.3 * random.random(built.shape) ** 4).astype(np.float32)

    def measured():
        islands, count = label_zones(built)
        assert count > 5
        smooth = touching._without_outliers(heights, islands, CELL_M, SPACING_M)
        return smooth, roofpieces.cut_pieces(smooth, built, strength, cell_m=CELL_M, core_m=1.0)

    smooth, pieces = measured()
    near = distance_transform_edt(~built) * CELL_M <= 1.5 + 0.8
    np.testing.assert_array_equal(smooth[near], median_filter(heights, 3, mode="nearest")[near])

    def everywhere(labels):
        return {number: (slice(0, labels.shape[0]), slice(0, labels.shape[1])) for number in boxes(labels)}

    for module in (touching, roofpieces):
        monkeypatch.setattr(module, "boxes", everywhere)
    np.testing.assert_array_equal(pieces, measured()[1])

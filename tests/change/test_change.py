"""What a survey did to the buildings: every kind of change on small towns, and none where nothing changed."""

import itertools
from collections.abc import Sequence

import geopandas as gpd
import numpy as np
import pytest
import shapely
from geopandas.testing import assert_geodataframe_equal
from hypothesis import given, settings
from hypothesis import strategies as st
from pandas.testing import assert_frame_equal
from shapely import box
from shapely.affinity import translate
from support.towns import RANDOM_TOWN, ROW, SOUTH, UTM, WEST, House, Steps, random_houses

from msbdb.change import comparison, thickness
from msbdb.change.comparison import Comparison, measure_roofs
from msbdb.change.decisions import BEYOND_BORDER, KINDS, LEVEL_CHANGE, NO_FOOTPRINT, PART_GONE, STOOD_BEFORE
from msbdb.change.differences import Offset, earlier_heights, estimate_offset
from msbdb.change.surveywindows import Heights
from msbdb.change.thickness import opened_and_dilated, without_slivers
from msbdb.detect.scene import Elevations
from msbdb.errors import PassingNotice
from msbdb.fuse.roofheights import measure_heights
from msbdb.grid import Grid, lattice
from msbdb.outline.polygons import rasterise
from msbdb.params import ChangeParams, Params
from msbdb.tables import FIRST_SURVEY, HEIGHTS

SPEC = lattice((WEST, SOUTH, WEST + 200, SOUTH + 120), 0.5, UTM)


def town(houses: list[House]) -> gpd.GeoDataFrame:
    """Return footprints with heights."""
    shapes = [box(WEST + w, SOUTH + s, WEST + e, SOUTH + n) for w, s, e, n, _ in houses]
    return gpd.GeoDataFrame({"h_p90": [house[4] for house in houses]}, geometry=shapes, crs=UTM)


def ground(houses: list[House], dx: float = 0.0) -> Grid:
    """Return the heights above ground of a town, shifted to the east."""
    frame = town(houses)
    labels = rasterise([translate(shape, dx) for shape in frame.geometry], SPEC)
    heights = np.concatenate([[0.0], frame["h_p90"].to_numpy()])
    return Grid(heights[labels].astype(np.float32), np.ones(SPEC.shape, dtype=np.bool_), SPEC)


def compare(
    before: gpd.GeoDataFrame,
    after: gpd.GeoDataFrame,
    *,
    heights: Grid,
    earlier: Sequence[Grid] = (),
    levels: Grid | None = None,
    earlier_levels: Sequence[Grid | None] = (),
    **options: object,
) -> Comparison:
    """Compare two towns in one window, and again in small ones, with the same result."""
    options["survey"] = Heights(heights, levels)
    options["earlier"] = [Heights(*both) for both in itertools.zip_longest(earlier, earlier_levels)]
    whole, part = (comparison.compare(before, after, **options, window_cells=side) for side in (10_000, 30))
    assert repr(whole.offset) == repr(part.offset)
    assert_frame_equal(whole.changes, part.changes)
    assert_geodataframe_equal(whole.versions, part.versions)
    return whole


def compared(before: list[House], after: list[House], **options: object) -> Comparison:
    """Compare two towns whose heights are known on both sides."""
    options.setdefault("earlier", [ground(before)])
    return compare(town(before), town(after), heights=ground(after), **options)


def kinds(found: Comparison) -> list[tuple[str, int, int]]:
    """Return kind, before and after of all rows that are no bare 'unchanged'."""
    rows = found.changes
    changed = rows[(rows["kind"] != "unchanged") | (rows["note"] != "")]
    return list(zip(changed["kind"], changed["before"], changed["after"], strict=True))


def test_thin_rests_of_a_footprint_are_dropped() -> None:
    """Cells along the outline of what was pulled down are; all of a building that is as thin is not."""
    cells = np.zeros((40, 40), dtype=np.bool_)
    cells[5:25, 5:20] = True
    wing = cells.copy()
    cells[5:25, 35] = True
    cells[30, [5, 9, 11]] = True
    assert (without_slivers(cells, SPEC, ChangeParams()) == wing).all()
    assert (without_slivers(cells & ~wing, SPEC, ChangeParams()) == (cells & ~wing)).all()


def test_equal_towns_have_no_change() -> None:
    """Every building has its row, and no version is written."""
    found = compared(ROW, ROW)
    assert found.changes["kind"].tolist() == ["unchanged"] * 8
    assert found.versions.empty
    assert found.changes["iou"].tolist() == pytest.approx([1.0] * 8)


def test_a_house_is_new_where_nothing_stood() -> None:
    """The newcomer continues nobody."""
    found = compared(ROW, [*ROW, (60, 60, 75, 75, 9)])
    assert kinds(found) == [("new", -1, 8)]
    assert found.versions[["before", "after"]].to_numpy().tolist() == [[-1, 8]]


def test_a_house_that_is_gone_is_demolished() -> None:
    """It has no new version."""
    found = compared(ROW, ROW[:7])
    assert kinds(found) == [("demolished", 7, -1)]
    assert found.versions.empty


def test_an_extension_modifies_the_outline() -> None:
    """The survey's outline is adopted whole."""
    longer = (150.0, 10.0, 162.0, 28.0, 13.0)
    found = compared(ROW, [*ROW[:7], longer])
    row = found.changes.iloc[7]
    assert (row["kind"], row["outline"], row["height"]) == ("modified", True, False)
    assert row["darea_m2"] == pytest.approx(12 * 6)
    assert found.versions["adopted"].tolist() == [True]


def test_a_raised_house_is_modified_in_height_and_a_tower_on_it_in_parts() -> None:
    """A rise of all of the roof is one of the building, that of a corner one of its parts."""
    raised = compared(ROW, [*ROW[:7], (150, 10, 162, 22, 19)]).changes.iloc[7]
    assert (raised["kind"], raised["outline"], raised["height"], raised["parts"]) == ("modified", False, True, False)
    assert raised["dh_m"] == pytest.approx(6)
    tower = ground([*ROW, (150, 10, 157, 17, 30)])
    part = compare(town(ROW), town(ROW), heights=tower, earlier=[ground(ROW)]).changes.iloc[7]
    assert (part["kind"], part["height"], part["parts"]) == ("modified", True, True)


def test_houses_joined_by_building_in_the_gap_merge_into_the_larger() -> None:
    """Both rows name the one building that is left."""
    pair: list[House] = [(20, 60, 40, 80, 8), (46, 60, 60, 80, 8)]
    found = compared([*ROW, *pair], [*ROW, (20, 60, 60, 80, 8)])
    assert kinds(found) == [("merged", 8, 8), ("merged", 9, 8)]
    assert found.versions[["before", "after"]].to_numpy().tolist() == [[8, 8]]


def test_a_house_parted_by_demolition_splits() -> None:
    """The larger part keeps the identity."""
    found = compared([*ROW, (20, 60, 60, 80, 8)], [*ROW, (20, 60, 40, 80, 8), (46, 60, 60, 80, 8)])
    assert kinds(found) == [("split", 8, 8), ("split", 8, 9)]
    assert found.versions[["before", "after"]].to_numpy().tolist() == [[8, 8], [-1, 9]]


def test_a_row_that_is_cut_otherwise_is_unchanged() -> None:
    """Neighbours that one survey separates and another does not are the same houses."""
    three: list[House] = [(20, 60, 30, 72, 8), (30, 60, 40, 72, 8), (40, 60, 50, 72, 8)]
    joined: list[House] = [(20, 60, 50, 72, 8)]
    for before, after in ((three, joined), (joined, three)):
        assert kinds(compared([*ROW, *before], [*ROW, *after])) == []


def test_of_a_joined_row_only_the_extended_house_is_modified() -> None:
    """Its neighbours stay as they are, and its outline is put together from its own and the new part."""
    three: list[House] = [(20, 60, 30, 72, 8), (30, 60, 40, 72, 8), (40, 60, 50, 72, 8)]
    found = compared([*ROW, *three], [*ROW, (20, 60, 50, 72, 8), (40, 72, 50, 80, 8)])
    # The extension is an object of its own here, joined to nothing of the inventory.
    assert kinds(found) == [("new", -1, 9)]
    block = gpd.GeoDataFrame(
        {"h_p90": [8.0]}, geometry=[town([(20, 60, 50, 72, 8), (40, 72, 50, 80, 8)]).union_all()], crs=UTM
    )
    after = gpd.GeoDataFrame(gpd.pd.concat([town(ROW), block], ignore_index=True), crs=UTM)
    heights = ground([*ROW, (20, 60, 50, 72, 8), (40, 72, 50, 80, 8)])
    found = compare(town([*ROW, *three]), after, heights=heights, earlier=[ground([*ROW, *three])])
    assert kinds(found) == [("modified", 10, 8)]
    shape = found.versions.geometry.iloc[0]
    assert not found.versions["adopted"].iloc[0]
    assert shape.equals(box(WEST + 40, SOUTH + 60, WEST + 50, SOUTH + 80))


def test_what_stood_before_is_not_new_and_what_stands_is_not_demolished() -> None:
    """A build that misses a house, or finds it later, is no change of the town."""
    known = [ground(ROW)]
    found = compare(town(ROW[:7]), town(ROW), heights=ground(ROW), earlier=known)
    assert kinds(found) == [("unchanged", -1, 7)]
    assert found.changes["note"].iloc[-1] == STOOD_BEFORE
    found = compare(town(ROW), town(ROW[:7]), heights=ground(ROW), earlier=known)
    assert kinds(found) == [("unchanged", 7, -1)]
    assert found.changes["note"].iloc[-1] == NO_FOOTPRINT


def test_the_first_survey_of_a_place_brings_new_buildings() -> None:
    """Without an inventory all is new."""
    found = compare(town([]), town(ROW), heights=ground(ROW))
    assert set(found.changes["kind"]) == {"new"}
    assert set(found.changes["note"]) == {FIRST_SURVEY}


def test_buildings_outside_of_the_survey_have_no_row() -> None:
    """Neither demolished nor unchanged: they were not surveyed."""
    found = compared(ROW, [], area=box(WEST + 100, SOUTH, WEST + 200, SOUTH + 120))
    assert found.changes["before"].tolist() == [5, 6, 7]
    assert set(found.changes["kind"]) <= {"unchanged", "demolished"}


@pytest.mark.parametrize("shift", [0.5, -1.5, 2.0])
def test_a_shift_of_the_survey_is_told_and_is_no_change(shift: float) -> None:
    """The offset is estimated to a cell, and a raised house is still found."""
    moved = [(w + shift, s, e + shift, n, h) for w, s, e, n, h in ROW]
    raised = [*moved[:7], (*moved[7][:4], 20.0)]
    found = compare(town(ROW), town(raised), heights=ground(raised), earlier=[ground(ROW)])
    assert found.offset.dx_m == pytest.approx(shift)
    assert found.offset.dy_m == 0
    assert kinds(found) == [("modified", 7, 7)]


def test_a_vertical_offset_is_told_and_is_no_change() -> None:
    """All roofs are 2 m higher: that is the ground of the survey, not the town."""
    higher = [(*house[:4], house[4] + 2) for house in ROW]
    found = compared(ROW, higher)
    assert found.offset.dz_m == pytest.approx(2)
    assert kinds(found) == []


def test_an_inventory_of_bare_footprints_is_compared_by_outlines_and_heights() -> None:
    """Without earlier heights of the place, those of the buildings show a rise."""
    after = [*ROW[:6], (*ROW[6][:4], 25.0), (150, 10, 162, 30, 13)]
    found = compare(town(ROW), town(after), heights=ground(after))
    assert kinds(found) == [("modified", 6, 6), ("modified", 7, 7)]
    assert found.changes["height"].tolist()[6:] == [True, False]


def test_slivers_and_small_annexes_are_no_change() -> None:
    """Half a metre around a roof, or a shed of 9 m2, is below what counts."""
    fat = [(w - 0.5, s - 0.5, e + 0.5, n + 0.5, h) for w, s, e, n, h in ROW]
    assert kinds(compared(ROW, fat)) == []
    assert kinds(compared(ROW, [*ROW[:7], (150, 10, 162, 22.5, 13)])) == []


def test_few_pairs_tell_no_offset() -> None:
    """Two houses may both have been extended."""
    found = estimate_offset(town(ROW[:2]), town(ROW[:2]), least_pairs=5)
    assert (found.dx_m, found.dy_m, found.dz_m, found.pairs) == (0, 0, 0, 2)


def test_rows_come_in_order_and_of_known_kinds() -> None:
    """Inventory first, then newcomers."""
    found = compared(ROW, [*ROW[1:], (60, 60, 75, 75, 9)], params=ChangeParams())
    assert found.changes["before"].tolist() == [*range(8), -1]
    assert set(found.changes["kind"]) <= set(KINDS)


def test_a_slender_building_that_is_gone_is_demolished() -> None:
    """It leaves no piece that a disc fits into, but no footprint and no height either."""
    slender: House = (20, 60, 80, 61.5, 5)
    found = compared([*ROW, slender], ROW)
    assert kinds(found) == [("demolished", 8, -1)]


def test_an_inventory_of_bare_footprints_loses_only_what_is_open_now() -> None:
    """A house that a build missed is unchanged while its heights remain."""
    found = compare(town(ROW), town(ROW[:7]), heights=ground(ROW))
    assert kinds(found) == [("unchanged", 7, -1)]
    found = compare(town(ROW), town(ROW[:7]), heights=ground(ROW[:7]))
    assert kinds(found) == [("demolished", 7, -1)]


def test_half_of_the_houses_raised_is_no_vertical_offset() -> None:
    """Of two equal groups the one that stayed decides."""
    raised = [(*house[:4], house[4] + 4 * (n % 2)) for n, house in enumerate(ROW)]
    found = estimate_offset(town(ROW), town(raised), least_pairs=5)
    assert found.dz_m == 0


def test_the_offset_is_finer_than_the_cells_of_the_outlines():
    """Outlines on cells of 0.5 m, each as its survey's lattice lies, still tell a shift of 0.2 m."""
    rng = np.random.default_rng(4)
    west, south = 60 * np.arange(40) + rng.uniform(0, 1, 40), rng.uniform(0, 1, 40)
    sides = rng.uniform(8, 40, (2, 40))

    def traced(shift):
        low, high = (np.round((place + shift) / 0.5) * 0.5 for place in (west, west + sides[0]))
        shapes = shapely.box(low, south, high, south + sides[1])
        return gpd.GeoDataFrame({"h_p90": np.full(40, 6.0)}, geometry=shapes)

    found = estimate_offset(traced(0.0), traced(0.2), least_pairs=5)
    assert found.dx_m == pytest.approx(0.2, abs=0.08)
    assert found.dy_m == pytest.approx(0, abs=0.01)


def test_each_change_names_the_new_state_of_its_building() -> None:
    """Merged buildings share one, unchanged and demolished ones have none."""
    pair: list[House] = [(20, 60, 40, 80, 8), (46, 60, 60, 80, 8)]
    found = compared([*ROW, *pair], [*ROW[1:], (20, 60, 60, 80, 8), (100, 60, 115, 75, 9)])
    rows = found.changes.set_index("before")["version"]
    assert rows[0] == rows[1] == -1
    assert rows[8] == rows[9] >= 0
    assert sorted({rows[8], rows[-1]}) == [0, 1]


def test_a_building_that_an_earlier_survey_cut_is_whole_now_and_unchanged() -> None:
    """What lies beyond the border of the earlier heights was not built since; the whole outline is adopted."""
    cut, whole = (180.0, 60.0, 190.0, 75.0, 9.0), (180.0, 60.0, 199.0, 75.0, 9.0)
    known = ground([*ROW, cut])
    before = known.spec.crop(slice(0, known.spec.shape[0]), slice(0, 380))
    earlier = Grid(np.asarray(known.values)[:, :380].copy(), known.valid[:, :380].copy(), before)
    found = compared([*ROW, cut], [*ROW, whole], earlier=[earlier])
    assert kinds(found) == [("unchanged", 8, 8)]
    row = found.changes.iloc[8]
    assert (row["note"], row["outline"]) == (BEYOND_BORDER, False)
    assert found.versions.geometry.area.tolist() == pytest.approx([19 * 15])
    assert kinds(compared([*ROW, cut], [*ROW, whole])) == [("modified", 8, 8)]


def test_touching_houses_that_an_earlier_survey_cut_are_not_merged_beyond_its_border() -> None:
    """What no earlier survey measured may have stood before: each house gets the cells that are nearest to it."""
    cut: list[House] = [(180, 60, 190, 70, 9), (180, 70, 190, 80, 6)]
    whole: list[House] = [(180, 60, 199, 80, 9)]
    known = ground([*ROW, *cut])
    border = known.spec.crop(slice(0, known.spec.shape[0]), slice(0, 380))
    earlier = Grid(np.asarray(known.values)[:, :380].copy(), known.valid[:, :380].copy(), border)
    after = town([*ROW, *whole])
    found = compare(town([*ROW, *cut]), after, heights=ground([*ROW, *whole, cut[1]]), earlier=[earlier])
    assert kinds(found) == [("unchanged", 8, 8), ("unchanged", 9, 8)]
    assert set(found.changes["note"].iloc[8:]) == {BEYOND_BORDER}
    assert found.versions.geometry.area.tolist() == pytest.approx([19 * 10, 19 * 10])
    assert shapely.area(shapely.intersection(*found.versions.geometry)) == 0


def test_a_raised_house_that_an_earlier_survey_cut_gets_its_whole_outline() -> None:
    """Its height changed, and what lies beyond the border is no change of its outline."""
    cut, whole = (180.0, 60.0, 190.0, 75.0, 9.0), (180.0, 60.0, 199.0, 75.0, 15.0)
    known = ground([*ROW, cut])
    border = known.spec.crop(slice(0, known.spec.shape[0]), slice(0, 380))
    earlier = Grid(np.asarray(known.values)[:, :380].copy(), known.valid[:, :380].copy(), border)
    found = compared([*ROW, cut], [*ROW, whole], earlier=[earlier])
    row = found.changes.iloc[8]
    assert (row["kind"], row["outline"], row["height"]) == ("modified", False, True)
    assert found.versions.geometry.area.tolist() == pytest.approx([19 * 15])


def test_a_strip_beyond_the_border_of_the_earlier_surveys_is_no_part_of_a_house() -> None:
    """A few cells along the border are within what outlines differ by, and need no new state."""
    cut, whole = (180.0, 60.0, 199.0, 80.0, 9.0), (180.0, 60.0, 200.5, 80.0, 9.0)
    known = ground([*ROW, cut])
    border = known.spec.crop(slice(0, known.spec.shape[0]), slice(0, 398))
    earlier = Grid(np.asarray(known.values)[:, :398].copy(), known.valid[:, :398].copy(), border)
    found = compared([*ROW, cut], [*ROW, whole], earlier=[earlier], params=ChangeParams(least_m2=5.0))
    assert kinds(found) == []
    assert found.versions.empty


def levels(houses: list[House], terrain: Grid, zero: float = 0.0) -> tuple[Grid, Grid]:
    """Return heights above a terrain that a survey found, and levels above its own zero."""
    above = np.asarray(ground(houses).values)
    found = above - np.asarray(terrain.values)
    return Grid(found.astype(np.float32), terrain.valid, SPEC), Grid(
        (above + zero).astype(np.float32), terrain.valid, SPEC
    )


def test_ground_that_is_found_elsewhere_beneath_a_block_is_no_change_of_its_roofs() -> None:
    """Two flights interpolate it differently; the levels of the roofs decide, each from its survey's own zero."""
    flat = ground([])
    hill = ground([(148, 8, 164, 24, 2.5)])
    before, base = levels(ROW, flat)
    after, now = levels(ROW, hill, zero=43.2)
    options = {"heights": after, "earlier": [before]}
    assert kinds(compare(town(ROW), town(ROW), **options)) == [("modified", 7, 7)]
    found = compare(town(ROW), town(ROW), **options, levels=now, earlier_levels=[base])
    assert kinds(found) == []
    assert found.changes["dh_m"].tolist() == pytest.approx([0.0] * 8, abs=1e-3)
    # An earlier survey without a terrain is compared by heights above ground.
    assert kinds(compare(town(ROW), town(ROW), **options, levels=now)) == [("modified", 7, 7)]
    assert kinds(compare(town(ROW), town(ROW), **options, levels=now, earlier_levels=[None])) == [("modified", 7, 7)]


def test_a_roof_that_rose_is_found_where_the_ground_is_found_elsewhere() -> None:
    """A storey more hides in heights above ground where the ground is found a storey higher."""
    flat, hill = ground([]), ground([(148, 8, 164, 24, 3.0)])
    raised = [*ROW[:7], (*ROW[7][:4], ROW[7][4] + 3)]
    before, base = levels(ROW, flat)
    after, now = levels(raised, hill, zero=-2.0)
    options = {"heights": after, "earlier": [before]}
    assert kinds(compare(town(ROW), town(raised), **options)) == []
    found = compare(town(ROW), town(raised), **options, levels=now, earlier_levels=[base])
    assert kinds(found) == [("modified", 7, 7)]
    assert found.changes["dh_m"].iloc[7] == pytest.approx(3.0, abs=1e-3)


def test_of_several_earlier_surveys_each_has_its_own_zero() -> None:
    """The latest has levels in the west alone; an older one has the east, from another zero."""
    west = np.zeros(SPEC.shape, dtype=np.bool_)
    west[:, :200] = True
    raised = [(*ROW[0][:4], 12.0), *ROW[1:7], (*ROW[7][:4], 20.0)]
    after, now = levels(raised, ground([]), zero=100.0)
    earlier, known = zip(*(levels(ROW, ground([]), zero=zero) for zero in (7.0, -30.0)), strict=True)
    halves = [
        Grid(np.where(west, np.asarray(grid.values), 0).astype(np.float32), west, SPEC)
        for grid in (earlier[0], known[0])
    ]
    found = compare(
        town(ROW), town(raised), heights=after, levels=now, earlier=[halves[0], earlier[1]],
        earlier_levels=[halves[1], known[1]],
    )  # fmt: skip
    assert kinds(found) == [("modified", 0, 0), ("modified", 7, 7)]
    assert found.changes["dh_m"].iloc[[0, 7]].tolist() == pytest.approx([6.0, 7.0], abs=1e-3)


def test_a_house_whose_height_alone_changed_keeps_its_outline() -> None:
    """The survey draws it half a metre wider, and joins it with its neighbour; neither is a change of its ground."""
    pair: list[House] = [(20, 60, 32, 72, 8), (32, 60, 44, 72, 8)]
    alone: list[House] = [*ROW[:7], (149.5, 9.5, 162.5, 22.5, 20.0)]
    found = compared(ROW, alone)
    assert kinds(found) == [("modified", 7, 7)]
    assert found.versions.geometry.iloc[0].equals(town(ROW).geometry.iloc[7])
    assert found.changes["darea_m2"].iloc[7] == 0
    after = town([*ROW, (20, 60, 44, 72, 8)])
    found = compare(
        town([*ROW, *pair]), after, heights=ground([*ROW, pair[0], (*pair[1][:4], 12)]), earlier=[ground([*ROW, *pair])]
    )
    assert kinds(found) == [("modified", 9, 8)]
    assert found.versions.geometry.iloc[0].equals(town(pair).geometry.iloc[1])


def test_a_footprint_on_ground_of_several_known_houses_is_none_of_its_own() -> None:
    """The survey divides a block otherwise, so that a house lies on parts of four; all of them stay as they are."""
    block: list[House] = [(west, south, west + 20, south + 20, 8) for west in (20.0, 40.0) for south in (60.0, 80.0)]
    middle: House = (35, 75, 45, 85, 8)
    found = compared([*ROW, *block], [*ROW, *block, middle])
    assert kinds(found) == []
    assert found.versions.empty
    assert found.changes["before"].tolist() == [*range(12)]


def test_a_slender_building_that_rises_as_a_whole_is_modified() -> None:
    """No disc fits into it, but most of its cells agree; a part of it that rose is no change."""
    slender: House = (20, 60, 60, 61.5, 6)
    found = compared([*ROW, slender], [*ROW, (*slender[:4], 10)])
    row = found.changes.iloc[8]
    assert (row["kind"], row["height"], row["outline"], row["parts"]) == ("modified", True, False, False)
    part = compare(
        town([*ROW, slender]),
        town([*ROW, slender]),
        heights=ground([*ROW, slender, (20, 60, 42, 61.5, 10)]),
        earlier=[ground([*ROW, slender])],
    )
    assert kinds(part) == []


def test_walls_of_a_slender_building_do_not_hide_that_it_rose() -> None:
    """Cells at its walls that sank say nothing of its roof; those that are as before do."""
    slender: House = (20, 60, 60, 61.5, 10)
    before = ground([*ROW, (*slender[:4], 6), (20, 60, 34, 61.5, 20)])
    rose = compare(town([*ROW, slender]), town([*ROW, slender]), heights=ground([*ROW, slender]), earlier=[before])
    assert kinds(rose) == [("modified", 8, 8)]
    stayed = ground([*ROW, (*slender[:4], 6), (20, 60, 34, 61.5, 10)])
    same = compare(town([*ROW, slender]), town([*ROW, slender]), heights=ground([*ROW, slender]), earlier=[stayed])
    assert kinds(same) == []


def test_a_raised_house_that_the_later_build_misses_is_modified() -> None:
    """It rose alike in all its cells, and keeps its outline; a crown that grew over it rises unlike."""
    house: House = (20, 60, 38, 75, 6)
    now = ground([*ROW, (*house[:4], 10)])
    found = compare(town([*ROW, house]), town(ROW), heights=now, earlier=[ground([*ROW, house])])
    row = found.changes.iloc[8]
    assert (row["kind"], row["after"], row["height"], row["outline"]) == ("modified", -1, True, False)
    assert row["note"] == LEVEL_CHANGE
    assert row["dh_m"] == pytest.approx(4)
    crown = np.asarray(now.values) + np.random.default_rng(1).normal(scale=1.5, size=SPEC.shape).astype(np.float32)
    grown = Grid(np.where(np.asarray(ground([house]).values) > 0, crown, now.values), now.valid, SPEC)
    found = compare(town([*ROW, house]), town(ROW), heights=grown, earlier=[ground([*ROW, house])])
    assert kinds(found) == [("unchanged", 8, -1)]
    assert found.changes["note"].iloc[8] == NO_FOOTPRINT


def test_a_raised_house_that_the_later_build_sees_in_part_is_modified() -> None:
    """Its heights decide; a crown that grew over a missed part of a roof does not count."""
    seen: House = (20, 60, 28, 75, 10)
    house: House = (20, 60, 38, 75, 6)
    raised = compare(
        town([*ROW, house]),
        town([*ROW, seen]),
        heights=ground([*ROW, (*house[:4], 10)]),
        earlier=[ground([*ROW, house])],
    ).changes.iloc[8]
    assert (raised["kind"], raised["height"], raised["outline"], raised["parts"]) == ("modified", True, False, False)
    crown = ground([*ROW, house, (28.5, 60, 38, 75, 10)])
    assert kinds(compare(town([*ROW, house]), town([*ROW, seen]), heights=crown, earlier=[ground([*ROW, house])])) == []


def test_an_outline_of_the_inventory_has_the_heights_of_a_building() -> None:
    """As measured on the whole survey, with all other houses; none outside of it."""
    heights, params = ground(ROW), Params()
    terrain = Elevations(np.full(SPEC.shape, 1234, dtype=np.int32))
    shapes = town(ROW).geometry
    own = measure_heights(
        rasterise(list(shapes), SPEC), len(ROW), heights, terrain, params=params.heights, surface=params.surface
    )
    for row, shape in enumerate(shapes):
        found = measure_roofs(shape, heights, terrain, params)
        assert list(found) == list(HEIGHTS)
        assert found == pytest.approx(own.loc[row, list(HEIGHTS)].to_dict())
        assert (found["z_ground"], found["eaves"]) == (12.34, ROW[row][4])
    assert measure_roofs(translate(shapes[0], 5000), heights, terrain, params) == {}


@pytest.mark.parametrize(
    ("rises", "expected"),
    [((0.2, 0.3, 0.2, 3.1, 3.0), 0.2), ((0.2, 3.0, 3.1, 6.2, -3.0), None), ((0.4,) * 5 + (3.2,) * 6, 3.2)],
)
def test_a_vertical_offset_needs_buildings_that_agree(rises: tuple[float, ...], expected: float | None) -> None:
    """Most of a few, or as many as a shift needs; otherwise it is 0, and a notice reports it."""
    shapes = [box(20 * n, 0, 20 * n + 12, 12) for n in range(len(rises))]
    before = gpd.GeoDataFrame({"h_p90": [6.0] * len(rises)}, geometry=shapes, crs=UTM)
    after = before.assign(h_p90=6.0 + np.array(rises))
    if expected is None:
        with pytest.warns(PassingNotice, match="of 5 buildings that are alike, 2 differ by the same"):
            found = estimate_offset(before, after, least_pairs=5)
        assert (found.dz_m, found.pairs) == (0.0, 5)
    else:
        assert estimate_offset(before, after, least_pairs=5).dz_m == pytest.approx(expected)


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 1.0, 1.5, 2.0, 2.9]), st.integers(3, 60))
def test_bands_with_their_halo_give_what_the_whole_gives(seed: int, reach: float, rows: int) -> None:
    """On random masks of all densities, and on bands of any number of rows."""
    random = np.random.default_rng(seed)
    coarse = random.random((12, 10)) < random.random()
    mask = np.kron(coarse, np.ones((5, 4), dtype=np.bool_)) ^ (random.random((60, 40)) < 0.02 * random.random())
    whole = opened_and_dilated(mask, reach)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(thickness, "BAND_CELLS", rows * mask.shape[1])
        np.testing.assert_array_equal(opened_and_dilated(mask, reach), whole)


def test_a_halo_with_a_row_less_does_not_do(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a disc the top cell is missing, so that no cell beneath it is near a place where the disc fits."""
    reach, rows = 4, np.arange(60)[:, None]
    mask = np.hypot(rows - 20, np.arange(41) - 20) <= reach
    below = 20 + 2 * reach
    mask[below, 20] = True
    assert opened_and_dilated(mask, reach)[below, 20]
    mask[20 - reach, 20] = False
    monkeypatch.setattr(thickness, "BAND_CELLS", below * mask.shape[1])
    assert not opened_and_dilated(mask, reach, 3 * reach).any()
    assert opened_and_dilated(mask, reach, 3 * reach - 1)[below, 20]


def test_heights_are_sampled_in_bands_as_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of several surveys the first valid one counts in each band, too."""
    offset = Offset(0.7, -0.4, 0.0, 0, float("nan"))
    first, other = ground(ROW), ground(ROW, 4.0)
    half = Grid(
        np.where(np.arange(SPEC.shape[1]) < 150, first.values, 0), first.valid & (np.arange(SPEC.shape[1]) < 150), SPEC
    )
    whole = earlier_heights([half, other], SPEC, offset)
    monkeypatch.setattr(thickness, "BAND_CELLS", 7 * SPEC.shape[1])
    found = earlier_heights([half, other], SPEC, offset)
    np.testing.assert_array_equal(found.values, whole.values)
    np.testing.assert_array_equal(found.valid, whole.valid)
    assert 0 < np.count_nonzero(whole.valid) < whole.valid.size


def test_a_house_built_onto_what_a_build_had_missed_is_new_by_itself() -> None:
    """The survey draws both as one; what stood before is unchanged, and the rest is new."""
    stood, built = (20.0, 60.0, 40.0, 75.0, 6.0), (40.0, 60.0, 48.0, 75.0, 6.0)
    whole = (20.0, 60.0, 48.0, 75.0, 6.0)
    found = compare(town(ROW), town([*ROW, whole]), heights=ground([*ROW, whole]), earlier=[ground([*ROW, stood])])
    assert kinds(found) == [("unchanged", -1, 8), ("new", -1, 8)]
    assert found.changes["note"].tolist()[8:] == [STOOD_BEFORE, ""]
    areas = [shape.symmetric_difference(town([house]).geometry.iloc[0]).area for shape, house in
             zip(found.versions.geometry, (stood, built), strict=True)]  # fmt: skip
    assert areas == pytest.approx([0, 0], abs=1e-6)


def current(found: Comparison, before: list[House]) -> list[shapely.Geometry]:
    """Return the outlines of an inventory after a survey: the new ones, and those that stay."""
    gone = found.changes.query("kind in ('demolished', 'merged')")["before"]
    stay = town(before).geometry.drop(index={n for n in [*found.versions["before"], *gone] if n >= 0})
    return [*found.versions.geometry, *stay]


def overlap_m2(found: Comparison, before: list[House]) -> float:
    """Return the largest area that two buildings share after a survey: new outlines, and those that stay."""
    return max(one.intersection(other).area for one, other in itertools.combinations(current(found, before), 2))


def test_a_new_house_takes_no_ground_of_a_known_one() -> None:
    """The survey draws it 3 m into the house beside it, whose outline stays; and one that was lifted keeps its own."""
    house, drawn, beside = (20.0, 60.0, 40.0, 75.0, 8.0), (20.0, 60.0, 37.0, 75.0, 8.0), (37.0, 60.0, 60.0, 75.0, 8.0)
    before = [*ROW, house]
    found = compared(before, [*ROW, drawn, beside])
    assert kinds(found) == [("new", -1, 9)]
    assert found.versions.geometry.area.tolist() == pytest.approx([20 * 15], abs=2)
    assert found.changes["darea_m2"].iloc[-1] == pytest.approx(20 * 15, abs=2)
    assert not found.versions["adopted"].any()
    found = compared(before, [*ROW, (*drawn[:4], 14.0), (*beside[:4], 14.0)])
    assert kinds(found) == [("modified", 8, 8), ("new", -1, 9)]
    assert overlap_m2(found, before) < 1
    assert found.versions.geometry.area.tolist() == pytest.approx([20 * 15, 20 * 15], abs=2)


@settings(max_examples=40, deadline=None)
@given(RANDOM_TOWN, RANDOM_TOWN, st.sampled_from([0.0, 2.0, 4.0]))
def test_no_ground_has_two_owners(one: list[Steps], other: list[Steps], east_m: float) -> None:
    """Houses on random places of two epochs, of which the later ones stand a little farther east."""
    before, after = [*ROW, *random_houses(one)], [*ROW, *random_houses(other, east_m)]
    assert overlap_m2(compared(before, after), before) < 1


def test_what_stands_of_a_known_house_is_taken_from_the_new_one_drawn_with_it() -> None:
    """New houses are drawn over both ends of a house; one end is too thin to stand by itself."""
    before = [*ROW, (58.0, 80.0, 76.0, 92.0, 9.0)]
    found = compared(before, [*ROW, (72.0, 80.0, 96.0, 92.0, 9.0), (42.0, 80.0, 60.0, 92.0, 9.0)])
    assert kinds(found) == [("modified", 8, -1), ("new", -1, 8), ("new", -1, 9)]
    assert found.changes["note"].iloc[8] == PART_GONE
    assert overlap_m2(found, before) < 1
    assert found.versions.geometry.area.tolist() == pytest.approx([4 * 12, 20 * 12, 18 * 12], abs=2)


def test_houses_on_the_ground_of_one_that_was_pulled_down_are_new() -> None:
    """A hall gives way to two houses of another height, and one that stands is extended onto its ground."""
    hall, beside = (20.0, 60.0, 60.0, 80.0, 6.0), (60.0, 60.0, 72.0, 80.0, 6.0)
    two: list[House] = [(22.0, 62.0, 30.0, 70.0, 9.0), (36.0, 66.0, 42.0, 76.0, 9.0)]
    found = compared([*ROW, hall, beside], [*ROW, *two, beside])
    assert kinds(found) == [("demolished", 8, -1), ("new", -1, 8), ("new", -1, 9)]
    assert found.versions.geometry.area.tolist() == pytest.approx([64, 60])
    found = compared([*ROW, hall, beside], [*ROW, two[0], (56.0, 60.0, 72.0, 80.0, 6.0)])
    assert kinds(found) == [("demolished", 8, -1), ("modified", 9, 9), ("new", -1, 8)]
    assert sorted(found.versions.geometry.area) == pytest.approx([64, 16 * 20])


def test_what_stands_of_a_house_that_is_gone_is_not_called_new() -> None:
    """A fifth of a hall is left as it was: a building of its own that existed before."""
    found = compared([*ROW, (20.0, 60.0, 70.0, 80.0, 6.0)], [*ROW, (20.0, 60.0, 30.0, 80.0, 6.0)])
    assert kinds(found) == [("demolished", 8, -1), ("unchanged", -1, 8)]
    assert found.changes["note"].iloc[-1] == STOOD_BEFORE
    assert found.versions.geometry.area.tolist() == pytest.approx([200])


def test_a_split_building_loses_no_footprint_that_lies_off_the_gap() -> None:
    """The survey draws what is left as three houses, one of which touches no ground that is gone."""
    house = (20.0, 60.0, 80.0, 75.0, 8.0)
    left: list[House] = [(20.0, 60.0, 35.0, 75.0, 8.0), (45.0, 60.0, 60.0, 75.0, 8.0), (60.0, 60.0, 80.0, 75.0, 8.0)]
    found = compared([*ROW, house], [*ROW, *left])
    assert sorted(found.versions.geometry.area) == pytest.approx([225, 225, 300])
    assert {kind for kind, _, _ in kinds(found)} == {"split"}


def test_a_building_that_the_survey_missed_loses_what_is_gone() -> None:
    """Half of a house is gone, and the rest is not distinguished; it rose, or did not."""
    house = (20.0, 60.0, 50.0, 75.0, 8.0)
    for height in (8.0, 12.0):
        after = [*ROW, (20.0, 60.0, 35.0, 75.0, height)]
        found = compare(town([*ROW, house]), town(ROW), heights=ground(after), earlier=[ground([*ROW, house])])
        assert kinds(found) == [("modified", 8, -1)]
        assert found.changes["note"].iloc[-1] == PART_GONE
        assert found.versions.geometry.area.tolist() == pytest.approx([225])


@settings(max_examples=40, deadline=None)
@given(RANDOM_TOWN, RANDOM_TOWN, st.sampled_from([0.0, 2.0, 4.0]))
def test_no_house_of_the_survey_is_lost(one: list[Steps], other: list[Steps], east_m: float) -> None:
    """Half of each lies in buildings of the inventory after the survey."""
    before, after = [*ROW, *random_houses(one)], [*ROW, *random_houses(other, east_m)]
    now = shapely.union_all(current(compared(before, after), before))
    for shape in town(after).geometry:
        assert shape.intersection(now).area >= shape.area / 2


@settings(max_examples=40, deadline=None)
@given(RANDOM_TOWN, RANDOM_TOWN, st.sampled_from([0.0, 2.0, 4.0]))
def test_no_building_stays_where_nothing_stands(one: list[Steps], other: list[Steps], east_m: float) -> None:
    """A quarter of each that the inventory has after the survey is built on."""
    before, after = [*ROW, *random_houses(one)], [*ROW, *random_houses(other, east_m)]
    built = shapely.union_all(town(after).geometry.to_numpy())
    for shape in current(compared(before, after), before):
        assert shape.intersection(built).area >= shape.area / 4


def test_a_split_building_takes_no_ground_of_its_neighbour() -> None:
    """The survey joins one of the parts with the neighbour, whose outline stays."""
    house, neighbour = (20.0, 60.0, 60.0, 75.0, 8.0), (60.0, 60.0, 80.0, 75.0, 8.0)
    west, east = (20.0, 60.0, 32.0, 75.0, 8.0), (44.0, 60.0, 80.0, 75.0, 8.0)
    before, after = [*ROW, house, neighbour], [*ROW, west, east]
    found = compared(before, after)
    assert sorted(kinds(found)) == [("split", 8, 8), ("split", 8, 9)]
    assert overlap_m2(found, before) < 1
    assert sorted(found.versions.geometry.area) == pytest.approx([12 * 15, 16 * 15])


def test_what_the_survey_draws_as_a_house_by_itself_is_no_part_of_its_neighbour() -> None:
    """An annexe and a house behind it are one piece of what was built; the building grows by the annexe alone."""
    house, neighbour = (20.0, 60.0, 40.0, 75.0, 8.0), (5.0, 60.0, 20.0, 75.0, 8.0)
    joined, behind = (5.0, 60.0, 46.0, 75.0, 8.0), (46.0, 60.0, 56.0, 75.0, 8.0)
    before = [*ROW, house, neighbour]
    found = compared(before, [*ROW, joined, behind])
    assert kinds(found) == [("modified", 8, 8), ("new", -1, 9)]
    assert overlap_m2(found, before) < 1
    assert sorted(found.versions.geometry.area) == pytest.approx([10 * 15, 26 * 15])
    found = compared(before, [*ROW, (5.0, 60.0, 41.0, 75.0, 8.0), (41.0, 60.0, 56.0, 75.0, 8.0)])
    assert kinds(found) == [("new", -1, 9)]


def test_ground_that_the_survey_divides_otherwise_is_built_onto_a_known_building() -> None:
    """A strip along three houses and an annexe is no building; the annexe keeps its part of the strip."""
    row: list[House] = [(20.0 + 10 * n, 60.0, 30.0 + 10 * n, 75.0, 8.0) for n in range(3)]
    joined, strip = (20.0, 60.0, 56.0, 75.0, 8.0), (20.0, 60.0, 56.0, 63.0, 8.0)
    found = compared([*ROW, *row], [*ROW, joined, strip])
    assert kinds(found) == [("modified", 10, 8)]
    assert found.versions.geometry.area.tolist() == pytest.approx([16 * 15])

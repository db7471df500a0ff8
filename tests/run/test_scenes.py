"""Every simulated scene from the point file to the database: what comes out of it, and what does not.

The known limits are asserted as they are, so that a change of them shows; docs/limits.md tells users of them.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import pytest
import shapely
from numpy.typing import NDArray
from simulated import scenes
from simulated.files import write_points
from support.sizes import sample

import msbdb
from msbdb.outline.polygons import rasterise
from msbdb.params import Params, profile, with_values

BOTH = sample(["default", "vu2009"], 2)
"""The profiles of a scene on which both must do the same; the paper's belongs to the long size."""


@dataclass(frozen=True)
class Outcome:
    """A scene, and the database that was built from it."""

    scene: scenes.Scene
    report: msbdb.BuildReport
    buildings: gpd.GeoDataFrame
    parts: gpd.GeoDataFrame
    rejections: pd.DataFrame  # counted, of the multi-scale extraction

    @property
    def footprints(self) -> NDArray[np.int32]:
        """The footprints on the lattice of the truth: row number + 1 in ``buildings``."""
        return rasterise(self.buildings.geometry, self.scene.spec)

    def overlap(self, number: int) -> float:
        """IoU of a true building with the footprint that covers most of it."""
        true = self.scene.buildings == number
        found = np.bincount(self.footprints[true])
        found[0] = 0
        footprint = self.footprints == found.argmax() if found.any() else np.zeros_like(true)
        return float((true & footprint).sum() / (true | footprint).sum())

    def building(self, number: int) -> pd.Series:
        """Return the building that covers most of a true one."""
        found = np.bincount(self.footprints[self.scene.buildings == number])
        found[0] = 0
        assert found.any(), f"building {number} of {self.scene.name} is missing"
        return self.buildings.iloc[int(found.argmax()) - 1]

    def part(self, fact: scenes.Fact) -> pd.Series:
        """Return the part of a known building that is most like a fact in area and storeys of its zone."""
        family = self.parts[self.parts["building_id"] == self.building(fact.building)["building_id"]]
        alike = family[family["hzone"] == 1 + np.floor((fact.height_m - 2) / 3)]
        assert len(alike), f"no part of {self.scene.name} has the storeys of {fact.name}"
        return alike.loc[(alike["area_m2"] - fact.area_m2).abs().idxmin()]

    def lost(self, stage: str) -> float:
        """Area that a stage sent to the ledger, square metres."""
        return float(self.rejections.loc[self.rejections["stage"] == stage, "area_m2"].sum())


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Build a scene once for each profile, parameters and options of the scene."""
    folder = tmp_path_factory.mktemp("scenes")

    def build(name: str, profile_name: str = "default", params: Params | None = None, **options: Any) -> Outcome:
        return build_once(name, profile_name, params, **options)

    @cache
    def build_once(name: str, profile_name: str, params: Params | None, **options: Any) -> Outcome:
        scene = scenes.SCENES[name](**options)
        stem = f"{name}_{profile_name}_{len(list(folder.iterdir()))}"
        points = write_points(folder / f"{stem}.laz", scene.points)
        db = folder / f"{stem}.sqlite"
        report = msbdb.build([points], db=db, survey=name, profile=profile_name, params=params)
        with msbdb.open(db) as opened:
            lost = opened.rejection_counts()
            own = lost[lost["method"] == "multiscale"]
            return Outcome(scene, report, opened.buildings(), opened.parts(), own)

    return build


def holes(building: pd.Series) -> list[float]:
    """Areas of the holes of a footprint."""
    return [shapely.Polygon(ring).area for part in shapely.get_parts(building.geometry) for ring in part.interiors]


@pytest.mark.parametrize("profile_name", BOTH)
def test_a_field_holds_nothing(built, profile_name):
    """No buildings, no parts and nothing rejected on a sloping meadow with a track."""
    field = built("flat_field", profile_name)
    assert (field.report.buildings, field.report.parts, field.report.rejected) == (0, 0, 0)
    assert len(field.buildings) == len(field.parts) == len(field.rejections) == 0


@pytest.mark.parametrize(
    ("name", "profile_name", "least"),
    [
        ("podium_tower", "default", 0.98),
        ("podium_tower", "vu2009", 0.98),
        ("courtyard", "default", 0.98),
        ("under_trees", "default", 0.88),
        pytest.param("under_trees", "vu2009", 0.88, marks=pytest.mark.long),
        ("wall", "default", 0.98),
        pytest.param("wall", "vu2009", 0.98, marks=pytest.mark.long),
        ("green_roof", "default", 0.98),
        pytest.param("green_roof", "vu2009", 0.98, marks=pytest.mark.long),
        ("elevated_road", "default", 0.98),
        ("large_building", "default", 0.98),
        pytest.param("large_building", "vu2009", 0.98, marks=pytest.mark.long),
    ],
)
def test_footprints_storeys_and_heights_are_the_true_ones(built, name, profile_name, least):
    """Each true building has one footprint that overlaps it by the share given, with its storeys and heights.

    Its storeys are those of most of its roof. What is smaller than 50 m2 does not count for the highest ones.
    """
    outcome = built(name, profile_name)
    for root in (fact for fact in outcome.scene.forest if fact.father is None):
        building = outcome.building(root.building)
        own = [fact for fact in outcome.scene.forest if fact.building == root.building and fact.area_m2 >= 50]
        tallest = max([root.height_m, *(fact.height_m for fact in own)])
        assert outcome.overlap(root.building) >= least
        assert building["area_m2"] == pytest.approx(root.area_m2, rel=0.08)
        assert building["storeys"] == 1 + (root.height_m - 2) // 3
        assert building["storeys_min"] <= building["storeys"] <= building["storeys_max"]
        assert building["storeys_top"] == 1 + (tallest - 2) // 3
        assert building["eaves"] == pytest.approx(root.height_m, abs=0.2)
        ground = float(outcome.scene.ground(building["xcen"], building["ycen"]))
        assert building["z_ground"] == pytest.approx(ground, abs=0.25)
        assert building["z_ridge"] - building["z_ground"] == pytest.approx(building["ridge"], abs=0.01)
        assert building["ridge"] <= building["h_max"] + 0.01
        assert building["h_p50"] == pytest.approx(root.height_m, abs=0.15)
        assert building["state"] == "confirmed"


@pytest.mark.long
@pytest.mark.parametrize("density", [1.0, 1.5, 2.0])
def test_a_tower_stands_on_its_podium_at_few_points(built, density):
    """The tower is cut beside its plant room there, and both halves stand on the podium."""
    assert built("podium_tower", density=density).report.buildings == 1


def test_a_tower_on_a_podium_is_a_tree_of_three_levels(built):
    """Plant room, tower and podium are parts of one building, each the child of the one below."""
    outcome = built("podium_tower")
    assert outcome.report.buildings == 1
    assert outcome.report.parts == 3
    podium, tower, plant = (outcome.part(fact) for fact in outcome.scene.forest)
    assert (podium["supid"], tower["supid"], plant["supid"]) == (0, podium["part_id"], tower["part_id"])
    assert podium["scale"] < tower["scale"] < plant["scale"]
    for part, fact in zip((podium, tower, plant), outcome.scene.forest, strict=True):
        assert part["area_m2"] == pytest.approx(fact.area_m2, rel=0.03)
    assert outcome.buildings["h_max"].iloc[0] == pytest.approx(36.5, abs=0.2)
    volume = 1200 * 6.5 + 300 * 24 + 36 * 6
    assert outcome.buildings["volume_m3"].iloc[0] == pytest.approx(volume, rel=0.02)


def test_the_paper_sees_no_part_below_its_finest_scale(built):
    """The plant room of 36 m2 is no part at the paper's scales of 50 m2 and up; the tower is one."""
    outcome = built("podium_tower", "vu2009")
    assert outcome.report.parts == 2
    podium, tower = (outcome.part(fact) for fact in outcome.scene.forest[:2])
    assert tower["supid"] == podium["part_id"]


def test_a_courtyard_stays_open(built):
    """The footprint of a perimeter block has its yard as a hole."""
    outcome = built("courtyard")
    assert outcome.report.buildings == 1
    assert holes(outcome.buildings.iloc[0]) == pytest.approx([256], rel=0.03)


def test_the_paper_closes_a_courtyard(built):
    """Known limit of the method as written: a closing with 1000 m2 makes roof of a yard of 256 m2."""
    outcome = built("courtyard", "vu2009")
    assert outcome.buildings["area_m2"].tolist() == pytest.approx([1600], rel=0.02)
    assert holes(outcome.buildings.iloc[0]) == []


@pytest.mark.parametrize("profile_name", BOTH)
def test_gaps_of_one_cell_merge_neighbours(built, profile_name):
    """Known limit (V51): houses one pulse apart share roots, but all are found, and the road keeps rows apart."""
    outcome = built("row_houses", profile_name)
    assert 2 <= outcome.report.buildings < 12
    covered = (outcome.footprints > 0) & (outcome.scene.buildings > 0)
    assert covered.sum() >= 0.98 * (outcome.scene.buildings > 0).sum()
    for number in range(1, outcome.report.buildings + 1):
        inside = outcome.scene.buildings[outcome.footprints == number]
        rows = {int(house - 1) // 6 for house in np.unique(inside[inside > 0])}
        assert len(rows) == 1
    assert (outcome.buildings["storeys"] == 2).all()


def test_gaps_of_three_cells_part_neighbours(built):
    """Houses three pulses apart are buildings of their own.

    Outlines are compared themselves: fitted walls may lie half a cell outside, and on cells this would count as one.
    """
    outcome = built("row_houses", gap_m=1.5)
    assert outcome.report.buildings == 12
    east, north = outcome.scene.world.origin
    for block in outcome.scene.world.blocks:
        west, south = east + block.west, north + block.south
        true = shapely.box(west, south, west + block.width, south + block.depth)
        found = outcome.building(block.building).geometry
        assert found.intersection(true).area / found.union(true).area > 0.95


@pytest.mark.parametrize(("profile_name", "stage"), [("default", "vegetation mask"), ("vu2009", "vegetation")])
def test_trees_are_cut_off_a_house_and_are_none(built, profile_name, stage):
    """A house under and beside crowns is the only building; grove and crowns are in the ledger as vegetation.

    By structure they are masked before the scale-space; by colour, as in the paper, cut from the clusters (V37).
    """
    outcome = built("under_trees", profile_name)
    assert outcome.report.buildings == 1
    crowns = (outcome.scene.cover == scenes.VEGETATION).sum() * outcome.scene.spec.cell_area_m2
    assert outcome.lost(stage) == pytest.approx(crowns, rel=0.15)
    refused = outcome.rejections["stage"] == "fusion"
    assert set(outcome.rejections.loc[~refused, "stage"]) == {stage}
    # Where the detectors decide together, the grove is an object that they refuse.
    assert refused.any() == (profile_name == "default")
    assert set(outcome.rejections.loc[refused, "reason"]) <= {"refuted"}


@pytest.mark.parametrize(("profile_name", "least"), sample([("default", 0.8), ("vu2009", 0.8)], 2))
def test_a_building_in_a_slope_is_one_building(built, profile_name, least):
    """A roof that nearly meets the bank behind it has one root, of what stands above the mask.

    Known limit: of its 480 m2 only the 396 m2 that stand 2 m above the bank can be found, and the bank is guessed
    beneath the roof from the ground around.
    """
    outcome = built("attached_to_slope", profile_name)
    standing = outcome.scene.heights >= 2
    found = outcome.footprints > 0
    assert outcome.report.buildings == 1
    assert (found & standing).sum() / (found | standing).sum() > least
    assert not (found & (outcome.scene.buildings == 0)).any()
    assert outcome.buildings["storeys"].iloc[0] == 2


def test_a_steep_earthwork_passes_for_a_building(built):
    """Known limit: banks of 5 m over 2 m are walls to the ground filter, and the plateau is the root of its house.

    The house is still found as a child of it, and the house below is right.
    """
    outcome = built("plateau")
    upper, lower = (outcome.building(number) for number in (1, 2))
    assert outcome.report.buildings == 2
    assert outcome.overlap(2) > 0.95
    assert upper["area_m2"] > 1900
    child = outcome.parts[outcome.parts["supid"] == upper["building_id"]]
    assert child["area_m2"].tolist() == pytest.approx([168], rel=0.05)
    assert lower["storeys"] == 2


@pytest.mark.parametrize("profile_name", BOTH)
def test_an_earthwork_with_common_banks_is_ground(built, profile_name):
    """Banks of 1 in 1.5, as dykes and dams have them, are told from walls; both houses are right."""
    outcome = built("plateau", profile_name, bank_m=7.5)
    assert outcome.report.buildings == 2
    assert min(outcome.overlap(number) for number in (1, 2)) > 0.95
    assert outcome.buildings["storeys"].tolist() == [2, 2]


def test_ground_classes_settle_the_earthwork(built):
    """With class 2 in the file the plateau is ground, and both houses are right."""
    outcome = built("plateau", classified=True)
    assert outcome.report.buildings == 2
    assert min(outcome.overlap(number) for number in (1, 2)) > 0.95
    assert outcome.buildings["storeys"].tolist() == [2, 2]
    assert outcome.buildings["h_p50"].tolist() == pytest.approx([6.5, 6.5], abs=0.15)


@pytest.mark.parametrize(
    ("profile_name", "stage", "reason"),
    [
        ("default", "vegetation mask", "vegetation, or supported by too few detectors"),
        ("vu2009", "opening", "smaller than the finest scale"),
    ],
)
def test_a_free_wall_is_rejected_with_its_reason(built, profile_name, stage, reason):
    """A wall of 40 m2 is in the ledger, and the house is the only building.

    For the default it is too thin for a roof; for the paper, which does not speak of walls, it is below 50 m2. Single
    cells that stand out from the house's edge are lost with it, 4 m2 in all.
    """
    outcome = built("wall", profile_name)
    assert outcome.report.buildings == 1
    assert outcome.lost(stage) == pytest.approx(40, abs=5)
    assert set(outcome.rejections["reason"]) == {reason}


@pytest.mark.parametrize("profile_name", BOTH)
def test_an_elevated_road_passes_for_a_building(built, profile_name):
    """Known limit (V51): a deck of 100 m by 12 m is a building, apart from the two houses."""
    outcome = built("elevated_road", profile_name)
    assert outcome.report.buildings == 3
    deck = outcome.scene.cover == scenes.BRIDGE
    false = outcome.footprints[deck]
    assert np.unique(false[false > 0]).size == 1
    assert (false > 0).mean() > 0.98


def test_a_lawn_on_a_roof_stays_roof(built):
    """A green roof is whole, though its colour is that of grass; the tree apart is in the ledger."""
    outcome = built("green_roof")
    assert outcome.report.buildings == 1
    assert holes(outcome.buildings.iloc[0]) == []
    tree = np.pi * 4.0**2
    assert outcome.lost("vegetation mask") == pytest.approx(tree, rel=0.15)


def test_a_large_hall_is_one_building_with_an_office_on_it(built):
    """A hall of 5400 m2 is one root; what stands on it are its children, of the office's area and storeys."""
    outcome = built("large_building")
    assert outcome.report.buildings == 1
    office = outcome.parts[outcome.parts["supid"] == outcome.buildings["building_id"].iloc[0]]
    assert office["area_m2"].sum() == pytest.approx(400, rel=0.04)
    assert (office["hzone"] == 6).all()


@pytest.mark.long
def test_more_classes_than_materials_split_a_roof(built):
    """Known limit of V44: classes beyond the two materials differ by noise, and split the office."""
    split = with_values(profile(), {"spectral": {"split_share": 0.2, "classes": 4}})
    assert len(built("large_building", params=split).parts) > 2
    assert len(built("large_building").parts) == 2


@pytest.mark.long
def test_the_city_is_found_whole(built):
    """Of a quarter with all kinds, every building is found; only the deck is none, and no tree or wall is one."""
    outcome = built("city")
    found, true = outcome.footprints > 0, outcome.scene.buildings > 0
    deck = outcome.scene.cover == scenes.BRIDGE
    assert (found & true).sum() / ((found | true) & ~deck).sum() > 0.94
    apart = [1, 2, 3, *range(12, 20)]
    assert min(outcome.overlap(number) for number in apart) > 0.9
    pairs = [{outcome.building(4 + n)["building_id"], outcome.building(5 + n)["building_id"]} for n in range(0, 8, 2)]
    assert [len(pair) for pair in pairs] == [1] * 4
    assert len(set.union(*pairs)) == 4
    assert outcome.report.buildings == len(apart) + 4 + 1
    tower, ring = outcome.building(1), outcome.building(2)
    assert (tower["storeys_top"], ring["storeys"]) == (10, 4)
    assert max(holes(ring)) == pytest.approx(14 * 14, rel=0.05)
    walls_and_crowns = np.isin(outcome.scene.cover, [scenes.VEGETATION, scenes.OTHER]) & ~true
    assert outcome.lost("vegetation mask") == pytest.approx(
        walls_and_crowns.sum() * outcome.scene.spec.cell_area_m2, rel=0.15
    )


@pytest.mark.long
def test_the_city_in_the_paper_s_profile(built):
    """At 1 m and the paper's scales the large buildings are found as well; the deck is one too."""
    outcome = built("city", "vu2009")
    assert min(outcome.overlap(number) for number in (1, 3)) > 0.95
    assert outcome.overlap(2) == pytest.approx(1028 / (36 * 34), abs=0.03)
    assert (outcome.footprints[outcome.scene.cover == scenes.BRIDGE] > 0).mean() > 0.9

"""Flat regions in whole builds: their tables, links and evidence, their figures, and what they leave alone."""

import shutil

import numpy as np
import pytest
from pyproj import CRS
from simulated.files import write_points
from simulated.scenes import SCENES

import msbdb
from msbdb.database import read_tables
from msbdb.detect.flatregions.mongus2013 import detect_flat_regions
from msbdb.errors import InputError, ParameterError
from msbdb.params import profile, with_values
from msbdb.points.cloud import PointCloud
from msbdb.run.inputs import Inputs
from msbdb.run.preparation.pointfacts import sparse_with_facts
from msbdb.run.preparation.prepare import Label, prepare
from msbdb.run.reports import Stages
from msbdb.tables import EXTRACTOR_SHARES, PART_FLAT_REGION

MULTISCALE = ("multiscale",)


@pytest.fixture(scope="module")
def points(tmp_path_factory):
    """Write a house, a grove and crowns over the house's roof."""
    return write_points(tmp_path_factory.mktemp("points") / "town.laz", SCENES["under_trees"]().points)


@pytest.fixture(scope="module")
def town(points, tmp_path_factory):
    """Build them with both extractors."""
    db = tmp_path_factory.mktemp("town") / "town.sqlite"
    return db, msbdb.build([points], db=db)


def test_flat_regions_confirm_the_house_and_no_crown(town):
    """The house is flat, the crowns are not; regions, links and the building's share agree."""
    db, report = town
    with msbdb.open(db) as opened:
        regions, buildings = opened.flat_regions(), opened.buildings()
        links = read_tables(opened.engine, [PART_FLAT_REGION])["part_flat_region"]
        parts = opened.parts().set_index("part_id")
    assert report.flat_regions == len(regions) == 1
    house = buildings.iloc[0]
    assert house["flat_share"] > 0.8
    assert house["state"] == "confirmed"
    root = links[links["part_id"] == house["building_id"]]
    assert root["part_share"].sum() == pytest.approx(house["flat_share"])
    overlap = regions.union_all().intersection(house.geometry).area
    assert overlap == pytest.approx(root["overlap_m2"].sum(), rel=0.05)
    assert set(links["part_id"]) <= set(parts.index)
    assert regions["h_p50"].between(2, 30).all()


def test_detectors_do_not_change_each_other(points, town, tmp_path):
    """Regions are the same whichever others are run; where cells are not fused, so are the parts."""
    alone, both = tmp_path / "alone.sqlite", tmp_path / "both.sqlite"
    single = with_values(profile(), {"fuse": {"votes": False}})
    msbdb.build([points], db=alone, extract=MULTISCALE, params=single)
    msbdb.build([points], db=both, extract=["flatregions", "multiscale"], params=single)
    shares = list(EXTRACTOR_SHARES.values())
    with msbdb.open(alone) as one, msbdb.open(both) as two, msbdb.open(town[0]) as four:
        assert one.parts().equals(two.parts())
        assert one.buildings()[shares].isna().all(axis=None)
        assert one.buildings().drop(columns=shares).equals(two.buildings().drop(columns=shares))
        assert len(one.flat_regions()) == 0
        assert two.flat_regions().equals(four.flat_regions())
        assert one.runs()["methods"].tolist() == ["multiscale"]
        assert four.runs()["methods"].tolist() == ["adaptive, area3d, flatregions, multiscale"]


def test_flat_regions_alone_make_no_building(points, tmp_path):
    """Without the multi-scale extraction there are flat regions, and nothing that they could be evidence of."""
    report = msbdb.build([points], db=tmp_path / "flat.sqlite", extract=["flatregions"])
    assert (report.buildings, report.parts, report.flat_regions) == (0, 0, 1)


@pytest.mark.long
def test_other_extractors_replace_the_run(points, town, tmp_path):
    """A survey has one run: building it again with one extractor less leaves what a first such build leaves."""
    again = shutil.copy(town[0], tmp_path / "again.sqlite")
    assert msbdb.build([points], db=again, extract=MULTISCALE, replace=True).changed
    msbdb.build([points], db=tmp_path / "fresh.sqlite", extract=MULTISCALE)
    with msbdb.open(again) as one, msbdb.open(tmp_path / "fresh.sqlite") as other:
        assert one.dump() == other.dump()


@pytest.mark.long
def test_labels_by_the_operator_keep_the_flat_regions(town, tmp_path):
    """A class labelled anew and back gives what its label alone gives, flat regions, links and ledger included.

    An operator's label counts more than the detectors at the edge of a roof, so single cells differ from the build's.
    """
    db, straight = (shutil.copy(town[0], tmp_path / name) for name in ("labelled.sqlite", "straight.sqlite"))
    with msbdb.open(db) as opened:
        built, regions, classes = opened.buildings(), opened.flat_regions(), opened.classes()
        roofs = classes.loc[classes["label"] == "building", "speindex"].tolist()
    msbdb.relabel(db, dict.fromkeys(roofs, "vegetation"))
    with msbdb.open(db) as opened:
        assert opened.flat_regions().equals(regions)
        assert len(opened.buildings()) == 0
        assert len(read_tables(opened.engine, [PART_FLAT_REGION])["part_flat_region"]) == 0
    msbdb.relabel(db, dict.fromkeys(roofs, "building"))
    msbdb.relabel(straight, dict.fromkeys(roofs, "building"))
    with msbdb.open(db) as one, msbdb.open(straight) as other:
        assert one.dump() == other.dump()
        labelled = one.buildings()
        assert (one.classes().set_index("speindex").loc[roofs, "labelled_by"] == "operator").all()
    assert labelled["building_id"].tolist() == built["building_id"].tolist()
    assert labelled["area_m2"].tolist() == pytest.approx(built["area_m2"].tolist(), rel=0.01)


@pytest.mark.long
def test_shuffled_points_give_the_same_flat_regions(town, tmp_path):
    """The order of the points does not matter."""
    cloud = SCENES["under_trees"]().points
    mixed = cloud.take(np.random.default_rng(5).permutation(len(cloud)))
    write_points(tmp_path / "mixed.laz", mixed)
    msbdb.build([tmp_path / "mixed.laz"], db=tmp_path / "mixed.sqlite", survey="town")
    with msbdb.open(tmp_path / "mixed.sqlite") as one, msbdb.open(town[0]) as other:
        assert one.dump() == other.dump()


@pytest.mark.long
def test_figures_of_zones_and_of_denoising_are_drawn(points, town, tmp_path):
    """Both are PNG; the map of a survey without flat regions is drawn, too."""
    with msbdb.open(town[0]) as opened:
        opened.view(tmp_path / "zones.png", what="flatregions")
    msbdb.build([points], db=tmp_path / "a.sqlite", denoising_figure=tmp_path / "denoising.png")
    msbdb.build([points], db=tmp_path / "b.sqlite", extract=MULTISCALE)
    with msbdb.open(tmp_path / "b.sqlite") as opened:
        opened.view(tmp_path / "none.png", what="flatregions")
    for name in ("zones", "denoising", "none"):
        assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")


def test_flat_regions_are_evaluated_on_their_own(town, tmp_path):
    """Against the buildings themselves, the flat regions score the share that they cover."""
    db, _ = town
    with msbdb.open(db) as opened:
        buildings = opened.buildings()
        buildings[["geometry"]].to_file(tmp_path / "truth.gpkg")
        score = opened.evaluate(tmp_path / "truth.gpkg", of="flatregions")
        parts = opened.evaluate(tmp_path / "truth.gpkg", of="parts")
        with pytest.raises(InputError, match="'roofs' cannot be evaluated"):
            opened.evaluate(tmp_path / "truth.gpkg", of="roofs")
    assert score.area.rates.completeness == pytest.approx(buildings["flat_share"].iloc[0], abs=0.05)
    assert parts.area.rates.quality > 0.99


def test_gaps_are_filled_as_the_profile_says(tmp_path):
    """A gap of 6 m in a roof is part of its region where all cells are interpolated, as in mongus2013 (M8)."""
    rng = np.random.default_rng(2)
    x, y = rng.uniform(0, 50, (2, 10_000))
    roof = (np.abs(x - 25) < 10) & (np.abs(y - 25) < 10)
    gap = (np.abs(x - 25) < 3) & (np.abs(y - 25) < 3)
    z = np.where(roof, 6.0, 0.0) + rng.normal(0, 0.01, x.size)
    points = PointCloud(x[~gap] + 389_000, y[~gap] + 5_821_000, z[~gap], CRS.from_epsg(32633))
    inputs = Inputs((write_points(tmp_path / "roof.laz", points),))
    areas = {}
    for gaps in ("near", "all"):
        params = with_values(profile(), {"flatregions": {"gaps": gaps}})
        scene, params, _ = prepare(inputs, sparse_with_facts(points, params), params, Stages(None), Label("roof"))
        areas[gaps] = detect_flat_regions(scene, params).table["area_m2"].tolist()
    assert [len(found) for found in areas.values()] == [1, 1]
    assert areas["all"][0] == pytest.approx(400, rel=0.06)
    assert areas["all"][0] - areas["near"][0] == pytest.approx(16, abs=8), (
        "6 m less the 1 m that is filled to each side"
    )
    assert profile("mongus2013").flatregions.gaps == "all"


def test_the_papers_profile_says_where_it_cannot_separate_the_ground(points, tmp_path):
    """On half a hectare the smooth ground is below λ_max of a town: it is one flat region, and the build says so."""
    params = profile("mongus2013")
    assert params.flatregions.on == "surface"
    report = msbdb.build([points], db=tmp_path / "paper.sqlite", params=params, profile="mongus2013")
    assert any("of the survey: on the raw surface, the ground is a flat region" in notice for notice in report.notices)


@pytest.mark.parametrize(
    "values",
    [{"lambda_min_m2": 500.0, "lambda_max_m2": 100.0}, {"lambda_step_m2": 0.0}],
)
def test_zones_that_make_no_sense_are_refused(points, tmp_path, values):
    """The message says what holds for λ, and nothing is written."""
    params = with_values(profile(), {"flatregions": values})
    with pytest.raises(ParameterError, match="0 < λ_min ≤ λ_max and a step λ_Δ above 0"):
        msbdb.build([points], db=tmp_path / "none.sqlite", params=params)
    assert not (tmp_path / "none.sqlite").exists()


def test_an_unknown_detector_is_refused_before_anything_is_read(tmp_path):
    """The message lists the detectors."""
    with pytest.raises(ParameterError, match="adaptive, area3d, flatregions, multiscale; got windows"):
        msbdb.build([tmp_path / "nothing.laz"], db=tmp_path / "none.sqlite", extract=["windows"])

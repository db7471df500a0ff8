"""Pictures over rasters of heights: what they do to the buildings, and what a plan keeps of their classes."""

from dataclasses import replace

import numpy as np
import pytest
import rasterio
from support.tiledtown import town, write_rasters

import msbdb
from msbdb.spectral.model import ClassModel
from msbdb.surveyplan import Plan


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Return DSM, DTM and orthophoto of a town by role."""
    return write_rasters(tmp_path_factory.mktemp("town"))


def in_grey(ortho, path):
    """Write a picture again without any hue."""
    with rasterio.open(ortho) as source:
        values, profile = source.read(), source.profile
        names = source.descriptions
    values[:3] = values[:3].mean(axis=0)
    profile.update(count=3)
    with rasterio.open(path, "w", **profile) as file:
        file.write(values[:3])
        for number, name in enumerate(names[:3], 1):
            file.set_band_description(number, name)
    return path


def with_rough_roofs(dsm, path):
    """Write heights again, with 20 cm of noise on all that is high: as rough as steep roofs are in coarse cells."""
    with rasterio.open(dsm) as source:
        heights, profile = source.read(1), source.profile
    noise_m = np.random.default_rng(4).normal(scale=0.2, size=heights.shape).astype(np.float32)
    heights += np.where(heights > np.median(heights) + 2, noise_m, np.float32(0))
    with rasterio.open(path, "w", **profile) as file:
        file.write(heights, 1)
    return path


def test_a_picture_without_hue_takes_no_building(files, tmp_path):
    """All houses of a town with rough roofs are there in grey. By hue and roughness alone all are vegetation."""
    grey = in_grey(files["ortho"], tmp_path / "grey.tif")
    heights = {"dsm": with_rough_roofs(files["dsm"], tmp_path / "dsm.tif"), "dtm": files["dtm"]}
    msbdb.build(**heights, ortho=grey, db=tmp_path / "town.sqlite", survey="town")
    with msbdb.open(tmp_path / "town.sqlite") as opened:
        found = opened.buildings()
    true = town()
    assert len(found) == len(np.unique(true.buildings)) - 1
    area_m2 = np.count_nonzero(true.buildings) * true.spec.cell_area_m2
    np.testing.assert_allclose(found.geometry.area.sum(), area_m2, rtol=0.05)


def test_a_plan_of_before_knows_no_shares_of_roofs(files):
    """It is read, and its classes say nothing about roofs."""
    plan = msbdb.plan(**files)
    assert ClassModel.of_plan(plan.classes).roof_odds is not None
    kept = plan.as_dict()
    del kept["classes"]["roof_share"], kept["classes"]["all_roofs"]
    before = Plan.from_dict(kept).classes
    assert ClassModel.of_plan(before).roof_odds is None
    assert replace(before, roof_share=plan.classes.roof_share, all_roofs=plan.classes.all_roofs) == plan.classes

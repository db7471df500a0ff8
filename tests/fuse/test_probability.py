"""Objects that the detectors refuse together: which they are, and their rows in the ledger."""

import numpy as np
import pytest
from pyproj import CRS
from scipy.special import logit

from msbdb.detect.scene import Regions
from msbdb.fuse.probability import building_probability, refuse, refused_objects
from msbdb.grid import Grid, lattice
from msbdb.params import FuseParams

SIDE = 40


def scene():
    """Return heights with a house, a crown beside it, two crowns apart, a mast and a hedge, and the house's cells."""
    values = np.zeros((SIDE, SIDE), dtype=np.float32)
    built = np.zeros((SIDE, SIDE), dtype=bool)
    built[2:12, 2:12] = True
    values[built] = 6
    values[2:8, 12:18] = 8  # a crown that touches the house
    values[20:26, 2:8] = 9  # a crown of 36 m²
    values[20:26, 20:26] = 4  # another one, that one detector takes
    values[30:33, 2:4] = 12  # smaller than a building
    values[36:38, 2:30] = 3  # a hedge, two cells wide
    spec = lattice((600000, 6200000.1, 600000 + SIDE - 1, 6200000 + SIDE - 0.1), 1.0, CRS.from_epsg(2154))
    return Grid(values, np.ones_like(built), spec), built


def seen(built, names, more=None):
    """Return the regions of detectors that take the house, and one that takes something more."""
    found = {name: Regions(name, built.astype(np.int32), None, None, {}) for name in names}
    if more is not None:
        found["area3d"] = Regions("area3d", (built | more).astype(np.int32), None, None, {})
    return found


def test_refused_objects_are_as_large_as_a_building_and_apart():
    """What touches a building, is narrow or small is no object of its own."""
    heights, built = scene()
    labels, count = refused_objects(heights, built, FuseParams(), mask_m=2.0)
    assert count == 2
    assert np.array_equal(labels > 0, np.isin(np.asarray(heights.values), (4, 9)))
    masked = Grid(heights.values, np.asarray(heights.values) != 9, heights.spec)
    assert refused_objects(masked, built, FuseParams(), mask_m=2.0)[1] == 1


def test_each_refused_object_is_a_row_with_its_state():
    """No detector takes the one: it is refuted. One and a half of four take the other: it is unsure."""
    heights, built = scene()
    half = np.asarray(heights.values) == 4
    regions = seen(built, ("multiscale", "flatregions", "adaptive"), half)
    regions["adaptive"] = Regions(
        "adaptive", (built | (half & (np.arange(SIDE) < 23))).astype(np.int32), None, None, {}
    )
    rows, counts = refuse(heights, regions, built, FuseParams(), mask_m=2.0, survey="here")
    assert rows["reason"].tolist() == ["refuted", "unsure"]
    assert rows["area_m2"].tolist() == [36.0, 36.0]
    assert rows[["method", "stage"]].drop_duplicates().to_numpy().tolist() == [["multiscale", "fusion"]]
    assert rows["xcen"].tolist() == [600005.0, 600023.0]
    assert rows["region_id"].nunique() == 2
    assert counts == {"fusion": {"in": 3, "pieces": 0, "kept": 1, "dropped": 2}}


def test_an_object_without_half_of_the_votes_is_never_confirmed():
    """However large it is, the fusion did not take it."""
    heights, built = scene()
    regions = seen(built, ("multiscale", "flatregions", "adaptive"), np.asarray(heights.values) == 4)
    sure = FuseParams(support_even=0.0, support_slope=100.0)
    rows, _ = refuse(heights, regions, built, sure, mask_m=2.0, survey="here")
    assert rows["reason"].tolist() == ["unsure", "unsure"]


def test_a_scene_without_objects_has_no_rows():
    """The stage is still counted."""
    heights, built = scene()
    level = Grid(np.where(built, heights.values, 0).astype(np.float32), heights.valid, heights.spec)
    rows, counts = refuse(level, seen(built, ("multiscale",)), built, FuseParams(), mask_m=2.0, survey="here")
    assert rows.empty
    assert counts["fusion"] == {"in": 1, "pieces": 0, "kept": 1, "dropped": 0}


def test_on_rasters_the_area_counts_as_far_as_detectors_take_an_object():
    """A large stand that one of four takes stays improbable. A house that all take is confirmed in fine cells alone."""
    fine, coarse = (FuseParams().of_rasters(cell_m) for cell_m in (0.5, 2.0))
    support, area_m2 = np.array([0.25, 0.25, 0.95]), np.array([50.0, 5000.0, 100.0])
    small, large, house = building_probability(support, area_m2, fine)
    assert small < 0.08
    assert large < 2 * small + 0.05
    assert house > 0.95
    assert building_probability(support, area_m2, coarse)[2] < 0.85
    # Of points the area counts alike, whatever the share.
    odds = [logit(building_probability(np.array([s, s]), np.array([50.0, 500.0]), FuseParams())) for s in (0.3, 0.8)]
    assert np.ptp(np.diff(odds)) == pytest.approx(0, abs=1e-9)
    assert fine.support_even == pytest.approx(FuseParams().raster_even)

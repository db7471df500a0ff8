"""Who decides on rasters of heights, and the fit of the probability there: on simulated votes."""

from dataclasses import replace

import numpy as np
import pytest
from cases.fusion import Islands, Seen
from cases.labelled import Reference
from pyproj import CRS
from support.processes import BENCHMARKS, load_script

from msbdb.fuse import cells
from msbdb.fuse.probability import building_probability
from msbdb.grid import Grid, lattice
from msbdb.params import DETECTORS, FuseParams

SHAPE = (30, 60)


@pytest.fixture(scope="module")
def rasters():
    """Return scripts/benchmarks/rasters."""
    return load_script(BENCHMARKS / "rasters")


def raster(rasters, name, true, taken, *, cell_m=0.5, table="without a picture"):
    """Return a raster of a house, which some detectors take, and of a crown, which others do."""
    spec = lattice((0, 0.01, SHAPE[1] * cell_m - 0.01, SHAPE[0] * cell_m), cell_m, CRS.from_epsg(2154))
    masks = {"house": np.zeros(SHAPE, dtype=bool), "crown": np.zeros(SHAPE, dtype=bool)}
    masks["house"][5:25, 5:25] = masks["crown"][5:25, 35:55] = True
    heights = Grid(6 * np.float32(masks["house"] | masks["crown"]), np.ones(SHAPE, dtype=bool), spec)
    covered = {
        method: np.logical_or.reduce([np.zeros(SHAPE, bool), *(masks[what] for what in masks if method in taken[what])])
        for method in DETECTORS
    }
    found = Seen(heights, None, covered, 2.0, np.zeros(SHAPE, dtype=bool), of_points=False, coloured="picture" in name)
    return rasters.Raster(table, name, Reference(masks[true], np.ones(SHAPE, dtype=bool), spec), found)


def test_each_rule_decides_by_its_votes(rasters):
    """Of a house that two detectors take and a crown that two others take; afterwards the build's own rule is back."""
    taken = {"house": ("multiscale", "area3d"), "crown": ("flatregions", "area3d")}
    case = raster(rasters, "town_1, 0.5 m", "house", taken)
    own = cells.count_votes
    found = {}
    for name, rule in rasters.RULES.items():
        with rasters.under(rule):
            found[name] = case.quality()
    assert cells.count_votes is own
    assert found == {
        "as a build decides": 100,
        "the same, with a picture too": 100,
        "`multiscale`": 100,
        "two of four, as with points": 50,
        "three of four": 0,
        "two of three, without flat regions": 100,
    }


def test_a_place_is_judged_by_the_rule_that_is_best_on_the_others(rasters):
    """In one town only flat regions and area3d see the house, in the other they see the crown alone."""
    both = ("flatregions", "area3d")
    odd = {"house": both, "crown": ()}
    usual = {"house": ("multiscale", "area3d", "adaptive"), "crown": both}
    cases = [
        raster(rasters, f"{place}, 0.5 m", "house", taken, table=table)
        for table in rasters.TABLES
        for place, taken in (("a", odd), ("b", usual))
    ]
    page = rasters.votes(cases)
    assert "| two of four, as with points | 75.0 | 100.0 | 50.0 |" in page
    assert "| as a build decides | 50.0 | 0.0 | 100.0 |" in page
    # The town whose house two of four find is judged by a rule of the other, and the other way round.
    assert page.count("| held out | 25.0 | 0.0 | 50.0 |") == 2


def test_the_fit_finds_the_odds_that_objects_were_drawn_from(rasters):
    """Also the cell's part, of two towns with cells of two sides each."""
    rng = np.random.default_rng(3)
    odds = {
        "raster_even": 0.6,
        "raster_slope": 8.0,
        "raster_area_slope": 1.5,
        "raster_area_power": 2.0,
        "raster_cell": 0.2,
    }
    params = replace(FuseParams(), **odds)
    taken = dict.fromkeys(("house", "crown"), ("multiscale",))
    every = []
    for place in "ab":
        for cell_m in (0.5, 2.0):
            support, area_m2 = rng.random(20_000), rng.uniform(10, 900, 20_000)
            true = rng.random(20_000) < building_probability(support, area_m2, params.of_rasters(cell_m))
            one = raster(rasters, f"{place}, {cell_m:g} m", "house", taken, cell_m=cell_m)
            every.append((one, Islands(np.ones(20_000, dtype=bool), support, true, area_m2)))
    found = rasters.fitted(every, 2.0, by_cell=True)
    assert found.raster_even == pytest.approx(0.6, abs=0.02)
    assert found.raster_slope == pytest.approx(8, abs=0.5)
    assert found.raster_area_slope == pytest.approx(1.5, abs=0.1)
    assert found.raster_cell == pytest.approx(0.2, abs=0.02)
    assert rasters.fitted(every, 2.0, by_cell=False).raster_cell == 0

"""The pages of accuracy and density: what is compared, and what their tables say of it."""

from pathlib import Path

import pytest
from support.processes import BENCHMARKS, load_script

from msbdb.params import DETECTORS


@pytest.fixture(scope="module")
def accuracy():
    """Return scripts/benchmarks/accuracy."""
    return load_script(BENCHMARKS / "accuracy")


def result(of, *, tile="delft_1", profile="default", classes="wiped", points=None, written=None):
    """Return what a run gives, all rates 0.8 but those by point."""
    rates = dict.fromkeys(("completeness", "correctness", "quality"), 0.8)
    score = {name: {"rates": rates} for name in ("area", "objects", "large_objects")}
    score |= {name: dict.fromkeys(rates, share) for name, share in (("points", points), ("written", written)) if share}
    return {"tile": tile, "profile": profile, "classes": classes, "of": of, "density": 11.26, "score": score}


def test_aims_that_are_missed_are_bold(accuracy):
    """Each extractor has its own aims; what was written back goes before what lies in the footprints."""
    page = accuracy.aims([result("area3d", points=0.8, written=0.9), result("adaptive", points=0.7, written=0.7)])
    assert "| delft_1 | 11.3 | area3d | 80.0 | 90.0 (of 88) | 80.0 | 80.0 |" in page
    assert "| delft_1 | 11.3 | adaptive | **80.0** (of 82) | 70.0 | 80.0 | **80.0** (of 90) |" in page


def test_aims_are_of_the_default_profile_without_classes(accuracy):
    """Other profiles, given classes, confirmed buildings and tiles without an aim are not judged."""
    others = [
        result("buildings", profile="vu2009"),
        result("buildings", classes="given"),
        result("confirmed"),
        result("buildings", tile="alexandria", classes="raster"),
    ]
    assert len(accuracy.aims(others).splitlines()) == 2


def test_points_have_a_table_where_they_were_scored(accuracy):
    """A tile with footprints as truth has no row; who writes nothing back has dashes."""
    page = accuracy.point_table([result("buildings", points=0.8), result("buildings", tile="goteborg")])
    assert page.splitlines()[2:] == [
        "| delft_1 | default | wiped | buildings | 80.0 | 80.0 | 80.0 | \N{EN DASH} | \N{EN DASH} | \N{EN DASH} |"
    ]


def test_tiles_of_points_are_counted_together(accuracy):
    """Areas, points and objects are summed up before they are divided; other tiles and given classes are left out."""

    def run(tile, share, found, *, classes="wiped"):
        area = {"both_m2": 100 * share, "reference_only_m2": 100.0 - 100 * share, "extracted_only_m2": 0.0}
        objects = {"found": found, "missed": 1, "true": found, "false": 0}
        counts = {"points": {"tp": 0, "fp": 1, "fn": 1}, "written": {"tp": 9, "fp": 1, "fn": 0}}
        score = {"area": area, "objects": objects, "large_objects": objects, "counts": counts}
        return {"tile": tile, "profile": "default", "classes": classes, "of": "area3d", "score": score}

    runs = [run("delft_1", 0.9, 2), run("beziers", 0.5, 5), run("goteborg", 0.1, 1)]
    page = accuracy.pooled([*runs, run("delft_2", 0.1, 1, classes="given")])
    assert page.splitlines()[2:] == [
        "| default | area3d | 70.0 | 90.0 | 7 of 9 | 7 of 7 | 77.8 | 7 of 9 | 7 of 7 | 77.8 |"
    ]


def test_rasters_have_all_detectors_and_profiles(accuracy):
    """As tiles of points; they are built once, as there are no classes to remove."""
    tiles = {tile.name: tile for tile in accuracy.TILES}
    assert [run for run in accuracy.runs(tiles["goteborg"]) if run[0] == "default"] == [("default", "raster")]
    for tile in ("goteborg", "delft_1"):
        assert {profile for profile, _ in accuracy.runs(tiles[tile])} == set(accuracy.PROFILES)
    work = accuracy.Work(tiles["goteborg"], "default", "raster", Path(), Path())
    assert accuracy.extractors(work) == sorted(DETECTORS)


def test_the_density_page_has_a_row_a_density_and_a_column_an_outline():
    """In the order of what is compared."""
    density = load_script(BENCHMARKS / "density")
    found = [density.Score("delft_1", 4.0, of, n, n, n) for n, of in enumerate(density.OF)]
    lines = density.table(found, "area").splitlines()
    assert lines[0] == "| tile | density | multiscale | flatregions | area3d | adaptive |"
    assert lines[2:] == ["| delft_1 | 4.0 | 0.0 | 1.0 | 2.0 | 3.0 |"]

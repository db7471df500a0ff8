"""The benchmark of loading, with a few rows."""

import json
import shutil

import pytest
from support.processes import BENCHMARKS, run_script

SCRIPT = BENCHMARKS / "load"


@pytest.mark.long
@pytest.mark.skipif(shutil.which("ogr2ogr") is None, reason="GDAL's tools (gdal-bin) are not installed")
def test_the_same_rows_are_loaded_in_each_way():
    """All seconds come from one run, and the ratios from them."""
    done = run_script(SCRIPT, "--rows", 60, "--runs", 1, "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    ways = told["SpatiaLite"]
    assert told["rows"] == 60
    for other in ("ogr2ogr, own table", "ogr2ogr, same table"):
        assert ways[f"ratio to {other}"] == pytest.approx(ways["msbdb"] / ways[other])
    assert min(ways["msbdb, in place of as many"], ways["msbdb, first build"]) > 0


def test_wrong_arguments_are_explained():
    """Before any work is done."""
    assert "at least one row" in run_script(SCRIPT, "--rows", 0).stderr

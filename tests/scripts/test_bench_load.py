"""The benchmark of loading, with a few rows."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "scripts" / "bench_load"


@pytest.mark.skipif(shutil.which("ogr2ogr") is None, reason="GDAL's tools (gdal-bin) are not installed")
def test_the_same_rows_are_loaded_in_each_way():
    """All seconds come from one run, and the ratios from them."""
    call = [sys.executable, "-B", SCRIPT, "--rows", "60", "--runs", "1", "--json"]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    ways = told["SpatiaLite"]
    assert told["rows"] == 60
    for other in ("ogr2ogr, own table", "ogr2ogr, same table"):
        assert ways[f"ratio to {other}"] == pytest.approx(ways["msbdb"] / ways[other])
    assert min(ways["msbdb, in place of as many"], ways["msbdb, first build"]) > 0


def test_wrong_arguments_are_explained():
    """Before any work is done."""
    call = [sys.executable, "-B", SCRIPT, "--rows", "0"]
    assert "at least one row" in subprocess.run(call, capture_output=True, text=True, check=False).stderr

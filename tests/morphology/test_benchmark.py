"""The benchmark of the morphology runs, and finds the tools' results equal."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[2] / "scripts" / "bench_morphology"


def run(*options):
    """Return what the script prints."""
    return subprocess.run([sys.executable, SCRIPT, *options], check=True, capture_output=True, text=True).stdout


def test_the_benchmark_compares_three_tools():
    """Each tool has its seconds, its ratio to this project, and the same checksum."""
    pytest.importorskip("diplib")
    pytest.importorskip("higra")
    report = json.loads(run("--size", "90", "--rounds", "1", "--threshold", "20", "--json"))
    assert report["tools"].keys() == {"msbdb", "diplib", "higra"}
    assert report["tools"]["msbdb"]["ratio_seconds"] == 1.0
    assert len({tool["sha256"] for tool in report["tools"].values()}) == 1


def test_the_benchmark_explains_itself():
    """All options are in the help."""
    text = run("--help")
    for option in ("--size", "--threshold", "--rounds", "--noise", "--seed", "--json"):
        assert option in text

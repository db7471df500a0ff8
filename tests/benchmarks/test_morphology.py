"""The benchmark of the morphology runs, and finds the tools' results equal."""

import json

import pytest
from support.processes import BENCHMARKS, run_script

SCRIPT = BENCHMARKS / "morphology"


def run(*options):
    """Return what the script prints."""
    done = run_script(SCRIPT, *options)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.long
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

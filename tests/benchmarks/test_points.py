"""The benchmark of the morphology on points runs, and finds the tools' on-sets equal."""

import json

from support.processes import BENCHMARKS, run_script

SCRIPT = BENCHMARKS / "points"


def run(*options):
    """Return what the script prints."""
    done = run_script(SCRIPT, *options)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_benchmark_compares_both_tools():
    """Each tool has its seconds of both steps, its ratio to this project, and the same checksum of its on-sets."""
    report = json.loads(run("--points", "4000", "--rounds", "1", "--json"))
    assert report["tools"].keys() == {"msbdb", "scipy"}
    assert report["tools"]["msbdb"]["ratio_seconds"] == 1.0
    assert len({tool["sha256"] for tool in report["tools"].values()}) == 1
    assert all(tool["graph_seconds"] > 0 and tool["filter_seconds"] > 0 for tool in report["tools"].values())


def test_the_benchmark_explains_itself():
    """All options are in the help."""
    text = run("--help")
    for option in (
        "--points",
        "--cloud",
        "--crs",
        "--distance",
        "--area",
        "--heights",
        "--rounds",
        "--tools",
        "--json",
    ):
        assert option in text

"""The benchmark of the profile runs, and finds equal openings."""

import json

import pytest
from support.processes import BENCHMARKS, run_script

SCRIPT = BENCHMARKS / "profiles"


def run(*options):
    """Return what the script prints."""
    done = run_script(SCRIPT, *options)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.long
def test_the_benchmark_compares_all_zones_with_one_opening():
    """Each run has its seconds and its ratio to one opening; what the tree opens is what the kernel opens."""
    pytest.importorskip("diplib")
    pytest.importorskip("higra")
    report = json.loads(run("--size", "120", "--rounds", "1", "--threshold", "20", "--zones", "9", "--json"))
    runs = report["runs"]
    assert runs.keys() == {"profile", "opening", "diplib", "higra"}
    assert runs["opening"]["ratio_seconds"] == 1.0
    assert runs["profile"]["sha256"] == runs["opening"]["sha256"]
    assert runs["diplib"]["sha256"] == runs["higra"]["sha256"] != runs["opening"]["sha256"]
    assert report["zones"] == 9


def test_the_benchmark_explains_itself():
    """All options are in the help."""
    text = run("--help")
    for option in ("--size", "--zones", "--least", "--most", "--threshold", "--rounds", "--seed", "--json"):
        assert option in text

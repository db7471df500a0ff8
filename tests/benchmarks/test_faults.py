"""Disturbed writers lose nothing: the long test of scripts/benchmarks/faults, in short."""

import json
from pathlib import Path

import pytest
from disturbance.runs import Outcome
from support.processes import BENCHMARKS, load_script, run_script

SCRIPT = BENCHMARKS / "faults"
HAS_SERVER = bool(list(Path("/usr/lib/postgresql").glob("*/lib/postgis-3.so")))


BOTH = ["spatialite", "postgis"]


@pytest.mark.campaign
@pytest.mark.parametrize(
    "dialects",
    [
        pytest.param(["spatialite"], marks=pytest.mark.skipif(HAS_SERVER, reason="both are tested"), id="spatialite"),
        pytest.param(BOTH, marks=pytest.mark.skipif(not HAS_SERVER, reason="PostGIS is not installed"), id="both"),
    ],
)
def test_disturbed_writers_lose_nothing(dialects: list[str]) -> None:
    """Killed, cut off, restarted under, or without room: sound at once, and whole after a repeat."""
    words = [word for dialect in dialects for word in ("--dialect", dialect)]
    done = run_script(SCRIPT, "--kills", 2, "--others", 1, "--json", *words)
    assert done.returncode == 0, done.stderr
    runs = json.loads(done.stdout)["runs"]
    assert {run["problem"] for run in runs} == {""}
    assert {run["dialect"] for run in runs if run["ended"] == "killed"} == set(dialects)
    known = {"kill", "limit"} | ({"restart", "cut", "wire"} if "postgis" in dialects else set())
    assert {run["fault"] for run in runs} >= known
    assert {run["ended"] for run in runs} >= {"killed", "refused"}


def test_the_table_counts_what_was_left_and_what_was_wrong() -> None:
    """A wrong run is in the table, whatever else it is."""
    script = load_script(SCRIPT)
    good = Outcome("spatialite", "kill", "update", "", "killed", "", "old")
    bad = Outcome("spatialite", "full", "copy", "", "done", "", "new", "a row is gone")
    lines = script.table([good, good, bad], "disturbance", lambda outcome: outcome.fault)
    assert lines[0] == "| disturbance | runs | came through | absent | old | between | new | wrong |"
    assert lines[2:] == [
        "| kill | 2 | 0 | 0 | 2 | 0 | 0 | 0 |",
        "| full | 1 | 1 | 0 | 0 | 0 | 1 | 1 |",
        "| all | 3 | 1 | 0 | 2 | 0 | 1 | 1 |",
    ]

"""Disturbed writers lose nothing: the long test of scripts/fault_test, in short."""

import json
import subprocess
import sys
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path
from types import ModuleType

import pytest
from faultruns import Outcome

ROOT = Path(__file__).resolve().parents[2]
HAS_SERVER = bool(list(Path("/usr/lib/postgresql").glob("*/lib/postgis-3.so")))


BOTH = ["spatialite", "postgis"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "dialects",
    [
        pytest.param(["spatialite"], marks=pytest.mark.skipif(HAS_SERVER, reason="both are tested"), id="spatialite"),
        pytest.param(BOTH, marks=pytest.mark.skipif(not HAS_SERVER, reason="PostGIS is not installed"), id="both"),
    ],
)
def test_disturbed_writers_lose_nothing(dialects: list[str]) -> None:
    """Killed, cut off, restarted under, or without room: sound at once, and whole after a repeat."""
    command = [sys.executable, str(ROOT / "scripts" / "fault_test"), "--kills", "2", "--others", "1", "--json"]
    command += [word for dialect in dialects for word in ("--dialect", dialect)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    runs = json.loads(done.stdout)["runs"]
    assert {run["problem"] for run in runs} == {""}
    assert {run["dialect"] for run in runs if run["ended"] == "killed"} == set(dialects)
    known = {"kill", "limit"} | ({"restart", "cut", "wire"} if "postgis" in dialects else set())
    assert {run["fault"] for run in runs} >= known
    assert {run["ended"] for run in runs} >= {"killed", "refused"}


def test_the_table_counts_what_was_left_and_what_was_wrong() -> None:
    """A wrong run is in the table, whatever else it is."""
    script = load_script()
    good = Outcome("spatialite", "kill", "update", "", "killed", "", "old")
    bad = Outcome("spatialite", "full", "copy", "", "done", "", "new", "a row is gone")
    lines = script.table([good, good, bad], "disturbance", lambda outcome: outcome.fault)
    assert lines[0] == "| disturbance | runs | came through | absent | old | between | new | wrong |"
    assert lines[2:] == [
        "| kill | 2 | 0 | 0 | 2 | 0 | 0 | 0 |",
        "| full | 1 | 1 | 0 | 0 | 0 | 1 | 1 |",
        "| all | 3 | 1 | 0 | 2 | 0 | 1 | 1 |",
    ]


def load_script() -> ModuleType:
    """Return the script as a module."""
    loader = SourceFileLoader("fault_test", str(ROOT / "scripts" / "fault_test"))
    spec = spec_from_loader(loader.name, loader)
    assert spec is not None
    module = module_from_spec(spec)
    sys.modules[loader.name] = module
    written, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    loader.exec_module(module)
    sys.dont_write_bytecode = written
    return module

"""The comparison of two dumps under stated changes."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "scripts" / "compare_dumps"
METHODS = ROOT / "scripts" / "dump_changes" / "methods.json"

NUMBERS = {"in": 2, "kept": 1, "dropped": 1}
OLD = [
    ["table", "rejection", "rejection_id", "stage", "reason"],
    ["rejection", 1, "flat ratio", "rough"],
    ["rejection", 2, "vegetation mask", "green"],
    ["table", "run", "run_id", "method", "counts"],
    ["run", 7, "flatregions,multiscale", json.dumps({"regions": {"flat ratio": NUMBERS, "vegetation mask": NUMBERS}})],
]
NESTED = {"flatregions": {"ratio": NUMBERS}, "multiscale": {"vegetation mask": NUMBERS}}
NEW = [
    ["table", "rejection", "rejection_id", "method", "stage", "reason"],
    ["rejection", 5, "multiscale", "vegetation mask", "green"],
    ["rejection", 9, "flatregions", "ratio", "rough"],
    ["table", "run", "run_id", "counts"],
    ["run", 7, json.dumps({"regions": NESTED}, sort_keys=True)],
    ["table", "run_method", "run_id", "method"],
    ["run_method", 7, "flatregions"],
    ["run_method", 7, "multiscale"],
]


def compared(folder: Path, old: list[list[object]], new: list[list[object]], *changes: Path) -> tuple[int, str]:
    """Return the end code and the output for two dumps."""
    for name, rows in (("old", old), ("new", new)):
        (folder / name).write_text("".join(f"{json.dumps(row)}\n" for row in rows))
    more = ["--changes", *map(str, changes)] if changes else []
    call = [sys.executable, str(SCRIPT), str(folder / "old"), str(folder / "new"), *more]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout + done.stderr


def test_the_methods_become_columns_and_rows(tmp_path: Path) -> None:
    """Under the stated change both dumps hold the same, whatever the order of rows; without it they differ."""
    assert compared(tmp_path, OLD, NEW, METHODS) == (0, "the same: 5 rows of 3 tables\n")
    code, said = compared(tmp_path, OLD, NEW)
    assert code == 1
    assert "+ run_method: 2 rows of 2" in said
    assert compared(tmp_path, NEW, NEW)[0] == 0


@pytest.mark.parametrize(("row", "cell", "value"), [(1, 4, "clean"), (1, 2, "area3d"), (4, 1, 8), (6, 2, "area3d")])
def test_a_single_other_value_is_a_difference(tmp_path: Path, row: int, cell: int, value: object) -> None:
    """It is shown, and the end code is 1."""
    other = [list(one) for one in NEW]
    other[row][cell] = value
    code, said = compared(tmp_path, OLD, other, METHODS)
    assert code == 1
    assert str(value) in said


def test_names_and_values_change(tmp_path: Path) -> None:
    """Tables and columns get other names or go, values are replaced, and what is ignored is not compared."""
    changes = {
        "values": {"part": {"state": {"unsure": "likely"}}},
        "columns": {"part": {"supid": "father", "hzone": ""}},
        "tables": {"part": "piece", "source": ""},
        "ignore": {"piece": ["area"]},
        "ignore_tables": ["survey"],
    }
    (tmp_path / "changes.json").write_text(json.dumps(changes))
    old = [["table", "part", "supid", "hzone", "state", "area"], ["part", 1, 3, "unsure", 5.0]]
    old += [["table", "source", "name"], ["source", "a.laz"], ["table", "survey", "name"], ["survey", "a"]]
    new = [["table", "piece", "father", "state", "area"], ["piece", 1, "likely", 6.0]]
    assert compared(tmp_path, old, new, tmp_path / "changes.json") == (0, "the same: 1 rows of 1 tables\n")


def test_an_unknown_stage_is_named(tmp_path: Path) -> None:
    """A file of changes that does not cover a stage is no silent pass."""
    (tmp_path / "changes.json").write_text(json.dumps({"ledger": {"flat ": "flatregions"}}))
    code, said = compared(tmp_path, OLD, NEW, tmp_path / "changes.json")
    assert code == 1
    assert "The stage 'vegetation mask' begins with none" in said

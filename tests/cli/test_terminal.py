"""What a person reads in a terminal: the bar, tables in 80 columns, summaries, quiet commands, and the log file."""

import json
import logging
import os
import re
import subprocess
import sys
import warnings
from pathlib import Path

import click
import numba
import pytest
from click.testing import CliRunner
from support.processes import ROOT, environment

from msbdb.cli import output
from msbdb.cli.command import command, shared
from msbdb.cli.output import emit_pairs, emit_table
from msbdb.cli.progress import Estimate, stages_of
from msbdb.errors import InputError, MsbdbWarning
from msbdb.params import DETECTORS
from msbdb.run.reports import STAGES, WORDS
from msbdb.threads import when_compiling

ID = 432187970982377768

ROWS = [
    {
        "building_id": ID + row,
        "survey": "a survey of a long name",
        "note": "a text of many words, which may well continue on the next line of the table",
        **{f"measure_{n}_m2": 1234.5678 + row for n in range(9)},
        "xcen": 809649.1234,
    }
    for row in range(3)
]


@pytest.fixture
def narrow(monkeypatch):
    """Let the standard output be a terminal of 80 columns."""
    monkeypatch.setattr(output, "_has_width", lambda: True)
    monkeypatch.setattr(output, "_width", lambda: 80)


def test_a_user_reads_a_wide_table_in_80_columns(narrow, capsys):
    """No line is longer, no id and no number is broken, and each group of columns has the numbers of the rows."""
    emit_table(ROWS)
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 80
    for row in ROWS:
        assert sum(str(row["building_id"]) in line for line in lines) == 1
    assert sum("1235" in line.split() for line in lines) >= 1, "areas have no decimals"
    assert not any("1234.5678" in line for line in lines)
    assert sum(line.split()[:1] == ["#"] for line in lines) >= 2


def test_a_user_pipes_a_wide_table(capsys):
    """Where the output is no terminal every row is one line."""
    emit_table(ROWS)
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2 + len(ROWS)
    assert all(ROWS[0]["note"] in line and str(ID + row) in line for row, line in enumerate(lines[2:]))


def test_a_user_reads_a_list_in_80_columns(narrow, capsys):
    """A long text continues below itself; an id and a path stay whole."""
    emit_pairs({"largest": f"{'word ' * 14}id {ID}", "database": "/folder" * 20, "ridge": 12.345, "area_m2": 541.7})
    printed = capsys.readouterr().out
    assert str(ID) in printed
    assert "/folder" * 20 in printed
    assert [line.split()[-1] for line in printed.splitlines() if "ridge, m" in line or "area, m²" in line] == [
        "12.3",
        "542",
    ]
    assert all(len(line) <= 80 for line in printed.splitlines() if "/folder" not in line)


def test_the_bar_goes_on_and_never_back():
    """Over a build with stages that take longer and shorter than expected, and with a pause."""
    clock = iter(range(10_000))
    plan = stages_of(DETECTORS)
    assert list(plan) == list(STAGES)
    estimate = Estimate(plan, now=lambda: float(next(clock)))
    assert estimate.state() == (0.0, None)
    shares = []
    for number, stage in enumerate(plan):
        estimate.advance(stage, 0, 1)
        assert estimate.words == WORDS[stage]
        if number == 3:
            estimate.hold()
            assert estimate.state() == estimate.state(), "time stands still while kernels are compiled"
            estimate.go_on()
        shares += [estimate.state()[0] for _ in range(1 + number % 3)]
        estimate.advance(stage, 1, 1)
    assert shares == sorted(shares)
    share, left_s = estimate.state()
    assert share == pytest.approx(1)
    assert left_s == pytest.approx(0, abs=1e-9)


def test_the_time_left_follows_the_pace():
    """A machine of a tenth of the speed has ten times the time left, once it has shown it."""
    left = {}
    for pace in (1.0, 10.0):
        now = [0.0]
        estimate = Estimate({"read": 100.0, "surface": 100.0}, now=lambda now=now: now[0])
        estimate.advance("read", 0, 1)
        estimate.advance("read", 1_000_000, 1_000_000)
        now[0] = 100.0 * pace
        estimate.advance("surface", 0, 1)
        left[pace] = estimate.state()[1]
    assert left[1.0] == pytest.approx(100, rel=0.01)
    assert 800 < left[10.0] <= 1000


def test_detectors_side_by_side_move_the_bar():
    """The first that began is named until it ends, and a later one that ends first is not yet counted."""
    now = [0.0]
    estimate = Estimate({"adaptive": 30.0, "area3d": 50.0, "parts": 20.0}, now=lambda: now[0])
    told = []
    for stage, done in (("adaptive", 0), ("area3d", 0), ("area3d", 1), ("adaptive", 1), ("parts", 0), ("parts", 1)):
        now[0] += 10.0
        estimate.advance(stage, done, 1)
        told.append((estimate.words, estimate.state()[0]))
    assert [words for words, _ in told] == [WORDS[name] for name in ("adaptive",) * 4 + ("parts",) * 2]
    shares = [share for _, share in told]
    assert shares == sorted(shares)
    assert shares[2] < 0.3 <= shares[3] <= 0.8 <= shares[4] < shares[5] == pytest.approx(1)


def test_fewer_detectors_have_fewer_stages():
    """The bar of a build counts only what it does."""
    assert not {"adaptive", "area3d", "flatregions", "houses"} & set(stages_of(["multiscale"]))
    assert list(stages_of(DETECTORS, "inventory"))[-1] == "inventory"


def test_a_compilation_is_told_once_for_each_kernel():
    """With its begin and its end; a kernel that is compiled already tells nothing."""
    told = []
    twice = numba.njit(lambda value: value + value)
    with when_compiling(told.append):
        assert [twice(2), twice(3)] == [4, 6]
    assert told == [True, False]


@command("noisy", examples=())
@click.argument("how")
@shared("json")
def noisy(*, how: str, as_json: bool) -> None:
    """Do what a command does."""
    warnings.warn("The unit is a guess.", MsbdbWarning, stacklevel=2)
    logging.getLogger("msbdb.step").info("Surface: 5 x 5 cells")
    logging.getLogger("msbdb.step").debug("a detail")
    if how == "fail":
        msg = "The file is of another place."
        raise InputError(msg)
    output.say("Wrote it.")
    if as_json:
        output.emit_json({"how": how})


def test_a_user_wants_it_quiet():
    """No notice and no remark; what was asked for stays, and errors do."""
    done = CliRunner().invoke(noisy, ["well", "--quiet"])
    assert (done.exit_code, done.output) == (0, "")
    assert json.loads(CliRunner().invoke(noisy, ["well", "--quiet", "--json"]).output) == {"how": "well"}
    failed = CliRunner().invoke(noisy, ["fail", "-q"])
    assert (failed.exit_code, failed.output) == (1, "Error: The file is of another place.\n")
    assert "opposites" in CliRunner().invoke(noisy, ["well", "-q", "-v"]).output


def test_a_user_follows_the_steps_in_words():
    """-v tells steps as sentences, -vv the details by their kind."""
    assert "Surface" not in CliRunner().invoke(noisy, ["well"]).stderr
    said = CliRunner().invoke(noisy, ["well", "-v"]).stderr.splitlines()
    assert "Surface: 5 x 5 cells" in said
    assert not any("detail" in line for line in said)
    assert "debug: a detail" in CliRunner().invoke(noisy, ["well", "-vv"]).stderr


def test_a_user_keeps_a_log_file(tmp_path):
    """All with times, of run after run, notices and the traceback of a failure too; the screen stays as it is."""
    log = tmp_path / "msbdb.log"
    for how in ("well", "fail"):
        done = CliRunner().invoke(noisy, [how, "--log-file", str(log)])
        assert "Surface" not in done.output
        assert "Notice: The unit is a guess." in done.stderr
    lines = log.read_text(encoding="utf-8").splitlines()
    for said in ("Surface: 5 x 5 cells", "a detail", "The unit is a guess."):
        assert sum(line.endswith(said) for line in lines) == 2, said
    assert re.match(r"\d{4}-\d{2}-\d{2} \d{2}:\d{2}:\d{2},\d{3} INFO noisy .* begins", lines[0])
    assert any("ERROR The file is of another place." in line for line in lines)
    assert lines[-1] == "msbdb.errors.InputError: The file is of another place."
    assert not [handler for handler in logging.getLogger("msbdb").handlers if isinstance(handler, logging.FileHandler)]


def test_a_log_file_is_no_other_file(tmp_path):
    """Nothing is added to a database, and no folder is made."""
    data = tmp_path / "town.sqlite"
    data.write_bytes(b"SQLite format 3\0")
    for name in ("town.sqlite", "none/x.log", "."):
        done = CliRunner().invoke(noisy, ["well", "--log-file", str(tmp_path / name)])
        assert done.exit_code == 2
        assert "log file" in done.output
    assert data.read_bytes() == b"SQLite format 3\0"
    assert [path.name for path in tmp_path.iterdir()] == ["town.sqlite"]


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("msbdb meas", {"measure"}),
        ("msbdb build --profile cao", {"cao-wu", "cao-wu-ss"}),
        ("msbdb db ch", {"check"}),
        ("msbdb info ", {"file"}),
    ],
)
def test_a_user_presses_tab_in_bash(typed, offered):
    """After the line of docs/cli.md; where a database is expected, bash completes names of files."""
    line = next(line for line in (ROOT / "docs" / "cli.md").read_text().splitlines() if "bash_source" in line)
    words = typed.split(" ")
    script = f"""{line.partition("#")[0]}
    compopt() {{ COMPREPLY=(file); }}  # bash has it only while Tab is pressed
    COMP_WORDS=({typed}) COMP_CWORD={len(words) - 1}
    _msbdb_completion msbdb
    printf '%s\\n' "${{COMPREPLY[@]}}"
    """
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    command = ["bash", "--norc", "-c", script]
    done = subprocess.run(command, env=environment(PATH=path), capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) == offered

"""docs/tutorial.md tells the truth: its commands and its Python run in order, and print what the page shows.

``MSBDB_REGEN=1`` writes what they print into the page.
"""

import ast
import contextlib
import io
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from msbdb.cli.main import cli

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "tutorial.md"
BLOCK = re.compile(r"```(console|pycon)\n(.*?)```", re.DOTALL)


def commands(lines: list[str], _names: dict[str, Any]) -> str:
    """Return the commands of a block, each with what it prints."""
    shown = []
    for line in (line for line in lines if line.startswith("$ ")):
        done = CliRunner().invoke(cli, shlex.split(line)[2:])
        assert done.exit_code == 0, f"{line}: {done.output}"
        shown += [line, *(own.rstrip() for own in done.output.splitlines())]
    return "\n".join(shown)


def statements(lines: list[str], names: dict[str, Any]) -> str:
    """Return the statements of a block, each with what it prints, as an interactive Python does."""
    prompted = [line for line in lines if line.startswith((">>> ", "... "))]
    source = "\n".join(line[4:] for line in prompted)
    shown: list[str] = []
    for node in ast.parse(source).body:
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            exec(compile(ast.Interactive([node]), str(PAGE), "single"), names)
        shown += [*prompted[node.lineno - 1 : node.end_lineno], *printed.getvalue().splitlines()]
    return "\n".join(shown)


KINDS: dict[str, Callable[[list[str], dict[str, Any]], str]] = {"console": commands, "pycon": statements}


def run(page: str, folder: Path) -> str:
    """Return the page with what its blocks print in a folder."""
    names: dict[str, Any] = {}

    def again(match: re.Match[str]) -> str:
        shown = KINDS[match[1]](match[2].splitlines(), names)
        shown = re.sub(r"(time +)\d+ s", r"\g<1>25 s", shown.replace(str(folder), "/home/anna/nimes"))
        return f"```{match[1]}\n{shown}\n```"

    return BLOCK.sub(again, page)


@pytest.mark.long
def test_the_tutorial_prints_what_it_shows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On the tile that the page names."""
    fetched = subprocess.run(
        [sys.executable, ROOT / "scripts" / "fetch_nimes"], capture_output=True, text=True, check=True
    )
    shutil.copy(fetched.stdout.strip(), tmp_path / "nimes.laz")
    monkeypatch.chdir(tmp_path)
    page = PAGE.read_text(encoding="utf-8")
    found = run(page, tmp_path)
    if os.environ.get("MSBDB_REGEN"):
        PAGE.write_text(found, encoding="utf-8")
    else:
        assert found == page

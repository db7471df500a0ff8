"""The notebook of docs/ runs: every cell of code, in its order, in one Python, on the tile that it names."""

import ast
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import pytest

import msbdb
from msbdb.errors import MissingDependencyError
from msbdb.view.page import read_library

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOK = json.loads((ROOT / "docs" / "notebooks" / "nimes.ipynb").read_text(encoding="utf-8"))
CODE = ["".join(cell["source"]) for cell in NOTEBOOK["cells"] if cell["cell_type"] == "code"]


def test_the_notebook_is_one_of_format_4() -> None:
    """Cells have ids of their own and words or code; results are not kept, so that none can be outdated."""
    assert (NOTEBOOK["nbformat"], NOTEBOOK["nbformat_minor"]) == (4, 5)
    assert len({cell["id"] for cell in NOTEBOOK["cells"]}) == len(NOTEBOOK["cells"])
    for cell in NOTEBOOK["cells"]:
        assert re.fullmatch(r"[\w-]{1,64}", cell["id"])
        kept = {"cell_type", "id", "metadata", "source"}
        if cell["cell_type"] == "code":
            assert (cell["outputs"], cell["execution_count"]) == ([], None)
            kept |= {"outputs", "execution_count"}
        assert set(cell) == kept
        assert all(line.endswith("\n") for line in cell["source"][:-1])


def test_the_names_in_the_notebook_exist() -> None:
    """Each name of msbdb, and each method of an open database."""
    code = "\n".join(CODE)
    assert set(re.findall(r"\bmsbdb\.(\w+)", code)) <= set(msbdb.__all__)
    methods = set(re.findall(r"\btown\.(\w+)\(", code))
    assert {"buildings", "parts", "view"} <= methods <= set(dir(msbdb.Inventory))


def run(source: str, names: dict[str, Any]) -> object:
    """Run a cell, and return the value of its last expression as Jupyter shows it."""
    *body, last = ast.parse(source).body
    exec(compile(ast.Module(body, []), "cell", "exec"), names)
    if isinstance(last, ast.Expr):
        return eval(compile(ast.Expression(last.value), "cell", "eval"), names)
    exec(compile(ast.Module([last], []), "cell", "exec"), names)
    return None


@pytest.mark.long
@pytest.mark.nimes
def test_every_cell_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The build, the frames, the pictures and the files; the answers are those of the tutorial."""
    try:
        read_library()
    except MissingDependencyError as error:
        pytest.skip(str(error))
    script = [sys.executable, ROOT / "scripts" / "fetch_nimes"]
    fetched = subprocess.run(script, capture_output=True, text=True, check=True)
    shutil.copy(fetched.stdout.strip(), tmp_path / "nimes.laz")
    monkeypatch.chdir(tmp_path)
    plt.switch_backend("agg")
    names: dict[str, Any] = {}
    shown = [run(source, names) for source in CODE]
    tutorial = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")
    counts = [re.search(rf"^ {what} +(\d+)", tutorial, re.MULTILINE) for what in ("buildings", "parts")]
    assert shown[0] == tuple(int(found[1]) for found in counts if found)
    assert len(shown[1]) == 5
    answers = next(own for own in shown if isinstance(own, dict) and isinstance(next(iter(own)), tuple))
    assert [own[0].partition(": ")[2][:10] for own in answers.values()] == ["lower than", "vegetation"]
    assert len(plt.get_fignums()) == 2
    plt.close("all")
    assert all(size > 10_000 for size in shown[-1].values())

"""The commands: what they promise in their help, hand to the public functions, print, and how they fail."""

import inspect
import io
import json
import logging
import shlex
import subprocess
import sys
import tomllib
import types
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import click
import numpy as np
import pandas as pd
import pytest
from click.shell_completion import ShellComplete
from click.testing import CliRunner
from rich.console import Console

import msbdb
import msbdb.api
from msbdb import params as declared
from msbdb.cli import output
from msbdb.cli.main import cli
from msbdb.cli.output import emit, text
from msbdb.database import TileStatus, example_queries
from msbdb.database.runs.places import Place
from msbdb.errors import DatabaseError, MsbdbWarning, ParameterError
from msbdb.params import DETECTORS
from msbdb.run.reports import Overview
from msbdb.tables import Reason

COMMANDS: dict[str, click.Command] = {
    **{name: made for name, made in cli.commands.items() if not isinstance(made, click.Group)},
    **{
        f"{name} {own}": made
        for name, group in cli.commands.items()
        if isinstance(group, click.Group)
        for own, made in group.commands.items()
    },
}
"""All commands, those of groups too, by the words that call them."""


@dataclass
class FakeReport:
    """A build's report as msbdb.api gives it."""

    survey: str = "spring"
    buildings: int = 3
    parts: int = 7
    flat_regions: int = 5
    candidate_regions: dict[str, int] = field(default_factory=lambda: {"adaptive": 4, "area3d": 6})
    rejected: int = 2345
    notices: tuple[str, ...] = ("No imagery: classes come from height texture.",)
    timings: dict[str, float] = field(default_factory=lambda: {"read": 0.5, "surface": 0.25})
    changed: bool = True
    database: str = "/data/town.sqlite"
    overview: Overview = field(
        default_factory=lambda: Overview(
            states={"confirmed": 2, "unsure": 1},
            largest={"building_id": 2**62 + 1, "easting": 10.0, "northing": 20.0, "area_m2": 1234.0, "ridge_m": 12.34},
            highest={"building_id": 7, "easting": 1.0, "northing": 2.0, "area_m2": 50.0, "ridge_m": 30.0},
            refused_m2={"vegetation by colour": 4321.0},
            refused_regions=9,
            unsure=({"building_id": 7, "easting": 1.0, "northing": 2.0, "area_m2": 50.0, "probability": 0.5},),
            uneven=(),
            counts={"unsure": 1, "uneven": 0},
        )
    )

    def as_dict(self) -> dict[str, Any]:
        """Return what --json prints."""
        return {"survey": self.survey, "buildings": self.buildings, "quality": float("nan"), "notices": self.notices}


def as_called(reply: Callable[..., Any]) -> Callable[..., Any]:
    """Let a method of the fake take what the function of msbdb.api takes, note it, and return or raise.

    The method gets the notes as one mapping, with the default of each argument that was not given. What a function
    hands on to another one (``**build``) is noted by its own names.
    """
    taken = inspect.signature(getattr(msbdb.api, reply.__name__))
    handed_on = [name for name, word in taken.parameters.items() if word.kind is inspect.Parameter.VAR_KEYWORD]

    def called(self: "FakeApi", *args: Any, **options: Any) -> Any:
        given = taken.bind(*args, **options)
        given.apply_defaults()
        notes = dict(given.arguments)
        for name in handed_on:
            notes |= notes.pop(name)
        self.calls.append((reply.__name__, notes))
        for warning in self.warns:
            warnings.warn(warning, stacklevel=2)
        logging.getLogger("msbdb.api").info("a stage was done")
        if self.fails is not None:
            raise self.fails
        return reply(self, notes)

    return called


NO_FILES = {"aoi": None, "ortho": None}
"""What msbdb.api.view is given without an area and an orthophoto."""


class FakeApi(types.ModuleType):
    """Stands for msbdb.api: remembers its calls, and returns or raises what a test sets."""

    def __init__(self) -> None:
        super().__init__("msbdb.api")
        self.calls: list[tuple[str, dict[str, Any]]] = []
        self.fails: BaseException | None = None
        self.warns: tuple[Warning, ...] = ()

    @as_called
    def build(self, given):
        """Pass two steps of a stage and return a report."""
        if given["progress"] is not None:
            given["progress"]("surface", 1, 2)
            given["progress"]("surface", 2, 2)
        return FakeReport()

    @as_called
    def plan(self, given):
        """Return a plan of one value."""
        return types.SimpleNamespace(as_dict=lambda: {"cell_m": 0.5}, pairs=lambda: {"cells": "0.5 m"})

    @as_called
    def read_plan(self, given):
        """Return a plan of one value."""
        return types.SimpleNamespace(as_dict=lambda: {"cell_m": 0.5}, pairs=lambda: {"cells": "0.5 m"})

    @as_called
    def tiles(self, given):
        """Return one tile that is done."""
        return [TileStatus("town", 97_017, 6_484, 0.0, 0.0, 60.0, 60.0, "done", 4_000, 100.0, 2.5)]

    @as_called
    def info(self, given):
        """Return two levels of plain and numpy values."""
        return {"schema": "0001", "surveys": [{"name": "spring", "cells": np.int64(5), "density": np.float32(2.5)}]}

    @as_called
    def query(self, given):
        """Return a row with an id beyond 2^53 and a null."""
        return pd.DataFrame({"building_id": [2**62 + 1], "storeys": pd.array([None], dtype="Int64")})

    def queries(self):
        """Return the real queries."""
        return example_queries()

    @as_called
    def relabel(self, given):
        """Return a report without notices."""
        return FakeReport(notices=())

    @as_called
    def classes(self, given):
        """Return two classes."""
        return pd.DataFrame({"speindex": [1, 2], "label": ["building", "other"], "ndvi": [0.25, float("nan")]})

    @as_called
    def serve(self, given):
        """Report an address."""
        given["started"](given["url"] or f"http://{given['host']}:{given['port']}")

    @as_called
    def view(self, given):
        """Draw nothing."""

    @as_called
    def why(self, given):
        """Return a place without a building."""
        return Place("town", given["x"], given["y"], Reason.LOW, None, 0.4, 2.0, "neither", "", ())

    @as_called
    def export(self, given):
        """Write nothing."""
        return {"footprint": 3}

    @as_called
    def qgis(self, given):
        """Write no project."""
        return ["Buildings"]

    @as_called
    def evaluate(self, given):
        """Return nested scores."""
        said = ("Area: 91 % quality.", "Buildings: 3 are found.", "Outlines: 0.5 m off.")
        return types.SimpleNamespace(
            sentences=said, as_dict=lambda: {"area": {"quality": 0.91234}, "objects": {"all": {"found": 3}}}
        )

    @as_called
    def evaluate_points(self, given):
        """Return counts."""
        said = ("Points: 100 % quality.", "All are found.", "All are true.")
        return types.SimpleNamespace(sentences=said, as_dict=lambda: {"matched": "order", "points": {"tp": 5, "fp": 0}})

    @as_called
    def classify(self, given):
        """Write nothing and return a report."""
        counts = {"points": 900, "building_points": 300, "ground_points": 0, "changed": 20, "demoted": 1}
        told = {**counts, "regions": {"area3d": 4}, "notices": ("It is COPC.",), "timings": {"read": 0.5}}
        return types.SimpleNamespace(**told, as_dict=lambda: told)

    @as_called
    def update(self, given):
        """Return the reports of a build and of an update."""
        offset = {"dx_m": 0.5, "dy_m": 0.0, "dz_m": 0.1, "pairs": 9, "spread_m": 0.2}
        counts = {"new": 1, "unchanged": 2, "versions": 1}
        told = {"survey": "spring", "date": "2024-04-20", "status": "created", "counts": counts, "offset": offset}
        inventory = types.SimpleNamespace(**told, notices=("Few pairs.",))
        return types.SimpleNamespace(build=FakeReport(), inventory=inventory, as_dict=lambda: {"inventory": told})

    @as_called
    def measure(self, given):
        """Return a report of three footprints."""
        told = {"survey": "spring", "name": "cadastre", "status": "created", "footprints": 3, "others": 1, "unseen": 0}
        told |= {"states": {"confirmed": 2, "refuted": 1}, "database": "/data/town.sqlite"}
        return types.SimpleNamespace(**told, build=FakeReport(), as_dict=lambda: told)

    @as_called
    def changes(self, given):
        """Return counts."""
        return types.SimpleNamespace(counts={"new": 1, "unchanged": 2}, in_between=0)

    def summary(self, found):
        """Return one change."""
        change = {"survey": "spring", "date": "2024-04-20", "kind": "new", "uid_before": None, "uid_after": 7}
        return {"counts": found.counts, "changes": [change | {"dh_m": 6.5, "darea_m2": 90.0, "note": ""}]}

    @as_called
    def import_inventory(self, given):
        """Return a report."""
        told = {"name": "cadastre", "date": "2019-01-01", "status": "created", "rows": 3}
        return types.SimpleNamespace(**told, as_dict=lambda: told)

    @as_called
    def import_roof_samples(self, given):
        """Return a report."""
        told = {"name": "roofs", "date": "", "status": "created", "rows": 3}
        return types.SimpleNamespace(**told, as_dict=lambda: told)

    @as_called
    def set_state(self, given):
        """Write nothing."""


@pytest.fixture
def api(monkeypatch, tmp_path):
    """Put the fake in the place of the public functions, in a fresh folder."""
    fake = FakeApi()
    monkeypatch.setitem(sys.modules, "msbdb.api", fake)
    monkeypatch.setattr(msbdb, "api", fake)
    monkeypatch.chdir(tmp_path)
    return fake


def run(*args: str) -> Any:
    """Run a command line."""
    return CliRunner().invoke(cli, list(args), prog_name="msbdb")


def example_lines() -> list[str]:
    """Return the examples of all commands that go through msbdb.api."""
    return [line for name, made in COMMANDS.items() if " " not in name for line in made.examples]


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_every_command_has_help_with_examples(name):
    """The help holds a sentence for the command and each option, the common options, and examples of this command."""
    result = run(*name.split(), "--help")
    assert result.exit_code == 0
    for expected in ("Examples:", f"msbdb {name} ", "--debug", "-v, --verbose"):
        assert expected in result.stdout
    options = [param for param in COMMANDS[name].params if isinstance(param, click.Option)]
    assert all(option.help for option in options)


@pytest.mark.parametrize("name", sorted({"build", "info", "classes", "classify", "evaluate", "params", "query"}))
def test_every_reporting_command_has_json(name, api):
    """With --json the standard output is one JSON value and nothing else."""
    Path("a.laz").touch()
    args = {
        "build": ["--points", "a.laz", "--db", "x"],
        "info": ["x"],
        "query": ["x", "tallest_buildings"],
        "classes": ["x"],
        "classify": ["a.laz", "b.laz"],
        "evaluate": ["x", "--reference", "a.laz"],
        "params": [],
    }[name]
    result = run(name, *args, "--json")
    assert result.exit_code == 0, result.stderr
    assert json.loads(result.stdout)


@pytest.mark.parametrize("line", example_lines())
def test_every_example_runs(line, api):
    """An example of the help works as it stands, given its files."""
    Path("tiles").mkdir()
    words: list[str] = []
    for word in shlex.split(line.partition(" > ")[0])[1:]:
        words += ["tiles/a.laz", "tiles/b.laz"] if "*" in word else [word]
    for word in words:
        if Path(word).suffix in {".laz", ".tif", ".gpkg", ".geojson"}:
            Path(word).touch()
    result = run(*words)
    assert result.exit_code == 0, result.stderr


def test_build_hands_everything_over(api):
    """Files become paths, several after one flag too; survey, date, CRS and unit pass as they are."""
    for name in ("a.laz", "b.laz", "o.tif"):
        Path(name).touch()
    result = run(
        *("build", "--points", "a.laz", "b.laz", "--ortho", "o.tif", "--db", "x.sqlite", "--survey", "spring"),
        *("--date", "2021-05", "--crs", "EPSG:2154", "--z-unit", "us-ft"),
    )
    assert result.exit_code == 0, result.stderr
    name, values = api.calls[0]
    assert name == "build"
    assert tuple(values["points"]) == (Path("a.laz"), Path("b.laz"))
    assert tuple(values["ortho"]) == (Path("o.tif"),)
    assert (values["db"], values["survey"], values["date"]) == ("x.sqlite", "spring", "2021-05")
    assert (values["crs"], values["z_unit"], values["profile"]) == ("EPSG:2154", "us-ft", "default")
    assert values["progress"] is None, "no bars where the standard error is no terminal"


def test_the_outlines_on_offer_are_those_of_the_parameter():
    """The words of --outline are the choices of vector.walls."""
    from msbdb.cli.inputs import WALLS
    from msbdb.params import Params, with_values

    for word in WALLS:
        assert with_values(Params(), {"vector": {"walls": word}}).vector.walls == word
    with pytest.raises(ParameterError, match=", ".join(WALLS)):
        with_values(Params(), {"vector": {"walls": "round"}})


def test_units_are_those_of_the_reader():
    """The units that the command offers are the ones that reading knows."""
    from msbdb.cli.inputs import Z_UNITS
    from msbdb.io import crs

    assert ("auto", *crs.Z_UNITS) == Z_UNITS


def test_the_nearest_word_on_a_parameter_wins(api):
    """The profile is overruled by the file, the file by --set, and that by --scales."""
    Path("a.laz").touch()
    Path("p.toml").write_text("[surface]\ncell_m = 2.0\nstorey_m = 2.5\n[vector]\nsimplify_px = 3.0\n")
    result = run(
        *("build", "--points", "a.laz", "--db", "x", "--profile", "vu2009", "--params", "p.toml"),
        *("--set", "surface.storey_m=2.7", "surface.slicing=step", "--set", "scale.scales_m2=[1, 2]"),
        *("--scales", "200,50"),
    )
    assert result.exit_code == 0, result.stderr
    params = api.calls[0][1]["params"]
    assert (params.surface.cell_m, params.surface.storey_m, params.vector.simplify_px) == (2.0, 2.7, 3.0)
    assert params.surface.slicing == "step"
    assert params.ground.ground_filter == "wavelet", "the profile's own value stays"
    assert params.scale.scales_m2 == (50.0, 200.0)
    assert api.calls[0][1]["profile"] == "vu2009"


def test_outline_is_a_value_of_the_parameters(api):
    """--outline wins over a file and --set, and without it these count."""
    Path("a.laz").touch()
    traced = ("build", "--points", "a.laz", "--db", "x", "--set", "vector.walls=traced")
    run(*traced)
    run(*traced, "--outline", "fitted")
    assert [call[1]["params"].vector.walls for call in api.calls] == ["traced", "fitted"]


def test_scales_auto_asks_for_granulometry(api):
    """--scales auto empties the list, by which the thresholds are found from the data (V8)."""
    Path("a.laz").touch()
    run("build", "--points", "a.laz", "--db", "x", "--scales", "auto")
    assert api.calls[0][1]["params"].scale.scales_m2 == ()


def test_build_reports_and_draws(api):
    """The summary goes to the standard output, notices to the standard error, and the figure is drawn once."""
    Path("a.laz").touch()
    result = run("build", "--points", "a.laz", "--db", "x", "--figure", "f.png")
    said = " ".join(result.stdout.split())
    for expected in (
        "spring", "3: 2 confirmed, 1 unsure", f"1,234 m², ridge 12.3 m, at 10.0,20.0, id {2**62 + 1}",
        "4,321 m² vegetation by colour", "Refused candidates: 2,345 in all, 9 of them as large",
        "1 unsure building at 1.0,2.0 (probability 0.50)",
        "/data/town.sqlite", "msbdb why /data/town.sqlite --at 10.0,20.0",
    ):  # fmt: skip
        assert expected in said
    assert "Notice" not in result.stdout
    assert result.stderr.count("Notice: No imagery") == 1
    called = {
        "db": "x",
        "out": Path("f.png"),
        "survey": "spring",
        "what": "parts",
        "aoi": None,
        "ortho": None,
        "overwrite": False,
    }
    assert api.calls[1] == ("view", called)


def test_measure_hands_everything_over_and_reports(api):
    """Footprints first, then options of a build, with several values after a flag; the counts are printed."""
    for name in ("c.gpkg", "a.laz", "b.laz"):
        Path(name).touch()
    words = ("measure", "c.gpkg", "--points", "a.laz", "b.laz", "--db", "x", "--id", "number", "--out", "m.csv")
    result = run(*words, "--set", "surface.cell_m=0.5")
    assert result.exit_code == 0, result.stderr
    name, values = api.calls[0]
    assert (name, values["footprints"], values["id_column"]) == ("measure", Path("c.gpkg"), "number")
    assert (values["points"], values["out"]) == ((Path("a.laz"), Path("b.laz")), Path("m.csv"))
    assert values["params"].surface.cell_m == 0.5
    said = " ".join(result.stdout.split())
    for expected in ("measured 3 footprints · confirmed 2 · refuted 1", "1 detected building", "written m.csv"):
        assert expected in said


def test_json_has_no_nan(api):
    """Not-a-number and the numbers of numpy become what JSON knows."""
    Path("a.laz").touch()
    result = run("build", "--points", "a.laz", "--db", "x", "--json")
    assert json.loads(result.stdout)["quality"] is None
    assert json.loads(run("info", "x", "--json").stdout)["surveys"] == [{"name": "spring", "cells": 5, "density": 2.5}]


@pytest.mark.parametrize(
    ("args", "says"),
    [
        (("--db", "x"), "Give --points"),
        (("--db", "x", "--dsm", "a.laz"), "--dsm needs --dtm"),
        (("--db", "x", "--ndsm", "a.laz", "--dtm", "a.laz"), "Leave --dtm out"),
        (("--db", "x", "--points", "a.laz", "--ndsm", "a.laz"), "--points and --ndsm"),
        (("--points", "a.laz"), "--db"),
        (("--db", "x", "--points", "missing.laz"), "missing.laz"),
        (("--db", "x", "--points", "a.laz", "--date", "2021-13-01"), "is no date"),
        (("--db", "x", "--points", "a.laz", "--scales", "many"), "'auto'"),
        (("--db", "x", "--points", "a.laz", "--set", "cell=1"), "no setting"),
    ],
)
def test_wrong_usage_is_told_apart(args, says, api):
    """A command line that makes no sense ends with code 2 and says what it should be; nothing is run."""
    Path("a.laz").touch()
    result = run("build", *args)
    assert result.exit_code == 2
    assert says in result.stderr
    assert not api.calls


def test_an_unknown_parameter_is_refused(api):
    """A setting that is not declared names those that are."""
    Path("a.laz").touch()
    result = run("build", "--points", "a.laz", "--db", "x", "--set", "surface.sell_m=1")
    assert result.exit_code == 1
    assert "surface.sell_m" in result.stderr
    assert "cell_m" in result.stderr


def test_an_error_is_one_line(api):
    """An expected error ends with code 1 and its message alone on the standard error."""
    api.fails = DatabaseError("The database x is locked; close the program that writes to it.")
    result = run("info", "x")
    assert result.exit_code == 1
    assert result.stdout == ""
    assert result.stderr.strip() == "Error: The database x is locked; close the program that writes to it."


def test_debug_shows_the_traceback(api):
    """The traceback comes with --debug, and the message still closes the output."""
    api.fails = DatabaseError("No.")
    result = run("info", "x", "--debug")
    assert result.exit_code == 1
    assert "Traceback (most recent call last)" in result.stderr
    assert result.stderr.strip().endswith("Error: No.")


def test_a_bug_is_called_a_bug(api):
    """An unexpected exception is one line that says whose fault it is and how to see more."""
    api.fails = ZeroDivisionError("division by zero")
    result = run("info", "x")
    assert result.exit_code == 1
    assert "bug in msbdb" in result.stderr
    assert "ZeroDivisionError: division by zero" in result.stderr
    assert "--debug" in result.stderr
    assert "Traceback" not in result.stderr


@pytest.mark.parametrize(
    ("failure", "says"),
    [
        (OSError(28, "No space left on device", "x.sqlite"), "No space left on device: x.sqlite"),
        (MemoryError(), "memory"),
    ],
)
def test_the_machine_s_limits_are_no_bugs(failure, says, api):
    """A full disk or memory is named as such."""
    api.fails = failure
    result = run("info", "x")
    assert result.exit_code == 1
    assert says in result.stderr
    assert "bug" not in result.stderr


def test_interruption_ends_with_130(api):
    """Ctrl-C says that the database is whole, and ends as shells expect."""
    api.fails = KeyboardInterrupt()
    result = run("info", "x")
    assert result.exit_code == 130
    assert "Interrupted" in result.stderr
    assert "Traceback" not in result.stderr


@pytest.mark.filterwarnings("default::UserWarning")
def test_notices_come_once_and_other_warnings_on_demand(api):
    """A notice is told once, though it is warned of and reported; other libraries' warnings need -v."""
    Path("a.laz").touch()
    api.warns = (MsbdbWarning("No imagery: classes come from height texture."), UserWarning("chatter"))
    quiet = run("build", "--points", "a.laz", "--db", "x")
    assert quiet.stderr.count("No imagery") == 1
    assert "chatter" not in quiet.stderr
    assert "chatter" in run("build", "--points", "a.laz", "--db", "x", "-v").stderr


def test_v_shows_the_stages(api):
    """Log records of the stages come with -v only, and logging is left as it was."""
    package = logging.getLogger("msbdb")
    before = (list(package.handlers), package.level)
    assert "a stage was done" not in run("info", "x").stderr
    assert "a stage was done" in run("info", "x", "-v").stderr
    assert (list(package.handlers), package.level) == before


def test_progress_is_drawn_on_terminals(api, monkeypatch):
    """On a terminal the build gets a callback, and the stage appears on the standard error."""
    monkeypatch.setenv("TERM", "xterm")  # a dumb terminal, as of an editor, draws no bar
    screen = io.StringIO()
    console = Console(file=screen, force_terminal=True, width=100)
    monkeypatch.setattr(output, "stderr_console", lambda: console)
    monkeypatch.setattr(output, "on_terminal", lambda: True)
    Path("a.laz").touch()
    result = run("build", "--points", "a.laz", "--db", "x")
    assert result.exit_code == 0
    assert api.calls[0][1]["progress"] is not None
    assert "Surface and ground" in screen.getvalue()
    assert "Surface and ground" not in result.stdout


def test_start_up_is_quick():
    """Importing the program loads none of the heavy libraries, so that help and mistakes answer at once."""
    heavy = [
        "numpy",
        "pandas",
        "geopandas",
        "numba",
        "rasterio",
        "laspy",
        "sqlalchemy",
        "matplotlib",
        "sklearn",
        "scipy",
    ]
    code = f"import sys, msbdb.cli.main; print([name for name in {heavy} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_classes_lists_and_relabels(api):
    """Without --set the classes are listed; with it they are labelled anew first."""
    listed = run("classes", "x")
    assert [name for name, _ in api.calls] == ["classes"]
    assert "building" in listed.stdout
    api.calls.clear()
    result = run("classes", "x", "--set", "3=vegetation", "--set", "7=building", "--survey", "spring", "--json")
    assert [name for name, _ in api.calls] == ["relabel", "classes"]
    values = api.calls[0][1]
    assert (values["db"], values["labels"], values["survey"]) == ("x", {3: "vegetation", 7: "building"}, "spring")
    printed = json.loads(result.stdout)
    assert printed["build"]["buildings"] == 3
    assert printed["classes"][1] == {"speindex": 2, "label": "other", "ndvi": None}


@pytest.mark.parametrize("wrong", ["3=tree", "three=water", "3"])
def test_a_wrong_label_is_refused(wrong, api):
    """A label that does not exist names those that do."""
    result = run("classes", "x", "--set", wrong)
    assert result.exit_code == 2
    assert "building, vegetation, shadow, water, other" in " ".join(result.stderr.split())
    assert not api.calls


def test_a_user_lists_and_runs_the_example_queries(api):
    """The list needs no database; rows keep their whole numbers; a value is handed over as it is written."""
    listed = run("query", "--list").stdout
    assert "tallest_buildings\n  Which are the tallest buildings" in listed
    assert "    count=10  how many to list" in listed
    assert {row["name"] for row in json.loads(run("query", "--list", "--json").stdout)} == set(example_queries())
    result = run("query", "x", "tallest_buildings", "--param", "count=3", "--param", "survey=a=b", "--json")
    assert json.loads(result.stdout) == {
        "query": "tallest_buildings",
        "parameters": {"count": 3, "survey": "a=b"},
        "rows": [{"building_id": 2**62 + 1, "storeys": None}],
    }
    assert api.calls == [
        ("query", {"db": "x", "name": "tallest_buildings", "parameters": {"count": "3", "survey": "a=b"}})
    ]
    assert str(2**62 + 1) in run("query", "x", "tallest_buildings").stdout


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ((), "msbdb query --list"),
        (("x",), "msbdb query --list"),
        (("x", "surveys", "--param", "survey"), "no parameter like survey=spring"),
        (("x", "surveys", "--param", "survey=a", "--param", "survey=b"), "more than once"),
    ],
)
def test_a_query_without_what_it_needs_is_refused(words, says, api):
    """The message has the next step."""
    result = run("query", *words)
    assert result.exit_code == 2
    assert says in result.stderr
    assert not api.calls


@pytest.mark.parametrize(
    ("words", "begun", "expected"),
    [
        (["query", "x.sqlite"], "tall", ["tall_buildings_near", "tallest_buildings"]),
        (["query", "x.sqlite", "tallest_buildings", "--param"], "", ["count=", "survey="]),
        (["que"], "", []),
    ],
)
def test_a_shell_completes_the_names_of_queries_and_parameters(words, begun, expected):
    """After the Tab key, where the shell's completion is on."""
    found = ShellComplete(cli, {}, "msbdb", "_MSBDB_COMPLETE").get_completions(words, begun)
    assert [item.value for item in found if not item.value.startswith("-")] == (expected or sorted(cli.commands))


def test_export_view_and_evaluate_pass_their_options(api):
    """The thin commands hand over what they are given."""
    Path("r.gpkg").touch()
    assert run("export", "x", "o.gpkg", "--overwrite", "--survey", "s").exit_code == 0
    assert run("view", "x", "--out", "f.png").exit_code == 0
    result = run("evaluate", "x", "--reference", "r.gpkg", "--layer", "b", "--overlap", "0.3", "--cell", "1")
    assert result.exit_code == 0
    name, values = api.calls[0]
    assert name == "export"
    given = {"db": "x", "out": Path("o.gpkg"), "layers": (), "survey": "s", "overwrite": True, "options": {}}
    assert {word: value for word, value in values.items() if value is not None} == given
    called = {
        "db": "x",
        "out": Path("f.png"),
        "survey": None,
        "what": "parts",
        "aoi": None,
        "ortho": None,
        "overwrite": False,
    }
    assert api.calls[1] == ("view", called)
    values = api.calls[2][1]
    assert (values["layer"], values["overlap"], values["cell_m"], values["aoi"]) == ("b", 0.3, 1.0, None)
    assert "0.912" in result.stdout
    assert result.stdout.startswith("Area: 91 % quality.\nBuildings: 3 are found.\nOutlines: 0.5 m off.\n")


@pytest.mark.parametrize(
    ("value", "says"),
    [
        ("https://example.org/a.laz", "is a URL; a file is expected. Download it first"),
        ("tiles", "is a folder; a file is expected"),
        ("none.laz", "does not exist"),
    ],
)
@pytest.mark.parametrize("option", ["--points", "--ortho", "--dtm", "--parcels", "--params"])
def test_a_user_gives_a_url_or_a_folder_for_a_file(option, value, says, api):
    """Each input says what it is and what to do."""
    Path("tiles").mkdir()
    result = run("build", option, value, "--db", "x")
    if option == "--points" and value != "none.laz":  # a folder stands for the files in it, and COPC may be remote
        assert api.calls[0][1]["points"] == (Path(value),)
        return
    assert result.exit_code == 2
    assert says in result.stderr
    assert not api.calls


def test_classify_passes_its_options_and_reports(api):
    """Names, lists, flags and parameters; notices go to the standard error."""
    for name in ("a.laz", "o.tif", "p.tif"):
        Path(name).touch()
    result = run(
        *("classify", "a.laz", "b.las", "--extract", "multiscale,adaptive", "--crs", "2154", "--ortho", "o.tif"),
        *("--ortho", "p.tif", "--set", "surface.mask_m=3", "--profile", "vu2009", "--keep", "--overwrite"),
    )
    assert result.exit_code == 0, result.stderr
    name, values = api.calls[0]
    assert name == "classify"
    assert (values["source"], values["out"]) == (Path("a.laz"), Path("b.las"))
    assert (values["extract"], values["crs"], values["profile"]) == (("multiscale", "adaptive"), "EPSG:2154", "vu2009")
    assert tuple(values["ortho"]) == (Path("o.tif"), Path("p.tif"))
    assert (values["keep"], values["overwrite"], values["params"].surface.mask_m) == (True, True, 3.0)
    assert "Notice: It is COPC." in result.stderr
    for line in ("regions by area3d 4", "building points 300", "written b.las"):
        assert line in " ".join(result.stdout.split())
    assert run("classify", "a.laz", "b.las").exit_code == 0
    assert (api.calls[1][1]["extract"], api.calls[1][1]["keep"]) == (DETECTORS, False)


def test_point_files_and_by_point_are_evaluated_by_point(api):
    """Each with the options that mean something for it."""
    Path("r.laz").touch()
    result = run("evaluate", "a.LAZ", "--reference", "r.laz", "--crs", "2154")
    assert result.exit_code == 0, result.stderr
    assert run("evaluate", "x", "--reference", "r.laz", "--by", "point", "--of", "area3d", "--json").exit_code == 0
    assert run("evaluate", "x", "--reference", "r.laz", "--by", "area").exit_code == 0
    names = [name for name, _ in api.calls]
    assert names == ["evaluate_points", "evaluate_points", "evaluate"]
    assert api.calls[0][1]["crs"] == "EPSG:2154"
    assert (api.calls[1][1]["found"], api.calls[1][1]["of"]) == ("x", "area3d")
    assert "order" in result.stdout


@pytest.mark.parametrize(
    ("args", "says"),
    [
        (["a.laz", "--overlap", "0.5"], "--overlap has no meaning for a comparison by point"),
        (["x", "--by", "point", "--layer", "b", "--cell", "1"], "--layer, --cell has no meaning"),
        (["a.laz", "--of", "parts"], "--of has no meaning for a file of points"),
        (["a.laz", "--survey", "s", "--by", "point"], "--survey has no meaning"),
        (["a.laz", "--by", "area"], "is compared by point"),
    ],
)
def test_options_without_effect_are_refused(args, says, api):
    """Rather than ignored."""
    Path("r.laz").touch()
    result = run("evaluate", *args, "--reference", "r.laz")
    assert result.exit_code == 2
    assert says in result.stderr
    assert api.calls == []


def test_params_lists_every_parameter():
    """The table names every declared parameter with its default; a profile shows its own value beside it."""
    printed = run("params").stdout
    for section, item, _ in declared.declared():
        assert f"{section}.{item.name} " in printed
    row = next(line for line in run("params", "--profile", "vu2009").stdout.splitlines() if "ground_filter" in line)
    assert '"auto"' in row
    assert '"wavelet"' in row


@pytest.mark.parametrize("name", list(declared.PROFILES))
def test_a_printed_parameter_file_reads_back(name, tmp_path):
    """'params --toml' is a file that 'build --params' takes and that gives the same values."""
    printed = run("params", "--toml", "--profile", name).stdout
    assert tomllib.loads(printed)
    path = tmp_path / "p.toml"
    path.write_text(printed, encoding="utf-8")
    assert declared.read_params(path, declared.Params()) == declared.profile(name)


def test_params_json_is_complete():
    """Each parameter comes with its value, default, unit, bounds, meaning and source."""
    rows = json.loads(run("params", "--json").stdout)
    assert len(rows) == len(list(declared.declared()))
    for row in rows:
        assert set(row) == {"name", "value", "default", "unit", "bounds", "doc", "source"}
        assert row["doc"]
        assert row["source"]


def test_results_are_legible(capsys):
    """Nested results print as sections and tables, and nothing is cut where the output is no terminal."""
    emit(
        {
            "name": "x" * 150,
            "area": {"quality": 0.5, "deep": {"n": 1}},
            "rows": [{"a": 1, "b": None}],
            "runs": [{"name": "spring", "survey": {"cell_m": 0.25}}],
            "none": [],
        }
    )
    printed = capsys.readouterr().out
    for expected in ("x" * 150, "0.5", "area · deep", "rows", "runs 1 · survey", "0.25"):
        assert expected in printed
    assert "{" not in printed
    assert text(True) == "yes"


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_shell_completes_commands_and_choices(shell, monkeypatch):
    """Each shell gets a script, which asks the program for the words."""
    monkeypatch.setenv("_MSBDB_COMPLETE", f"{shell}_source")
    script = CliRunner().invoke(cli, prog_name="msbdb")
    assert "_MSBDB_COMPLETE=" in script.output
    monkeypatch.setenv("_MSBDB_COMPLETE", "bash_complete")
    for words, expected in (("msbdb ex", "export"), ("msbdb view --what ar", "area3d")):
        monkeypatch.setenv("COMP_WORDS", words)
        monkeypatch.setenv("COMP_CWORD", str(words.count(" ")))
        assert f"plain,{expected}" in CliRunner().invoke(cli, prog_name="msbdb").output.splitlines()


@pytest.mark.parametrize(("words", "meant"), [(("infoo", "x"), "'info'"), (("db", "chekc", "x"), "'check'")])
def test_a_user_mistypes_a_command(words, meant):
    """The message has the command that is meant."""
    result = run(*words)
    assert result.exit_code == 2
    assert f"Did you mean {meant}?" in result.stderr


def test_a_user_draws_a_figure_that_could_not_be_written(api, tmp_path):
    """Every option that names a figure is refused before the build begins; no folder is made."""
    for name in ("a.laz", "there.png", "photo.png"):
        Path(name).write_bytes(b"mine")
    cases = {
        ("--figure", "x.tif"): ".png",
        ("--figure", "none/x.png"): "none does not exist",
        ("--figure", "there.png"): "--overwrite",
        ("--figure", "photo.png", "--ortho", "photo.png", "--overwrite"): "is the source itself",
        ("--figure", "x.png", "--denoising-figure", "x.png"): "name the same file",
        ("--figure", "."): ".png",
    }
    for words, says in cases.items():
        for command_ in (["build"], ["update", "--survey", "s", "--date", "2021"]):
            result = run(*command_, "--points", "a.laz", "--db", "x", *words)
            assert result.exit_code in (1, 2), words
            assert says in result.stderr, words
    assert not api.calls
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.laz", "photo.png", "there.png"]
    assert run("build", "--points", "a.laz", "--db", "x", "--figure", "there.png", "--overwrite").exit_code == 0
    assert api.calls[-1][1]["overwrite"]

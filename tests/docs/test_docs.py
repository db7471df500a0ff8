"""The documents tell the truth: generated pages are current, links lead somewhere, names exist."""

import itertools
import re
import shlex
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import click
import pytest

import msbdb
from msbdb.cli.main import cli

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])


def read(name: str) -> str:
    """Return the text of a page."""
    return (ROOT / name).read_text(encoding="utf-8")


def commands_in(text: str) -> list[list[str]]:
    """Return the words of every command line of msbdb in a page's shell blocks and inline code."""
    blocks = re.findall(r"```sh\n(.*?)```", text, flags=re.DOTALL)
    lines = [line for block in blocks for line in block.splitlines()]
    lines += re.findall(r"`((?:msbdb) [^`]*)`", text)
    words = [shlex.split(line, comments=True) for line in lines if re.match(r"(\.venv/bin/)?msbdb ", line)]
    return [line[1:] for line in words]


def test_generated_pages_are_current():
    """docs/cli.md, docs/parameters.md and docs/fields.md are what scripts/generate_docs writes today."""
    done = subprocess.run(
        [sys.executable, str(ROOT / "scripts/generate_docs"), "--check"],
        capture_output=True,
        text=True,
        cwd=ROOT,
        env={"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin"},
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("name", sorted(cli.commands))
def test_every_command_has_its_place(name):
    """A command has a section in docs/cli.md that names all its options."""
    section = read("docs/cli.md").split(f"## msbdb {name}\n", 1)[1].split("\n## ", 1)[0]
    for param in cli.commands[name].params:
        if param.param_type_name == "option":
            assert param.opts[-1] in section


def rows_of_rooms():
    """Return the rows of the table in ARCHITECTURE.md: the rooms of a row, and the libraries it is the home of."""
    rows = re.findall(r"^\| (`\w+`(?:, `\w+`)*) \|[^|]*\| ?([^|]*) ?\|$", read("ARCHITECTURE.md"), flags=re.MULTILINE)
    return [(re.findall(r"\w+", rooms), re.findall(r"[\w-]+", libraries)) for rooms, libraries in rows]


def test_every_room_is_in_the_architecture():
    """ARCHITECTURE.md lists each package and module of msbdb once, and none that does not exist."""
    listed = sorted(room for rooms, _ in rows_of_rooms() for room in rooms)
    packages = {path.parent.name for path in ROOT.glob("msbdb/*/__init__.py")}
    modules = {path.stem for path in ROOT.glob("msbdb/*.py")} - {"__init__", "__main__"}
    assert listed == sorted(packages | modules)


def test_the_architecture_keeps_the_layers_of_the_linter():
    """Going down the rows of ARCHITECTURE.md one goes down the import-linter contract; a layer may have many rows."""
    row = {room: number for number, (rooms, _) in enumerate(rows_of_rooms()) for room in rooms}
    contract = re.search(r"layers = \[(.*?)\n\]", read("pyproject.toml"), flags=re.DOTALL)
    assert contract is not None
    order = [re.findall(r"msbdb\.(\w+)", line) for line in contract[1].splitlines() if "msbdb." in line]
    layers = [[row[room] for room in rooms] for rooms in order]
    assert len(layers) > 10
    for upper, lower in itertools.pairwise(layers):
        assert max(upper) < min(lower)


def test_each_library_has_one_home():
    """A library that ARCHITECTURE.md gives one home is imported by no other room."""
    homes = {
        library.replace("scikit-learn", "sklearn"): rooms[0] for rooms, names in rows_of_rooms() for library in names
    }
    assert {"click", "laspy", "sqlalchemy", "matplotlib"} <= set(homes)
    exceptions = {("outline", "rasterio.features"), ("database", "rasterio"), ("database", "pyogrio")}
    for path in ROOT.glob("msbdb/**/*.py"):
        room = path.relative_to(ROOT / "msbdb").parts[0].removesuffix(".py")
        imported = re.findall(r"^\s*(?:import|from) ([\w.]+)", path.read_text(encoding="utf-8"), flags=re.MULTILINE)
        for name in imported:
            home = homes.get(name.split(".")[0], room)
            assert room == home or (room, name) in exceptions, f"{path} imports {name}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page):
    """Every relative link of a page leads to a file, and every anchor to a heading."""
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if target.startswith(("http:", "https:")):
            continue
        path, _, anchor = target.partition("#")
        found = (page.parent / path) if path else page
        assert found.exists(), target
        if anchor:
            headings = re.findall(r"^#+ (.*)$", found.read_text(encoding="utf-8"), flags=re.MULTILINE)
            assert anchor in {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_every_decision_is_listed():
    """The list of decisions holds every page beside it, and no number twice."""
    pages = sorted(path.name for path in ROOT.glob("docs/decisions/0*.md"))
    assert re.findall(r"\]\((0[^)]*)\)", read("docs/decisions/README.md")) == pages
    assert len({name[:4] for name in pages}) == len(pages)


def test_command_lines_of_the_docs_exist():
    """Each command line of the pages names a command and options that exist."""
    found = {str(page.relative_to(ROOT)): commands_in(page.read_text(encoding="utf-8")) for page in PAGES}
    with_commands = {name for name, lines in found.items() if lines}
    assert {"README.md", "docs/inputs.md", "docs/inventory.md", "docs/database.md"} <= with_commands
    for name, lines in found.items():
        for words in lines:
            command = cli.commands[words[0]]
            if isinstance(command, click.Group):
                command = command.commands[words[1]]
            known = {opt for param in command.params for opt in param.opts}
            assert {word for word in words if word.startswith("-")} <= known, (name, words)


def test_parameters_that_the_docs_name_exist():
    """Each `section.name` of the pages is a parameter."""
    sections = asdict(msbdb.profile())
    for page in PAGES:
        for section, name in re.findall(r"`(\w+)\.(\w+)(?: ?=[^`]*)?`", page.read_text(encoding="utf-8")):
            if section in sections:
                assert name in sections[section], (page.name, f"{section}.{name}")


def test_scripts_that_the_docs_name_exist():
    """Every script of the README is there and can be run."""
    for name in set(re.findall(r"\bscripts/\w+", read("README.md"))):
        assert (ROOT / name).stat().st_mode & 0o111, name


@pytest.mark.parametrize("name", ["scripts/setup", "scripts/demo", "scripts/test", ".ci/run"])
def test_shell_scripts_are_sound(name):
    """Each script is bash without mistakes of grammar, and stops at the first failure."""
    assert subprocess.run(["bash", "-n", str(ROOT / name)], check=False).returncode == 0
    assert "set -euo pipefail" in read(name)


def test_python_of_the_readme_exists():
    """The Python of the README is Python, and the names of msbdb that it uses are public."""
    blocks = re.findall(r"```python\n(.*?)```", read("README.md"), flags=re.DOTALL)
    assert blocks
    for block in blocks:
        compile(block, "README.md", "exec")
        assert set(re.findall(r"\bmsbdb\.(\w+)", block)) <= set(msbdb.__all__)


@pytest.mark.parametrize("page", ["README.md", "docs/columns.md"])
def test_sql_of_the_docs_runs(page, tmp_path):
    """Every SQL statement of a page is understood by a database as msbdb makes it."""
    import sqlalchemy

    from msbdb.database import open_database

    blocks = re.findall(r"```sql\n(.*?)```", read(page), flags=re.DOTALL)
    statements = [statement for block in blocks for statement in block.split(";") if statement.strip()]
    assert statements
    engine = open_database(tmp_path / "town.sqlite", create=True, srid=2154)
    with engine.connect() as connection:
        for statement in statements:
            connection.execute(sqlalchemy.text(statement), {"building": 1} if ":building" in statement else {}).all()
    engine.dispose()


def test_paper_names_of_the_glossary_are_those_of_the_export():
    """The glossary's columns and paper names are the ones that the Shapefile has."""
    from msbdb.export.fields import PAPER

    text = read("docs/glossary.md")
    for column, name in PAPER.items():
        if column != "part_id":
            assert name in text
            assert f"`{column}`" in text

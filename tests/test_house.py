"""The house itself: rooms that the architecture names, whole modules, and names that are used once."""

import ast
import importlib
import importlib.metadata
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import msbdb

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "msbdb"

MIRRORS = {"params", "cli", "api", "run"}
"""Rooms whose modules are named after what they declare, show, publish or compose."""


def modules() -> Iterator[Path]:
    """Yield the modules of the package, without the files that only make a folder a package."""
    return (path for path in PACKAGE.rglob("*.py") if path.name != "__init__.py")


def public_classes(path: Path) -> list[str]:
    """Return the names of the public classes that a module defines."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return [node.name for node in tree.body if isinstance(node, ast.ClassDef) and not node.name.startswith("_")]


def test_the_architecture_names_every_room_and_no_other():
    """The table of rooms lists exactly the folders and modules of the package's first level."""
    page = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")
    table = page[page.index("| room |") : page.index("Exceptions:")]
    named = {
        name.strip("` ")
        for line in table.splitlines()[2:]
        if line.startswith("|")
        for name in line.split("|")[1].split(",")
    }
    found = {path.stem for path in PACKAGE.iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()}
    assert named - {""} == found - {"__init__", "__main__"}


def test_a_folder_has_at_most_a_dozen_modules():
    """A room that one can look through."""
    crowded = {
        str(folder.relative_to(PACKAGE)): count
        for folder in [PACKAGE, *(path.parent for path in PACKAGE.rglob("__init__.py"))]
        if folder != PACKAGE and (count := sum(path.parent == folder for path in modules())) > 12
    }
    assert not crowded


def test_a_module_is_named_once():
    """A module's name says its idea without its folder; only mirrors share names."""
    homes = defaultdict(list)
    for path in modules():
        if path.relative_to(PACKAGE).parts[0] not in MIRRORS:
            homes[path.stem].append(str(path.relative_to(PACKAGE)))
    assert not {name: places for name, places in homes.items() if len(places) > 1}


def test_a_public_class_is_named_once():
    """No two public classes of the package share a name."""
    homes = defaultdict(list)
    for path in modules():
        for name in public_classes(path):
            homes[name].append(str(path.relative_to(PACKAGE)))
    assert not {name: places for name, places in homes.items() if len(places) > 1}


def test_scripts_import_what_there_is():
    """No script, most of which have no suffix, names a module or a name of the package that has moved."""
    scripts = [path for path in (ROOT / "scripts").rglob("*") if path.is_file()]
    texts = {path: path.read_bytes() for path in scripts if "__pycache__" not in path.parts}
    python = {path: text for path, text in texts.items() if path.suffix == ".py" or b"python" in text.split(b"\n")[0]}
    imports = [
        (path.name, node.module, name.name)
        for path, text in python.items()
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "msbdb"
        for name in node.names
    ]
    assert ("touching", "msbdb.fuse.houses.touching", "divide") in imports
    missing = []
    for script, module, name in imports:
        try:
            if not hasattr(importlib.import_module(module), name):
                importlib.import_module(f"{module}.{name}")
        except ModuleNotFoundError:
            missing.append((script, module, name))
    assert not missing


def test_every_module_and_room_begins_with_a_sentence():
    """The first line of each docstring says what lives there."""
    for path in PACKAGE.rglob("*.py"):
        first = (ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "").split("\n")[0]
        assert first.endswith((".", ":")), path


def test_the_public_names_are_seen_by_completion():
    """The public interface is a plain list of imports."""
    assert set(msbdb.__all__) <= set(dir(msbdb))
    assert msbdb.__version__ == importlib.metadata.version("msbdb")


def test_importing_the_package_loads_no_heavy_library():
    """``import msbdb`` loads none of the libraries that take time, so that it stays quick."""
    heavy = {
        "numpy",
        "pandas",
        "scipy",
        "numba",
        "sqlalchemy",
        "geopandas",
        "rasterio",
        "matplotlib",
        "sklearn",
        "laspy",
    }
    code = "import sys, msbdb, msbdb.cli.main; print(*sorted({name.split('.')[0] for name in sys.modules}))"
    loaded = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout.split()
    assert not heavy & set(loaded)

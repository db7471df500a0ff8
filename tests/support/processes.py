"""Other processes that the tests start: the project's scripts, and Python with the tests' own modules."""

import os
import subprocess
import sys
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).resolve().parents[2]
BENCHMARKS = ROOT / "scripts" / "benchmarks"
PATHS = (ROOT, ROOT / "tests", BENCHMARKS)


def environment(**more: str) -> dict[str, str]:
    """Return this process's environment, in which Python finds msbdb and the modules of tests and benchmarks."""
    return {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, PATHS)), **more}


def run_script(path: Path, *words: object) -> subprocess.CompletedProcess[str]:
    """Run a script of this project with this Python, and return its exit code and what it printed."""
    command = [sys.executable, "-B", str(path), *map(str, words)]
    return subprocess.run(command, env=environment(), capture_output=True, text=True, check=False)


def load_script(path: Path) -> ModuleType:
    """Return a script, whose name has no suffix, as a module."""
    loader = SourceFileLoader(f"script_{path.name}", str(path))
    spec = spec_from_loader(loader.name, loader)
    assert spec is not None
    module = module_from_spec(spec)
    sys.modules[loader.name] = module
    # Without a bytecode file beside the script.
    written, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    loader.exec_module(module)
    sys.dont_write_bytecode = written
    return module

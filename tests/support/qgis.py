"""Debian's QGIS without a screen: it opens what msbdb wrote, in a process of its own, and says what it finds."""

import functools
import json
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import pytest

from support.processes import ROOT

PYTHON = "/usr/bin/python3"
"""The Python for which Debian installs the modules of QGIS."""


@functools.cache
def is_installed() -> bool:
    """Return whether that Python has QGIS."""
    if not Path(PYTHON).exists():
        return False
    return subprocess.run([PYTHON, "-c", "import qgis.core"], capture_output=True, check=False).returncode == 0


def opened_by_qgis(*targets: object) -> list[dict[str, dict[str, Any]]]:
    """Return what QGIS finds in each target, by layer (``scripts/check_qgis``).

    The test is skipped where QGIS is not installed, and fails where QGIS complains or something is wrong.
    """
    if not is_installed():
        pytest.skip("QGIS is not installed (apt-get install python3-qgis qgis-providers)")
    with tempfile.TemporaryDirectory() as home:
        environment = {"QT_QPA_PLATFORM": "offscreen", "HOME": home, "PATH": "/usr/bin:/bin"}
        words = [PYTHON, "-B", str(ROOT / "scripts" / "check_qgis"), *map(str, targets), "--json"]
        done = subprocess.run(words, capture_output=True, text=True, env=environment, check=False)
    assert done.stdout, done.stderr
    found = {target: {row["layer"]: row for row in rows} for target, rows in json.loads(done.stdout).items()}
    wrong = {name: row["faults"] for rows in found.values() for name, row in rows.items() if row["faults"]}
    assert not wrong
    assert done.returncode == 0, done.stderr
    assert "warning" not in done.stderr.lower(), done.stderr
    return list(found.values())

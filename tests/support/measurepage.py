"""Measure the page of a large simulated town: how long it takes to open, and its size.

A district of 100 houses is built by the real stages. What its page holds is repeated until the town has as many
buildings as asked. Chromium opens the page from the disk without a graphics card (SwiftShader); with one it is faster.

Examples
--------
    python tests/support/measurepage.py                          10,000 buildings
    python tests/support/measurepage.py --buildings 100000 --picture town.png
"""

import argparse
import json
import math
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import patch

import geopandas as gpd
import numpy as np
import pandas as pd
import psutil
import shapely

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests"))

from msbdb.database import open_database, write_build  # noqa: E402
from msbdb.kept import KeptRun  # noqa: E402
from msbdb.run import townpage as made  # noqa: E402
from msbdb.view.page import DEGREE, read_library, write_page  # noqa: E402
from support.browser import PATIENCE_MS, browser  # noqa: E402  (the tests' own folder)
from support.towns import EPSG, House, town_build  # noqa: E402

SIDE, PITCH_M = 10, 24.0
"""Houses a side of a district, and the distance from one to the next."""

STEP = (30_000, 23_000)
"""From one district to the next, to the east and to the north: 240 m and some more, in steps of 10⁻⁷ degrees."""


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


def page_values(folder: Path, *, tiled: bool) -> tuple[dict[str, Any], gpd.GeoDataFrame | None]:
    """Return what the page of one district holds; with tiles its outlines are a frame."""
    engine = open_database(folder / "district.sqlite", create=True, srid=EPSG)
    write_build(engine, district())
    with patch.object(made, "FEW_PARTS", 0 if tiled else made.MOST_PARTS):
        town = made.town_of(folder / "district.sqlite", engine, made.choose(engine, None))
    engine.dispose()
    return town, town.pop("outlines", None)


def repeated(town: dict[str, Any], across: int, along: int) -> dict[str, Any]:
    """Return a town of as many districts side by side, each with ids and numbers of its own."""
    buildings, parts, blocks = town["buildings"], town["parts"], town["blocks"]
    places = [(n, STEP[0] * (n % across), STEP[1] * (n // across)) for n in range(across * along)]

    def each(rows: list[Any], change: Callable[[Any, int, int, int], Any] = lambda own, *_: own) -> list[Any]:
        return [change(own, *place) for place in places for own in rows]

    def number(count: int) -> Callable[[int, int, int, int], int]:
        return lambda own, n, *_: own if own < 0 else own + n * count

    def moved(shape: list[Any], _: int, dx: int, dy: int) -> list[Any]:
        return [[[ring[0] + dx, ring[1] + dy, *ring[2:]] for ring in polygon] for polygon in shape]

    ways: dict[str, Callable[..., Any]] = {
        "id": lambda own, n, *_: str(int(own) + n),
        "shape": moved,
        "box": lambda own, _, dx, dy: [own[0] + dx, own[1] + dy, own[2] + dx, own[3] + dy],
        "building": number(len(buildings["id"])),
        "father": number(len(parts["id"])),
        "part": number(len(parts["id"])),
    }
    large = [
        {name: each(rows, *filter(None, [ways.get(name)])) for name, rows in table.items() if isinstance(rows, list)}
        for table in (buildings, parts, blocks)
    ]
    for group in ("values", "shares"):
        large[0][group] = {name: each(rows) for name, rows in buildings[group].items()}
    west, south = np.min(town["place"]["corners"], axis=0).tolist()
    corners = [[west + (x - west) * across, south + (y - south) * along] for x, y in town["place"]["corners"]]
    return town | {
        "buildings": large[0], "parts": large[1], "blocks": large[2], "place": town["place"] | {"corners": corners}
    }  # fmt: skip


def repeated_outlines(town: dict[str, Any], outlines: gpd.GeoDataFrame, across: int, along: int) -> gpd.GeoDataFrame:
    """Return the outlines of `repeated`, of which ``town`` is one district."""
    rows, parts, blocks = (
        len(town[name][key]) for name, key in (("buildings", "id"), ("parts", "id"), ("blocks", "part"))
    )
    districts = across * along
    frames = []
    for n in range(districts):
        move = np.array([STEP[0] * (n % across), STEP[1] * (n // across)]) / DEGREE
        number = outlines["n"].to_numpy()
        single = number < rows
        frames.append(outlines.assign(
            n=number + np.where(single, n * rows, (districts - 1) * rows + n * blocks), row=outlines["row"] + n * rows,
            part=np.where(single, -1, outlines["part"] + n * parts),
            geometry=shapely.transform(outlines.geometry.to_numpy(), lambda xy, move=move: xy + move),
        ))  # fmt: skip
    return gpd.GeoDataFrame(pd.concat(frames, ignore_index=True).sort_values("n", ignore_index=True), crs=outlines.crs)


def processor_s() -> float:
    """Return the processor seconds of the programs that this one started, the browser among them."""
    own = psutil.Process()
    return sum(sum(child.cpu_times()[:2]) for child in own.children(recursive=True))


def opened(page: Path, picture: Path | None) -> dict[str, float]:
    """Open the page, and return the seconds until it could be used, and those of the processor."""
    with browser() as chromium:
        sheet = chromium.new_page(viewport={"width": 1200, "height": 800})
        sheet.set_default_timeout(PATIENCE_MS * 3)
        complaints: list[str] = []
        sheet.on("console", lambda message: complaints.append(message.text))
        sheet.on("pageerror", lambda error: complaints.append(str(error)))
        begin = processor_s()
        sheet.goto(page.as_uri())
        sheet.wait_for_selector("html[data-ready]")
        ready = float(sheet.evaluate("document.documentElement.dataset.ready")) / 1000
        spent = processor_s() - begin
        if picture:
            sheet.screenshot(path=picture)
        if complaints:
            sys.stderr.write(f"{complaints}\n")
        return {"ready_s": ready, "ready_cpu_s": round(spent, 1)}


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--buildings", type=int, default=10_000)
    parser.add_argument("--keep", type=Path, help="a folder for the page")
    parser.add_argument("--picture", type=Path)
    asked = parser.parse_args()
    across = round(math.sqrt(asked.buildings / SIDE**2))
    along = -(-asked.buildings // (SIDE**2 * across))
    with tempfile.TemporaryDirectory() as name:
        town, outlines = page_values(Path(name), tiled=False)
        rows = (len(town["buildings"]["id"]) + len(town["parts"]["id"])) * across * along
        if rows > made.FEW_PARTS:
            (Path(name) / "district.sqlite").unlink()
            town, outlines = page_values(Path(name), tiled=True)
        begin = time.process_time()
        archives = (
            ()
            if outlines is None
            else made.archives_of(repeated_outlines(town, outlines, across, along), len(town["scales"]))
        )
        found = {
            "buildings": SIDE**2 * across * along,
            "rows": rows,
            "tiles_cpu_s": round(time.process_time() - begin, 1),
        }
        page = (asked.keep or Path(name)) / f"town{asked.buildings}.html"
        write_page(repeated(town, across, along), page, read_library(), archives)
        found["page_mb"] = round(page.stat().st_size / 1e6, 1)
        sys.stdout.write(f"{json.dumps(found | opened(page, asked.picture))}\n")


if __name__ == "__main__":
    main()

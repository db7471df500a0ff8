"""Three real tiles, built into a SpatiaLite file and into PostGIS, give the same content; skipped without the tiles."""

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import laspy
import pytest

import msbdb
from msbdb.database import canonical_dump, check_database, copy_database, open_database

DATA = os.environ.get("MSBDB_DATA", "")
pytestmark = [
    pytest.mark.data,
    pytest.mark.postgis,
    pytest.mark.skipif(not DATA, reason="MSBDB_DATA names no real tiles"),
]


@dataclass(frozen=True)
class Tile:
    """A window of a real tile: western and southern edge, and side, in metres."""

    points: str
    crs: str
    west: float
    south: float
    side: float
    ortho: tuple[str, ...] = ()


TILES = {
    "Nîmes": Tile("nimes/points.laz", "EPSG:2154", 0.2, 0.2, 160.0),
    "Delft": Tile("delft/delft_1.laz", "EPSG:28992", 0.3, 0.3, 100.0),
    "Montpellier": Tile(
        "montpellier/points.laz",
        "EPSG:2154",
        0.2,
        0.2,
        80.0,
        ("montpellier/ortho_rgb.tif", "montpellier/ortho_irc.tif"),
    ),
}
"""Edges as shares of the whole tile."""


def window(tile: Tile, folder: Path) -> Path:
    """Write the points of a tile's window."""
    las = laspy.read(Path(DATA) / tile.points)
    (west, south, _), (east, north, _) = las.header.mins, las.header.maxs
    x, y = las.x - (west + tile.west * (east - west)), las.y - (south + tile.south * (north - south))
    las.points = las.points[(x >= 0) & (x < tile.side) & (y >= 0) & (y < tile.side)]
    path = folder / "window.laz"
    las.write(path)
    return path


@pytest.mark.parametrize("name", TILES)
def test_both_dialects_hold_the_same_of_a_real_tile(name: str, tmp_path: Path, new_postgis: Callable[[], str]) -> None:
    """Built and taken into the inventory on each: equal dumps, nothing that the check finds, and so are copies."""
    tile = TILES[name]
    points = window(tile, tmp_path)
    places = [str(tmp_path / "town.sqlite"), new_postgis()]
    for place in places:
        options = {"ortho": [Path(DATA) / ortho for ortho in tile.ortho], "ortho_crs": tile.crs} if tile.ortho else {}
        msbdb.update([points], db=place, survey=name, date="2021-06-01", crs=tile.crs, **options)
    engines = [open_database(place) for place in places]
    dumps = [list(canonical_dump(engine, provenance=True)) for engine in engines]
    assert [check_database(engine) for engine in engines] == [[], []]
    tables = {line.split(",", 1)[0] for line in dumps[0]}
    assert {f'["{table}"' for table in ("part", "building", "candidate_region", "building_version")} <= tables
    assert dumps[0] == dumps[1]
    copies = [new_postgis(), str(tmp_path / "copy.sqlite")]
    for place, copied in zip(places, copies, strict=True):
        copy_database(place, copied)
        assert list(canonical_dump(open_database(copied), provenance=True)) == dumps[0]

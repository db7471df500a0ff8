"""Footprints that are measured on a survey in tiles: the content of the measurement on one piece."""

from pathlib import Path

import geopandas as gpd
import shapely
from support.tiledtown import TILE_M, town, write_rasters, write_town

import msbdb
from msbdb.database import canonical_dump, check_database, opened

CORNER = (389_040.0, 5_821_020.0)

HOUSES = {
    "west half of the ring": (44, 44, 61, 78),
    "east half of the ring": (61, 44, 78, 78),
    "hall": (52, 95, 72, 109),
    "west": (15, 20, 29, 32),
    "nothing": (100, 50, 110, 60),
}
"""Footprints by their name: west, south, east and north from the corner, metres. The ring lies over four tiles."""


def lines(db: Path) -> list[str]:
    """Return the lines of the dump of a sound database, without the counts of runs: of tiles some are not known."""
    with opened(db) as engine:
        found = [line for line in canonical_dump(engine) if not line.startswith('["run", ')]
        assert not check_database(engine)
    return found


def footprints(folder: Path) -> Path:
    """Write the footprints with their names, and return the file."""
    west, south = CORNER
    shapes = [shapely.box(west + w, south + s, west + e, south + n) for w, s, e, n in HOUSES.values()]
    path = folder / "footprints.gpkg"
    gpd.GeoDataFrame({"name": list(HOUSES)}, geometry=shapes, crs=town().points.crs).to_file(path)
    return path


def test_footprints_are_measured_on_tiles_as_on_one_piece(tmp_path):
    """All rows of all tables are equal, the inventory's with them, and all rasters."""
    files, given = write_town(tmp_path / "points"), {"survey": "town", "date": "2020-05-01", "id_column": "name"}
    shapes = footprints(tmp_path)
    whole = msbdb.measure(shapes, files, db=tmp_path / "one.sqlite", **given)
    tiled = msbdb.measure(shapes, files, db=tmp_path / "tiles.sqlite", **given, tile=TILE_M)
    assert (tiled.states, tiled.footprints, tiled.others) == (whole.states, whole.footprints, whole.others)
    assert tiled.footprints == len(HOUSES)
    assert tiled.others == 2  # the houses in the south and in the east have no footprint
    assert len(msbdb.tiles(tmp_path / "tiles.sqlite")) == 4
    assert lines(tmp_path / "tiles.sqlite") == lines(tmp_path / "one.sqlite")


def test_footprints_are_measured_on_rasters_in_tiles(tmp_path):
    """As on one piece of the same rasters, which lie beside the absolute lattice."""
    given = write_rasters(tmp_path / "rasters") | {"survey": "town", "date": "2020-05-01", "id_column": "name"}
    shapes = footprints(tmp_path)
    whole = msbdb.measure(shapes, db=tmp_path / "one.sqlite", **given)
    tiled = msbdb.measure(shapes, db=tmp_path / "tiles.sqlite", **given, tile=TILE_M)
    assert (tiled.states, tiled.footprints, tiled.others) == (whole.states, whole.footprints, whole.others)
    assert tiled.footprints == len(HOUSES)
    assert lines(tmp_path / "tiles.sqlite") == lines(tmp_path / "one.sqlite")

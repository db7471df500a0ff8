"""The tiles of a survey in the database: built there by every dialect alike, with a way back to the older schema."""

import numpy as np
import pytest
from sqlalchemy import text
from support.tiledtown import TILE_M, write_town

import msbdb
from msbdb.database import (
    OutdatedError,
    RasterWindows,
    canonical_dump,
    check_database,
    copy_database,
    downgrade_schema,
    open_database,
    read_rasters,
    upgrade_schema,
)
from msbdb.database.dialects.migration import head_version


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Return the files of the town."""
    return write_town(tmp_path_factory.mktemp("town"))


def dump(db):
    """Return the lines of the dump."""
    engine = open_database(db)
    found = list(canonical_dump(engine))
    engine.dispose()
    return found


def test_tiles_are_built_into_every_dialect(files, target, tmp_path):
    """The server keeps the results of its tiles until they are merged; the content is that of a file."""
    given = {"survey": "town", "extract": "multiscale", "tile": TILE_M}
    assert msbdb.build(files, db=target, **given).changed
    assert not msbdb.build(files, db=target, **given).changed
    msbdb.build(files, db=tmp_path / "file.sqlite", **given)
    assert dump(target) == dump(tmp_path / "file.sqlite")
    engine = open_database(target)
    assert not check_database(engine)
    every, some = read_rasters(engine), read_rasters(engine, more=["terrain_cm"])
    assert some.by_name().keys() == {"ndsm_cm", "valid", "structure", "terrain_cm"} < every.by_name().keys()
    assert all(np.array_equal(cells, every.by_name()[name]) for name, cells in some.by_name().items())
    with engine.begin() as connection:
        assert connection.scalar(text("SELECT count(*) FROM tile WHERE state = 'done' AND result IS NULL")) == 4
        connection.execute(text("DELETE FROM raster_tile WHERE name = 'valid'"))
    assert {finding.check for finding in check_database(engine)} == {"rasters", "content"}
    engine.dispose()


@pytest.mark.parametrize("tile", [TILE_M, None], ids=["pieces", "whole"])
def test_rasters_are_read_by_windows(files, target, tile):
    """Windows at will, one after the other, are the cells of the whole, over the edges of pieces, too."""
    msbdb.build(files, db=target, survey="town", extract="multiscale", tile=tile)
    engine, random = open_database(target), np.random.default_rng(0)
    whole, reader = read_rasters(engine).by_name(), RasterWindows(engine, "town")
    assert reader.names == set(whole)
    for _ in range(10):
        rows, cols = (slice(*sorted(random.choice(size + 1, 2, replace=False))) for size in whole["valid"].shape)
        for name in ("ndsm_cm", "valid", "terrain_cm"):
            assert np.array_equal(reader.read(name, rows, cols), whole[name][rows, cols])
    engine.dispose()


def test_a_window_of_a_replaced_run_is_refused(files, target):
    """Others may build the survey again meanwhile; cells of two builds are never mixed."""
    msbdb.build(files, db=target, survey="town", extract="multiscale", tile=TILE_M)
    engine = open_database(target)
    reader = RasterWindows(engine, "town")
    msbdb.build(files, db=target, survey="town", extract="multiscale", replace=True)
    with pytest.raises(OutdatedError):
        reader.read("valid", slice(0, 4), slice(0, 4))
    engine.dispose()


def test_pieces_are_copied(files, target, tmp_path):
    """A copy has the rows of the tiles and the pieces of their rasters."""
    msbdb.build(files, db=tmp_path / "town.sqlite", survey="town", extract="multiscale", tile=TILE_M)
    copy_database(tmp_path / "town.sqlite", tmp_path / "copy.sqlite")
    assert dump(tmp_path / "copy.sqlite") == dump(tmp_path / "town.sqlite")
    assert msbdb.tiles(tmp_path / "copy.sqlite") == msbdb.tiles(tmp_path / "town.sqlite")


def test_the_tables_come_and_go_with_the_schema_0008(target):
    """Without a survey in tiles nothing is lost."""
    open_database(target, create=True, srid=32633).dispose()
    before, after, lost = downgrade_schema(target, "0007", force=False)
    assert (before, after, lost) == (head_version(), "0007", [])
    upgrade_schema(target)
    assert msbdb.tiles(target) == []

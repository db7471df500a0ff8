"""The inventory is updated by surveys in tiles as by surveys in one piece, on both dialects."""

from functools import partial

import pytest
from support.tiledtown import TILE_M, write_town

import msbdb
from msbdb.database import canonical_dump, check_database, opened
from msbdb.errors import TilesError
from msbdb.run.inventory import ground, update
from msbdb.scale import tilework

ONE = {"extract": "multiscale"}
TILES = {**ONE, "tile": TILE_M}


@pytest.fixture(scope="module")
def epochs(tmp_path_factory):
    """Return the files of two surveys, between which a house was pulled down, with their names and dates."""
    folder = tmp_path_factory.mktemp("epochs")
    older, newer = write_town(folder / "older"), write_town(folder / "newer", without="west")
    return [(older, {"survey": "older", "date": "2015"}), (newer, {"survey": "newer", "date": "2020"})]


@pytest.fixture(scope="module")
def expected(epochs, tmp_path_factory):
    """Return the dump after two updates by surveys in one piece."""
    db = tmp_path_factory.mktemp("whole") / "town.sqlite"
    for files, words in epochs:
        report = msbdb.update(files, db=db, **words, **ONE)
    assert report.inventory.counts == {"unchanged": 4, "demolished": 1, "versions": 0}
    return content(db)


def content(db):
    """Return the lines of the dump of a sound database, without the counts of the runs, which tiles do not have."""
    with opened(db) as engine:
        assert not check_database(engine)
        return [line for line in canonical_dump(engine) if not line.startswith('["run", ')]


def test_updates_in_tiles_end_as_those_in_one_piece(target, epochs, expected):
    """The content is the same; a repetition builds nothing, whichever way it asks for."""
    for files, words in epochs:
        assert msbdb.update(files, db=target, **words, **TILES).build.changed
    assert content(target) == expected
    for how in (TILES, ONE):
        again = msbdb.update(epochs[1][0], db=target, **epochs[1][1], **how)
        assert (again.build, again.inventory.status) == (None, "unchanged")
    assert content(target) == expected


@pytest.mark.parametrize("how", [TILES, ONE], ids=["tiles", "one"])
def test_a_comparison_by_small_windows_ends_as_one_of_the_whole(target, epochs, expected, how, monkeypatch):
    """Windows of 10 m, smaller than each house: rasters in pieces and whole ones are read alike."""
    monkeypatch.setattr(update, "compare", partial(update.compare, window_cells=10))
    monkeypatch.setattr(ground, "WINDOW_CELLS", 10)
    for files, words in epochs:
        msbdb.update(files, db=target, **words, **how)
    assert content(target) == expected


def test_an_update_with_a_failed_tile_is_resumed(target, epochs, expected, monkeypatch):
    """The inventory stays until all tiles are done; the repetition builds the one tile, and completes the update."""
    original, built = tilework.find_regions, []

    def fails(job, plan, stages, window):
        built.append(window.own)
        if broken and len(built) == 2:
            msg = "the disk is on fire"
            raise OSError(msg)
        return original(job, plan, stages, window)

    (older, first), (newer, second) = epochs
    msbdb.update(older, db=target, **first, **ONE)
    before = content(target)
    monkeypatch.setattr(tilework, "find_regions", fails)
    broken = True
    with pytest.raises(TilesError, match="--resume"):
        msbdb.update(newer, db=target, **second, **TILES)
    assert content(target) == before
    broken, built[:] = False, []
    msbdb.update(newer, db=target, **second, **TILES, resume=True)
    assert len(built) == 1
    assert content(target) == expected

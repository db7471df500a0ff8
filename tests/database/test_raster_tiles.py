"""Builds in tiles from rasters, killed or by several workers: the dump of one process, on both dialects."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from support.processes import environment
from support.tiledtown import KILLED, TILE_M, write_rasters

import msbdb
from msbdb.database import canonical_dump, check_database, opened, tiles_with_results

GIVEN = {"survey": "town", "extract": "multiscale", "tile": TILE_M}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Return DSM, DTM and orthophoto of the town by role."""
    return write_rasters(tmp_path_factory.mktemp("town"))


@pytest.fixture(scope="module")
def expected(files: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Return the dump of the town that one process builds in tiles, undisturbed."""
    db = tmp_path_factory.mktemp("quick") / "town.sqlite"
    msbdb.build(**files, db=db, **GIVEN)
    return dump(db)


def dump(db: str | Path) -> list[str]:
    """Return the lines of the dump of a sound database without results of tiles."""
    with opened(db) as engine:
        assert not check_database(engine)
        assert not tiles_with_results(engine, "town")
        return list(canonical_dump(engine))


@pytest.mark.postgis
def test_processes_build_rasters_into_a_server(new_postgis, files, expected) -> None:
    """Two workers write their tiles into PostGIS themselves; the dump is that of one process and a file."""
    pytest.importorskip("distributed")
    target = new_postgis()
    assert msbdb.build(**files, db=target, **GIVEN, workers=2).changed
    assert dump(target) == expected


def test_a_killed_build_of_rasters_goes_on_where_it_was(target, files, expected, tmp_path) -> None:
    """The command is killed at its third tile: two are done and no survey is there; the repetition builds the rest."""
    code = (
        "import sys, msbdb\n"
        "from msbdb.scale import tilework\n"
        "from support.tiledtown import TILE_M, end_at_third\n"
        "tilework.work = end_at_third\n"
        "db, dsm, dtm, ortho = sys.argv[1:]\n"
        "how = {'survey': 'town', 'extract': 'multiscale', 'tile': TILE_M}\n"
        "msbdb.build(db=db, dsm=dsm, dtm=dtm, ortho=ortho, **how)\n"
    )
    words = [sys.executable, "-c", code, target, *(str(files[role]) for role in ("dsm", "dtm", "ortho"))]
    own = environment(**{KILLED: str(tmp_path / "done")})
    ended = subprocess.run(words, env=own, capture_output=True, text=True, check=False)
    assert ended.returncode == -signal.SIGKILL, ended.stderr
    with opened(target) as engine:
        assert not [line for line in canonical_dump(engine) if line.startswith(('["survey", ', '["building", '))]
    left = {tile.key: tile.seconds for tile in msbdb.tiles(target) if tile.state == "done"}
    assert len(left) == 2
    assert msbdb.build(**files, db=target, **GIVEN, resume=True).changed
    assert left == {tile.key: tile.seconds for tile in msbdb.tiles(target) if tile.key in left}
    assert dump(target) == expected

"""Known changes of the real tile of Nîmes are found by ``msbdb update``, and none is made up."""

import os
from pathlib import Path

import pytest
import shapely
from simulated.epochs import EDITS
from simulated.tiles import judge, write_first, write_second

from msbdb import api
from msbdb.database import open_database, read_buildings, read_changes, read_history

pytestmark = pytest.mark.nimes

TILE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "msbdb" / "nimes.laz"
CRUMB_M2 = 3.0
SHIFT_M = 0.5
"""By which the second epoch lies off the first."""

OPTIONS = {"crs": "EPSG:2154"}


@pytest.mark.long
def test_edits_of_the_points_are_found_and_nothing_else(tmp_path: Path) -> None:
    """Every kind of edit, under a shift of half a metre, thinner points and other noise."""
    if not TILE.is_file():
        pytest.skip(f"{TILE} is not there; scripts/fetch_nimes brings it")
    (tmp_path / "second").mkdir()
    first, db = write_first([TILE], tmp_path), tmp_path / "nimes.sqlite"
    api.update(first, db=db, survey="first", date="2020-01-01", **OPTIONS)
    second, edits = write_second(first, db, "first", tmp_path / "second", seed=1, each=4, crs="EPSG:2154")
    report = api.update(second, db=db, survey="second", date="2024-01-01", **OPTIONS)
    assert report.inventory.offset["dx_m"] == pytest.approx(0.5, abs=0.2)
    assert report.inventory.offset["dz_m"] == pytest.approx(0, abs=0.2)
    engine = open_database(db)
    told = judge(edits, read_changes(engine, "2020-01-01"), read_history(engine))
    changed = read_changes(engine, "2020-01-01")
    changed = changed[(changed["kind"] == "modified") & changed["outline"].astype(bool)]
    found = [read_buildings(engine, survey).geometry.explode() for survey in ("first", "second")]
    engine.dispose()
    # What is put together of the old outline and the change has no crumbs but those of the two surveys.
    pieces = changed.geometry.explode()
    crumbs = shapely.union_all([piece for shapes in found for piece in shapes if piece.area <= CRUMB_M2])
    assert (pieces.area > CRUMB_M2).sum() >= len(changed)
    assert (pieces[pieces.area <= CRUMB_M2].distance(crumbs) < 2 * SHIFT_M).all()
    assert {edit.what for edit in told.found} == set(EDITS)
    assert told.missed == ()
    assert told.invented == ()
    assert api.update(second, db=db, survey="second", date="2024-01-01", **OPTIONS).inventory.status == "unchanged"

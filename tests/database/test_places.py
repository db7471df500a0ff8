"""What a run says of a place, on both dialects, and of runs that kept less."""

import zlib
from dataclasses import replace

import numpy as np
import pytest
from simulated.builds import HOUSE, SOUTH, WEST, small_build
from sqlalchemy import Engine, text

from msbdb.database import check_database, copy_database, explain_places, open_database, read_build, write_build
from msbdb.tables import Reason

IN_HOUSE = (WEST + 65.0, SOUTH + 15.0)
IN_CROWN = (WEST + 150.0, SOUTH + 20.0)


def with_reasons(build):
    """Return a build with a raster of reasons in which only the crown is vegetation, and answers of a detector."""
    shape = build.rasters.valid.shape
    reason = np.full(shape, Reason.LOW, dtype=np.uint8)
    cell = build.heights.spec.rowcol(np.float64(IN_CROWN[0]), np.float64(IN_CROWN[1]))
    reason[cell] = Reason.VEGETATION_BY_STRUCTURE
    support = np.zeros(shape, dtype=np.uint8)
    support[cell] = 0b1010
    return replace(build, rasters=replace(build.rasters, reason=reason, support=support))


@pytest.fixture
def house(engine: Engine):
    """Return a point on the house of the small build, from the database."""
    write_build(engine, with_reasons(small_build()))
    with engine.connect() as connection:
        query = text("SELECT xin, yin FROM building WHERE building_id = :id")
        return tuple(connection.execute(query, {"id": HOUSE}).one())


def test_a_building_and_a_crown_are_explained(engine: Engine, house) -> None:
    """The building by its outline, the crown by the raster of reasons and the votes of the detectors."""
    first, second = explain_places(engine, [house, IN_CROWN])
    assert first.building is not None
    assert first.building["building_id"] == HOUSE
    assert first.sentences[0].startswith(f"Building {HOUSE} stands here")
    assert (second.building, second.reason) == (None, Reason.VEGETATION_BY_STRUCTURE)
    assert [one.supports for one in second.detectors] == [False, True, False, True]
    assert "Of 4 detectors 2 would take it for a building" in second.sentences[0]


def test_a_run_without_reasons_says_so(engine: Engine, house) -> None:
    """A run of an older msbdb has its buildings, and elsewhere says that it kept no reasons."""
    with engine.begin() as connection:
        connection.execute(text("DELETE FROM run_state WHERE name IN ('reason', 'support')"))
    first, second = explain_places(engine, [house, IN_CROWN])
    assert first.reason == Reason.BUILDING
    assert second.reason is None
    assert "older msbdb and kept no reasons" in second.sentences[0]
    assert second.detectors[0].supports is None
    assert "multiscale: not kept by this run." in second.sentences


def test_a_copy_gives_the_same_answers(engine: Engine, house, tmp_path) -> None:
    """The rasters and the numbers of the ledger are copied with the rest."""
    copy_database(str(engine.url.render_as_string(hide_password=False)), tmp_path / "copy.sqlite")
    other = open_database(tmp_path / "copy.sqlite")
    assert explain_places(other, [house, IN_CROWN]) == explain_places(engine, [house, IN_CROWN])
    other.dispose()


def test_heights_in_16_bits_are_the_same_content(engine: Engine) -> None:
    """Heights that fit are kept in 16 bits, others in 32; a build is recognised in either."""
    build = small_build()
    heights = build.rasters.heights_cm
    assert heights.dtype == np.int32
    kept = text("SELECT dtype FROM run_state WHERE name = 'ndsm_cm'")
    write_build(engine, build)
    with engine.connect() as connection:
        assert connection.scalar(kept) == "<i2"
    assert read_build(engine).rasters.heights_cm.tolist() == heights.tolist()
    with engine.begin() as connection:
        wide = {"data": zlib.compress(heights.astype("<i4").tobytes())}
        connection.execute(text("UPDATE run_state SET dtype = '<i4', data = :data WHERE name = 'ndsm_cm'"), wide)
    assert check_database(engine) == []
    assert write_build(engine, build).status == "unchanged"
    tall = replace(build, rasters=replace(build.rasters, heights_cm=heights + 40_000))
    assert write_build(engine, tall).status == "replaced"
    with engine.connect() as connection:
        assert connection.scalar(kept) == "<i4"
    assert check_database(engine) == []

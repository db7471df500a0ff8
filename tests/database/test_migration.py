"""Databases of the first schema are upgraded with all of their rows, and built on."""

import zlib
from typing import Any

import pandas as pd
import pytest
from alembic import command
from alembic.config import Config
from builds import EPSG, HOUSE, small_build
from sqlalchemy import Connection, Engine, text

from msbdb.database import canonical_dump, list_runs, open_database, read_build, read_buildings, upgrade, write_build
from msbdb.database.canonical import text_id
from msbdb.database.crs import crs_from, register
from msbdb.database.dialect import dialect_of
from msbdb.database.engine import database_url
from msbdb.errors import DatabaseError, SchemaVersionError

OLD_TABLES = {
    "survey": "survey_id, name, date, epsg, crs_wkt, vertical_crs, density, cell_m, west, south, east, north",
    "source": "survey_id, number, name, role, sha256, bytes",
    "run": "run_id, survey_id, method, profile, version, parameters, counts, timings, notices, content_sha256",
    "run_state": "run_id, name, dtype, shape, data",
    "scale": "run_id, scale, threshold_px, threshold_m2",
    "spectral_class": "run_id, speindex, label, labelled_by, source, cells, share, ndvi, brightness, roughness_m",
    "spectral_class_band": "run_id, speindex, band, mean",
    "part": "part_id, run_id, supid, father_id, supscale, root_id, scale, hindex, class_id, h_std, ST_AsText(geometry)",
    "building": (
        "building_id, run_id, root_id, state, storeys, h_max, h_mean, h_p50, h_p90, area_m2, volume_m3, parts, "
        "scales, speindex, class_id, ST_AsText(geometry)"
    ),
    "rejection": "rejection_id, run_id, region_id, stage, reason, scale, area_m2, ST_AsText(geometry)",
}
SURVEY_ID = text_id("survey", "delft")
RUN_ID = text_id("run", "delft", "multiscale")
"""The run's key as the first schema's loader made it, from the method too."""

RUN_SQL = """
INSERT INTO run VALUES (:run_id, :survey_id, :method, 'default', '0.1.0', '{"scale": {"scales_m2": [20.0, 200.0]}}',
  '{"duplicates": {"in": 7, "kept": 6, "dropped": 1}}', '{"read": 0.5}', '["The heights were in feet."]', 'old digest')
"""


def rows_of(frame: pd.DataFrame, **more: Any) -> tuple[list[str], list[tuple[Any, ...]]]:
    """Return a frame's columns and rows without the geometry, with further columns in front."""
    plain = frame.drop(columns=["geometry", "flat_share"], errors="ignore")
    cells = plain.astype(object).where(plain.notna(), None)
    return [*more, *plain.columns], [(*more.values(), *row) for row in cells.itertuples(index=False)]


def old_database(target: str) -> None:
    """Create a database of the schema 0001 that holds the small build, without any of today's loader."""
    url = database_url(target)
    dialect = dialect_of(url)
    build = small_build("delft", "multiscale")

    def fill(connection: Connection) -> None:
        register(connection, EPSG, crs_from(EPSG, ""))
        config = Config()
        config.set_main_option("script_location", str(upgrade.packaged("migrations")))
        config.attributes.update(connection=connection, dialect=dialect, srid=EPSG)
        command.upgrade(config, "0001")
        survey = (
            "INSERT INTO survey VALUES (:id, 'delft', '2020-04-01', :epsg, :wkt, 'NAP height', 10.5, 1, 0, 0, 9, 9)"
        )
        values = {"id": SURVEY_ID, "epsg": EPSG, "wkt": build.survey.crs_wkt}
        connection.execute(text(survey), values)
        connection.execute(text("INSERT INTO source VALUES (:id, 1, 'a.laz', 'points', 'ab', 9)"), values)
        connection.execute(text(RUN_SQL), {"run_id": RUN_ID, "survey_id": SURVEY_ID, "method": "multiscale"})
        state = "INSERT INTO run_state VALUES (:run, 'ndsm', '|u1', '[2, 2]', :data)"
        connection.execute(text(state), {"run": RUN_ID, "data": zlib.compress(bytes(4))})
        for name in ("scale", "spectral_class", "spectral_class_band", "part", "building"):
            insert(connection, name, build.frames[name])
        for number, (index, _row) in enumerate(build.frames["rejection"].iterrows(), start=1):
            insert(connection, "rejection", build.frames["rejection"].loc[[index]], rejection_id=number)

    def insert(connection: Connection, name: str, frame: pd.DataFrame, **more: Any) -> None:
        columns, rows = rows_of(frame, run_id=RUN_ID, **more)
        if "geometry" in frame:
            columns.append("geometry")
            shapes = dialect.encode(frame["geometry"].to_numpy(), EPSG)
            rows = [(*row, shape) for row, shape in zip(rows, shapes, strict=True)]
        dialect.insert_rows(connection, name, columns, rows, EPSG)

    dialect.create(url, 5.0, fill)


def content(target: str) -> dict[str, list[tuple[Any, ...]]]:
    """Return all rows of the first schema's columns."""
    url = database_url(target)
    with dialect_of(url).make_engine(url, 5.0).connect() as connection:
        return {
            name: sorted(map(tuple, connection.execute(text(f"SELECT {columns} FROM {name}"))), key=repr)
            for name, columns in OLD_TABLES.items()
        }


def version(target: str) -> str:
    """Return the schema's version."""
    url = database_url(target)
    with dialect_of(url).make_engine(url, 5.0).connect() as connection:
        return upgrade.schema_version(connection)


def upgraded(target: str) -> Engine:
    """Upgrade as a build does."""
    return open_database(target, create=True)


def test_an_upgrade_keeps_every_row(target: str) -> None:
    """All tables, keys and geometries stay; what was not known is null; the new tables are empty."""
    old_database(target)
    before = content(target)
    assert [len(before[name]) for name in ("part", "building", "rejection", "run")] == [6, 4, 3, 1]
    with pytest.raises(SchemaVersionError, match="older schema"):
        open_database(target)
    engine = upgraded(target)
    assert (version(target), content(target)) == (upgrade.head_version(), before)
    build = read_build(engine, "delft")
    assert build.run.method == "multiscale"
    assert build.frames["building"]["flat_share"].isna().all()
    assert build.frames["flat_region"].empty
    assert build.frames["part_flat_region"].empty
    with engine.connect() as connection:
        shown = connection.execute(text("SELECT building_id, flat_share FROM building_summary")).all()
        assert len(shown) == 4
        assert connection.scalar(text("SELECT COUNT(*) FROM part_evidence WHERE flat_share IS NULL")) == 6
        assert connection.scalar(text("SELECT COUNT(*) FROM footprint")) == 4


def test_indexes_and_keys_of_the_widened_table_work(target: str) -> None:
    """The spatial index covers the kept rows, keys hold, and the layers are registered with their extents."""
    old_database(target)
    engine = upgraded(target)
    with engine.connect() as connection:
        if engine.dialect.name == "sqlite":
            assert connection.scalar(text("SELECT CheckSpatialIndex('building', 'geometry')")) == 1
            assert connection.execute(text("PRAGMA foreign_key_check")).all() == []
            assert connection.scalar(text("PRAGMA integrity_check")) == "ok"
            figures = "SELECT view_name, row_count FROM views_geometry_columns_statistics ORDER BY view_name"
            assert connection.execute(text(figures)).all() == [
                ("building_summary", 4),
                ("footprint", 4),
                ("part_evidence", 6),
                ("part_tree", 6),
                ("unexplained_flat_region", 0),
            ]
        else:
            index = "SELECT COUNT(*) FROM pg_indexes WHERE tablename = 'building' AND indexdef LIKE '%gist (geometry)'"
            assert connection.scalar(text(index)) == 1
    with engine.begin() as connection:
        connection.execute(text("DELETE FROM building WHERE building_id = :house"), {"house": HOUSE})
        connection.execute(text("DELETE FROM part WHERE part_id = :house"), {"house": HOUSE})
    assert len(read_buildings(engine)) == 3


@pytest.mark.parametrize("method", ["multiscale", "flatregions,multiscale"])
def test_building_an_old_survey_again_replaces_its_run(target: str, tmp_path, method: str) -> None:
    """The old run goes, though it has another key, and the database is as if it had been built today."""
    old_database(target)
    engine = upgraded(target)
    assert write_build(engine, small_build("delft", method)).status == "replaced"
    assert list_runs(engine)["method"].tolist() == [method]
    fresh = open_database(tmp_path / "fresh.sqlite", create=True, srid=EPSG)
    write_build(fresh, small_build("delft", method))
    assert list(canonical_dump(engine, provenance=True)) == list(canonical_dump(fresh, provenance=True))
    assert write_build(engine, small_build("delft", method)).status == "unchanged"


def test_an_upgrade_that_fails_at_the_end_changes_nothing(target: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Dropping, creating and copying tables is all in one transaction."""
    old_database(target)
    before = content(target)

    def full(_connection: Connection) -> None:
        message = "no space"
        raise DatabaseError(message)

    with monkeypatch.context() as patch:
        patch.setattr(dialect_of(database_url(target)), "after_load", full)
        with pytest.raises(DatabaseError, match="no space"):
            upgraded(target)
    assert (version(target), content(target)) == ("0001", before)
    upgraded(target)
    assert content(target) == before


def test_several_runs_of_a_survey_are_not_thrown_away(target: str) -> None:
    """The first schema allowed them; the upgrade leaves the choice to the user."""
    old_database(target)
    url = database_url(target)
    engine = dialect_of(url).make_engine(url, 5.0)
    with engine.begin() as connection:
        connection.execute(text(RUN_SQL), {"run_id": 7, "survey_id": SURVEY_ID, "method": "adaptive"})
    before = content(target)
    with pytest.raises(SchemaVersionError, match="survey 'delft' has 2"):
        upgraded(target)
    assert (version(target), content(target)) == ("0001", before)
    with engine.begin() as connection:
        connection.execute(text("DELETE FROM run WHERE run_id = 7"))
    assert len(list_runs(upgraded(target))) == 1

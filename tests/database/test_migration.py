"""Databases of older schemas are upgraded with all of their rows, built on, and brought back."""

import zlib
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from alembic import command
from alembic.config import Config
from olddatabases import place_old_database
from simulated.builds import EPSG, HOUSE, small_build
from sqlalchemy import Connection, Engine, text
from support.schemaobjects import objects

from msbdb.database import (
    canonical_dump,
    check_database,
    downgrade_schema,
    list_runs,
    open_database,
    read_build,
    read_buildings,
    read_candidates,
    upgrade,
    upgrade_schema,
    write_build,
)
from msbdb.database.canonical import text_id
from msbdb.database.crs import crs_from, register
from msbdb.database.dialect import dialect_of
from msbdb.database.engine import database_url
from msbdb.errors import DatabaseError, SchemaVersionError
from msbdb.tables import Build

FIRST_TABLES = {
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
TABLES = {
    "0001": FIRST_TABLES,
    "0002": FIRST_TABLES
    | {
        "building": f"flat_share, {FIRST_TABLES['building']}",
        "flat_region": "region_id, run_id, zone, lambda_m2, gradient_sum, perimeter_m, ycen, ST_AsText(geometry)",
        "part_flat_region": "part_id, region_id, run_id, overlap_m2, part_share, region_share",
    },
}
"""The tables of each old schema, with columns to look at."""
METHODS = {"0001": "multiscale", "0002": "flatregions,multiscale"}
"""All extractors of the msbdb of each old schema."""
LATER = {"0001": ["flat_share", "area3d_share", "adaptive_share"], "0002": ["area3d_share", "adaptive_share"]}
"""The columns of building that each old schema had not."""
OLD = list(TABLES)
SURVEY_ID = text_id("survey", "delft")
RUN_IDS = {"0001": text_id("run", "delft", "multiscale"), "0002": text_id("run", "delft")}
"""The run's key as the old loaders made it; the first one's, from the method too."""

SURVEY_SQL = "INSERT INTO survey VALUES (:id, 'delft', '2020-04-01', :epsg, :wkt, 'NAP height', 10.5, 1, 0, 0, 9, 9)"
RUN_SQL = """
INSERT INTO run VALUES (:run_id, :survey_id, :method, 'default', '0.1.0', '{"scale": {"scales_m2": [20.0, 200.0]}}',
  '{"duplicates": {"in": 7, "kept": 6, "dropped": 1}}', '{"read": 0.5}', '["The heights were in feet."]', 'old digest')
"""


def rows_of(frame: pd.DataFrame, revision: str, **more: Any) -> tuple[list[str], list[tuple[Any, ...]]]:
    """Return the columns and rows that an old schema knew, without the geometry, with further columns in front."""
    plain = frame.drop(columns=["geometry", *LATER[revision]], errors="ignore")
    cells = plain.astype(object).where(plain.notna(), None)
    return [*more, *plain.columns], [(*more.values(), *row) for row in cells.itertuples(index=False)]


def migration(connection: Connection) -> Config:
    """Return Alembic's configuration, as msbdb hands it over."""
    config = Config()
    config.set_main_option("script_location", str(upgrade.packaged("migrations")))
    config.attributes.update(connection=connection, dialect=dialect_of(connection.engine.url), srid=EPSG)
    return config


def old_database(target: str, revision: str) -> None:
    """Create a database of an old schema that holds the small build, without any of today's loader."""
    url = database_url(target)
    build = small_build("delft", METHODS[revision])

    def fill(connection: Connection) -> None:
        register(connection, EPSG, crs_from(EPSG, ""))
        command.upgrade(migration(connection), revision)
        values = {"id": SURVEY_ID, "epsg": EPSG, "wkt": build.survey.crs_wkt}
        connection.execute(text(SURVEY_SQL), values)
        connection.execute(text("INSERT INTO source VALUES (:id, 1, 'a.laz', 'points', 'ab', 9)"), values)
        run = {"run_id": RUN_IDS[revision], "survey_id": SURVEY_ID, "method": METHODS[revision]}
        connection.execute(text(RUN_SQL), run)
        state = "INSERT INTO run_state VALUES (:run, 'ndsm', '|u1', '[2, 2]', :data)"
        connection.execute(text(state), {"run": RUN_IDS[revision], "data": zlib.compress(bytes(4))})
        insert_frames(connection, build, revision)

    dialect_of(url).create(url, 5.0, fill)


def insert_frames(connection: Connection, build: Build, revision: str) -> None:
    """Insert the rows of all tables that an old schema had."""
    dialect = dialect_of(connection.engine.url)
    for name in ("scale", "spectral_class", "spectral_class_band", "part", "building", "flat_region"):
        if name in TABLES[revision]:
            insert(connection, name, build.frames[name], revision)
    if "part_flat_region" in TABLES[revision]:
        insert(connection, "part_flat_region", build.frames["part_flat_region"], revision)
    ledger = build.frames["rejection"]
    for number, index in enumerate(ledger.index, start=1):
        insert(connection, "rejection", ledger.loc[[index]], revision, rejection_id=number)
    dialect.settle(connection)


def insert(connection: Connection, name: str, frame: pd.DataFrame, revision: str, **more: Any) -> None:
    """Insert one frame's rows by plain SQL."""
    columns, rows = rows_of(frame, revision, run_id=RUN_IDS[revision], **more)
    values = ", ".join(f":{column}" for column in columns)
    if "geometry" in frame:
        columns.append("geometry")
        values += f", ST_GeomFromText(:geometry, {EPSG})"
        rows = [(*row, shape.wkt) for row, shape in zip(rows, frame["geometry"], strict=True)]
    statement = text(f"INSERT INTO {name} ({', '.join(columns)}) VALUES ({values})")
    connection.execute(statement, [dict(zip(columns, row, strict=True)) for row in rows])


def content(target: str, revision: str) -> dict[str, list[tuple[Any, ...]]]:
    """Return all rows of an old schema's columns."""
    url = database_url(target)
    with dialect_of(url).make_engine(url, 5.0).connect() as connection:
        return {
            name: sorted(map(tuple, connection.execute(text(f"SELECT {columns} FROM {name}"))), key=repr)
            for name, columns in TABLES[revision].items()
        }


def schema(target: str) -> set[tuple[str, ...]]:
    """Return all that the schema consists of, but for comments, which are documentation, and figures for planning."""
    url = database_url(target)
    with dialect_of(url).make_engine(url, 5.0).connect() as connection:
        return {row for row in objects(connection) if row[0] != "comment" and "sqlite_stat" not in row[1]}


def version(target: str) -> str:
    """Return the schema's version."""
    url = database_url(target)
    with dialect_of(url).make_engine(url, 5.0).connect() as connection:
        return upgrade.schema_version(connection)


def upgraded(target: str) -> Engine:
    """Upgrade as a build does."""
    return open_database(target, create=True)


def downgrade(engine: Engine, revision: str) -> None:
    """Bring a database back to an older schema."""
    with dialect_of(engine.url).writing(engine) as connection:
        command.downgrade(migration(connection), revision)


@pytest.mark.parametrize("revision", OLD)
def test_an_upgrade_keeps_every_row(target: str, revision: str) -> None:
    """All tables, keys and geometries stay; what was not known is null; the new tables are empty."""
    old_database(target, revision)
    before = content(target, revision)
    assert [len(before[name]) for name in ("part", "building", "rejection", "run")] == [6, 4, 3, 1]
    with pytest.raises(SchemaVersionError, match="older schema"):
        open_database(target)
    engine = upgraded(target)
    assert (version(target), content(target, revision)) == (upgrade.head_version(), before)
    build, known = read_build(engine, "delft"), small_build("delft", METHODS[revision])
    assert build.run.method == METHODS[revision]
    assert build.frames["building"][LATER[revision]].isna().all(axis=None)
    assert {name: len(frame) for name, frame in build.frames.items()} == {
        name: len(frame) for name, frame in known.frames.items()
    }
    assert read_candidates(engine).empty
    shares = known.frames["building"]["flat_share"]
    with engine.connect() as connection:
        shown = connection.execute(text("SELECT flat_share FROM building_summary ORDER BY building_id")).all()
        assert [share for (share,) in shown] == [None if pd.isna(share) else share for share in shares]
        for column in LATER[revision]:
            assert connection.scalar(text(f"SELECT COUNT(*) FROM part_evidence WHERE {column} IS NULL")) == 6
        assert connection.scalar(text("SELECT COUNT(*) FROM footprint")) == 4
        heard = connection.scalars(text("SELECT extractors_heard FROM building_evidence")).all()
        assert heard == [int("flatregions" in METHODS[revision])] * 4


@pytest.mark.parametrize("revision", OLD)
def test_indexes_and_keys_of_the_widened_table_work(target: str, revision: str) -> None:
    """The spatial index covers the kept rows, keys hold, and the layers are registered with their extents."""
    old_database(target, revision)
    engine = upgraded(target)
    regions = len(small_build("delft", METHODS[revision]).frames["flat_region"])
    with engine.connect() as connection:
        if engine.dialect.name == "sqlite":
            assert connection.scalar(text("SELECT CheckSpatialIndex('building', 'geometry')")) == 1
            assert connection.execute(text("PRAGMA foreign_key_check")).all() == []
            assert connection.scalar(text("PRAGMA integrity_check")) == "ok"
            figures = "SELECT view_name, row_count FROM views_geometry_columns_statistics ORDER BY view_name"
            assert connection.execute(text(figures)).all() == [
                ("building_evidence", 4),
                ("building_history", 0),
                ("building_summary", 4),
                ("candidate_evidence", 0),
                ("footprint", 4),
                ("footprint_current", 0),
                ("part_evidence", 6),
                ("part_tree", 6),
                ("unexplained_candidate", 0),
                ("unexplained_flat_region", regions // 2),
            ]
        else:
            index = "SELECT COUNT(*) FROM pg_indexes WHERE tablename = 'building' AND indexdef LIKE '%gist (geometry)'"
            assert connection.scalar(text(index)) == 1
    with engine.begin() as connection:
        connection.execute(text("DELETE FROM building WHERE building_id = :house"), {"house": HOUSE})
        connection.execute(text("DELETE FROM part WHERE part_id = :house"), {"house": HOUSE})
    assert len(read_buildings(engine)) == 3


@pytest.mark.parametrize("revision", OLD)
@pytest.mark.parametrize("method", ["multiscale", "adaptive,area3d,flatregions,multiscale"])
def test_building_an_old_survey_again_replaces_its_run(target: str, tmp_path, method: str, revision: str) -> None:
    """The old run goes, though it may have another key, and the database is as if it had been built today."""
    old_database(target, revision)
    engine = upgraded(target)
    assert write_build(engine, small_build("delft", method)).status == "replaced"
    assert list_runs(engine)["method"].tolist() == [method]
    fresh = open_database(tmp_path / "fresh.sqlite", create=True, srid=EPSG)
    write_build(fresh, small_build("delft", method))
    assert list(canonical_dump(engine, provenance=True)) == list(canonical_dump(fresh, provenance=True))
    assert write_build(engine, small_build("delft", method)).status == "unchanged"


@pytest.mark.parametrize("revision", OLD)
def test_an_upgrade_that_fails_at_the_end_changes_nothing(
    target: str, revision: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Dropping, creating and copying tables is all in one transaction."""
    old_database(target, revision)
    before = content(target, revision)

    def full(_connection: Connection) -> None:
        message = "no space"
        raise DatabaseError(message)

    with monkeypatch.context() as patch:
        patch.setattr(dialect_of(database_url(target)), "after_load", full)
        with pytest.raises(DatabaseError, match="no space"):
            upgraded(target)
    assert (version(target), content(target, revision)) == (revision, before)
    upgraded(target)
    assert content(target, revision) == before


def test_several_runs_of_a_survey_are_not_thrown_away(target: str) -> None:
    """The first schema allowed them; the upgrade leaves the choice to the user."""
    old_database(target, "0001")
    url = database_url(target)
    engine = dialect_of(url).make_engine(url, 5.0)
    with engine.begin() as connection:
        connection.execute(text(RUN_SQL), {"run_id": 7, "survey_id": SURVEY_ID, "method": "adaptive"})
    before = content(target, "0001")
    with pytest.raises(SchemaVersionError, match="survey 'delft' has 2"):
        upgraded(target)
    assert (version(target), content(target, "0001")) == ("0001", before)
    with engine.begin() as connection:
        connection.execute(text("DELETE FROM run WHERE run_id = 7"))
    assert len(list_runs(upgraded(target))) == 1


def test_a_downgrade_keeps_what_the_older_schema_knows(target: str) -> None:
    """Candidates go, all other rows stay, and the way up is open again."""
    engine = open_database(target, create=True, srid=EPSG)
    build = small_build("delft")
    write_build(engine, build)
    before, dump = content(target, "0002"), list(canonical_dump(engine))
    downgrade(engine, "0002")
    assert (version(target), content(target, "0002")) == ("0002", before)
    if engine.dialect.name == "sqlite":
        with engine.connect() as connection:
            assert connection.scalar(text("SELECT CheckSpatialIndex('building', 'geometry')")) == 1
            assert connection.execute(text("PRAGMA foreign_key_check")).all() == []
    again = upgraded(target)
    assert read_candidates(again).empty
    assert write_build(again, build).status == "replaced"
    assert list(canonical_dump(again)) == dump


def test_a_downgrade_forgets_the_labels_of_candidates(engine: Engine) -> None:
    """The rasters that no older msbdb reads go; the others stay."""
    build = small_build()
    labels = np.ones((3, 4), dtype=np.int32)
    write_build(engine, replace(build, state={**build.state, "area3d": labels, "adaptive": labels, "flat": labels}))
    downgrade(engine, "0002")
    with engine.connect() as connection:
        names = connection.scalars(text("SELECT name FROM run_state ORDER BY name")).all()
    assert names == ["class_index", "flat", "ndsm"]


def test_a_downgraded_schema_is_the_old_one(target: str, request: pytest.FixtureRequest, tmp_path) -> None:
    """No table, index, view or key is left that the older schema had not."""
    is_file = "://" not in target
    other = str(tmp_path / "other.sqlite") if is_file else request.getfixturevalue("new_postgis")()
    old_database(other, "0002")
    engine = open_database(target, create=True, srid=EPSG)
    write_build(engine, small_build())
    downgrade(engine, "0002")
    assert schema(target) == schema(other)


def test_digests_of_the_history_are_made_for_old_rows_and_dropped_without_loss(target: str) -> None:
    """Upgraded, the rows of an old inventory are sealed; brought back, the schema is the old one to the letter."""
    place_old_database(target, "0004")
    before = schema(target)
    upgrade_schema(target)
    dump = list(canonical_dump(open_database(target)))
    assert check_database(open_database(target)) == []
    assert downgrade_schema(target) == ("0005", "0004", [])
    assert schema(target) == before
    engine = upgraded(target)
    assert check_database(engine) == []
    assert list(canonical_dump(engine)) == dump
    with engine.connect() as connection:
        for name, rows in {"building_version": 8, "operator_state": 2, "roof_sample": 2, "inventory_event": 3}.items():
            query = text(f"SELECT count(row_digest), count(DISTINCT row_digest) FROM {name}")
            assert connection.execute(query).one() == (rows, rows)

"""Ledgers of many rows: as whole, as findable and as safe as few rows are."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from simulated.builds import BASE, EPSG, SOUTH, WEST, ledger_build, small_build
from sqlalchemy import Engine, text
from sqlalchemy.exc import DatabaseError as RefusedError

from msbdb.database import canonical_dump, open_database, read_rejections, write_build
from msbdb.database.dialects import bulk, spatialite
from msbdb.database.schema.sqlfiles import VIEWS
from msbdb.database.schema.sqltables import SPATIAL
from msbdb.errors import DatabaseError, LoadError
from msbdb.kept import KeptRun

COUNT = 2000
WINDOW = (WEST + 7.3, SOUTH + 5.1, WEST + 19.9, SOUTH + 23.7)

IN_WINDOW = {
    "sqlite": (
        "SELECT region_id FROM rejection WHERE rejection_id IN "
        "(SELECT pkid FROM idx_rejection_geometry WHERE xmax >= :west AND xmin <= :east AND ymax >= :south "
        "AND ymin <= :north) ORDER BY region_id"
    ),
    "postgresql": (
        "SELECT region_id FROM rejection WHERE geometry && ST_MakeEnvelope(:west, :south, :east, :north, 28992) "
        "ORDER BY region_id"
    ),
}


def in_window(engine: Engine) -> list[int]:
    """Return the regions of the ledger in the window, found through the spatial index."""
    words = dict(zip(("west", "south", "east", "north"), WINDOW, strict=True))
    with engine.connect() as connection:
        if engine.dialect.name == "postgresql":
            connection.execute(text("SET enable_seqscan = off"))
            plan = connection.execute(text(f"EXPLAIN {IN_WINDOW['postgresql']}"), words).scalars().all()
            assert "idx_rejection_geometry" in " ".join(plan)
        return list(connection.scalars(text(IN_WINDOW[engine.dialect.name]), words))


def expected(ledger: pd.DataFrame) -> list[int]:
    """Return the regions in the window, by their coordinates."""
    west, south, east, north = WINDOW
    inside = ledger["xcen"].between(west, east) & ledger["ycen"].between(south, north)
    return sorted(ledger.loc[inside, "region_id"].tolist())


def assert_sound(engine: Engine) -> None:
    """Check a SpatiaLite file by SQLite's and SpatiaLite's own means."""
    with engine.connect() as connection:
        assert connection.scalar(text("PRAGMA integrity_check")) == "ok"
        assert connection.execute(text("PRAGMA foreign_key_check")).all() == []
        for table in SPATIAL:
            assert connection.scalar(text(f"SELECT CheckSpatialIndex('{table}', 'geometry')")) == 1
            assert connection.scalar(text(f"SELECT rtreecheck('idx_{table}_geometry')")) == "ok"


def objects(engine: Engine) -> list[tuple[str, ...]]:
    """Return all objects of a file's schema, with their statements."""
    with engine.connect() as connection:
        query = "SELECT type, name, tbl_name, coalesce(sql, '') FROM sqlite_master ORDER BY type, name"
        return [tuple(row) for row in connection.execute(text(query)) if not row.name.startswith("sqlite_stat")]


@pytest.fixture
def file(tmp_path: Path) -> Engine:
    """Return a new SpatiaLite file."""
    return open_database(tmp_path / "city.sqlite", create=True, srid=EPSG)


def test_every_row_of_a_long_ledger_is_there_and_found(engine: Engine) -> None:
    """Right after the load, the spatial index finds what lies in a window, and all rows are as given."""
    build = ledger_build(COUNT)
    assert write_build(engine, build).rows["rejection"] == COUNT
    ledger = build.frames["rejection"].sort_values("region_id", ignore_index=True)
    found = read_rejections(engine).sort_values("region_id", ignore_index=True)
    pd.testing.assert_frame_equal(pd.DataFrame(found), pd.DataFrame(ledger), check_dtype=False)
    assert 100 < len(expected(ledger)) < COUNT / 2
    assert in_window(engine) == expected(ledger)


def test_the_index_follows_rows_that_move(engine: Engine) -> None:
    """The same regions elsewhere, another survey of a few rows, and fewer rows: each is found where it is."""
    write_build(engine, ledger_build(COUNT))
    moved = ledger_build(COUNT, north_m=11.0)
    assert write_build(engine, moved).status == "replaced"
    assert in_window(engine) == expected(moved.frames["rejection"])
    few = ledger_build(30, "leiden", shift=10**6)
    write_build(engine, few)
    both = pd.concat([moved.frames["rejection"], few.frames["rejection"]])
    assert in_window(engine) == expected(both)
    fewer = ledger_build(100)
    write_build(engine, fewer)
    assert in_window(engine) == expected(pd.concat([fewer.frames["rejection"], few.frames["rejection"]]))
    if engine.dialect.name == "sqlite":
        assert_sound(engine)


def test_a_region_that_was_dropped_twice_has_two_rows(engine: Engine) -> None:
    """The same stage and reason again, and another stage: keys differ, and do not depend on the order of rows."""
    build = ledger_build(50)
    ledger = build.frames["rejection"]
    other = ledger[:10].assign(stage="compactness", reason="too long and thin")
    ledger = pd.concat([ledger, ledger[:10], other], ignore_index=True)
    assert write_build(engine, replace(build, frames={**build.frames, "rejection": ledger})).rows["rejection"] == 70
    before = list(canonical_dump(engine))
    shuffled = {**build.frames, "rejection": ledger.sample(frac=1, random_state=3)}
    again = replace(build, frames=shuffled, run=replace(build.run, version="2"))
    assert write_build(engine, again).status == "replaced"
    changed = [line for line in canonical_dump(engine) if line not in before]
    assert [line.split(",")[0] for line in changed] == ['["run"']


def test_rows_that_are_refused_in_the_middle_leave_everything_as_it_was(engine: Engine) -> None:
    """A row that breaks a check after thousands of good ones undoes all, the indexes' upkeep included."""
    write_build(engine, ledger_build(COUNT))
    before = list(canonical_dump(engine))
    build = ledger_build(COUNT, north_m=5.0)
    ledger = build.frames["rejection"].copy()
    ledger.loc[COUNT // 2, "area_m2"] = -1.0
    schema = objects(engine) if engine.dialect.name == "sqlite" else None
    with pytest.raises(LoadError, match="refused"):
        write_build(engine, replace(build, frames={**build.frames, "rejection": ledger}))
    assert list(canonical_dump(engine)) == before
    assert in_window(engine) == expected(ledger_build(COUNT).frames["rejection"])
    if schema is not None:
        assert objects(engine) == schema
        assert_sound(engine)


def test_a_failure_after_the_rows_leaves_everything_as_it_was(file: Engine, monkeypatch) -> None:
    """Where one of SpatiaLite's functions fails after half of the indexes, the old rows and indexes are there."""
    write_build(file, ledger_build(COUNT))
    before, schema = list(canonical_dump(file)), objects(file)
    call, made = bulk._call, []

    def fail_on_the_second(connection, function: str, layer: str) -> None:
        made.append(layer)
        call(connection, function, "missing" if function == "CreateSpatialIndex" and made.count(layer) > 1 else layer)

    monkeypatch.setattr(bulk, "_call", fail_on_the_second)
    with pytest.raises(DatabaseError, match="CreateSpatialIndex failed on the layer missing"):
        write_build(file, ledger_build(COUNT, north_m=5.0))
    assert (list(canonical_dump(file)), objects(file)) == (before, schema)
    assert_sound(file)


def test_geometries_of_another_crs_are_refused_as_the_trigger_would(file: Engine, monkeypatch) -> None:
    """The check of all rows at once is as strict as that of each."""
    insert_rows = spatialite.insert_rows

    def wrong(connection, table, columns, srid):
        insert_rows(connection, table, columns, 4326 if table == "rejection" else srid)

    monkeypatch.setattr(spatialite, "insert_rows", wrong)
    before = list(canonical_dump(file))
    with pytest.raises(LoadError, match="rejection refused 200 geometries of another type or SRID"):
        write_build(file, ledger_build(200))
    assert list(canonical_dump(file)) == before


def test_other_programs_find_the_triggers_on(file: Engine) -> None:
    """After a load the file refuses wrong geometries, and its index takes single rows, as before."""
    schema = objects(file)
    write_build(file, ledger_build(COUNT))
    assert objects(file) == schema
    row = (
        f"INSERT INTO rejection SELECT 1, run_id, {BASE}, 'multiscale', 'mine', 'mine', 0, 1, 0, 0, "
        "MakePoint({}, {}, {}) FROM run"
    )
    with file.begin() as connection:
        connection.execute(text(row.format(WEST + 10, SOUTH + 10, EPSG)))
    assert BASE in in_window(file)
    with pytest.raises(RefusedError, match="SRID not allowed"), file.begin() as connection:
        connection.execute(text(row.format(WEST + 10, SOUTH + 10, 4326)))
    assert_sound(file)


def test_a_table_without_spatial_index_stays_without(file: Engine) -> None:
    """Whoever takes an index off in a client finds it off after the next load, and the rows there."""
    with file.begin() as connection:
        connection.execute(text("SELECT DisableSpatialIndex('rejection', 'geometry')"))
        connection.execute(text("DROP TABLE idx_rejection_geometry"))
    write_build(file, ledger_build(100))
    assert len(read_rejections(file)) == 100


EXTENT = "row_count, extent_min_x, extent_min_y, extent_max_x, extent_max_y"
REGISTERED = (
    f"SELECT f_table_name, {EXTENT} FROM geometry_columns_statistics "
    f"UNION ALL SELECT view_name, {EXTENT} FROM views_geometry_columns_statistics"
)
COUNTED = (
    "SELECT count(*), min(MbrMinX(geometry)), min(MbrMinY(geometry)), max(MbrMaxX(geometry)), max(MbrMaxY(geometry)) "
    "FROM {name}"
)


def empty_build() -> KeptRun:
    """Return the small build without a row but its scales."""
    build = small_build()
    frames = {name: frame if name == "scale" else frame[:0] for name, frame in build.frames.items()}
    return replace(build, frames=frames)


@pytest.mark.parametrize("build", [empty_build(), small_build(), ledger_build(500)], ids=["empty", "small", "ledger"])
def test_the_register_has_the_count_and_extent_of_each_layer(file: Engine, build) -> None:
    """Tables and views: counted by the rows, which replace others."""
    write_build(file, ledger_build(30, north_m=1000.0))
    write_build(file, build)
    with file.connect() as connection:
        found = {name: tuple(row) for name, *row in connection.execute(text(REGISTERED))}
        assert set(found) == set(SPATIAL) | {view.name for view in VIEWS}
        for name, row in found.items():
            assert row == tuple(connection.execute(text(COUNTED.format(name=name))).one()), name


def test_statistics_are_made_anew_whatever_the_clock_said_before(file: Engine) -> None:
    """A file whose statistics seem to be of the future has those of the new rows after a load."""
    write_build(file, ledger_build(30))
    with file.begin() as connection:
        connection.execute(text("UPDATE geometry_columns_statistics SET last_verified = '2999-01-01T00:00:00.000Z'"))
    write_build(file, ledger_build(500))
    with file.connect() as connection:
        query = "SELECT row_count FROM geometry_columns_statistics WHERE f_table_name = 'rejection'"
        assert connection.scalar(text(query)) == 500


def test_the_statistics_are_not_older_than_the_rows(file: Engine) -> None:
    """The times of the load are in the register, and later ones in the statistics."""
    write_build(file, ledger_build(500))
    with file.connect() as connection:
        late = connection.scalar(
            text(
                "SELECT count(*) FROM geometry_columns_time NATURAL JOIN geometry_columns_statistics "
                "WHERE f_table_name IN ('part', 'rejection') AND (last_verified < last_insert OR last_insert < '2000')"
            )
        )
        known = connection.scalar(text("SELECT count(*) FROM geometry_columns_field_infos"))
    assert late == 0
    assert known > 0


@pytest.mark.long
@pytest.mark.postgis
def test_both_dialects_hold_the_same_ledger(tmp_path, new_postgis) -> None:
    """The dumps of thousands of rows are equal line by line, after a first load and after a replacement."""
    engines = [open_database(place, create=True, srid=EPSG) for place in (tmp_path / "city.sqlite", new_postgis())]
    for north_m in (0.0, 3.0):
        for engine in engines:
            write_build(engine, ledger_build(COUNT, north_m=north_m))
        one, two = (list(canonical_dump(engine)) for engine in engines)
        assert one == two
        assert sum(line.startswith('["rejection"') for line in one) == COUNT


def test_ids_of_rows_come_from_what_they_tell(file: Engine) -> None:
    """A row keeps its key whatever else is in the ledger; keys are above 0 and below 2**59."""
    write_build(file, ledger_build(COUNT))
    query = text("SELECT region_id, rejection_id FROM rejection")
    with file.connect() as connection:
        whole = dict(map(tuple, connection.execute(query)))
    build = ledger_build(COUNT)
    some = build.frames["rejection"][::7]
    write_build(file, replace(build, frames={**build.frames, "rejection": some}))
    with file.connect() as connection:
        part = dict(map(tuple, connection.execute(query)))
    assert part == {region: whole[region] for region in part}
    assert len(part) == len(some)
    ids = np.array(list(whole.values()))
    assert len(np.unique(ids)) == COUNT
    assert ids.min() > 0
    assert ids.max() < 2**59

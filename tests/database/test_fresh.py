"""New tables of PostGIS are indexed and held to their keys once they are filled; tables in use keep all they have."""

import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import shapely
from simulated.builds import EPSG, small_build
from sqlalchemy import Connection, make_url, text

from msbdb.database import canonical_dump, check_database, copy_database, open_database, store_build, write_build
from msbdb.database.dialects import postgis
from msbdb.errors import LoadError

pytestmark = pytest.mark.postgis

OBJECTS = """
SELECT conrelid::regclass::text, conname, pg_get_constraintdef(oid) FROM pg_constraint
WHERE connamespace = 'public'::regnamespace
UNION ALL
SELECT indrelid::regclass::text, indexrelid::regclass::text, pg_get_indexdef(indexrelid) FROM pg_index
WHERE indrelid IN (SELECT oid FROM pg_class WHERE relnamespace = 'public'::regnamespace)
ORDER BY 1, 2, 3
"""


@pytest.fixture(autouse=True)
def few_rows_count(monkeypatch: pytest.MonkeyPatch) -> None:
    """Take the way of many rows for the small build too."""
    monkeypatch.setattr(postgis, "WORTH", 1)


def objects(url: str) -> list[tuple[str, ...]]:
    """Return the definitions of all keys, checks and indexes."""
    with open_database(url).connect() as connection:
        return [tuple(row) for row in connection.execute(text(OBJECTS))]


def watched(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return what counts the indexes and foreign keys of the table part at each insertion into it."""
    seen: list[int] = []
    insert_rows = postgis.insert_rows

    def counting(connection: Connection, table: str, *others: object) -> None:
        if table == "part":
            counted = (
                "SELECT (SELECT count(*) FROM pg_index WHERE indrelid = 'part'::regclass) + "
                "(SELECT count(*) FROM pg_constraint WHERE conrelid = 'part'::regclass AND contype = 'f')"
            )
            seen.append(connection.scalar(text(counted)))
        insert_rows(connection, table, *others)  # type: ignore[arg-type]  # passed on as they came

    monkeypatch.setattr(postgis, "insert_rows", counting)
    return seen


def test_a_first_build_ends_in_the_same_schema_and_rows(
    new_postgis: Callable[[], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As one into an empty database; while rows come only the primary key and the unique one are there."""
    first, second = new_postgis(), new_postgis()
    seen = watched(monkeypatch)
    store_build(first, small_build())
    write_build(open_database(second, create=True, srid=EPSG), small_build())
    assert seen[0] == 2
    assert seen[1] > 10
    assert objects(first) == objects(second)
    assert list(canonical_dump(open_database(first))) == list(canonical_dump(open_database(second)))
    assert not list(check_database(open_database(first)))


def test_tables_in_use_keep_their_indexes(new_postgis: Callable[[], str], monkeypatch: pytest.MonkeyPatch) -> None:
    """A second survey takes nothing off, as that would lock readers out."""
    url = new_postgis()
    store_build(url, small_build())
    seen = watched(monkeypatch)
    write_build(open_database(url), small_build("leiden", shift=1000))
    assert seen[0] > 10


def test_few_rows_go_in_beside_the_indexes(new_postgis: Callable[[], str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Below the bound indexes stay, as making them takes longer."""
    monkeypatch.setattr(postgis, "WORTH", 1000)
    seen = watched(monkeypatch)
    store_build(new_postgis(), small_build())
    assert seen[0] > 10


def test_a_copy_of_rows_that_break_a_key_leaves_nothing(new_postgis: Callable[[], str], tmp_path: Path) -> None:
    """The keys that are made at the end find what SQLite was told not to look at."""
    source, url = tmp_path / "town.sqlite", new_postgis()
    write_build(open_database(source, create=True, srid=EPSG), small_build())
    with closing(sqlite3.connect(source)) as connection, connection:
        connection.execute("UPDATE part_flat_region SET region_id = 77 WHERE rowid = 1")
    with pytest.raises(LoadError, match=r"refused the rows.*fk_part_flat_region_flat_region"):
        copy_database(source, url)
    assert not postgis.exists(make_url(url), 5.0)


def test_large_outlines_are_packed_by_lz4(new_postgis: Callable[[], str]) -> None:
    """Where the server can: it takes a third of the time."""
    build, url = small_build(), new_postgis()
    part = build.frames["part"]
    # Whole numbers, which can be packed.
    circle = shapely.set_precision(shapely.Point(85_500, 446_500).buffer(900.0, quad_segs=400), 1.0)
    part["geometry"] = np.array([circle] * len(part), dtype=object)
    store_build(url, build)
    with open_database(url).connect() as connection:
        known = connection.scalar(
            text("SELECT 'lz4' = ANY(enumvals) FROM pg_settings WHERE name = 'default_toast_compression'")
        )
        used = set(connection.scalars(text("SELECT pg_column_compression(geometry) FROM part")))
    assert used == {"lz4" if known else "pglz"}

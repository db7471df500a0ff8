"""Looking after a database that has been kept through surveys: history, operators' words and samples go with it."""

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pandas as pd
import psycopg
import pytest
from psycopg import sql
from sqlalchemy import Engine, func, make_url, select
from support.sizes import sample
from support.towns import EPSG, ROW, footprints, town_build

from msbdb.api import advance
from msbdb.database import (
    canonical_dump,
    check_database,
    copy_database,
    grant_role,
    open_database,
    write_build,
    write_import,
    write_samples,
    write_state,
)
from msbdb.database.history.versions import MEASURES
from msbdb.database.schema.sqltables import METADATA
from msbdb.errors import DatabaseError

LATER = [*ROW[1:7], (150, 10, 162, 28, 13), (60, 60, 75, 75, 9)]


def fill(engine: Engine) -> None:
    """Import an inventory, update it by two surveys, and let operators speak."""
    frame = footprints(ROW)
    values = dict.fromkeys(MEASURES) | {"state": "unsure", "area_m2": frame.area}
    keys = [str(n) for n in range(len(frame))]
    attributes = [{"käse": f"{n}'; --", "number": n} for n in range(len(frame))]
    office = frame.assign(key=keys, attributes=attributes, **values)
    write_import(engine, "register", "2015-01-01", office, digest="a")
    for name, date, houses in (("s1", "2020-01-01", ROW), ("s2", "2021-05-01", LATER)):
        write_build(engine, town_build(name, date, list(houses)))
        advance(engine.url, name)
    [uid, *_] = history(engine)
    write_state(engine, uid, "refuted", operator="x'; DROP TABLE part; --", note='"quoted"', decided_at="2021-06-01")
    points = [shape.representative_point() for shape in frame.geometry[:2]]
    samples = {"material": ["slate", "tile"], "note": ["", "'"], "attributes": [None, {"a": 1}], "geometry": points}
    write_samples(engine, pd.DataFrame(samples))


def history(engine: Engine) -> list[int]:
    """Return the buildings of the inventory."""
    with engine.connect() as connection:
        return list(connection.scalars(select(METADATA.tables["inventory_building"].c.uid).order_by("uid")))


def counts(engine: Engine) -> dict[str, int]:
    """Return the rows by table."""
    with engine.connect() as connection:
        return {
            name: connection.scalar(select(func.count()).select_from(table)) for name, table in METADATA.tables.items()
        }


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a file with all kinds of rows."""
    place = tmp_path_factory.mktemp("kept") / "town.sqlite"
    fill(open_database(place, create=True, srid=EPSG))
    return place


@pytest.fixture
def kept(original: Path, target: str) -> Engine:
    """Return a copy of one's own, on each dialect."""
    copy_database(original, target)
    return open_database(target)


@pytest.fixture
def own(original: Path, target: str) -> Engine:
    """Return the same content to be damaged, on each dialect."""
    if "://" in target:
        copy_database(original, target)
        return open_database(target)
    return open_database(shutil.copy(original, target))


def test_a_kept_inventory_is_sound_and_copied_with_all(original: Path, kept: Engine) -> None:
    """No table of the inventory is empty here, and every row goes over."""
    assert check_database(open_database(original)) == []
    assert check_database(kept) == []
    rows = counts(kept)
    assert rows == counts(open_database(original))
    tables = {"inventory_building", "building_version", "building_change", "survey_offset", "inventory_event"}
    assert all(rows[name] for name in (*tables, "operator_state", "roof_sample"))
    for provenance in (False, True):
        lines = list(canonical_dump(kept, provenance=provenance))
        assert lines == list(canonical_dump(open_database(original), provenance=provenance))


def test_the_copy_goes_on_as_the_original_would(kept: Engine) -> None:
    """The same update again changes nothing."""
    before = list(canonical_dump(kept))
    assert advance(kept.url, "s2").status == "unchanged"
    assert list(canonical_dump(kept)) == before


@pytest.mark.parametrize(
    ("statement", "check", "table", "what"),
    sample(
        [
            ("DELETE FROM building_change WHERE kind = 'new'", "events", "inventory_event", "6 unchanged, 2 versions"),
            (
                "UPDATE building_change SET kind = 'modified' WHERE kind = 'new'",
                "events",
                "inventory_event",
                "2 modified",
            ),
            (
                "UPDATE inventory_event SET number = 9 WHERE number = 2",
                "events",
                "inventory_event",
                "event 2 is missing",
            ),
            ("DELETE FROM inventory_event WHERE number = 3", "events", "building_change", "no event has its changes"),
            (
                "UPDATE building_change SET uid_after = (SELECT MIN(uid) FROM inventory_building) WHERE kind = 'new'",
                *("links", "building_change", "uid_after is"),
            ),
        ],
        2,
    ),
)
def test_damage_to_the_history_is_found(own: Engine, statement: str, check: str, table: str, what: str) -> None:
    """Rows that no key holds, but that an update has counted."""
    with own.begin() as connection:
        connection.exec_driver_sql(statement)
    found = check_database(own)
    assert [one for one in found if (one.check, one.table) == (check, table) and what in one.what]


@pytest.fixture
def operator(databases: object) -> Iterator[Callable[[Engine], Engine]]:
    """Return a maker of engines of a user who has the role operator."""
    made: list[Engine] = []
    name = sql.Identifier("desk '; --")

    def run(engine: Engine, *statements: sql.Composed) -> None:
        conninfo = make_url(engine.url).set(drivername="postgresql").render_as_string(hide_password=False)
        with psycopg.connect(conninfo) as connection:
            for statement in statements:
                connection.execute(statement)

    def make(engine: Engine) -> Engine:
        made.append(engine)
        run(engine, sql.SQL("CREATE ROLE {} LOGIN").format(name))
        grant_role(engine, "operator", "desk '; --")
        return open_database(engine.url.set(username="desk '; --"))

    yield make
    for engine in made:
        run(engine, sql.SQL("DROP OWNED BY {}").format(name), sql.SQL("DROP ROLE {}").format(name))


@pytest.mark.postgis
def test_operators_decide_but_do_not_write_history(
    original: Path, new_postgis: Callable[[], str], operator: Callable[[Engine], Engine]
) -> None:
    """States and samples are theirs; an update is the owner's, and is refused whole."""
    target = new_postgis()
    copy_database(original, target)
    engine = open_database(target)
    desk = operator(engine)
    [_, uid, *_] = history(engine)
    write_state(desk, uid, "confirmed", operator="desk", note="seen", decided_at="2022-01-01")
    write_build(desk, town_build("s3", "2022-01-01", list(ROW)))
    before = list(canonical_dump(engine))
    with pytest.raises(DatabaseError, match="does not allow it"):
        advance(desk.url, "s3")
    assert list(canonical_dump(engine)) == before
    assert check_database(engine) == []
    assert advance(engine.url, "s3").status == "created"
    assert check_database(engine) == []

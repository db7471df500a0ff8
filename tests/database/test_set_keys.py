"""Keys checked in sets: a broken link is refused, whoever writes it and however it is checked."""

from collections.abc import Callable
from dataclasses import replace

import pytest
from simulated.builds import EPSG, small_build
from sqlalchemy import Engine, text
from sqlalchemy.exc import IntegrityError
from support.sizes import sample

from msbdb.database import canonical_dump, open_database, write_build
from msbdb.database.dialects import postgis, setkeys
from msbdb.database.dialects.dialect import dialect_of
from msbdb.errors import LoadError

pytestmark = pytest.mark.postgis

LINKS = (("part_flat_region", "region_id"), ("part_flat_region", "part_id"), ("part", "building_id"), ("part", "scale"))


@pytest.fixture
def engine(new_postgis: Callable[[], str]) -> Engine:
    """Return a database with a build."""
    engine = open_database(new_postgis(), create=True, srid=EPSG)
    write_build(engine, small_build())
    return engine


def broken(engine: Engine, table: str, column: str, *, in_sets: bool) -> None:
    """Write a copy of a row that refers to nothing, as a load does."""
    with dialect_of(engine.url).writing(engine) as connection:
        row = dict(connection.execute(text(f"SELECT * FROM {table} LIMIT 1")).mappings().one())
        own = {name for name in row if name not in ("father_id", "class_id")}
        key = {"part": "part_id", "part_flat_region": "part_id"}[table]
        row |= {column: 424242} if column != key else {}
        row[key] = 424242
        if table == "part":
            row |= {"root_id": 424242, "supid": 0, "supscale": 0} | ({column: 77} if column == "scale" else {})
        names = ", ".join(sorted(own))
        insert = f"INSERT INTO {table} ({names}) VALUES ({', '.join(':' + name for name in sorted(own))})"
        if in_sets:
            with setkeys.keys_in_sets(connection, ["part", "part_flat_region"], int(row["run_id"])):
                connection.execute(text(insert), row)
        else:
            connection.execute(text(insert), row)


@pytest.mark.parametrize(("table", "column"), sample(LINKS, 2))
def test_a_load_with_a_broken_link_is_refused(engine: Engine, table: str, column: str) -> None:
    """The message names the table, the column and its value, and nothing is written."""
    before = list(canonical_dump(engine))
    with pytest.raises(LoadError, match=rf"{table} refers by .*{column}.* = .*(424242|77)"):
        broken(engine, table, column, in_sets=True)
    assert list(canonical_dump(engine)) == before


@pytest.mark.parametrize(("table", "column"), LINKS[1:3])
def test_everybody_else_is_held_by_the_keys(
    engine: Engine, monkeypatch: pytest.MonkeyPatch, table: str, column: str
) -> None:
    """Also a load by a user who may not leave out the triggers."""
    with pytest.raises(IntegrityError):
        broken(engine, table, column, in_sets=False)
    monkeypatch.setattr(setkeys, "_MAY", dict.fromkeys((True, False), "SELECT false"))
    with pytest.raises(IntegrityError):
        broken(engine, table, column, in_sets=True)


def test_the_keys_hold_again_after_a_load(engine: Engine) -> None:
    """Within the same transaction; where somebody added triggers, they fire, and keys are checked row by row."""
    with dialect_of(engine.url).writing(engine) as connection:
        run_id = connection.scalar(text("SELECT run_id FROM run"))
        role = text("SHOW session_replication_role")
        with postgis.keys_in_sets(connection, ["part"], run_id):
            assert connection.scalar(role) == "replica"
        assert connection.scalar(role) == "origin"
        connection.execute(text("CREATE TABLE note (part_id bigint)"))
        connection.execute(
            text(
                "CREATE FUNCTION noted() RETURNS trigger LANGUAGE plpgsql AS "
                "'BEGIN INSERT INTO note VALUES (NEW.part_id); RETURN NEW; END'"
            )
        )
        connection.execute(text("CREATE TRIGGER noted AFTER INSERT ON part FOR EACH ROW EXECUTE FUNCTION noted()"))
        with postgis.keys_in_sets(connection, ["part"], run_id):
            assert connection.scalar(role) == "origin"
    changed = small_build()
    write_build(engine, replace(changed, run=replace(changed.run, version="2")))
    with engine.connect() as connection:
        assert connection.scalar(text("SELECT count(*) FROM note")) == len(changed.frames["part"])


def test_a_load_without_the_right_gives_the_same_content(engine: Engine, monkeypatch: pytest.MonkeyPatch) -> None:
    """As on older servers, and for users without the grant."""
    changed = small_build()
    changed = replace(changed, run=replace(changed.run, version="2"))
    assert write_build(engine, changed).status == "replaced"
    in_sets = list(canonical_dump(engine))
    write_build(engine, small_build())
    monkeypatch.setattr(setkeys, "_MAY", dict.fromkeys((True, False), "SELECT false"))
    assert write_build(engine, changed).status == "replaced"
    assert list(canonical_dump(engine)) == in_sets

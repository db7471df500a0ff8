"""Many at once: writers of different areas, readers among them, two operators, and one writer at a time on a file."""

import multiprocessing
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import pytest
from simulated.builds import big_build, small_build
from simulated.scenes import SCENES
from sqlalchemy import Engine, text
from sqlalchemy.exc import DBAPIError
from support.faultfiles import write_points
from support.sizes import sample
from support.streettiles import bring, bring_when, tile

from msbdb import api
from msbdb.api import advance
from msbdb.database import (
    BuildBasis,
    OutdatedError,
    canonical_dump,
    check_database,
    copy_database,
    footprint_at,
    open_database,
    read_build,
    read_classes,
    read_digest,
    read_labelled_classes,
    read_states,
    store_build,
    write_build,
    write_state,
)
from msbdb.database.dialects.connection import snapshot
from msbdb.database.dialects.dialect import dialect_of
from msbdb.database.schema.sqltables import METADATA
from msbdb.errors import DatabaseError
from msbdb.kept import KeptRun
from msbdb.params import Params, with_values
from msbdb.run import compose, store
from msbdb.run.inventory import update

SPAWN = multiprocessing.get_context("spawn")

# rasterio itself silences this warning while it burns shapes. But all threads share the filters of warnings, so that
# another thread may restore them meanwhile.
pytestmark = pytest.mark.filterwarnings("ignore:Dataset has no geotransform")


def content(target: str) -> list[str]:
    """Return all but the numbers of events, which tell in which order they came."""
    return [line for line in canonical_dump(open_database(target)) if not line.startswith('["inventory_event"')]


@pytest.mark.parametrize("each", sample([1, 2], 2))
def test_processes_at_once_bring_different_areas_into_one_database(target: str, tmp_path: Path, each: int) -> None:
    """From an empty place on, so many tiles each: all is there, sound, and equal to one after the other."""
    own, others = tuple(range(each)), tuple(range(each, 2 * each))
    one = str(tmp_path / "sequential.sqlite")
    bring(one, own + others)
    begun = SPAWN.Event()
    other = SPAWN.Process(target=bring_when, args=(target, others, begun))
    other.start()
    assert begun.wait(60)
    bring(target, own)
    other.join()
    assert other.exitcode == 0
    assert content(target) == content(one)
    assert check_database(open_database(target)) == []


@pytest.fixture(scope="module")
def begun_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a file with the first survey of one tile in its inventory, to be copied."""
    path = tmp_path_factory.mktemp("begun") / "city.sqlite"
    store_build(path, tile(0))
    advance(path, "t0_2020")
    return path


@pytest.fixture
def begun(target: str, begun_file: Path) -> str:
    """Return a database with the first survey of one tile in its inventory."""
    if "://" in target:
        copy_database(begun_file, target)
    else:
        shutil.copy(begun_file, target)
    return target


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Callable[[float], list[str]]:
    """Return what makes, once, the content after a second survey by itself."""
    folder = tmp_path_factory.mktemp("undisturbed")

    @cache
    def make(grown: float) -> list[str]:
        path = str(folder / f"{grown}.sqlite")
        for build in (tile(0), tile(0, 2021, grown=grown)):
            store_build(path, build)
            advance(path, build.survey.name)
        return content(path)

    return make


def test_updates_of_one_survey_at_once_end_in_one_of_them(
    begun: str, undisturbed: Callable[[float], list[str]]
) -> None:
    """Run and inventory are of the same one, whichever was built last, as if it had been alone."""
    alone = [undisturbed(grown) for grown in (5.0, 9.0)]
    assert alone[0] != alone[1]

    def bring_one(grown: float) -> None:
        store_build(begun, tile(0, 2021, grown=grown), timeout_s=60)
        advance(begun, "t0_2021")

    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(bring_one, (5.0, 9.0))) == [None, None]
    assert content(begun) in alone
    assert check_database(open_database(begun)) == []


def test_a_build_during_an_update_is_compared_anew(
    begun: str, undisturbed: Callable[[float], list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What was computed from the run that is gone is not written."""
    original, calls = update.write_advance, []

    def meanwhile(*args: object) -> str:
        calls.append(args)
        if len(calls) == 1:
            store_build(begun, tile(0, 2021, grown=9.0))
        return original(*args)

    monkeypatch.setattr(update, "write_advance", meanwhile)
    store_build(begun, tile(0, 2021, grown=5.0))
    assert advance(begun, "t0_2021").status == "created"
    assert len(calls) == 2
    assert content(begun) == undisturbed(9.0)


def test_an_update_that_others_always_overtake_says_so(begun: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """After some attempts, in one line; the inventory stays as it was."""

    def overtaken(*args: object) -> str:
        raise OutdatedError

    store_build(begun, tile(0, 2021))
    before = content(begun)
    monkeypatch.setattr(update, "write_advance", overtaken)
    with pytest.raises(DatabaseError, match="Others keep changing the inventory at the place of the survey 't0_2021'"):
        advance(begun, "t0_2021")
    assert content(begun) == before


@contextmanager
def rewriting(engine: Engine, builds: list[KeptRun]) -> Iterator[threading.Event]:
    """Write builds by turns until the block ends; yields what is set when all were written once."""
    stop, once, failures = threading.Event(), threading.Event(), []

    def work() -> None:
        try:
            while not stop.is_set():
                for build in builds:
                    write_build(engine, build)
                once.set()
        except BaseException as error:
            failures.append(error)
            once.set()

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield once
    finally:
        stop.set()
        thread.join()
    assert failures == []


def test_readers_see_whole_states_while_a_survey_is_replaced(target: str) -> None:
    """A dump and a build are of one state, though they are many queries, and one of those that were written."""
    low, high = big_build(120, height_m=6.0), big_build(90, height_m=9.0)
    store_build(target, low)
    engine = open_database(target)
    states = {}
    for build in (low, high):
        write_build(engine, build)
        states[len(build.frames["part"])] = list(canonical_dump(engine))
    seen = set()
    with rewriting(engine, [low, high]) as once:
        until = time.monotonic() + 60
        while not (once.is_set() and len(seen) == 2) and time.monotonic() < until:
            dump = list(canonical_dump(engine))
            assert dump in list(states.values())
            build = read_build(engine)
            parts = build.frames["part"]
            assert len(build.frames["building"]) * 2 == len(parts)
            assert parts["h_max"].unique().tolist() == ([6.0] if len(parts) == 240 else [9.0])
            seen.add(len(parts))
    assert seen <= set(states)


def test_two_operators_on_one_building_follow_each_other(begun: str) -> None:
    """Whoever comes last has the word, and is told whose it was; nobody's word on another building is lost."""
    engine = open_database(begun, timeout_s=60)
    one, other = footprint_at(engine, "2020")["uid"].tolist()

    def say(name: str, uid: int) -> list[str | None]:
        replaced = []
        for n in range(6):
            words = {"operator": name, "note": f"{name} {n}", "decided_at": f"2020-01-01T00:00:0{n}Z"}
            before = write_state(engine, uid, ("confirmed", "refuted")[n % 2], **words)
            replaced.append(None if before is None else before["note"])
        return replaced

    with ThreadPoolExecutor(3) as pool:
        ann, ben, cleo = pool.map(say, ("ann", "ben", "cleo"), (one, one, other))
    said = read_states(engine).set_index("uid")
    assert len(said) == 2
    assert cleo == [None, *(f"cleo {n}" for n in range(5))]
    assert said.loc[other, ["operator", "state", "note"]].tolist() == ["cleo", "refuted", "cleo 5"]
    # Each word was replaced by just one other, but for the last.
    assert said["note"][one] in {"ann 5", "ben 5"}
    replaced = sorted(word for word in [*ann, *ben, said["note"][one]] if word is not None)
    assert replaced == sorted(f"{name} {n}" for name in ("ann", "ben") for n in range(6))


def test_labels_that_came_meanwhile_are_not_written_over(target: str) -> None:
    """A build that did not know of them, or went on from an older run, is refused; nothing changes."""
    build = small_build()
    store_build(target, build)
    engine = open_database(target)
    before, digest = read_labelled_classes(target, "delft"), read_digest(engine, "delft")
    assert store_build(target, small_build(version="2"), basis=BuildBasis(before, digest)).status == "replaced"
    classes = build.frames["spectral_class"]
    labelled = classes.assign(label="vegetation", labelled_by="operator")
    write_build(engine, KeptRun(build.survey, build.run, {**build.frames, "spectral_class": labelled}, build.rasters))
    for basis in (BuildBasis(labelled=before), BuildBasis(content_sha256=digest)):
        with pytest.raises(OutdatedError):
            store_build(target, small_build(version="3"), basis=basis)
    assert set(read_classes(engine)["label"]) == {"vegetation"}
    known = BuildBasis(read_labelled_classes(target, "delft"), read_digest(engine, "delft"))
    assert store_build(target, small_build(version="3"), basis=known).status == "replaced"


def test_a_second_writer_waits_for_the_first(target: str) -> None:
    """Not longer than it has to, and then all is there."""
    store_build(target, small_build("one"))
    engine = open_database(target, timeout_s=30)
    with ThreadPoolExecutor(1) as pool:
        with dialect_of(engine.url).writing(engine) as connection:
            connection.execute(text("UPDATE survey SET density = 12.5"))
            second = pool.submit(write_build, engine, small_build("two", shift=1000))
            time.sleep(0.5)
            assert not second.done()
        assert second.result().status == "created"
    with engine.connect() as connection:
        assert sorted(connection.scalars(text("SELECT density FROM survey"))) == [10.5, 12.5]


def test_a_writer_that_waited_in_vain_says_so(target: str) -> None:
    """One line: which database, why, and what to do; and readers are not held up."""
    store_build(target, small_build("one"))
    engine = open_database(target, timeout_s=0.3)
    with dialect_of(engine.url).writing(engine):
        with pytest.raises(DatabaseError, match=r"is locked: another program writes to it.*try again"):
            write_build(engine, small_build("two", shift=1000))
        assert len(read_classes(engine, "one")) == 3


@pytest.fixture(scope="module")
def labelling(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Return the points of a small scene with colours, and a database of them."""
    folder = tmp_path_factory.mktemp("labelling")
    cloud = SCENES["podium_tower"](density=1.0).points
    points = write_points(folder / "tile.laz", cloud, crs=cloud.crs)
    api.build([points], db=folder / "town.sqlite", survey="new", extract=["multiscale"])
    return points, folder / "town.sqlite"


def test_operators_who_label_at_once_both_have_their_labels(
    labelling: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second gives the label again, to what the first wrote."""
    db = shutil.copy(labelling[1], tmp_path / "town.sqlite")
    original, calls = store.relabelled, []

    def meanwhile(*args: object) -> KeptRun:
        calls.append(args)
        if len(calls) == 1:
            api.relabel(db, {1: "other"})
        return original(*args)

    monkeypatch.setattr(store, "relabelled", meanwhile)
    api.relabel(db, {2: "other"})
    assert len(calls) == 3
    classes = read_classes(open_database(db)).set_index("speindex")
    assert classes.loc[[1, 2], ["label", "labelled_by"]].to_numpy().tolist() == [["other", "operator"]] * 2


def test_a_label_during_a_rebuild_is_not_lost(
    labelling: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The build says so; built again, the label is there."""
    db = shutil.copy(labelling[1], tmp_path / "town.sqlite")
    original = compose.run_survey

    def meanwhile(*args: object) -> object:
        api.relabel(db, {1: "other"})
        return original(*args)

    params = with_values(Params(), {"surface": {"storey_m": 2.8}})
    again = {"db": db, "survey": "new", "extract": ["multiscale"], "params": params}
    monkeypatch.setattr(compose, "run_survey", meanwhile)
    with pytest.raises(DatabaseError, match="An operator labelled classes of the survey 'new' while it was built"):
        api.build([labelling[0]], **again)
    monkeypatch.undo()
    assert api.build([labelling[0]], **again).changed
    assert read_classes(open_database(db)).set_index("speindex").loc[1, "label"] == "other"


def row_versions(engine: Engine) -> dict[tuple[str, str], str]:
    """Return place and transactions of each row, by table and key: whoever writes or locks a row changes them."""
    found = {}
    with engine.connect() as connection:
        for table in METADATA.sorted_tables:
            key = ", ".join(column.name for column in table.primary_key.columns)
            rows = connection.execute(
                text(f"SELECT ({key})::text, ctid || '/' || xmin || '/' || xmax FROM {table.name}")
            )
            found |= {(table.name, own): version for own, version in rows}
    return found


@pytest.mark.postgis
def test_an_update_of_one_tile_touches_only_its_rows(new_postgis: Callable[[], str]) -> None:
    """Of all rows that were there only those of the tile's own buildings and survey are written or locked."""
    target = new_postgis()
    for number in (0, 1, 2):
        store_build(target, tile(number))
        advance(target, f"t{number}_2020")
    engine = open_database(target)
    before = row_versions(engine)
    with engine.connect() as connection:
        own = connection.execute(
            text(
                "SELECT v.uid, v.version_id, s.survey_id FROM building_version AS v "
                "JOIN survey AS s ON s.survey_id = v.survey_id WHERE s.name = 't1_2020'"
            )
        ).all()
    store_build(target, tile(1, 2021))
    advance(target, "t1_2021")
    after = row_versions(engine)
    touched = {row for row, version in before.items() if after.get(row) != version}
    tables = ("inventory_building", "building_version", "survey")
    assert touched
    assert touched <= {(table, str(key)) for row in own for table, key in zip(tables, row, strict=True)}


@pytest.mark.postgis
def test_isolation_is_what_was_chosen(new_postgis: Callable[[], str]) -> None:
    """Whatever the server's default: writers see what was committed before their lock, readers one state alone."""
    target = new_postgis()
    store_build(target, small_build("one"))
    engine, level = open_database(target), text("SHOW transaction_isolation")
    default = f"ALTER DATABASE {engine.url.database} SET default_transaction_isolation = '%s'"
    with engine.begin() as connection:
        connection.execute(text(default % "serializable"))
    try:
        with dialect_of(engine.url).writing(engine) as connection:
            assert connection.scalar(level) == "read committed"
        with snapshot(engine) as connection:
            assert connection.scalar(level) == "repeatable read"
            with pytest.raises(DBAPIError, match="read-only transaction"):
                connection.execute(text("UPDATE survey SET density = 1"))
    finally:
        with engine.begin() as connection:
            connection.execute(text(default % "read committed"))


@pytest.mark.postgis
def test_a_writer_whose_machine_is_gone_frees_its_lock_soon(new_postgis: Callable[[], str]) -> None:
    """Both ends ask each other whether they live: a minute after the last word, not two hours."""
    target = new_postgis()
    store_build(target, small_build("one"))
    with open_database(target).connect() as connection:
        given = connection.connection.driver_connection.info.get_parameters()
    for name, value in {"idle": 30, "interval": 10, "count": 3}.items():
        assert given[f"keepalives_{name}"] == str(value)
        assert f"-c tcp_keepalives_{name}={value}" in given["options"]
    assert given["tcp_user_timeout"] == "60000"
    assert "-c tcp_user_timeout=60000" in given["options"]


@pytest.mark.postgis
def test_a_connection_that_is_cut_is_told(new_postgis: Callable[[], str]) -> None:
    """As the server's or the network's doing, and nothing is written."""
    target = new_postgis()
    store_build(target, small_build("one"))
    engine, other = open_database(target), open_database(target)
    before = list(canonical_dump(engine))
    with pytest.raises(DatabaseError, match=r"connection was lost: .* run the command again"):
        cut_while_writing(engine, other)
    assert list(canonical_dump(other)) == before


def cut_while_writing(engine: Engine, other: Engine) -> None:
    """Close a writer's connection from the server's side, between its rows."""
    from msbdb.database.dialects import postgis

    original = postgis.after_load

    def cut(connection: object) -> None:
        with other.connect() as closing:
            closing.execute(text("SELECT pg_terminate_backend(pid) FROM pg_locks WHERE locktype = 'advisory'"))
        original(connection)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(postgis, "after_load", cut)
        write_build(engine, small_build("two", shift=1000))

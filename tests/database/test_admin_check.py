"""Deliberate corruptions, each found and named by the check; what is sound is left in peace."""

import shutil
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import psycopg
import pytest
from numpy.typing import NDArray
from simulated.builds import CROWN, EPSG, HOUSE, LIFT, PODIUM, SLAB, SLAB_ROOF, small_build
from sqlalchemy import URL, Engine, event, make_url, text
from support.sizes import sample

from msbdb.api import advance
from msbdb.database import (
    CHECKS,
    Finding,
    check_database,
    copy_database,
    open_database,
    write_build,
    write_import,
    write_samples,
    write_state,
)
from msbdb.database.admin import shapechecks
from msbdb.database.history.versions import MEASURES
from msbdb.database.schema.sqltables import METADATA
from msbdb.identity import text_id

RUN, OTHER_RUN = text_id("run", "delft"), text_id("run", "spring")
UID = text_id("inventory building", "import", "register", "1")
ENTERED, GONE = text_id("version", "import", "register", UID), text_id("change", "spring", "demolished", UID, None)
"""A building of the imported register: its first version, which ended with the first survey, and its end."""
SAMPLE = text_id("roof sample", (85_002) * 1000, (446_002) * 1000)
VERSION = """
INSERT INTO building_version (version_id, uid, valid_from, valid_to, source, state, area_m2, geometry)
SELECT {id}, 7, '{begins}', {ends}, 'import', 'unsure', 100, geometry FROM part WHERE part_id = {HOUSE}
"""
BUILDING_7 = "INSERT INTO inventory_building (uid, source) VALUES (7, 'register')"


def version(number: int, begins: str, ends: str | None) -> str:
    """Return the statement that gives building 7 a version with the outline of the house."""
    return VERSION.format(id=number, begins=begins, ends=f"'{ends}'" if ends else "NULL", HOUSE=HOUSE)


def moved(geometry: str, x: float) -> str:
    """Return an expression for a geometry that lies elsewhere."""
    return f"ST_Translate({geometry}, {x}, 0, 0)"


@dataclass(frozen=True)
class Corruption:
    """What is done to a database, by whom nothing is enforced, and what the check must say of it.

    ``spatialite`` and ``postgis`` are what goes before, or stands for ``sql``, on one dialect.
    """

    name: str
    check: str
    table: str
    key: str
    what: str
    sql: tuple[str, ...] = ()
    spatialite: tuple[str, ...] = ()
    postgis: tuple[str, ...] = ()


KEPT = (
    "run_id, scale, hindex, hzone, speindex, xo, yo, xcen, ycen, xin, yin, area_px, area_m2, h_max, h_mean, h_p50, "
    "h_p90, h_std, building_share, outline_source, geometry"
)
"""The columns of part but its place in the forest."""

BOWTIE = "MULTIPOLYGON(((85000 446000, 85010 446010, 85010 446000, 85000 446010, 85000 446000)))"

CORRUPTIONS = [
    Corruption(
        "a father is gone",
        *("forest", "part", f"part_id={LIFT}", f"its father {SLAB} does not exist"),
        sql=(f"DELETE FROM part WHERE part_id = {SLAB}",),
    ),
    Corruption(
        "the father's key refers to nothing",
        *("foreign keys", "part", f"part_id={LIFT}", f"father_id={SLAB}"),
        sql=(f"DELETE FROM part WHERE part_id = {SLAB}",),
    ),
    Corruption(
        "fathers in a circle",
        *("forest", "part", f"part_id={SLAB}", "form a circle"),
        sql=(f"UPDATE part SET supid = {LIFT}, supscale = 3 WHERE part_id = {SLAB}",),
        postgis=("ALTER TABLE part DROP CONSTRAINT ck_part_father",),
    ),
    Corruption(
        "a father on a finer scale",
        *("forest", "part", f"part_id={SLAB}", "it is on scale 2"),
        sql=(
            f"UPDATE part SET scale = 3 WHERE part_id = {PODIUM}",
            f"UPDATE part SET supscale = 3 WHERE part_id = {SLAB}",
        ),
        postgis=("ALTER TABLE part DROP CONSTRAINT ck_part_father",),
    ),
    Corruption(
        "a part larger than its father",
        *("forest", "part", f"part_id={SLAB}", "it has 99999 cells"),
        sql=(f"UPDATE part SET area_px = 99999 WHERE part_id = {SLAB}",),
    ),
    Corruption(
        "a part of another tree than its father",
        *("forest", "part", f"part_id={LIFT}", f"its tree is {HOUSE}"),
        sql=(f"UPDATE part SET root_id = {HOUSE} WHERE part_id = {LIFT}",),
    ),
    Corruption(
        "a link to a region of another run",
        *("links", "part_flat_region", f"part_id={SLAB}, region_id={SLAB_ROOF}", f"it is of run {OTHER_RUN}"),
        sql=(f"UPDATE part_flat_region SET run_id = {OTHER_RUN} WHERE part_id = {SLAB}",),
    ),
    Corruption(
        "an outline that crosses itself",
        *("geometries", "part", f"part_id={HOUSE}", "not valid: Self-intersection"),
        sql=(f"UPDATE part SET geometry = ST_GeomFromText('{BOWTIE}', {EPSG}) WHERE part_id = {HOUSE}",),
    ),
    Corruption(
        "a building outside its survey",
        *("geometries", "building", f"building_id={HOUSE}", "it reaches to 95060.00"),
        sql=(f"UPDATE building SET geometry = {moved('geometry', 10_000)} WHERE building_id = {HOUSE}",),
    ),
    Corruption(
        "an outline of another SRID",
        *("geometries", "part", f"part_id={HOUSE}", "its SRID is 4326"),
        sql=(f"UPDATE part SET geometry = {{set_srid}}(geometry, 4326) WHERE part_id = {HOUSE}",),
        spatialite=("DROP TRIGGER ggu_part_geometry",),
        postgis=("UPDATE pg_attribute SET atttypmod = -1 WHERE attrelid = 'part'::regclass AND attname = 'geometry'",),
    ),
    Corruption(
        "a register that names another SRID",
        *("registers", "building", "geometry", "the registered SRID is 4326"),
        spatialite=("UPDATE geometry_columns SET srid = 4326 WHERE f_table_name = 'building'",),
        postgis=(
            "UPDATE pg_attribute SET atttypmod = geometry_typmod_in('{MULTIPOLYGON,4326}') "
            "WHERE attrelid = 'building'::regclass AND attname = 'geometry'",
        ),
    ),
    Corruption(
        "no spatial index",
        *("spatial index", "part", "", "the index is missing"),
        spatialite=("UPDATE geometry_columns SET spatial_index_enabled = 0 WHERE f_table_name = 'part'",),
        postgis=("DROP INDEX idx_part_geometry",),
    ),
    Corruption(
        "a ledger row less",
        *("ledger", "rejection", f"run_id={RUN}", "1 rows of stage 'spectral' of multiscale for 'vegetation'"),
        sql=(f"DELETE FROM rejection WHERE region_id = {CROWN}",),
    ),
    Corruption(
        "a dropped region counted once more",
        *("ledger", "rejection_count", f"run_id={RUN}", "3 regions of stage 'spectral' of multiscale"),
        sql=("UPDATE rejection_count SET regions = 3, small = 1 WHERE stage = 'spectral'",),
    ),
    Corruption(
        "a part more than was kept",
        *("ledger", "part", f"run_id={RUN}", "7 parts"),
        sql=(
            f"INSERT INTO part (part_id, supid, supscale, root_id, building_id, {KEPT}) "
            f"SELECT 99, 0, 0, 99, building_id, {KEPT} FROM part WHERE part_id = {HOUSE}",
        ),
    ),
    Corruption(
        "books that do not balance",
        *("ledger", "run", f"run_id={RUN}", "stage 'a' of multiscale: 3 in, 1 kept, 1 dropped"),
        sql=("""UPDATE run SET counts = '{"regions": {"multiscale": {"a": {"in": 3, "kept": 1, "dropped": 1}}}}'""",),
    ),
    Corruption(
        "a building with a wrong count of parts",
        *("buildings", "building", f"building_id={PODIUM}", "parts is 9"),
        sql=(f"UPDATE building SET parts = 9 WHERE building_id = {PODIUM}",),
    ),
    Corruption(
        "a part without a building",
        *("buildings", "part", f"part_id={HOUSE}", "its building does not exist"),
        sql=(f"DELETE FROM building WHERE building_id = {HOUSE}",),
    ),
    Corruption(
        "a part in another building than its root",
        *("buildings", "part", f"part_id={LIFT}", f"it is in building {HOUSE}"),
        sql=(f"UPDATE part SET building_id = {HOUSE} WHERE part_id = {LIFT}",),
    ),
    Corruption(
        "a share above 1",
        *("values", "part", f"part_id={HOUSE}", "it breaks ck_part_building_share"),
        sql=(f"UPDATE part SET building_share = 1.5 WHERE part_id = {HOUSE}",),
        postgis=("ALTER TABLE part DROP CONSTRAINT ck_part_building_share",),
    ),
    Corruption(
        "a class that does not exist",
        *("foreign keys", "building", f"building_id={HOUSE}", "class_id=77"),
        sql=(f"UPDATE building SET speindex = 77 WHERE building_id = {HOUSE}",),
    ),
    Corruption(
        "a raster that cannot be unpacked",
        *("rasters", "run_state", f"run_id={RUN}, name=ndsm_cm", "it cannot be read"),
        sql=("UPDATE run_state SET data = CAST('x' AS {blob}) WHERE name = 'ndsm_cm'",),
    ),
    Corruption(
        "a raster that was deleted",
        *("rasters", "run_state", f"run_id={RUN}, name=valid", "the raster is missing"),
        sql=("DELETE FROM run_state WHERE name = 'valid'",),
    ),
    Corruption(
        "a raster beside the lattice",
        *("rasters", "run_state", f"run_id={RUN}, name=ndsm_cm", "its shape is [400, 100]"),
        sql=("UPDATE run_state SET shape = '[400, 100]' WHERE name = 'ndsm_cm'",),
    ),
    Corruption(
        "a height that somebody edited",
        *("content", "run", f"run_id={RUN}", "survey 'delft' give the digest"),
        sql=(f"UPDATE building SET h_max = h_max + 0.001 WHERE building_id = {HOUSE}",),
    ),
    Corruption(
        "a cell of a raster that somebody edited",
        *("content", "run", f"run_id={RUN}", "survey 'delft' give the digest"),
        sql=("UPDATE run_state SET dtype = '<f2' WHERE name = 'ndsm_cm'",),
    ),
    Corruption(
        "versions that overlap",
        *("intervals", "building_version", "version_id=2", "it begins on 2021-01-01"),
        sql=(BUILDING_7, version(1, "2020-01-01", "2021-06-01"), version(2, "2021-01-01", None)),
    ),
    Corruption(
        "two current versions",
        *("intervals", "building_version", "version_id=2", "an earlier version that is current"),
        sql=(BUILDING_7, version(1, "2020-01-01", None), version(2, "2021-01-01", None)),
        spatialite=("DROP INDEX ix_building_version_current",),
        postgis=("DROP INDEX ix_building_version_current",),
    ),
    Corruption(
        "a building without a version",
        *("orphans", "inventory_building", "uid=7", "it has no version"),
        sql=(BUILDING_7,),
    ),
    Corruption(
        "a survey without a run",
        *("orphans", "survey", f"survey_id={text_id('survey', 'spring')}", "it has no run"),
        sql=(f"DELETE FROM run WHERE run_id = {OTHER_RUN}",),
    ),
    Corruption(
        "a height in the history that somebody edited",
        *("digests", "building_version", f"version_id={ENTERED}", "its values give the digest"),
        sql=(f"UPDATE building_version SET h_p90 = h_p90 + 0.000001 WHERE version_id = {ENTERED}",),
    ),
    Corruption(
        "an end of a version that somebody edited",
        *("digests", "building_version", f"version_id={ENTERED}", "its values give the digest"),
        sql=(f"UPDATE building_version SET valid_to = '2020-03-31' WHERE version_id = {ENTERED}",),
    ),
    Corruption(
        "an office's attribute that somebody edited",
        *("digests", "building_version", f"version_id={ENTERED}", "its values give the digest"),
        sql=(f"""UPDATE building_version SET attributes = '{{"owner": "me"}}' WHERE version_id = {ENTERED}""",),
    ),
    Corruption(
        "an outline in the history that somebody moved",
        *("digests", "building_version", f"version_id={ENTERED}", "its values give the digest"),
        sql=(f"UPDATE building_version SET geometry = {moved('geometry', 0.01)} WHERE version_id = {ENTERED}",),
    ),
    Corruption(
        "a change that somebody edited",
        *("digests", "building_change", f"change_id={GONE}", "its values give the digest"),
        sql=(f"UPDATE building_change SET note = 'it burned down' WHERE change_id = {GONE}",),
    ),
    Corruption(
        "an offset that somebody edited",
        *("digests", "survey_offset", f"survey_id={text_id('survey', 'delft')}", "its values give the digest"),
        sql=("UPDATE survey_offset SET dx_m = dx_m + 0.5",),
    ),
    Corruption(
        "an update without its offset",
        *("events", "inventory_event", "number=2", "its survey has no offset"),
        sql=(f"DELETE FROM survey_offset WHERE survey_id = {text_id('survey', 'delft')}",),
    ),
    Corruption(
        "a day of an event that somebody edited",
        *("digests", "inventory_event", "number=1", "its values give the digest"),
        sql=("UPDATE inventory_event SET date = '2015-01-02' WHERE number = 1",),
    ),
    Corruption(
        "an origin of a building that somebody edited",
        *("digests", "inventory_building", f"uid={UID}", "its values give the digest"),
        sql=(f"UPDATE inventory_building SET source = 'elsewhere' WHERE uid = {UID}",),
    ),
    Corruption(
        "an operator's word that somebody edited",
        *("digests", "operator_state", f"uid={UID}", "its values give the digest"),
        sql=("UPDATE operator_state SET state = 'confirmed'",),
    ),
    Corruption(
        "an operator's word that msbdb did not write",
        *("digests", "operator_state", "uid=7", "it has no digest"),
        sql=(
            "INSERT INTO operator_state (uid, state, operator, note, decided_at) "
            "VALUES (7, 'refuted', 'me', '', '2024-01-01')",
        ),
    ),
    Corruption(
        "a roof's material that somebody edited",
        *("digests", "roof_sample", f"sample_id={SAMPLE}", "its values give the digest"),
        sql=("UPDATE roof_sample SET material = 'slate'",),
    ),
    Corruption(
        "a view that was dropped",
        *("schema", "footprint_current", "", "the view is missing"),
        sql=("DROP VIEW footprint_current",),
    ),
    Corruption(
        "a table that was dropped",
        *("schema", "run_state", "", "the table is missing"),
        sql=("DROP TABLE run_state",),
    ),
    Corruption(
        "an index that was dropped",
        *("schema", "part", "ix_part_father_id", "the index is missing"),
        sql=("DROP INDEX ix_part_father_id",),
    ),
    Corruption(
        "a column that was dropped",
        *("schema", "spectral_class", "height_m", "the column is missing"),
        sql=("ALTER TABLE spectral_class DROP COLUMN height_m",),
        postgis=("DROP VIEW IF EXISTS roof_material_by_class",),
    ),
    Corruption(
        "a rule that was dropped",
        *("schema", "part", "ck_part_area", "the check is missing"),
        spatialite=(
            "PRAGMA writable_schema = ON",
            "UPDATE sqlite_master SET sql = replace(sql, 'CONSTRAINT ck_part_area ', '') WHERE name = 'part'",
        ),
        postgis=("ALTER TABLE part DROP CONSTRAINT ck_part_area",),
    ),
    Corruption(
        "two runs of one survey",
        *("values", "run", f"survey_id={text_id('survey', 'delft')}", "2 rows have this key"),
        sql=("DROP INDEX ix_run_survey_id", f"UPDATE run SET survey_id = {text_id('survey', 'delft')}"),
    ),
]

ONE_DIALECT = [
    Corruption(
        "two surveys of one name",
        *("values", "survey", "name=delft", "2 rows have this key"),
        postgis=(
            "ALTER TABLE survey DROP CONSTRAINT uq_survey",
            "CREATE TEMPORARY TABLE twin AS SELECT * FROM survey",
            "UPDATE twin SET survey_id = survey_id + 1",
            "INSERT INTO survey SELECT * FROM twin",
        ),
    ),
    Corruption(
        "a row that the index lacks",
        *("spatial index", "part", f"part_id={HOUSE}", "the index lacks the row"),
        spatialite=(f"DELETE FROM idx_part_geometry WHERE pkid = {HOUSE}",),
    ),
    Corruption(
        "a row that the index has elsewhere",
        *("spatial index", "part", f"part_id={HOUSE}", "the index has it at 0.00"),
        spatialite=(f"UPDATE idx_part_geometry SET xmin = 0 WHERE pkid = {HOUSE}",),
    ),
    Corruption(
        "a box without a row",
        *("spatial index", "part", "part_id=5", "a box without a row"),
        spatialite=("INSERT INTO idx_part_geometry VALUES (5, 0, 1, 0, 1)",),
    ),
    Corruption(
        "a word where a number should be",
        *("values", "part", f"part_id={HOUSE}", "hindex holds a value of type text"),
        spatialite=(f"UPDATE part SET hindex = 'many' WHERE part_id = {HOUSE}",),
    ),
    Corruption(
        "a fraction where a whole number should be",
        *("content", "run", f"run_id={RUN}", "its rows cannot be read"),
        spatialite=(f"UPDATE flat_region SET zone = zone + 0.5 WHERE region_id = {SLAB_ROOF}",),
    ),
    Corruption(
        "a trigger that was dropped",
        *("schema", "part", "gii_part_geometry", "the trigger is missing"),
        spatialite=("DROP TRIGGER gii_part_geometry",),
    ),
    Corruption(
        "an index that is not valid",
        *("spatial index", "part", "", "the index is not valid"),
        postgis=("UPDATE pg_index SET indisvalid = false WHERE indexrelid = 'idx_part_geometry'::regclass",),
    ),
    Corruption(
        "a missing value",
        *("values", "survey", f"survey_id={text_id('survey', 'delft')}", "date is null"),
        postgis=("ALTER TABLE survey ALTER COLUMN date DROP NOT NULL", "UPDATE survey SET date = NULL"),
    ),
]


WORDS = {"{blob}": ("BLOB", "bytea"), "{set_srid}": ("SetSRID", "ST_SetSRID")}
"""What is spelled otherwise on each dialect."""


def plant(engine: Engine, corruption: Corruption) -> None:
    """Do the damage with all enforcement off, outside of msbdb."""
    is_file = engine.dialect.name == "sqlite"
    if is_file:
        off = ("PRAGMA foreign_keys = OFF", "PRAGMA ignore_check_constraints = ON")
    else:
        off = ("SET session_replication_role = replica",)
    connection = engine.raw_connection()
    if not is_file:
        connection.driver_connection.autocommit = True
    cursor = connection.cursor()
    for statement in (*off, *(corruption.spatialite if is_file else corruption.postgis), *corruption.sql):
        for word, (spatialite, postgis) in WORDS.items():
            statement = statement.replace(word, spatialite if is_file else postgis)
        cursor.execute(statement)
    cursor.close()
    connection.close()


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a file with an inventory and two surveys, in which all is right."""
    place = tmp_path_factory.mktemp("sound") / "city.sqlite"
    engine = open_database(place, create=True, srid=EPSG)
    for build, height in (small_build(), 900), (small_build("spring", shift=1000), 0):
        level = replace(build.rasters, heights_cm=np.full((100, 400), height, dtype=np.int32))
        write_build(engine, replace(build, rasters=level))
    enter_history(engine)
    return place


def enter_history(engine: Engine) -> None:
    """Import a register, apply both surveys, of which the second finds everything gone, and enter people's words."""
    office = small_build().frames["building"].iloc[[0]]
    unknown = dict.fromkeys(MEASURES) | {"state": "unsure", "area_m2": office.geometry.area, "h_p90": 8.0}
    office = office[["geometry"]].assign(**unknown, key="1", attributes=[{"owner": "O'Hara"}])
    write_import(engine, "register", "2015-01-01", office, digest="of its file")
    for survey in ("delft", "spring"):
        advance(engine.url, survey)
    point = gpd.GeoSeries.from_xy([85_002.0], [446_002.0], crs=EPSG)
    write_samples(engine, gpd.GeoDataFrame({"material": ["tile"], "note": "", "attributes": None}, geometry=point))
    write_state(engine, UID, "refuted", operator="ann", note="", decided_at="2021-06-01T00:00:00Z")


@pytest.fixture(scope="module")
def template(databases: Any, original: Path) -> Iterator[str]:
    """Return the URL of a database of the same content, of which the server makes copies."""
    place = databases.acquire()
    copy_database(original, place)
    yield place
    databases.release([place])


@pytest.fixture(params=["spatialite", pytest.param("postgis", marks=pytest.mark.postgis)])
def sound(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Engine]:
    """Return a database with two surveys, in which all is right, to be damaged."""
    if request.param == "spatialite":
        yield file_of(request, tmp_path)
        return
    yield from server_of(request)


def file_of(request: pytest.FixtureRequest, folder: Path) -> Engine:
    """Return a SpatiaLite file of one's own."""
    return open_database(shutil.copyfile(request.getfixturevalue("original"), folder / "city.sqlite"))


def server_of(request: pytest.FixtureRequest) -> Iterator[Engine]:
    """Yield a PostGIS database of one's own, and drop it."""
    url = make_url(request.getfixturevalue("template"))
    name = f"{url.database}_damaged"
    root = request.getfixturevalue("databases").url
    execute(root, f"DROP DATABASE IF EXISTS {name} WITH (FORCE)")
    execute(root, f"CREATE DATABASE {name} TEMPLATE {url.database}")
    yield open_database(url.set(database=name))
    execute(root, f"DROP DATABASE {name} WITH (FORCE)")


def execute(url: URL, statement: str) -> None:
    """Run a statement outside of a transaction."""
    conninfo = url.set(drivername="postgresql").render_as_string(hide_password=False)
    with psycopg.connect(conninfo, autocommit=True) as connection:
        connection.execute("SET client_min_messages = warning")
        connection.execute(statement.encode())


def found(engine: Engine, corruption: Corruption) -> list[Finding]:
    """Return the findings that name a corruption."""
    return [
        one
        for one in check_database(engine)
        if (one.check, one.table, one.key) == (corruption.check, corruption.table, corruption.key)
        and corruption.what in one.what
    ]


def test_what_is_sound_is_found_sound(sound: Engine) -> None:
    """No check finds anything, each is made, and nothing is changed."""
    steps: list[int] = []
    assert check_database(sound, progress=lambda _stage, done, _total: steps.append(done)) == []
    assert steps == list(range(1, len(CHECKS) + 1))


@pytest.mark.parametrize("corruption", sample(CORRUPTIONS, 3), ids=lambda one: one.name)
def test_each_corruption_is_named(sound: Engine, corruption: Corruption) -> None:
    """By the check, the table and the row; with what is there and what should be."""
    plant(sound, corruption)
    findings = found(sound, corruption)
    assert findings
    assert all(one.expected for one in findings)


@pytest.mark.parametrize("corruption", [one for one in ONE_DIALECT if one.spatialite], ids=lambda one: one.name)
def test_each_corruption_of_a_file_is_named(
    request: pytest.FixtureRequest, tmp_path: Path, corruption: Corruption
) -> None:
    """What SQLite alone lets in: types, and what triggers and the R*Tree keep."""
    engine = file_of(request, tmp_path)
    plant(engine, corruption)
    assert found(engine, corruption)


@pytest.mark.postgis
@pytest.mark.parametrize("corruption", [one for one in ONE_DIALECT if one.postgis], ids=lambda one: one.name)
def test_each_corruption_of_a_server_is_named(request: pytest.FixtureRequest, corruption: Corruption) -> None:
    """What only PostgreSQL's catalogues allow."""
    for engine in server_of(request):
        plant(engine, corruption)
        assert found(engine, corruption)


def test_rows_that_cannot_be_read_do_not_end_the_check(request: pytest.FixtureRequest, tmp_path: Path) -> None:
    """What a check cannot cope with is reported as a finding, and the other checks go on."""
    engine = file_of(request, tmp_path)
    wrong = ("UPDATE run SET counts = '[1, 2'", f"UPDATE part SET supid = 'none' WHERE part_id = {HOUSE}")
    plant(engine, Corruption("", "", "", "", "", spatialite=wrong))
    told = {(one.check, one.what.partition(":")[0]) for one in check_database(engine)}
    for check in ("forest", "ledger"):
        assert (check, "the check failed") in told
    assert ("values", "supid holds a value of type text") in told


def test_a_check_asks_few_questions(sound: Engine) -> None:
    """Each statement takes a millisecond, so a table's rules are tested by one, and a schema is read by one."""
    asked: list[str] = []
    event.listen(sound, "before_cursor_execute", lambda _connection, _cursor, statement, *_: asked.append(statement))
    check_database(sound)
    assert len(asked) < 10 * len(METADATA.tables)


def test_boxes_are_compared_in_batches(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rows of a table come together, not one by one."""
    rows: list[int] = []
    compare = shapechecks._holds

    def counted(own: NDArray[np.float64], entry: NDArray[np.float64]) -> NDArray[np.bool_]:
        rows.append(own.shape[1])
        return compare(own, entry)

    monkeypatch.setattr(shapechecks, "_holds", counted)
    engine = file_of(request, tmp_path)
    with engine.connect() as connection:
        assert not list(CHECKS["spatial index"](connection))
        assert connection.scalar(text("SELECT count(*) FROM part")) in rows


def test_a_box_without_the_last_digit_is_sound(request: pytest.FixtureRequest, tmp_path: Path) -> None:
    """Some versions of SQLite write 120872.99999999999 into the index as 120873; others round it down."""
    engine = file_of(request, tmp_path)
    west, east = np.nextafter((120873.0, 120885.0), 0).tolist()
    shape = f"SetSRID(MultiPolygonFromText('MULTIPOLYGON((({{}})))'), {EPSG})"
    ring = ", ".join(f"{x!r} {y}" for x, y in ((west, 0), (east, 0), (east, 9), (west, 9), (west, 0)))
    with engine.begin() as connection:
        connection.execute(text(f"UPDATE part SET geometry = {shape.format(ring)} WHERE part_id = {HOUSE}"))
        box = f"SELECT xmin, xmax FROM idx_part_geometry WHERE pkid = {HOUSE}"
        assert connection.execute(text(box)).one() in {(120873.0, 120885.0), (120872.984375, 120885.0)}
        assert not list(CHECKS["spatial index"](connection))


def test_findings_are_sorted_and_name_their_check(sound: Engine) -> None:
    """The same damage is told in the same order."""
    plant(sound, CORRUPTIONS[0])
    findings = check_database(sound)
    assert findings == sorted(findings) == check_database(sound)
    assert {one.check for one in findings} <= set(CHECKS)


def test_an_empty_database_is_sound(engine: Engine) -> None:
    """There is nothing to be wrong."""
    assert check_database(engine) == []

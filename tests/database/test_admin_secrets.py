"""Passwords are shown nowhere: not in errors, logs, run rows or JSON; and bad URLs are told without their text."""

import logging
import os
import re
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psycopg
import pytest
from click.testing import CliRunner
from simulated.builds import EPSG, small_build
from simulated.files import write_heights
from sqlalchemy import make_url
from support.towns import ROW, footprints, town_heights

from msbdb.cli.main import cli
from msbdb.database import canonical_dump, create_database, footprint_at, open_database, write_build
from msbdb.database.dialects.dialect import database_url, shown
from msbdb.errors import DatabaseError

SECRET = "Geheim&42"
QUOTED = "Geheim%2642"
SCRIPT = Path(__file__).resolve().parents[2] / "scripts" / "postgis_server"

UNREACHABLE = {
    "a port where nobody listens": f"postgresql://anna:{QUOTED}@127.0.0.1:1/town",
    "a host that does not exist": f"postgresql://anna:{QUOTED}@no-such-host.invalid/town",
    "a socket that does not exist": f"postgresql://anna:{QUOTED}@/town?host=/no/such/folder",
    "a password in the query": f"postgresql://anna@127.0.0.1:1/town?password={QUOTED}",
    "a password of a key in the query": f"postgresql://anna@127.0.0.1:1/town?sslpassword={QUOTED}",
    "two passwords in the query": f"postgresql://anna@127.0.0.1:1/town?password={QUOTED}&password={QUOTED}",
    "an option that is none": f"postgresql://anna:{QUOTED}@127.0.0.1:1/town?passwort={QUOTED}",
    "a port that is no number": f"postgresql://anna:{QUOTED}@localhost:port/town",
    "a password with an at": f"postgresql://anna:{SECRET}@{SECRET}@127.0.0.1:1/town",
    "a password with a slash": f"postgresql://anna:/{SECRET}@127.0.0.1:1/town",
    "another database": f"mysql://anna:{QUOTED}@127.0.0.1:1/town",
    "words of libpq": f"host=127.0.0.1 port=1 user=anna password={SECRET} dbname=town",
}
COMMANDS: dict[str, list[str]] = {
    "check": ["db", "check", "URL", "--json"],
    "dump": ["db", "dump", "URL"],
    "create": ["db", "create", "URL", "--crs", "EPSG:28992"],
    "upgrade": ["db", "upgrade", "URL"],
    "copy": ["db", "copy", "town.sqlite", "URL"],
    "grant": ["db", "grant", "URL", "--role", "reader", "--to", "anna"],
    "info": ["info", "URL", "--json"],
    "import": ["import", "town.gpkg", "--as", "inventory", "--db", "URL", "--json"],
    "samples": ["import", "town.gpkg", "--as", "roof-samples", "--db", "URL", "--json"],
    "update": ["update", "--ndsm", "town.tif", "--db", "URL", "--survey", "first", "--date", "2020", "--json"],
    "changes": ["changes", "URL", "--json"],
    "state": ["state", "URL", "7", "refuted", "--operator", "anna"],
}


def run(words: list[str], url: str) -> Any:
    """Run a command with all that it can tell."""
    words = [url if word == "URL" else word for word in words]
    return CliRunner().invoke(cli, [*words, "-vv", "--debug"], prog_name="msbdb")


def write_town(folder: Path) -> None:
    """Write an office's footprints and heights of the same town into a folder."""
    footprints(ROW).to_file(folder / "town.gpkg")
    write_heights(folder / "town.tif", town_heights(ROW))


def assert_no_secret(*texts: str) -> None:
    """Refuse texts that hold the password, as it is or quoted."""
    for text in texts:
        assert not re.search(f"{re.escape(SECRET)}|{re.escape(QUOTED)}|Geheim", text)


@pytest.mark.parametrize("url", UNREACHABLE.values(), ids=UNREACHABLE)
@pytest.mark.parametrize("name", ["check", "create"])
def test_what_cannot_be_reached_is_told_without_the_password(
    url: str, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Even in the traceback; and it is told as the user's matter, not as a bug."""
    monkeypatch.chdir(tmp_path)
    result = run(COMMANDS[name], url)
    assert result.exit_code == 1
    assert "Error: " in result.stderr
    assert "bug in msbdb" not in result.stderr
    assert_no_secret(result.stdout, result.stderr)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_keeps_the_password(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each command of the group, and another."""
    monkeypatch.chdir(tmp_path)
    create_database("town.sqlite", "EPSG:28992")
    write_town(tmp_path)
    result = run(COMMANDS[name], UNREACHABLE["a port where nobody listens"])
    assert (result.exit_code, "postgresql+psycopg://anna:***@127.0.0.1:1/town" in result.stderr) == (1, True)
    assert_no_secret(result.stdout, result.stderr)


def test_a_url_is_shown_without_any_password() -> None:
    """In its place and in the query, once or twice."""
    url = database_url(f"postgresql://anna:{QUOTED}@host/town?password={QUOTED}&sslpassword={QUOTED}&connect_timeout=3")
    assert_no_secret(shown(url))
    assert "connect_timeout=3" in shown(url)


@pytest.mark.postgis
def test_a_password_that_is_given_needlessly_stays_out_of_the_database(
    new_postgis: Any, caplog: pytest.LogCaptureFixture
) -> None:
    """Neither the rows of a run nor the log know how the database was reached."""
    caplog.set_level(logging.DEBUG)
    url = make_url(new_postgis()).set(password=SECRET)
    engine = open_database(url, create=True, srid=EPSG)
    write_build(engine, small_build())
    result = run(COMMANDS["info"], url.render_as_string(hide_password=False))
    assert result.exit_code == 0
    with engine.connect() as connection:
        rows = connection.exec_driver_sql("SELECT r::text FROM run AS r").scalars().all()
    assert_no_secret(*rows, *canonical_dump(engine, provenance=True), caplog.text, result.stdout, result.stderr)
    assert_no_secret(repr(engine), str(engine.url))


@pytest.mark.postgis
def test_the_inventory_does_not_learn_the_password(
    new_postgis: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Imports, updates, states and changes are written and told without it, in all tables, logs and files."""
    monkeypatch.chdir(tmp_path)
    write_town(tmp_path)
    url = make_url(new_postgis()).set(password=SECRET)
    place = url.render_as_string(hide_password=False)
    told = [run(COMMANDS[name], place) for name in ("import", "update", "changes")]
    engine = open_database(url)
    uid = str(footprint_at(engine, "2021")["uid"].iloc[0])
    told.append(run(["state", "URL", uid, "refuted", "--operator", "anna"], place))
    told.append(run(["changes", "URL", "--out", "changes.geojson"], place))
    assert [result.exit_code for result in told] == [0] * 5
    assert_no_secret(*(result.stdout + result.stderr for result in told), Path("changes.geojson").read_text())
    assert_no_secret(*canonical_dump(engine, provenance=True))
    with engine.connect() as connection:
        for table in ("run", "inventory_event", "operator_state", "building_change"):
            assert_no_secret(*connection.exec_driver_sql(f"SELECT r::text FROM {table} AS r").scalars())


@pytest.fixture(scope="module")
def guarded_server() -> Iterator[str]:
    """Return the URL of a server of one's own that asks the user anna for a password."""
    if not list(Path("/usr/lib/postgresql").glob("*/lib/postgis-3.so")):
        pytest.skip("PostGIS is not installed")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as name:
        folder = Path(name)
        folder.chmod(0o755)
        place = folder / "pg"
        started = subprocess.run([SCRIPT, "start", place], capture_output=True, text=True, check=True)
        try:
            rules = place / "data" / "pg_hba.conf"
            rules.write_text("local all anna scram-sha-256\n" + rules.read_text())
            url = make_url(started.stdout.strip())
            conninfo = url.set(drivername="postgresql").render_as_string(hide_password=False)
            with psycopg.connect(conninfo, autocommit=True) as connection:
                connection.execute(f"CREATE ROLE anna LOGIN SUPERUSER PASSWORD '{SECRET}'".encode())
                connection.execute("SELECT pg_reload_conf()")
            yield url.set(username="anna").render_as_string()
        finally:
            subprocess.run([SCRIPT, "stop", place], capture_output=True, check=True)


@pytest.mark.postgis
def test_a_wrong_password_is_told_without_it(guarded_server: str) -> None:
    """A real server refuses it, and takes the right one."""
    url = make_url(guarded_server)
    for command in ("check", "create", "info"):
        result = run(COMMANDS[command], url.set(password=f"{SECRET}x").render_as_string(hide_password=False))
        assert result.exit_code == 1
        assert 'password authentication failed for user "anna"' in result.stderr
        assert_no_secret(result.stdout, result.stderr)
    result = run(COMMANDS["create"], url.set(password=SECRET).render_as_string(hide_password=False))
    assert (result.exit_code, "Created" in result.stdout) == (0, True)
    assert_no_secret(result.stdout, result.stderr)


def test_the_environment_can_hold_the_password(monkeypatch: pytest.MonkeyPatch) -> None:
    """PGPASSWORD is libpq's own way; it is not shown either."""
    monkeypatch.setitem(os.environ, "PGPASSWORD", SECRET)
    with pytest.raises(DatabaseError) as refused:
        open_database("postgresql://anna@127.0.0.1:1/town")
    assert_no_secret(str(refused.value), repr(refused.value.__cause__))

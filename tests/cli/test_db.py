"""``msbdb db`` on real files: what each command prints, writes and ends with."""

import json
import re
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from simulated.builds import EPSG, HOSTILE, small_build
from sqlalchemy import text
from support.latermigration import LATER, TODAY, migrations_of_tomorrow

from msbdb.cli.db import db as commands
from msbdb.cli.main import cli
from msbdb.database import CHECKS, ROLES, Finding, canonical_dump, check_database, open_database, write_build
from msbdb.database.dialects import migration as upgrade


def run(*args: str) -> Any:
    """Run a command line of msbdb db."""
    return CliRunner().invoke(cli, ["db", *args], prog_name="msbdb")


def told(*args: str, code: int = 0) -> Any:
    """Return what a command line prints as JSON, and nothing else."""
    result = run(*args, "--json")
    assert result.exit_code == code, result.stderr
    return json.loads(result.stdout)


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a database of two surveys, one with a hostile name, to be copied."""
    path = tmp_path_factory.mktemp("original") / "town.sqlite"
    engine = open_database(path, create=True, srid=EPSG)
    write_build(engine, small_build())
    write_build(engine, small_build(HOSTILE, shift=1000))
    return path


@pytest.fixture
def town(original: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Return a copy of it in a folder of its own, which is the current one."""
    monkeypatch.chdir(tmp_path)
    return str(Path(shutil.copy(original, tmp_path)).relative_to(tmp_path))


def test_create_tells_whether_it_did(tmp_path: Path) -> None:
    """The first time and the second."""
    place = str(tmp_path / "new.sqlite")
    assert told("create", place, "--crs", "28992") == {"database": place, "crs": "EPSG:28992", "created": True}
    assert told("create", place, "--crs", "EPSG:28992")["created"] is False
    assert "It exists already, unchanged" in run("create", place, "--crs", "EPSG:28992").stdout
    assert run("create", place).exit_code == 2


@pytest.fixture
def tomorrow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Return what makes the schema of tomorrow the newest."""
    folder = migrations_of_tomorrow(tmp_path / "migrations")
    return lambda: monkeypatch.setattr(upgrade, "packaged", lambda _name: folder)


def test_upgrade_and_downgrade_tell_the_versions(tmp_path: Path, tomorrow: Callable[[], None]) -> None:
    """Before and after, and what was lost."""
    place = str(tmp_path / "old.sqlite")
    told("create", place, "--crs", "28992")
    tomorrow()
    assert run("check", place).exit_code == 1
    assert "msbdb db upgrade" in run("check", place).stderr
    told_up = told("upgrade", place)
    assert (told_up["before"], told_up["lost"]) == (TODAY, [])
    assert told("downgrade", place, "--to", TODAY)["after"] == TODAY
    assert LATER in run("upgrade", place).stdout


def test_a_downgrade_with_losses_ends_with_1(town: str, tomorrow: Callable[[], None]) -> None:
    """It names what would be lost; forced, it lists what was."""
    tomorrow()
    told("upgrade", town)
    refused = run("downgrade", town, "--to", TODAY)
    assert refused.exit_code == 1
    assert "6 values of building.colour" in refused.stderr
    assert "6 values of building.colour" in told("downgrade", town, "--to", TODAY, "--force")["lost"]


def test_a_sound_database_ends_with_0(town: str) -> None:
    """In words and as JSON."""
    result = run("check", town)
    assert (result.exit_code, f"{len(CHECKS)} checks passed" in result.stdout) == (0, True)
    found = told("check", town)
    assert found["findings"] == []
    assert "forest" in found["checks"]


def test_an_unsound_database_ends_with_1_and_says_why(town: str) -> None:
    """A row a finding: check, table, key, what, expected; a hostile name is shown as it is."""
    engine = open_database(town)
    connection = engine.raw_connection()
    cursor = connection.cursor()
    cursor.execute("PRAGMA foreign_keys = OFF")
    cursor.execute("UPDATE survey SET name = '[/red] ' || name")
    connection.close()
    result = run("check", town)
    assert result.exit_code == 1
    assert f"[/red] {HOSTILE}" in result.stdout
    assert "2 findings" in result.stdout
    [one, two] = told("check", town, code=1)["findings"]
    assert set(one) == {"check", "table", "key", "what", "expected"}
    assert {one["check"], two["check"]} == {"content"}


def test_dump_is_the_same_twice_and_in_a_file(town: str) -> None:
    """To the byte, with and without what tells of files."""
    expected = "".join(f"{line}\n" for line in canonical_dump(open_database(town))).encode()
    assert run("dump", town).stdout_bytes == run("dump", town).stdout_bytes == expected
    assert run("dump", town, "--out", "a.txt").exit_code == 0
    assert Path("a.txt").read_bytes() == expected
    assert run("dump", town, "--provenance", "--out", "b.txt").exit_code == 0
    assert b"tile.laz" in Path("b.txt").read_bytes()
    assert b"tile.laz" not in expected
    assert run("dump", town, "--out", "no/where.txt").exit_code == 1


def test_copy_tells_the_rows(town: str) -> None:
    """By table as JSON, in all in words; a target with rows is refused."""
    rows = told("copy", town, "copy.sqlite")["rows"]
    assert (rows["survey"], rows["part"]) == (2, 12)
    assert run("copy", town, "copy.sqlite").exit_code == 1
    assert str(sum(rows.values())) in run("copy", town, "again.sqlite").stdout
    assert check_database(open_database("copy.sqlite")) == []


def test_grant_is_for_servers(town: str) -> None:
    """A file has no users; the message says what to do instead."""
    refused = run("grant", town, "--role", "reader", "--to", "anna")
    assert refused.exit_code == 1
    assert "file system" in refused.stderr
    assert run("grant", town, "--role", "king", "--to", "anna").exit_code == 2


def upgrade_without_values(town: str, tomorrow: Callable[[], None]) -> None:
    """Bring a town to the schema of tomorrow, with no row or value that today's could not hold."""
    tomorrow()
    told("upgrade", town)
    with open_database(town).begin() as connection:
        connection.execute(text("UPDATE building SET colour = NULL"))
        for table in ("visit", "flat_region_candidate"):
            connection.execute(text(f"DELETE FROM {table}"))


@pytest.mark.parametrize("line", commands.examples)
def test_every_example_runs_as_written(line: str, town: str, tomorrow: Callable[[], None]) -> None:
    """On a town; an example for a server that does not exist fails for that reason."""
    words = shlex.split(line)[2:]
    if words[0] == "create":
        Path(town).unlink()
    if words[0] == "downgrade":
        upgrade_without_values(town, tomorrow)
    result = run(*words)
    if "postgresql" in line:
        assert (result.exit_code, "me@localhost/town" in result.stderr) == (1, True)
    else:
        assert result.exit_code == 0, result.stderr


def test_the_group_lists_its_commands() -> None:
    """The help of the group names each, with the examples."""
    shown = run("--help").stdout
    for name, made in commands.commands.items():
        assert name in shown
        assert all(line in shown for line in made.examples)


GUIDE = (Path(__file__).resolve().parents[2] / "docs" / "database.md").read_text(encoding="utf-8")


def test_the_guide_s_commands_run_in_their_order(
    town: str, tomorrow: Callable[[], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a file as written; those for a server fail only because there is none."""
    today = upgrade.packaged
    blocks = re.findall(r"```sh\n(.*?)```", GUIDE, flags=re.DOTALL)
    lines = [line for block in blocks for line in block.splitlines() if line.startswith("msbdb db ")]
    assert len(lines) >= 8
    for line in lines:
        words = shlex.split(line)[2:]
        if words[0] == "downgrade":
            upgrade_without_values(town, tomorrow)
        result = run(*words)
        if "postgresql" in line:
            assert (result.exit_code, "keeper@localhost/town" in result.stderr) == (1, True)
        else:
            assert result.exit_code == 0, f"{line}: {result.stderr}"
        if words[0] == "downgrade":
            monkeypatch.setattr(upgrade, "packaged", today)


def test_the_guide_names_every_check_and_role() -> None:
    """Each has its line in a table."""
    for name in CHECKS:
        assert f"| {name} |" in GUIDE
    for name in ROLES:
        assert f"| `{name}` |" in GUIDE


def test_a_user_reads_of_one_finding(town: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """One is not plural."""
    found = Finding("rows", "survey", "spring", "it is wrong", "right")
    for findings, says in (([found], "1 finding in "), ([found, found], "2 findings in ")):
        monkeypatch.setattr("msbdb.database.check_database", lambda *_, found=findings, **__: found)
        result = run("check", town)
        assert (result.exit_code, says in result.stdout) == (1, True)


def test_a_user_has_to_choose_a_survey(town: str) -> None:
    """The message has the option to use, and the names."""
    for words in (["classes", town], ["classes", town, "--survey", "none"]):
        result = CliRunner().invoke(cli, words)
        assert result.exit_code == 1
        assert "by --survey: " in result.stderr
        assert "delft" in result.stderr

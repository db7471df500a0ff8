"""A kill at any moment of a load leaves the last committed state readable, and the next load completes."""

import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from simulated.builds import EPSG, big_build, small_build
from sqlalchemy import Engine, text
from support.processes import environment
from support.sizes import sample

from msbdb.database import canonical_dump, open_database, read_parts, store_build, write_build
from msbdb.database.dialects.dialect import database_url, dialect_of
from msbdb.errors import DatabaseError

LOADER = """
import sys
from simulated.builds import big_build
from msbdb.database import open_database, write_build
from msbdb.database.dialects import {dialect}

def stop_here(original):
    def stopped(*args, **options):
        original(*args, **options)
        print("here", flush=True)
        sys.stdin.read()
    return stopped

{dialect}.{function} = stop_here({dialect}.{function})
write_build(open_database(sys.argv[1]), big_build(3000))
"""


def killed_load(target: str, function: str) -> None:
    """Load 6000 parts in another process, and kill it after a hook of the dialect was called."""
    code = LOADER.format(dialect="postgis" if "://" in target else "spatialite", function=function)
    call = [sys.executable, "-c", code, target]
    process = subprocess.Popen(call, env=environment(), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdin is not None
    assert process.stdout.readline() == "here\n"
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    process.stdin.close()
    process.stdout.close()


def triggers_of(engine: Engine) -> list[str]:
    """Return the triggers of a SpatiaLite file, which are off during a load; none of PostGIS."""
    if engine.dialect.name != "sqlite":
        return []
    with engine.connect() as connection:
        return list(connection.scalars(text("SELECT sql FROM sqlite_master WHERE type = 'trigger' ORDER BY name")))


@pytest.mark.parametrize("function", sample(["insert_rows", "after_load"], 2))
def test_a_kill_during_a_load_leaves_the_old_state(target: str, function: str) -> None:
    """Whether rows are half written or all but committed, readers see what was there before."""
    engine = open_database(target, create=True, srid=EPSG)
    write_build(engine, small_build())
    before = list(canonical_dump(engine))
    triggers = triggers_of(engine)
    killed_load(target, function)
    assert list(canonical_dump(open_database(target))) == before
    assert triggers_of(engine) == triggers
    assert write_build(engine, big_build(3000)).status == "replaced"
    assert len(read_parts(engine)) == 6000
    if engine.dialect.name == "sqlite":
        assert [p.name for p in Path(target).parent.iterdir()] == ["city.sqlite"]


@pytest.mark.parametrize("function", sample(["insert_rows", "after_load"], 2))
def test_a_first_build_that_fails_leaves_no_database(
    target: str, monkeypatch: pytest.MonkeyPatch, function: str
) -> None:
    """Database and build are one transaction, so that another CRS may come first after all."""

    def fail(*args: object) -> None:
        raise DatabaseError(function)

    monkeypatch.setattr(dialect_of(database_url(target)), function, fail)
    with pytest.raises(DatabaseError, match=function):
        store_build(target, small_build())
    monkeypatch.undo()
    with pytest.raises(DatabaseError, match="There is no msbdb database"):
        open_database(target)
    report = store_build(target, big_build(50, epsg=25832))
    assert (report.status, report.rows["part"]) == ("created", 100)
    assert store_build(target, big_build(50, epsg=25832)).status == "unchanged"
    assert store_build(target, big_build(60, epsg=25832)).status == "replaced"
    if "://" not in target:
        assert [p.name for p in Path(target).parent.iterdir()] == ["city.sqlite"]


@pytest.mark.skipif(shutil.which("ogrinfo") is None, reason="GDAL's tools (gdal-bin) are not installed")
def test_a_read_only_client_reads_after_a_kill(tmp_path: Path) -> None:
    """GDAL, opening for reading alone, is first at the file after the kill, and sees the old state."""
    target = str(tmp_path / "city.sqlite")
    write_build(open_database(target, create=True, srid=EPSG), small_build())
    killed_load(target, "after_load")
    call = ["ogrinfo", "-ro", "-so", target, "part"]
    done = subprocess.run(call, capture_output=True, text=True, check=True)
    assert "Feature Count: 6\n" in done.stdout

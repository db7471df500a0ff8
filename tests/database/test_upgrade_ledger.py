"""A database in which each dropped region has a row becomes one with numbers of the ledger."""

from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest
from simulated.builds import EPSG, ledger_build, ledger_counts
from sqlalchemy import Engine, text
from support.baseline import as_baseline, first_migration

from msbdb.database import (
    check_database,
    explain_places,
    open_database,
    read_rejection_counts,
    read_rejections,
    upgrade_schema,
    write_build,
)

ROWS = 200


@pytest.fixture
def old(target: str, tmp_path: Path) -> Engine:
    """Return a database of the first schema with a ledger of single cells."""
    today = open_database(tmp_path / "today.sqlite", create=True, srid=EPSG)
    write_build(today, ledger_build(ROWS))
    return as_baseline(today, target, EPSG, first_migration(tmp_path / "migrations"))


def test_all_rows_stay_and_are_counted(old: Engine, target: str) -> None:
    """The numbers are those that a build of these rows has; nothing is said to be small, as each region has a row."""
    upgrade_schema(target)
    rows, counts = read_rejections(old), read_rejection_counts(old)
    assert len(rows) == ROWS
    expected = ledger_counts(ledger_build(ROWS).frames["rejection"])
    pd.testing.assert_frame_equal(counts, expected)
    assert counts["small"].sum() == 0
    assert not [one for one in check_database(old) if one.check == "ledger"]


def test_an_upgraded_run_has_no_reasons(old: Engine, target: str) -> None:
    """It says so where no building is, as nothing can be made of what it kept."""
    upgrade_schema(target)
    with old.connect() as connection:
        west, south, east, north = connection.execute(text("SELECT west, south, east, north FROM survey")).one()
    [place] = explain_places(old, [((west + east) / 2, south + 0.9 * (north - south))])
    assert (place.reason, place.building) == (None, None)
    assert "kept no reasons" in place.sentences[0]


def test_two_surveys_are_counted_apart(target: str, tmp_path: Path, new_postgis: Callable[[], str]) -> None:
    """Each run has its own numbers from 1."""
    today = open_database(tmp_path / "both.sqlite", create=True, srid=EPSG)
    write_build(today, ledger_build(20))
    write_build(today, ledger_build(30, "leiden", shift=10**6))
    is_server = "://" in target
    place = new_postgis() if is_server else tmp_path / "old.sqlite"
    engine = as_baseline(today, str(place), EPSG, first_migration(tmp_path / "migrations"))
    upgrade_schema(str(place))
    for survey, rows in (("delft", 20), ("leiden", 30)):
        counts = read_rejection_counts(engine, survey)
        assert counts["regions"].sum() == rows
        assert counts["number"].tolist() == list(range(1, len(counts) + 1))

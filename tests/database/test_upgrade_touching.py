"""A database without reasons of division gets them: its buildings stay undivided, also after labels by hand."""

from pathlib import Path

import pytest
from simulated.builds import EPSG, small_build
from sqlalchemy import Engine, text
from support.baseline import as_baseline, first_migration

from msbdb.database import check_database, open_database, read_buildings, read_run, upgrade_schema, write_build
from msbdb.database.schema.migration import head_version
from msbdb.params import Params, with_values


@pytest.fixture
def upgraded(target: str, tmp_path: Path) -> Engine:
    """Return an upgraded database of the first schema."""
    today = open_database(tmp_path / "today.sqlite", create=True, srid=EPSG)
    write_build(today, small_build())
    old = as_baseline(today, target, EPSG, first_migration(tmp_path / "migrations"))
    assert upgrade_schema(target) == ("0001", head_version())
    return old


def test_old_buildings_are_divided_by_nothing(upgraded: Engine) -> None:
    """Their rows say so, and no check finds a fault but the digest, which the first schema wrote otherwise."""
    assert read_buildings(upgraded)["divided_by"].tolist() == [""] * 4
    assert {finding.check for finding in check_database(upgraded)} <= {"content"}
    with upgraded.connect() as connection:
        assert connection.scalar(text("SELECT count(*) FROM building WHERE divided_by = ''")) == 4


def test_the_parameters_of_old_runs_divide_nothing(upgraded: Engine) -> None:
    """A re-labelling takes the run's own parameters."""
    params = with_values(Params(), read_run(upgraded).parameters)  # type: ignore[arg-type]  # plain nested values
    assert not params.touching.divide

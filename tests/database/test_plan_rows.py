"""The plan of a run in the database: written and read with the run, watched by the check, absent in older schemas."""

from dataclasses import replace

from simulated.builds import EPSG, small_build
from sqlalchemy import text

from msbdb.database import (
    check_database,
    downgrade_schema,
    open_database,
    read_build,
    read_plan,
    upgrade_schema,
    write_build,
)
from msbdb.surveyplan import Plan

PLAN = Plan("EPSG:28992", 0.5, 4.0, None, "given", (20.0, 100.0), (), None, None, {"scale": {"connectivity": 8}})


def test_a_plan_is_part_of_a_runs_content(target: str) -> None:
    """It is read back as it was; another plan replaces the run, and the check finds that one was removed."""
    engine = open_database(target, create=True, srid=EPSG)
    build = replace(small_build(), plan=PLAN)
    assert write_build(engine, build).status == "created"
    assert read_plan(engine) == read_build(engine).plan == PLAN
    assert write_build(engine, build).status == "unchanged"
    assert write_build(engine, replace(build, plan=replace(PLAN, cell_m=0.4))).status == "replaced"
    assert read_plan(engine).cell_m == 0.4
    assert not check_database(engine)
    with engine.begin() as connection:
        connection.execute(text("DELETE FROM survey_plan"))
    assert [finding.check for finding in check_database(engine)] == ["content"]
    assert write_build(engine, small_build()).status == "replaced"
    assert read_plan(engine) is None


def test_a_run_without_a_plan_goes_down_and_up_again(target: str) -> None:
    """The table comes and goes with the schema 0007, and nothing else changes."""
    engine = open_database(target, create=True, srid=EPSG)
    write_build(engine, small_build())
    downgrade_schema(target, "0006", force=False)
    with engine.connect() as connection:
        assert not engine.dialect.has_table(connection, "survey_plan")
    upgrade_schema(target)
    assert read_plan(engine) is None
    assert not check_database(engine)

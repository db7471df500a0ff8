"""Touching houses: why a building is divided from those beside it.

The buildings that are there were not divided, and no re-labelling divides them: their runs get the value that says so.
The six tables around buildings are made anew and filled from copies, so that their columns stand in the order of a new
database. Runs keep a digest of their content; it is computed again where it was right before.

There is no way back: houses that were divided have no place in the schema before.
"""

from types import ModuleType

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0002"

NEW = ("divided_by", "''")
"""The new column of building, and the value of the rows that are there."""


def upgrade() -> None:
    """Copy, drop, create, fill, and compute the digests again."""
    opts = op.get_context().opts
    hooks, srid = opts["hooks"], opts["srid"]
    script = op.get_context().script
    baseline, buildings = (script.get_revision(version).module for version in ("0001", "0002"))
    before = buildings.content_tables(old=False)
    right = [run_id for run_id, kept, found in run_digests(before) if kept == found]
    buildings.drop_views(hooks)
    filled = {table: columns_of(table) for table in buildings.MADE_ANEW}
    for table, columns in filled.items():
        op.execute(f"CREATE TEMPORARY TABLE old_{table} AS SELECT {', '.join(columns)} FROM {table}")  # noqa: S608  (our own names)
    for table in reversed(buildings.MADE_ANEW):
        for statement in hooks.drop_geometry_ddl(table) if table in buildings.SPATIAL else ():
            op.execute(statement)
        op.drop_table(table)
    create_buildings(baseline)
    buildings.create_parts(baseline)
    one = ("part_id", "part", "part_share")
    baseline.create_links("part_flat_region", one, ("region_id", "flat_region", "region_share"))
    baseline.create_links("part_candidate", one, ("candidate_id", "candidate_region", "candidate_share"))
    buildings.create_versions(baseline)
    buildings.create_changes(baseline)
    for table in buildings.SPATIAL:
        baseline.run_all(hooks.geometry_ddl(table, "MULTIPOLYGON", srid))
    baseline.run_all([f"ALTER TABLE {table} ADD COLUMN row_digest BIGINT" for table in buildings.DIGESTED])
    for table, columns in filled.items():
        names = ", ".join(columns)
        column, value = (f", {text}" for text in NEW) if table == "building" else ("", "")
        op.execute(f"INSERT INTO {table} ({names}{column}) SELECT {names}{value} FROM old_{table}")  # noqa: S608  (our own names)
        op.execute(f"DROP TABLE old_{table}")
    buildings.create_views(baseline, hooks)
    keep_undivided()
    run = sa.table("run", sa.column("run_id"), sa.column("content_sha256"))
    for run_id, _, found in run_digests(content_tables(before)):
        if run_id in right:
            op.execute(run.update().where(run.c.run_id == run_id).values(content_sha256=found))


def columns_of(table: str) -> list[str]:
    """Return the columns of a table but those that the database computes."""
    columns = sa.inspect(op.get_bind()).get_columns(table)
    return [str(column["name"]) for column in columns if "computed" not in column]


def create_buildings(baseline: ModuleType) -> None:
    """Create building, with the reasons of its borders."""
    table, check, shares = "building", baseline.check, baseline.SHARES
    op.create_table(
        table,
        baseline.row_id("building_id"),
        *baseline.integers("run_id"),
        *baseline.words("state"),
        *baseline.numbers("probability", nullable=True),
        *baseline.integers("storeys"),
        *baseline.numbers("h_max", "h_mean", "h_p50", "h_p90", "area_m2", "volume_m3"),
        *baseline.integers("trees", "parts", "scales", "speindex"),
        baseline.generated("class_id", "nullif(speindex, 0)"),
        *baseline.numbers("building_share", "xcen", "ycen", "xin", "yin"),
        *baseline.numbers("multiscale_share", *shares, nullable=True),
        *baseline.words("divided_by"),
        baseline.key(table, "building_id"),
        sa.UniqueConstraint("building_id", "run_id", name=op.f("uq_building")),
        baseline.of_class(table, "class_id"),
        check(table, "building_id", "building_id > 0"),
        check(table, "state", "state IN ('confirmed', 'unsure', 'refuted')"),
        check(table, "size", "storeys >= 0 AND area_m2 > 0"),
        check(table, "parts", "trees >= 1 AND parts >= trees AND scales >= 1"),
        *baseline.shares(table, "probability", "building_share", "multiscale_share", *shares),
        baseline.of_run(table),
    )
    baseline.create_indexes(table, ("run_id", "class_id"))


def keep_undivided() -> None:
    """Write into each run that its touching houses were not divided."""
    run = sa.table("run", sa.column("run_id"), sa.column("parameters", sa.JSON()))
    for run_id, parameters in op.get_bind().execute(sa.select(run.c.run_id, run.c.parameters)).all():
        changed = {**parameters, "touching": {"divide": False}}
        op.execute(run.update().where(run.c.run_id == run_id).values(parameters=changed))


def content_tables(before: list[object]) -> list[object]:
    """Return the declarations of a run's content, with the new column."""
    from msbdb.tables import Column, Table

    column = Column(NEW[0], "str", "-", "")
    return [
        Table(table.name, "", (*table.columns, column), geometry=table.geometry) if table.name == "building" else table
        for table in before
    ]


def run_digests(tables: list[object]) -> list[tuple[int, str, str | None]]:
    """Return each run with its kept digest, and that of its rows; None where they cannot be read."""
    from msbdb.database.admin.runchecks import UNREADABLE

    from msbdb.database.runs.reading import content_of

    connection = op.get_bind()
    query = "SELECT r.run_id, r.content_sha256, s.name FROM run AS r JOIN survey AS s ON s.survey_id = r.survey_id"
    found = []
    for run_id, kept, survey in connection.execute(sa.text(query)).all():
        try:
            digest = content_of(connection, survey, tables).digest()
        except UNREADABLE:
            digest = None
        found.append((run_id, kept, digest))
    return found

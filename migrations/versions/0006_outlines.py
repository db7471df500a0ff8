"""Outlines: each building and part says whether its outline is fitted to walls or traced along cells.

The outlines that are there were traced, so this is what their rows and the parameters of their runs get. The six tables
around buildings are made anew and filled from copies, so that their columns stand in the order of a new database. Runs
keep a digest of their content; it is computed again where it was right before.

There is no way back: a fitted outline has no place in the schema before.
"""

from pathlib import Path
from types import ModuleType

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0002"

TEXTS = Path(__file__).parents[1] / "sql" / revision
OUTLINED = ("part", "building")
NEW = ("outline_source", "'traced'")
"""The new column, and the value of the rows that are there."""


def upgrade() -> None:
    """Copy, drop, create, fill, and compute the digests again."""
    opts = op.get_context().opts
    hooks, srid = opts["hooks"], opts["srid"]
    script = op.get_context().script
    baseline, buildings = (script.get_revision(version).module for version in ("0001", "0002"))
    before = buildings.content_tables(old=False)
    right = [run_id for run_id, kept, found in run_digests(before) if kept == found]
    settle_keys()
    buildings.drop_views(hooks)
    filled = {table: columns_of(table) for table in buildings.MADE_ANEW}
    for table, columns in filled.items():
        op.execute(f"CREATE TEMPORARY TABLE old_{table} AS SELECT {', '.join(columns)} FROM {table}")  # noqa: S608  (our own names)
    for table in reversed(buildings.MADE_ANEW):
        for statement in hooks.drop_geometry_ddl(table) if table in buildings.SPATIAL else ():
            op.execute(statement)
        op.drop_table(table)
    create_buildings(baseline)
    create_parts(baseline)
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
        column, value = (f", {text}" for text in NEW) if table in OUTLINED else ("", "")
        op.execute(f"INSERT INTO {table} ({names}{column}) SELECT {names}{value} FROM old_{table}")  # noqa: S608  (our own names)
        op.execute(f"DROP TABLE old_{table}")
    create_views(baseline, buildings, hooks)
    keep_traced()
    run = sa.table("run", sa.column("run_id"), sa.column("content_sha256"))
    for run_id, _, found in run_digests(content_tables(before)):
        if run_id in right:
            op.execute(run.update().where(run.c.run_id == run_id).values(content_sha256=found))


def settle_keys() -> None:
    """Check the deferred keys of an earlier migration in this transaction: PostgreSQL drops no table before."""
    if op.get_bind().dialect.name == "postgresql":
        op.execute("SET CONSTRAINTS ALL IMMEDIATE")
        op.execute("SET CONSTRAINTS ALL DEFERRED")


def columns_of(table: str) -> list[str]:
    """Return the columns of a table but those that the database computes."""
    columns = sa.inspect(op.get_bind()).get_columns(table)
    return [str(column["name"]) for column in columns if "computed" not in column]


def create_buildings(baseline: ModuleType) -> None:
    """Create building, with the source of its outline."""
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
        *baseline.words("outline_source"),
        baseline.key(table, "building_id"),
        sa.UniqueConstraint("building_id", "run_id", name=op.f("uq_building")),
        baseline.of_class(table, "class_id"),
        check(table, "building_id", "building_id > 0"),
        check(table, "state", "state IN ('confirmed', 'unsure', 'refuted')"),
        check(table, "outline_source", "outline_source IN ('fitted', 'traced')"),
        check(table, "size", "storeys >= 0 AND area_m2 > 0"),
        check(table, "parts", "trees >= 1 AND parts >= trees AND scales >= 1"),
        *baseline.shares(table, "probability", "building_share", "multiscale_share", *shares),
        baseline.of_run(table),
    )
    baseline.create_indexes(table, ("run_id", "class_id"))


def create_parts(baseline: ModuleType) -> None:
    """Create part, with the source of its outline."""
    table, check = "part", baseline.check
    father = "(supid = 0 AND supscale = 0 AND root_id = part_id) OR (supid > 0 AND supscale > 0 AND supscale < scale)"
    op.create_table(
        table,
        baseline.row_id("part_id"),
        *baseline.integers("run_id", "supid"),
        baseline.generated("father_id", "nullif(supid, 0)"),
        *baseline.integers("supscale", "root_id", "building_id", "scale", "hindex", "hzone", "speindex"),
        baseline.generated("class_id", "nullif(speindex, 0)"),
        *baseline.numbers("xo", "yo", "xcen", "ycen", "xin", "yin"),
        *baseline.integers("area_px"),
        *baseline.numbers("area_m2"),
        *baseline.numbers("stddis", nullable=True),
        *baseline.numbers("h_max", "h_mean", "h_p50", "h_p90", "h_std", "building_share"),
        *baseline.words("outline_source"),
        baseline.key(table, "part_id"),
        sa.UniqueConstraint("part_id", "scale", "root_id", "run_id", name=op.f("uq_part")),
        sa.ForeignKeyConstraint(
            ["father_id", "supscale", "root_id", "run_id"],
            ["part.part_id", "part.scale", "part.root_id", "part.run_id"],
            name=op.f("fk_part_part"),
            deferrable=True,
            initially="DEFERRED",
        ),
        sa.ForeignKeyConstraint(
            ["building_id", "run_id"],
            ["building.building_id", "building.run_id"],
            name=op.f("fk_part_building"),
            deferrable=True,
            initially="DEFERRED",
        ),
        sa.ForeignKeyConstraint(["run_id", "scale"], ["scale.run_id", "scale.scale"], name=op.f("fk_part_scale")),
        baseline.of_class(table, "class_id"),
        check(table, "part_id", "part_id > 0"),
        check(table, "father", father),
        check(table, "area", "area_px > 0 AND area_m2 > 0"),
        check(table, "storeys", "hindex >= 0 AND hzone >= 0"),
        check(table, "outline_source", "outline_source IN ('fitted', 'traced')"),
        *baseline.shares(table, "building_share"),
        baseline.of_run(table),
    )
    baseline.create_indexes(
        table,
        ("father_id", "supscale", "root_id", "run_id"),
        ("root_id",),
        ("building_id", "run_id"),
        ("run_id", "scale"),
        ("run_id", "class_id"),
    )


def create_views(baseline: ModuleType, buildings: ModuleType, hooks: object) -> None:
    """Create all views, and the function of PostGIS, from the newest text of each."""
    for view, (key, base) in buildings.VIEWS.items():
        op.execute(f"CREATE VIEW {view} AS\n{text_of(baseline, buildings, view)}")
        baseline.run_all(hooks.view_ddl(view, key, base))
    view = "roof_material_by_class"
    op.execute(f"CREATE VIEW {view} AS\n{text_of(baseline, buildings, view)}")
    if op.get_bind().dialect.name == "postgresql":
        op.execute(text_of(baseline, buildings, "footprint_at"))


def text_of(baseline: ModuleType, buildings: ModuleType, name: str) -> str:
    """Return the statement of a view: its text of this migration, or the one before."""
    path = TEXTS / f"{name}.sql"
    if not path.is_file():
        return buildings.text_of(baseline, name)
    lines = path.read_text(encoding="utf-8").splitlines()
    return "\n".join(line for line in lines if not line.startswith("--")).strip().rstrip(";")


def keep_traced() -> None:
    """Write into each run that its outlines were traced, with all holes and pieces."""
    run = sa.table("run", sa.column("run_id"), sa.column("parameters", sa.JSON()))
    for run_id, parameters in op.get_bind().execute(sa.select(run.c.run_id, run.c.parameters)).all():
        vector = {"walls": "traced", "court_m2": 0.0, **parameters.get("vector", {})}
        op.execute(run.update().where(run.c.run_id == run_id).values(parameters={**parameters, "vector": vector}))


def content_tables(before: list[object]) -> list[object]:
    """Return the declarations of a run's content, with the new column."""
    from msbdb.tables import Column, Table

    column = Column(NEW[0], "str", "-", "")
    return [
        Table(table.name, "", (*table.columns, column), geometry=table.geometry) if table.name in OUTLINED else table
        for table in before
    ]


def run_digests(tables: list[object]) -> list[tuple[int, str, str | None]]:
    """Return each run with its kept digest, and that of its rows; None where they cannot be read."""
    from msbdb.database.admin.contentchecks import UNREADABLE
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

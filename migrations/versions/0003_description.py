"""How buildings are described: heights, why touching houses are divided, and whether outlines are fitted to walls.

Heights of rows that are there stay empty: the terrain of older runs was not kept. Their houses were not divided and
their outlines were traced, so this is what they and the parameters of their runs get. The six tables around buildings
are made anew and filled from copies, because SQLite cannot add checks to a table. Runs keep a digest of their content;
it is computed again where it was right before.

There is no way back: levels, divided houses and fitted outlines have no place in the schema before.
"""

from pathlib import Path
from types import ModuleType

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"

TEXTS = Path(__file__).parents[1] / "sql" / revision
LEVELS = ("z_ground", "z_ground_min", "z_ground_max", "z_eaves", "z_ridge", "eaves", "ridge")
RANGE = ("storeys_min", "storeys_max", "storeys_top")
QUALITY = ("coverage", "nodata_share", "density")

SAID = {"building": {"divided_by": "''", "outline_source": "'traced'"}, "part": {"outline_source": "'traced'"}}
"""The new columns of rows that are there, and their values."""

CONTENT = (
    "*building_id:i state:s probability:f z_ground:f z_ground_min:f z_ground_max:f z_eaves:f z_ridge:f eaves:f ridge:f "
    "storeys:i storeys_min:n storeys_max:n storeys_top:n h_max:f h_mean:f h_p50:f h_p90:f area_m2:f volume_m3:f "
    "floor_area_m2:f trees:i parts:i scales:i speindex:i building_share:f xcen:f ycen:f xin:f yin:f "
    "multiscale_share:f flat_share:f area3d_share:f adaptive_share:f coverage:f nodata_share:f density:f "
    "divided_by:s outline_source:s"
)
"""The columns of a building in a run's content, with their kinds; n are whole numbers that may be null."""


def upgrade() -> None:
    """Copy, drop, create, fill, and compute the digests again."""
    opts = op.get_context().opts
    hooks, srid = opts["hooks"], opts["srid"]
    script = op.get_context().script
    baseline, buildings = (script.get_revision(version).module for version in ("0001", "0002"))
    right = [run_id for run_id, kept, found in run_digests(old=True) if kept == found]
    settle_keys()
    buildings.drop_views(hooks)
    filled = {table: columns_of(table) for table in buildings.MADE_ANEW}
    for table in buildings.MADE_ANEW:
        op.execute(f"CREATE TEMPORARY TABLE old_{table} AS SELECT {', '.join(filled[table])} FROM {table}")  # noqa: S608  (our own names)
    for table in reversed(buildings.MADE_ANEW):
        for statement in hooks.drop_geometry_ddl(table) if table in buildings.SPATIAL else ():
            op.execute(statement)
        op.drop_table(table)
    create_buildings(baseline)
    create_parts(baseline)
    one = ("part_id", "part", "part_share")
    baseline.create_links("part_flat_region", one, ("region_id", "flat_region", "region_share"))
    baseline.create_links("part_candidate", one, ("candidate_id", "candidate_region", "candidate_share"))
    create_versions(baseline)
    buildings.create_changes(baseline)
    for table in buildings.SPATIAL:
        baseline.run_all(hooks.geometry_ddl(table, "MULTIPOLYGON", srid))
    baseline.run_all([f"ALTER TABLE {table} ADD COLUMN row_digest BIGINT" for table in buildings.DIGESTED])
    for table, columns in filled.items():
        said = SAID.get(table, {})
        names, values = ", ".join([*columns, *said]), ", ".join([*columns, *said.values()])
        op.execute(f"INSERT INTO {table} ({names}) SELECT {values} FROM old_{table}")  # noqa: S608  (our own names)
        op.execute(f"DROP TABLE old_{table}")
    create_views(baseline, buildings, hooks)
    keep_as_they_were()
    run = sa.table("run", sa.column("run_id"), sa.column("content_sha256"))
    for run_id, _, found in run_digests(old=False):
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
    """Create building, with heights, qualities, the reasons of its borders and the source of its outline."""
    table, check, shares = "building", baseline.check, baseline.SHARES
    op.create_table(
        table,
        baseline.row_id("building_id"),
        *baseline.integers("run_id"),
        *baseline.words("state"),
        *baseline.numbers("probability", *LEVELS, nullable=True),
        *baseline.integers("storeys"),
        *baseline.integers(*RANGE, nullable=True),
        *baseline.numbers("h_max", "h_mean", "h_p50", "h_p90", "area_m2", "volume_m3"),
        *baseline.numbers("floor_area_m2", nullable=True),
        *baseline.integers("trees", "parts", "scales", "speindex"),
        baseline.generated("class_id", "nullif(speindex, 0)"),
        *baseline.numbers("building_share", "xcen", "ycen", "xin", "yin"),
        *baseline.numbers("multiscale_share", *shares, *QUALITY, nullable=True),
        *baseline.words("divided_by", "outline_source"),
        baseline.key(table, "building_id"),
        sa.UniqueConstraint("building_id", "run_id", name=op.f("uq_building")),
        baseline.of_class(table, "class_id"),
        check(table, "building_id", "building_id > 0"),
        check(table, "state", "state IN ('confirmed', 'unsure', 'refuted')"),
        check(table, "outline_source", "outline_source IN ('fitted', 'traced')"),
        check(table, "size", "storeys >= 0 AND area_m2 > 0"),
        *height_rules(baseline, table),
        check(table, "parts", "trees >= 1 AND parts >= trees AND scales >= 1"),
        *baseline.shares(table, "probability", "building_share", "multiscale_share", *shares, *QUALITY[:2]),
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


def height_rules(baseline: ModuleType, table: str) -> list[sa.CheckConstraint]:
    """Return what holds between the heights of a building."""
    rule = "storeys_min >= 1 AND storeys_min <= storeys AND storeys <= storeys_max"
    return [baseline.check(table, "heights", "ridge >= eaves"), baseline.check(table, "storeys", rule)]


def create_versions(baseline: ModuleType) -> None:
    """Create building_version, with the heights."""
    table, check, refers = "building_version", baseline.check, baseline.refers
    op.create_table(
        table,
        baseline.row_id("version_id"),
        *baseline.integers("uid"),
        *baseline.words("valid_from"),
        *baseline.words("valid_to", nullable=True),
        *baseline.words("source"),
        *baseline.integers("survey_id", "closed_by", "building_id", nullable=True),
        *baseline.words("state"),
        *baseline.numbers(*LEVELS, nullable=True),
        *baseline.integers("storeys", *RANGE, nullable=True),
        *baseline.numbers("h_max", "h_mean", "h_p50", "h_p90", nullable=True),
        *baseline.numbers("area_m2"),
        *baseline.numbers("volume_m3", nullable=True),
        *baseline.integers("parts", nullable=True),
        *baseline.numbers(*baseline.SHARES, "probability", nullable=True),
        *baseline.documents("attributes", nullable=True),
        baseline.key(table, "version_id"),
        check(table, "version_id", "version_id > 0"),
        check(table, "valid_from", "length(valid_from) = 10"),
        check(table, "valid_to", "valid_to IS NULL OR (length(valid_to) = 10 AND valid_to >= valid_from)"),
        check(table, "source", "source IN ('survey', 'import')"),
        check(table, "survey", "(source = 'survey') = (survey_id IS NOT NULL)"),
        check(table, "closed_by", "closed_by IS NULL OR valid_to IS NOT NULL"),
        check(table, "state", "state IN ('confirmed', 'unsure', 'refuted')"),
        check(table, "area", "area_m2 > 0"),
        check(table, "parts", "storeys >= 0 AND parts >= 1"),
        *height_rules(baseline, table),
        *baseline.shares(table, *baseline.SHARES, "probability"),
        refers(table, "uid", "inventory_building.uid", cascade=False),
        refers(table, "survey_id", "survey.survey_id", cascade=False),
        refers(table, "closed_by", "survey.survey_id", "fk_building_version_closed_by", cascade=False),
    )
    baseline.create_indexes(table, ("uid", "valid_from"), ("survey_id",), ("closed_by",))
    current = sa.text("valid_to IS NULL")
    op.create_index(
        "ix_building_version_current", table, ["uid"], unique=True, sqlite_where=current, postgresql_where=current
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


def keep_as_they_were() -> None:
    """Write into each run that its houses were not divided, and its outlines traced with all holes and pieces."""
    run = sa.table("run", sa.column("run_id"), sa.column("parameters", sa.JSON()))
    for run_id, parameters in op.get_bind().execute(sa.select(run.c.run_id, run.c.parameters)).all():
        vector = {"walls": "traced", "court_m2": 0.0, **parameters.get("vector", {})}
        changed = {**parameters, "touching": {"divide": False}, "vector": vector}
        op.execute(run.update().where(run.c.run_id == run_id).values(parameters=changed))


def run_digests(*, old: bool) -> list[tuple[int, str, str | None]]:
    """Return each run with its kept digest, and that of its rows; None where they cannot be read."""
    from msbdb.database.admin.contentchecks import UNREADABLE
    from msbdb.database.runs.reading import content_of

    connection = op.get_bind()
    query = "SELECT r.run_id, r.content_sha256, s.name FROM run AS r JOIN survey AS s ON s.survey_id = r.survey_id"
    tables = content_tables(old=old)
    found = []
    for run_id, kept, survey in connection.execute(sa.text(query)).all():
        try:
            digest = content_of(connection, survey, tables).digest()
        except UNREADABLE:
            digest = None
        found.append((run_id, kept, digest))
    return found


def content_tables(*, old: bool) -> list[object]:
    """Return the declarations of a run's content before this migration, or after it."""
    buildings = op.get_context().script.get_revision(down_revision).module
    before: list[object] = buildings.content_tables(old=False)
    if old:
        return before
    new = {"building": building_table(), "part": part_table(next(table for table in before if table.name == "part"))}
    return [new.get(table.name, table) for table in before]


def part_table(before: object) -> object:
    """Return the declaration of a part in a run's content, with the source of its outline."""
    from msbdb.tables import Column, Table

    return Table("part", "", (*before.columns, Column("outline_source", "str", "-", "")), geometry=before.geometry)


def building_table() -> object:
    """Return the declaration of a building in a run's content, of this schema."""
    from msbdb.tables import Column, Table

    kinds = {"i": "int64", "n": "Int64", "f": "float64", "s": "str"}
    columns = [word.partition(":") for word in CONTENT.split()]
    stored = tuple(Column(name.lstrip("*"), kinds[kind], "-", "", primary=name[0] == "*") for name, _, kind in columns)
    return Table("building", "", stored, geometry="MULTIPOLYGON")

"""The living inventory: its buildings, their versions and changes, operators' states and roof samples.

The views of evidence are made anew: they sum up the links of each row that is asked for, no longer those of all rows.
"""

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"

RowId = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
SPATIAL = {"building_version": "MULTIPOLYGON", "inventory_event": "MULTIPOLYGON", "roof_sample": "POINT"}


def upgrade() -> None:
    """Create the tables, their views, and on PostGIS ``footprint_at``; the views of evidence look row by row."""
    opts = op.get_context().opts
    hooks, srid = opts["hooks"], opts["srid"]
    create_buildings()
    create_versions()
    create_changes()
    create_events()
    create_words()
    for table, kind in SPATIAL.items():
        run_all(hooks.geometry_ddl(table, kind, srid))
    drop_views(hooks, OLD_EVIDENCE)
    create_views(hooks, EVIDENCE)
    create_views(hooks, VIEWS)
    op.execute(f"CREATE VIEW roof_material_by_class AS\n{ROOF_MATERIAL_BY_CLASS.strip()}")
    if op.get_bind().dialect.name == "postgresql":
        op.execute(FOOTPRINT_AT.strip())


def downgrade() -> None:
    """Drop the inventory with all that tells of it; surveys and their runs stay as they are."""
    hooks = op.get_context().opts["hooks"]
    if op.get_bind().dialect.name == "postgresql":
        op.execute("DROP FUNCTION footprint_at(date)")
    op.execute("DROP VIEW roof_material_by_class")
    drop_views(hooks, VIEWS)
    drop_views(hooks, EVIDENCE)
    create_views(hooks, OLD_EVIDENCE)
    op.drop_table("building_change")
    op.drop_table("survey_offset")
    op.drop_table("operator_state")
    for table in SPATIAL:
        run_all(hooks.drop_geometry_ddl(table))
        op.drop_table(table)
    op.drop_table("inventory_building")


def run_all(statements: list[str]) -> None:
    """Run statements of the dialect's hooks."""
    for statement in statements:
        op.execute(statement)


def drop_views(hooks: object, views: tuple[tuple[str, str, str, str], ...]) -> None:
    """Drop views and forget their geometries."""
    for view, *_ in views:
        run_all(hooks.drop_view_ddl(view))
        op.execute(f"DROP VIEW {view}")


def create_views(hooks: object, views: tuple[tuple[str, str, str, str], ...]) -> None:
    """Create views and register their geometries."""
    for view, key, base, sql in views:
        op.execute(f"CREATE VIEW {view} AS\n{sql.strip()}")
        run_all(hooks.view_ddl(view, key, base))


def words(*names: str, nullable: bool = False) -> list[sa.Column]:
    """Return columns of text."""
    return [sa.Column(name, sa.Text(), nullable=nullable) for name in names]


def integers(*names: str, nullable: bool = False) -> list[sa.Column]:
    """Return 64-bit columns that the database never counts up by itself."""
    return [sa.Column(name, sa.BigInteger(), autoincrement=False, nullable=nullable) for name in names]


def numbers(*names: str, nullable: bool = False) -> list[sa.Column]:
    """Return columns of floating-point numbers."""
    return [sa.Column(name, sa.Double(), nullable=nullable) for name in names]


def check(table: str, name: str, rule: str) -> sa.CheckConstraint:
    """Return a named check."""
    return sa.CheckConstraint(rule, name=op.f(f"ck_{table}_{name}"))


def refers(name: str, column: str, to: str) -> sa.ForeignKeyConstraint:
    """Return a key that holds rows back from being deleted."""
    return sa.ForeignKeyConstraint([column], [to], name=op.f(name))


def row_id(name: str) -> sa.Column:
    """Return a primary key of one column."""
    return sa.Column(name, RowId, autoincrement=False, nullable=False)


def key(table: str, column: str) -> sa.PrimaryKeyConstraint:
    """Return a table's primary key."""
    return sa.PrimaryKeyConstraint(column, name=op.f(f"pk_{table}"))


def create_buildings() -> None:
    """Create inventory_building."""
    table = "inventory_building"
    op.create_table(
        table,
        row_id("uid"),
        *words("source"),
        key(table, "uid"),
        check(table, "uid", "uid > 0"),
    )


def create_versions() -> None:
    """Create building_version."""
    table, shares = "building_version", ("flat_share", "area3d_share", "adaptive_share")
    ended = "valid_to IS NULL OR (length(valid_to) = 10 AND valid_to >= valid_from)"
    op.create_table(
        table,
        row_id("version_id"),
        *integers("uid"),
        *words("valid_from"),
        *words("valid_to", nullable=True),
        *words("source"),
        *integers("survey_id", "closed_by", "building_id", nullable=True),
        *words("state"),
        *integers("storeys", nullable=True),
        *numbers("h_max", "h_mean", "h_p50", "h_p90", nullable=True),
        *numbers("area_m2"),
        *numbers("volume_m3", nullable=True),
        *integers("parts", nullable=True),
        *numbers(*shares, nullable=True),
        sa.Column("attributes", sa.JSON(), nullable=True),
        key(table, "version_id"),
        check(table, "version_id", "version_id > 0"),
        check(table, "valid_from", "length(valid_from) = 10"),
        check(table, "valid_to", ended),
        check(table, "source", "source IN ('survey', 'import')"),
        check(table, "survey", "(source = 'survey') = (survey_id IS NOT NULL)"),
        check(table, "closed_by", "closed_by IS NULL OR valid_to IS NOT NULL"),
        check(table, "state", "state IN ('confirmed', 'unsure', 'refuted')"),
        check(table, "area", "area_m2 > 0"),
        check(table, "parts", "storeys >= 0 AND parts >= 1"),
        *(check(table, name, f"{name} >= 0 AND {name} <= 1") for name in shares),
        refers("fk_building_version_inventory_building", "uid", "inventory_building.uid"),
        refers("fk_building_version_survey", "survey_id", "survey.survey_id"),
        refers("fk_building_version_closed_by", "closed_by", "survey.survey_id"),
    )
    for columns in (["uid", "valid_from"], ["survey_id"], ["closed_by"]):
        op.create_index(op.f(f"ix_{table}_{'_'.join(columns)}"), table, columns)
    current = sa.text("valid_to IS NULL")
    name = op.f("ix_building_version_current")
    op.create_index(name, table, ["uid"], unique=True, sqlite_where=current, postgresql_where=current)


def create_changes() -> None:
    """Create building_change and survey_offset."""
    table = "building_change"
    kinds = "kind IN ('unchanged', 'modified', 'new', 'demolished', 'merged', 'split')"
    pairs = "(uid_before IS NULL) = (version_before IS NULL) AND (uid_after IS NULL) = (version_after IS NULL)"
    op.create_table(
        table,
        row_id("change_id"),
        *integers("survey_id"),
        *words("kind"),
        *integers("uid_before", "uid_after", "version_before", "version_after", nullable=True),
        *(sa.Column(name, sa.Boolean(), nullable=False) for name in ("outline", "height", "parts")),
        *numbers("overlap_m2", "iou"),
        *numbers("dh_m", nullable=True),
        *numbers("darea_m2"),
        *words("note"),
        key(table, "change_id"),
        check(table, "change_id", "change_id > 0"),
        check(table, "kind", kinds),
        check(table, "uid", "uid_before IS NOT NULL OR uid_after IS NOT NULL"),
        check(table, "version", pairs),
        check(table, "overlap", "overlap_m2 >= 0 AND iou >= 0 AND iou <= 1"),
        refers("fk_building_change_survey", "survey_id", "survey.survey_id"),
        *(refers(f"fk_building_change_{n}", n, "inventory_building.uid") for n in ("uid_before", "uid_after")),
        *(
            refers(f"fk_building_change_{n}", n, "building_version.version_id")
            for n in ("version_before", "version_after")
        ),
    )
    for columns in (["survey_id", "kind"], ["uid_before"], ["uid_after"], ["version_before"], ["version_after"]):
        op.create_index(op.f(f"ix_{table}_{'_'.join(columns)}"), table, columns)
    table = "survey_offset"
    op.create_table(
        table,
        *integers("survey_id"),
        *numbers("dx_m", "dy_m", "dz_m"),
        *integers("pairs"),
        *numbers("spread_m", nullable=True),
        key(table, "survey_id"),
        check(table, "pairs", "pairs >= 0"),
        refers("fk_survey_offset_survey", "survey_id", "survey.survey_id"),
    )


def create_events() -> None:
    """Create inventory_event."""
    table = "inventory_event"
    op.create_table(
        table,
        row_id("number"),
        *words("kind", "name", "date"),
        *integers("survey_id", nullable=True),
        sa.Column("counts", sa.JSON(), nullable=False),
        *words("content_sha256"),
        key(table, "number"),
        check(table, "number", "number > 0"),
        check(table, "kind", "kind IN ('import', 'update')"),
        check(table, "name", "name <> ''"),
        check(table, "date", "length(date) = 10"),
        check(table, "survey", "(kind = 'update') = (survey_id IS NOT NULL)"),
        refers("fk_inventory_event_survey", "survey_id", "survey.survey_id"),
    )
    op.create_index(op.f(f"ix_{table}_survey_id"), table, ["survey_id"], unique=True)


def create_words() -> None:
    """Create operator_state and roof_sample: what people say."""
    table = "operator_state"
    op.create_table(
        table,
        row_id("uid"),
        *words("state", "operator", "note", "decided_at"),
        key(table, "uid"),
        check(table, "state", "state IN ('confirmed', 'refuted')"),
        check(table, "operator", "operator <> ''"),
    )
    table = "roof_sample"
    op.create_table(
        table,
        row_id("sample_id"),
        *words("material", "note"),
        sa.Column("attributes", sa.JSON(), nullable=True),
        key(table, "sample_id"),
        check(table, "sample_id", "sample_id > 0"),
        check(table, "material", "material <> ''"),
    )


FOOTPRINTS = """
SELECT v.version_id, v.uid, v.valid_from, v.valid_to, v.source, s.name AS survey, COALESCE(o.state, v.state) AS state,
       v.state AS found_state, o.operator, o.note, v.storeys, v.h_max, v.h_mean, v.h_p50, v.h_p90, v.area_m2,
       v.volume_m3, v.parts, v.flat_share, v.area3d_share, v.adaptive_share, v.building_id, v.attributes, v.geometry
FROM building_version AS v
LEFT JOIN survey AS s ON s.survey_id = v.survey_id
LEFT JOIN operator_state AS o ON o.uid = v.uid
"""

FOOTPRINT_CURRENT = f"{FOOTPRINTS.strip()}\nWHERE v.valid_to IS NULL"

BUILDING_HISTORY = """
SELECT v.version_id, v.uid, v.valid_from, v.valid_to, v.source, s.name AS survey,
       COALESCE((SELECT MIN(c.kind) FROM building_change AS c
                 WHERE c.version_after = v.version_id AND c.survey_id = v.survey_id), 'imported') AS began_as,
       e.name AS ended_in,
       (SELECT MIN(c.kind) FROM building_change AS c
        WHERE c.version_before = v.version_id AND c.survey_id = v.closed_by) AS ended_as,
       v.state, v.storeys, v.h_max, v.h_p90, v.area_m2, v.volume_m3, v.geometry
FROM building_version AS v
LEFT JOIN survey AS s ON s.survey_id = v.survey_id
LEFT JOIN survey AS e ON e.survey_id = v.closed_by
"""

ROOF_MATERIAL_BY_CLASS = """
SELECT s.name AS survey, m.material, p.speindex, c.label AS class_label, COUNT(*) AS samples
FROM roof_sample AS m
JOIN part AS p ON ST_Intersects(p.geometry, m.geometry)
JOIN run AS r ON r.run_id = p.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
LEFT JOIN spectral_class AS c ON c.run_id = p.run_id AND c.speindex = p.class_id
WHERE NOT EXISTS (
  SELECT 1 FROM part AS f
  WHERE f.root_id = p.root_id AND f.scale > p.scale AND ST_Intersects(f.geometry, m.geometry)
)
GROUP BY s.name, m.material, p.speindex, c.label
"""

FOOTPRINT_AT = f"""
CREATE FUNCTION footprint_at(day date)
RETURNS TABLE (
  version_id bigint, uid bigint, valid_from text, valid_to text, source text, survey text, state text,
  found_state text, operator text, note text, storeys bigint, h_max double precision, h_mean double precision,
  h_p50 double precision, h_p90 double precision, area_m2 double precision, volume_m3 double precision, parts bigint,
  flat_share double precision, area3d_share double precision, adaptive_share double precision, building_id bigint,
  attributes json, geometry geometry
)
LANGUAGE sql STABLE AS $$
{FOOTPRINTS.strip()}
WHERE v.valid_from <= to_char(day, 'YYYY-MM-DD')
  AND (v.valid_to IS NULL OR v.valid_to > to_char(day, 'YYYY-MM-DD'))
$$
"""

VIEWS = (
    ("footprint_current", "version_id", "building_version", FOOTPRINT_CURRENT),
    ("building_history", "version_id", "building_version", BUILDING_HISTORY),
)

OLD_PART_EVIDENCE = """
SELECT p.part_id, s.name AS survey, r.method, p.root_id, p.supid, p.scale, p.hindex, p.area_m2, p.building_share,
       CASE WHEN ',' || r.method || ',' LIKE '%,flatregions,%' THEN COALESCE(e.flat_share, 0.0) END AS flat_share,
       CASE WHEN ',' || r.method || ',' LIKE '%,flatregions,%' THEN COALESCE(e.flat_regions, 0) END AS flat_regions,
       CASE WHEN ',' || r.method || ',' LIKE '%,area3d,%' THEN COALESCE(c.area3d_share, 0.0) END AS area3d_share,
       CASE WHEN ',' || r.method || ',' LIKE '%,area3d,%' THEN COALESCE(c.area3d_regions, 0) END AS area3d_regions,
       CASE WHEN ',' || r.method || ',' LIKE '%,adaptive,%' THEN COALESCE(c.adaptive_share, 0.0) END AS adaptive_share,
       CASE WHEN ',' || r.method || ',' LIKE '%,adaptive,%' THEN COALESCE(c.adaptive_regions, 0) END
         AS adaptive_regions,
       p.geometry
FROM part AS p
JOIN run AS r ON r.run_id = p.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
LEFT JOIN (
  SELECT part_id, SUM(part_share) AS flat_share, COUNT(*) AS flat_regions FROM part_flat_region GROUP BY part_id
) AS e ON e.part_id = p.part_id
LEFT JOIN (
  SELECT l.part_id,
         SUM(CASE WHEN k.method = 'area3d' THEN l.part_share END) AS area3d_share,
         COUNT(CASE WHEN k.method = 'area3d' THEN 1 END) AS area3d_regions,
         SUM(CASE WHEN k.method = 'adaptive' THEN l.part_share END) AS adaptive_share,
         COUNT(CASE WHEN k.method = 'adaptive' THEN 1 END) AS adaptive_regions
  FROM part_candidate AS l JOIN candidate_region AS k ON k.candidate_id = l.candidate_id
  GROUP BY l.part_id
) AS c ON c.part_id = p.part_id
"""

PART_EVIDENCE = """
SELECT p.part_id, s.name AS survey, r.method, p.root_id, p.supid, p.scale, p.hindex, p.area_m2, p.building_share,
       CASE WHEN ',' || r.method || ',' LIKE '%,flatregions,%' THEN COALESCE((
         SELECT SUM(l.part_share) FROM part_flat_region AS l WHERE l.part_id = p.part_id), 0.0) END AS flat_share,
       CASE WHEN ',' || r.method || ',' LIKE '%,flatregions,%' THEN (
         SELECT COUNT(*) FROM part_flat_region AS l WHERE l.part_id = p.part_id) END AS flat_regions,
       CASE WHEN ',' || r.method || ',' LIKE '%,area3d,%' THEN COALESCE((
         SELECT SUM(l.part_share) FROM part_candidate AS l JOIN candidate_region AS k ON k.candidate_id = l.candidate_id
         WHERE l.part_id = p.part_id AND k.method = 'area3d'), 0.0) END AS area3d_share,
       CASE WHEN ',' || r.method || ',' LIKE '%,area3d,%' THEN (
         SELECT COUNT(*) FROM part_candidate AS l JOIN candidate_region AS k ON k.candidate_id = l.candidate_id
         WHERE l.part_id = p.part_id AND k.method = 'area3d') END AS area3d_regions,
       CASE WHEN ',' || r.method || ',' LIKE '%,adaptive,%' THEN COALESCE((
         SELECT SUM(l.part_share) FROM part_candidate AS l JOIN candidate_region AS k ON k.candidate_id = l.candidate_id
         WHERE l.part_id = p.part_id AND k.method = 'adaptive'), 0.0) END AS adaptive_share,
       CASE WHEN ',' || r.method || ',' LIKE '%,adaptive,%' THEN (
         SELECT COUNT(*) FROM part_candidate AS l JOIN candidate_region AS k ON k.candidate_id = l.candidate_id
         WHERE l.part_id = p.part_id AND k.method = 'adaptive') END AS adaptive_regions,
       p.geometry
FROM part AS p
JOIN run AS r ON r.run_id = p.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
"""

OLD_UNEXPLAINED_FLAT_REGION = """
SELECT f.region_id, s.name AS survey, r.method, f.zone, f.lambda_low_m2, f.lambda_m2, f.gradient_sum, f.mean_gradient,
       f.area_m2, f.perimeter_m, f.compactness, f.h_max, f.h_mean, f.h_p50, f.h_p90, f.h_std, f.xcen, f.ycen,
       COALESCE(e.explained_share, 0.0) AS explained_share, f.geometry
FROM flat_region AS f
JOIN run AS r ON r.run_id = f.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
LEFT JOIN (
  SELECT l.region_id, SUM(l.region_share) AS explained_share
  FROM part_flat_region AS l JOIN part AS root ON root.part_id = l.part_id
  WHERE root.supid = 0
  GROUP BY l.region_id
) AS e ON e.region_id = f.region_id
WHERE COALESCE(e.explained_share, 0.0) < 0.5
"""

UNEXPLAINED_FLAT_REGION = """
SELECT f.region_id, s.name AS survey, r.method, f.zone, f.lambda_low_m2, f.lambda_m2, f.gradient_sum, f.mean_gradient,
       f.area_m2, f.perimeter_m, f.compactness, f.h_max, f.h_mean, f.h_p50, f.h_p90, f.h_std, f.xcen, f.ycen,
       COALESCE((
         SELECT SUM(l.region_share) FROM part_flat_region AS l JOIN part AS root ON root.part_id = l.part_id
         WHERE l.region_id = f.region_id AND root.supid = 0), 0.0) AS explained_share, f.geometry
FROM flat_region AS f
JOIN run AS r ON r.run_id = f.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
WHERE COALESCE((
         SELECT SUM(l.region_share) FROM part_flat_region AS l JOIN part AS root ON root.part_id = l.part_id
         WHERE l.region_id = f.region_id AND root.supid = 0), 0.0) < 0.5
"""

OLD_CANDIDATE_EVIDENCE = """
SELECT k.candidate_id, s.name AS survey, k.method, k.rule, k.height_scale_m, k.points, k.area_m2, k.rectangularity,
       k.compactness, k.linearity, k.ndvi, k.h_p50, k.h_p90, k.h_std, k.xcen, k.ycen,
       CASE WHEN ',' || r.method || ',' LIKE '%,multiscale,%' THEN COALESCE(e.explained_share, 0.0) END
         AS explained_share,
       CASE WHEN ',' || r.method || ',' LIKE '%,flatregions,%' THEN COALESCE(f.flat_share, 0.0) END AS flat_share,
       k.geometry
FROM candidate_region AS k
JOIN run AS r ON r.run_id = k.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
LEFT JOIN (
  SELECT l.candidate_id, SUM(l.candidate_share) AS explained_share
  FROM part_candidate AS l JOIN part AS root ON root.part_id = l.part_id
  WHERE root.supid = 0
  GROUP BY l.candidate_id
) AS e ON e.candidate_id = k.candidate_id
LEFT JOIN (
  SELECT candidate_id, SUM(candidate_share) AS flat_share FROM flat_region_candidate GROUP BY candidate_id
) AS f ON f.candidate_id = k.candidate_id
"""

CANDIDATE_EVIDENCE = """
SELECT k.candidate_id, s.name AS survey, k.method, k.rule, k.height_scale_m, k.points, k.area_m2, k.rectangularity,
       k.compactness, k.linearity, k.ndvi, k.h_p50, k.h_p90, k.h_std, k.xcen, k.ycen,
       CASE WHEN ',' || r.method || ',' LIKE '%,multiscale,%' THEN COALESCE((
         SELECT SUM(l.candidate_share) FROM part_candidate AS l JOIN part AS root ON root.part_id = l.part_id
         WHERE l.candidate_id = k.candidate_id AND root.supid = 0), 0.0) END
         AS explained_share,
       CASE WHEN ',' || r.method || ',' LIKE '%,flatregions,%' THEN COALESCE((
         SELECT SUM(l.candidate_share) FROM flat_region_candidate AS l WHERE l.candidate_id = k.candidate_id), 0.0) END
         AS flat_share,
       k.geometry
FROM candidate_region AS k
JOIN run AS r ON r.run_id = k.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
"""

OLD_UNEXPLAINED_CANDIDATE = """
SELECT k.candidate_id, s.name AS survey, k.method, k.rule, k.height_scale_m, k.points, k.area_m2, k.rectangularity,
       k.compactness, k.linearity, k.ndvi, k.h_max, k.h_mean, k.h_p50, k.h_p90, k.h_std, k.xcen, k.ycen,
       COALESCE(e.explained_share, 0.0) AS explained_share, k.geometry
FROM candidate_region AS k
JOIN run AS r ON r.run_id = k.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
LEFT JOIN (
  SELECT l.candidate_id, SUM(l.candidate_share) AS explained_share
  FROM part_candidate AS l JOIN part AS root ON root.part_id = l.part_id
  WHERE root.supid = 0
  GROUP BY l.candidate_id
) AS e ON e.candidate_id = k.candidate_id
WHERE COALESCE(e.explained_share, 0.0) < 0.5
"""

UNEXPLAINED_CANDIDATE = """
SELECT k.candidate_id, s.name AS survey, k.method, k.rule, k.height_scale_m, k.points, k.area_m2, k.rectangularity,
       k.compactness, k.linearity, k.ndvi, k.h_max, k.h_mean, k.h_p50, k.h_p90, k.h_std, k.xcen, k.ycen,
       COALESCE((
         SELECT SUM(l.candidate_share) FROM part_candidate AS l JOIN part AS root ON root.part_id = l.part_id
         WHERE l.candidate_id = k.candidate_id AND root.supid = 0), 0.0) AS explained_share, k.geometry
FROM candidate_region AS k
JOIN run AS r ON r.run_id = k.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
WHERE COALESCE((
         SELECT SUM(l.candidate_share) FROM part_candidate AS l JOIN part AS root ON root.part_id = l.part_id
         WHERE l.candidate_id = k.candidate_id AND root.supid = 0), 0.0) < 0.5
"""

OLD_EVIDENCE = (
    ("part_evidence", "part_id", "part", OLD_PART_EVIDENCE),
    ("unexplained_flat_region", "region_id", "flat_region", OLD_UNEXPLAINED_FLAT_REGION),
    ("candidate_evidence", "candidate_id", "candidate_region", OLD_CANDIDATE_EVIDENCE),
    ("unexplained_candidate", "candidate_id", "candidate_region", OLD_UNEXPLAINED_CANDIDATE),
)

EVIDENCE = (
    ("part_evidence", "part_id", "part", PART_EVIDENCE),
    ("unexplained_flat_region", "region_id", "flat_region", UNEXPLAINED_FLAT_REGION),
    ("candidate_evidence", "candidate_id", "candidate_region", CANDIDATE_EVIDENCE),
    ("unexplained_candidate", "candidate_id", "candidate_region", UNEXPLAINED_CANDIDATE),
)

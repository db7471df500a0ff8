"""Candidate regions, their links to parts and flat regions, and the buildings' shares of them."""

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"

RowId = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
KEPT = (
    "building_id, run_id, root_id, state, storeys, h_max, h_mean, h_p50, h_p90, area_m2, volume_m3, parts, scales, "
    "speindex, flat_share, geometry"
)
"""The columns of building that the second schema had and that are not computed."""


def upgrade() -> None:
    """Create the new tables, give building its columns, and make the views anew."""
    opts = op.get_context().opts
    hooks, srid = opts["hooks"], opts["srid"]
    drop_views(hooks, OLD_VIEWS)
    replace_building(hooks, srid, "flat_share", "area3d_share", "adaptive_share")
    create_candidates()
    run_all(hooks.geometry_ddl("candidate_region", "MULTIPOLYGON", srid))
    create_views(hooks, VIEWS)


def downgrade() -> None:
    """Drop the candidate regions with all that tells of them, and bring the old views back.

    The run's method, counts and ledger still name the extractors: they are what was done.
    """
    opts = op.get_context().opts
    hooks, srid = opts["hooks"], opts["srid"]
    drop_views(hooks, VIEWS)
    op.drop_table("flat_region_candidate")
    op.drop_table("part_candidate")
    run_all(hooks.drop_geometry_ddl("candidate_region"))
    op.drop_table("candidate_region")
    op.execute("DELETE FROM run_state WHERE name IN ('area3d', 'adaptive')")
    replace_building(hooks, srid, "flat_share")
    create_views(hooks, OLD_VIEWS)


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


def replace_building(hooks: object, srid: int, *shares: str) -> None:
    """Make building anew around its rows, so that an upgraded table is to the letter one that was created.

    No table refers to building, hence nothing else goes with it.
    """
    op.execute(f"CREATE TEMPORARY TABLE kept_building AS SELECT {KEPT} FROM building")  # noqa: S608  (names are ours)
    run_all(hooks.drop_geometry_ddl("building"))
    op.drop_table("building")
    create_building(*shares)
    run_all(hooks.geometry_ddl("building", "MULTIPOLYGON", srid))
    op.execute(f"INSERT INTO building ({KEPT}) SELECT {KEPT} FROM kept_building")  # noqa: S608  (names are ours)
    hooks.settle(op.get_bind())
    op.drop_table("kept_building")


def integers(*names: str) -> list[sa.Column]:
    """Return 64-bit columns that must be given."""
    return [sa.Column(name, sa.BigInteger(), autoincrement=False, nullable=False) for name in names]


def numbers(*names: str, nullable: bool = False) -> list[sa.Column]:
    """Return columns of floating-point numbers."""
    return [sa.Column(name, sa.Double(), nullable=nullable) for name in names]


def check(table: str, name: str, rule: str) -> sa.CheckConstraint:
    """Return a named check."""
    return sa.CheckConstraint(rule, name=op.f(f"ck_{table}_{name}"))


def refers(table: str, column: str, to: str) -> sa.ForeignKeyConstraint:
    """Return the key by which a row goes when the row goes that it refers to."""
    name = op.f(f"fk_{table}_{to}")
    return sa.ForeignKeyConstraint([column], [f"{to}.{column}"], name=name, ondelete="CASCADE")


def create_building(*shares: str) -> None:
    """Create building with the shares that extractors cover."""
    op.create_table(
        "building",
        sa.Column("building_id", RowId, autoincrement=False, nullable=False),
        *integers("run_id", "root_id"),
        sa.Column("state", sa.Text(), nullable=False),
        *integers("storeys"),
        *numbers("h_max", "h_mean", "h_p50", "h_p90", "area_m2", "volume_m3"),
        *integers("parts", "scales", "speindex"),
        sa.Column(
            "class_id",
            sa.BigInteger(),
            sa.Computed("nullif(speindex, 0)", persisted=True),
            autoincrement=False,
            nullable=True,
        ),
        *numbers(*shares, nullable=True),
        sa.PrimaryKeyConstraint("building_id", name=op.f("pk_building")),
        sa.UniqueConstraint("root_id", name=op.f("uq_building")),
        sa.ForeignKeyConstraint(
            ["root_id"], ["part.part_id"], name=op.f("fk_building_part"), deferrable=True, initially="DEFERRED"
        ),
        sa.ForeignKeyConstraint(
            ["run_id", "class_id"],
            ["spectral_class.run_id", "spectral_class.speindex"],
            name=op.f("fk_building_spectral_class"),
        ),
        check("building", "building_id", "building_id > 0"),
        check("building", "state", "state IN ('confirmed', 'unsure', 'refuted')"),
        check("building", "size", "storeys >= 0 AND area_m2 > 0"),
        check("building", "parts", "parts >= 1 AND scales >= 1"),
        *(check("building", name, f"{name} >= 0 AND {name} <= 1") for name in shares),
        refers("building", "run_id", "run"),
    )
    op.create_index(op.f("ix_building_run_id_class_id"), "building", ["run_id", "class_id"])


def create_candidates() -> None:
    """Create candidate_region and its links."""
    table = "candidate_region"
    op.create_table(
        table,
        sa.Column("candidate_id", RowId, autoincrement=False, nullable=False),
        *integers("run_id"),
        sa.Column("method", sa.Text(), nullable=False),
        sa.Column("rule", sa.Text(), nullable=False),
        *numbers("height_scale_m", nullable=True),
        *integers("points"),
        *numbers("area_m2"),
        *integers("perimeter"),
        *numbers("mbr_m2", "rectangularity"),
        *numbers("compactness", "linearity", "direction_1", "direction_2", "ndvi", nullable=True),
        *numbers("h_max", "h_mean", "h_p50", "h_p90", "h_std", "xcen", "ycen"),
        sa.PrimaryKeyConstraint("candidate_id", name=op.f("pk_candidate_region")),
        check(table, "candidate_id", "candidate_id > 0"),
        check(table, "method", "method IN ('area3d', 'adaptive')"),
        check(table, "rule", "rule <> ''"),
        check(table, "height_scale", "height_scale_m IS NULL OR method = 'area3d'"),
        check(table, "points", "points > 0 AND perimeter >= 0"),
        check(table, "shape", "area_m2 > 0 AND mbr_m2 >= 0 AND rectangularity >= 0 AND compactness >= 0"),
        check(table, "linearity", "linearity >= 0 AND linearity <= 1"),
        check(table, "direction_1", "direction_1 >= 0 AND direction_1 <= 180"),
        check(table, "direction_2", "direction_2 >= 0 AND direction_2 <= 180"),
        check(table, "ndvi", "ndvi >= -1 AND ndvi <= 1"),
        refers(table, "run_id", "run"),
    )
    op.create_index(op.f("ix_candidate_region_run_id_method"), table, ["run_id", "method"])
    create_links("part_candidate", "part_id", "part", "part_share")
    create_links("flat_region_candidate", "region_id", "flat_region", "region_share")


def create_links(table: str, column: str, to: str, share: str) -> None:
    """Create the table of the candidate regions that share cells with rows of another table."""
    op.create_table(
        table,
        *integers(column, "candidate_id", "run_id"),
        *numbers("overlap_m2", share, "candidate_share"),
        sa.PrimaryKeyConstraint(column, "candidate_id", name=op.f(f"pk_{table}")),
        check(table, "overlap", "overlap_m2 > 0"),
        check(table, share, f"{share} > 0 AND {share} <= 1"),
        check(table, "candidate_share", "candidate_share > 0 AND candidate_share <= 1"),
        refers(table, column, to),
        refers(table, "candidate_id", "candidate_region"),
        refers(table, "run_id", "run"),
    )
    op.create_index(op.f(f"ix_{table}_candidate_id"), table, ["candidate_id"])
    op.create_index(op.f(f"ix_{table}_run_id"), table, ["run_id"])


FOOTPRINT = """
SELECT p.part_id, s.name AS survey, r.method, b.state, p.scale, p.hindex, p.speindex, p.area_m2,
       p.h_max, p.h_mean, p.h_p50, p.h_p90, p.xin, p.yin, p.geometry
FROM part AS p
JOIN run AS r ON r.run_id = p.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
LEFT JOIN building AS b ON b.root_id = p.part_id
WHERE p.supid = 0
"""

OLD_BUILDING_SUMMARY = """
SELECT b.building_id, s.name AS survey, s.date AS survey_date, r.method, b.root_id, b.state, b.storeys,
       b.flat_share, b.h_max, b.h_mean, b.h_p50, b.h_p90, b.area_m2, b.volume_m3,
       (SELECT SUM(p.area_m2 * CASE WHEN p.hindex > COALESCE(f.hindex, 0)
                               THEN p.hindex - COALESCE(f.hindex, 0) ELSE 0 END)
        FROM part AS p LEFT JOIN part AS f ON f.part_id = p.father_id
        WHERE p.root_id = b.root_id) AS floor_area_m2,
       b.parts, b.scales, b.speindex, c.label AS class_label, root.xcen, root.ycen, root.xin, root.yin, b.geometry
FROM building AS b
JOIN run AS r ON r.run_id = b.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
JOIN part AS root ON root.part_id = b.root_id
LEFT JOIN spectral_class AS c ON c.run_id = b.run_id AND c.speindex = b.class_id
"""

OLD_PART_EVIDENCE = """
SELECT p.part_id, s.name AS survey, r.method, p.root_id, p.supid, p.scale, p.hindex, p.area_m2, p.building_share,
       CASE WHEN ',' || r.method || ',' LIKE '%,flatregions,%' THEN COALESCE(e.flat_share, 0.0) END AS flat_share,
       CASE WHEN ',' || r.method || ',' LIKE '%,flatregions,%' THEN COALESCE(e.flat_regions, 0) END AS flat_regions,
       p.geometry
FROM part AS p
JOIN run AS r ON r.run_id = p.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
LEFT JOIN (
  SELECT part_id, SUM(part_share) AS flat_share, COUNT(*) AS flat_regions FROM part_flat_region GROUP BY part_id
) AS e ON e.part_id = p.part_id
"""

BUILDING_SUMMARY = """
SELECT b.building_id, s.name AS survey, s.date AS survey_date, r.method, b.root_id, b.state, b.storeys,
       b.flat_share, b.area3d_share, b.adaptive_share, b.h_max, b.h_mean, b.h_p50, b.h_p90, b.area_m2, b.volume_m3,
       (SELECT SUM(p.area_m2 * CASE WHEN p.hindex > COALESCE(f.hindex, 0)
                               THEN p.hindex - COALESCE(f.hindex, 0) ELSE 0 END)
        FROM part AS p LEFT JOIN part AS f ON f.part_id = p.father_id
        WHERE p.root_id = b.root_id) AS floor_area_m2,
       b.parts, b.scales, b.speindex, c.label AS class_label, root.xcen, root.ycen, root.xin, root.yin, b.geometry
FROM building AS b
JOIN run AS r ON r.run_id = b.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
JOIN part AS root ON root.part_id = b.root_id
LEFT JOIN spectral_class AS c ON c.run_id = b.run_id AND c.speindex = b.class_id
"""

PART_EVIDENCE = """
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

CANDIDATE_EVIDENCE = """
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

UNEXPLAINED_CANDIDATE = """
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

BUILDING_EVIDENCE = """
SELECT b.building_id, s.name AS survey, r.method, b.state, b.storeys, b.h_p90, b.area_m2, root.building_share,
       b.flat_share, b.area3d_share, b.adaptive_share,
       CASE WHEN root.building_share >= 0.5 THEN 1 ELSE 0 END AS classes_for,
       CASE WHEN b.flat_share IS NULL THEN 0 ELSE 1 END + CASE WHEN b.area3d_share IS NULL THEN 0 ELSE 1 END
         + CASE WHEN b.adaptive_share IS NULL THEN 0 ELSE 1 END AS extractors_heard,
       CASE WHEN b.flat_share >= 0.1 THEN 1 ELSE 0 END
         + CASE WHEN b.area3d_share >= 0.1 THEN 1 ELSE 0 END
         + CASE WHEN b.adaptive_share >= 0.1 THEN 1 ELSE 0 END AS extractors_for,
       b.geometry
FROM building AS b
JOIN run AS r ON r.run_id = b.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
JOIN part AS root ON root.part_id = b.root_id
"""

OLD_VIEWS = (
    ("footprint", "part_id", "part", FOOTPRINT),
    ("building_summary", "building_id", "building", OLD_BUILDING_SUMMARY),
    ("part_evidence", "part_id", "part", OLD_PART_EVIDENCE),
)

VIEWS = (
    ("footprint", "part_id", "part", FOOTPRINT),
    ("building_summary", "building_id", "building", BUILDING_SUMMARY),
    ("part_evidence", "part_id", "part", PART_EVIDENCE),
    ("candidate_evidence", "candidate_id", "candidate_region", CANDIDATE_EVIDENCE),
    ("unexplained_candidate", "candidate_id", "candidate_region", UNEXPLAINED_CANDIDATE),
    ("building_evidence", "building_id", "building", BUILDING_EVIDENCE),
)

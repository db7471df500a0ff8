"""Flat regions, their links to parts, the buildings' flat share, and one run a survey."""

import sqlalchemy as sa
from alembic import op

from msbdb.errors import SchemaVersionError

revision = "0002"
down_revision = "0001"

RowId = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
KEPT = (
    "building_id, run_id, root_id, state, storeys, h_max, h_mean, h_p50, h_p90, area_m2, volume_m3, parts, scales, "
    "speindex, geometry"
)
"""The columns of building that the first schema had and that are not computed."""


def upgrade() -> None:
    """Create the new tables, give building its column, and make the views anew."""
    opts = op.get_context().opts
    hooks, srid = opts["hooks"], opts["srid"]
    require_one_run()
    op.create_index(op.f("ix_run_survey_id"), "run", ["survey_id"], unique=True)
    for view in ("footprint", "building_summary"):
        run_all(hooks.drop_view_ddl(view))
        op.execute(f"DROP VIEW {view}")
    widen_building(hooks, srid)
    create_flat_regions()
    run_all(hooks.geometry_ddl("flat_region", "MULTIPOLYGON", srid))
    for view, key, base, sql in VIEWS:
        op.execute(f"CREATE VIEW {view} AS\n{sql.strip()}")
        run_all(hooks.view_ddl(view, key, base))


def run_all(statements: list[str]) -> None:
    """Run statements of the dialect's hooks."""
    for statement in statements:
        op.execute(statement)


def require_one_run() -> None:
    """Refuse a survey of several runs, of which none can be told to be the one."""
    query = """
    SELECT s.name, COUNT(*) FROM run AS r JOIN survey AS s ON s.survey_id = r.survey_id
    GROUP BY s.name HAVING COUNT(*) > 1 ORDER BY s.name
    """
    several = op.get_bind().execute(sa.text(query)).all()
    if several:
        msg = (
            f"The schema {revision} holds one run a survey; the survey '{several[0][0]}' has {several[0][1]}. "
            "Delete all but one of them from the table run, and try again; nothing was changed."
        )
        raise SchemaVersionError(msg)


def widen_building(hooks: object, srid: int) -> None:
    """Make building anew around its rows, so that an upgraded table is to the letter one that was created.

    No table refers to building, hence nothing else goes with it.
    """
    op.execute(f"CREATE TEMPORARY TABLE kept_building AS SELECT {KEPT} FROM building")  # noqa: S608  (names are ours)
    run_all(hooks.drop_geometry_ddl("building"))
    op.drop_table("building")
    create_building()
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


def create_building() -> None:
    """Create building with flat_share."""
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
        *numbers("flat_share", nullable=True),
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
        check("building", "flat_share", "flat_share >= 0 AND flat_share <= 1"),
        refers("building", "run_id", "run"),
    )
    op.create_index(op.f("ix_building_run_id_class_id"), "building", ["run_id", "class_id"])


def create_flat_regions() -> None:
    """Create flat_region and part_flat_region."""
    op.create_table(
        "flat_region",
        sa.Column("region_id", RowId, autoincrement=False, nullable=False),
        *integers("run_id", "zone"),
        *numbers("lambda_low_m2", "lambda_m2", "gradient_sum", "mean_gradient", "area_m2", "perimeter_m"),
        *numbers("compactness", "h_max", "h_mean", "h_p50", "h_p90", "h_std", "xcen", "ycen"),
        sa.PrimaryKeyConstraint("region_id", name=op.f("pk_flat_region")),
        check("flat_region", "region_id", "region_id > 0"),
        check("flat_region", "zone", "zone >= 0 AND lambda_low_m2 >= 0 AND lambda_low_m2 <= lambda_m2"),
        check("flat_region", "gradient", "gradient_sum >= 0 AND mean_gradient >= 0"),
        check("flat_region", "shape", "area_m2 > 0 AND perimeter_m > 0 AND compactness > 0"),
        refers("flat_region", "run_id", "run"),
    )
    op.create_index(op.f("ix_flat_region_run_id_zone"), "flat_region", ["run_id", "zone"])
    op.create_table(
        "part_flat_region",
        *integers("part_id", "region_id", "run_id"),
        *numbers("overlap_m2", "part_share", "region_share"),
        sa.PrimaryKeyConstraint("part_id", "region_id", name=op.f("pk_part_flat_region")),
        check("part_flat_region", "overlap", "overlap_m2 > 0"),
        check("part_flat_region", "part_share", "part_share > 0 AND part_share <= 1"),
        check("part_flat_region", "region_share", "region_share > 0 AND region_share <= 1"),
        refers("part_flat_region", "part_id", "part"),
        refers("part_flat_region", "region_id", "flat_region"),
        refers("part_flat_region", "run_id", "run"),
    )
    op.create_index(op.f("ix_part_flat_region_region_id"), "part_flat_region", ["region_id"])
    op.create_index(op.f("ix_part_flat_region_run_id"), "part_flat_region", ["run_id"])


FOOTPRINT = """
SELECT p.part_id, s.name AS survey, r.method, b.state, p.scale, p.hindex, p.speindex, p.area_m2,
       p.h_max, p.h_mean, p.h_p50, p.h_p90, p.xin, p.yin, p.geometry
FROM part AS p
JOIN run AS r ON r.run_id = p.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
LEFT JOIN building AS b ON b.root_id = p.part_id
WHERE p.supid = 0
"""

BUILDING_SUMMARY = """
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

PART_EVIDENCE = """
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

UNEXPLAINED_FLAT_REGION = """
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

VIEWS = (
    ("footprint", "part_id", "part", FOOTPRINT),
    ("building_summary", "building_id", "building", BUILDING_SUMMARY),
    ("part_evidence", "part_id", "part", PART_EVIDENCE),
    ("unexplained_flat_region", "region_id", "flat_region", UNEXPLAINED_FLAT_REGION),
)

"""Surveys, runs, buildings as trees of parts, classes, rejections, state, and the views."""

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None

RowId = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
VIEWS = {
    "footprint": ("part_id", "part"),
    "part_tree": ("part_id", "part"),
    "building_summary": ("building_id", "building"),
}


def upgrade() -> None:
    """Create everything; the dialect's hooks add geometry columns, spatial indexes and the views' registration."""
    opts = op.get_context().opts
    hooks, srid = opts["hooks"], opts["srid"]
    create_provenance()
    create_classes()
    create_parts()
    create_buildings()
    create_rejections()
    for table, kind in (("part", "MULTIPOLYGON"), ("building", "MULTIPOLYGON"), ("rejection", "POINT")):
        for statement in hooks.geometry_ddl(table, kind, srid):
            op.execute(statement)
    for (view, (key, base)), sql in zip(VIEWS.items(), (FOOTPRINT, PART_TREE, BUILDING_SUMMARY), strict=True):
        op.execute(f"CREATE VIEW {view} AS\n{sql}")
        for statement in hooks.view_ddl(view, key, base):
            op.execute(statement)


def integers(*names: str) -> list[sa.Column]:
    """Return 64-bit columns that must be given."""
    return [sa.Column(name, sa.BigInteger(), autoincrement=False, nullable=False) for name in names]


def row_id(name: str) -> sa.Column:
    """Return a primary key of one column, in SQLite the row's own number."""
    return sa.Column(name, RowId, autoincrement=False, nullable=False)


def numbers(*names: str, nullable: bool = False) -> list[sa.Column]:
    """Return columns of floating-point numbers."""
    return [sa.Column(name, sa.Double(), nullable=nullable) for name in names]


def words(*names: str) -> list[sa.Column]:
    """Return columns of text."""
    return [sa.Column(name, sa.Text(), nullable=False) for name in names]


def documents(*names: str) -> list[sa.Column]:
    """Return columns of JSON."""
    return [sa.Column(name, sa.JSON(), nullable=False) for name in names]


def number_32(name: str) -> sa.Column:
    """Return a 32-bit column."""
    return sa.Column(name, sa.Integer(), autoincrement=False, nullable=False)


def generated(name: str, expression: str) -> sa.Column:
    """Return a column that the database computes."""
    return sa.Column(name, sa.BigInteger(), sa.Computed(expression, persisted=True), autoincrement=False, nullable=True)


def of_run(table: str) -> sa.ForeignKeyConstraint:
    """Return the key by which rows go when their run goes."""
    return sa.ForeignKeyConstraint(["run_id"], ["run.run_id"], name=op.f(f"fk_{table}_run"), ondelete="CASCADE")


def check(table: str, name: str, rule: str) -> sa.CheckConstraint:
    """Return a named check."""
    return sa.CheckConstraint(rule, name=op.f(f"ck_{table}_{name}"))


def create_provenance() -> None:
    """Create survey, source, run, and the run's rasters."""
    op.create_table(
        "survey",
        row_id("survey_id"),
        *words("name", "date"),
        number_32("epsg"),
        *words("crs_wkt", "vertical_crs"),
        *numbers("density", "cell_m", "west", "south", "east", "north"),
        sa.PrimaryKeyConstraint("survey_id", name=op.f("pk_survey")),
        sa.UniqueConstraint("name", name=op.f("uq_survey")),
        check("survey", "name", "name <> ''"),
        check("survey", "density", "density >= 0 AND cell_m > 0"),
        check("survey", "bounds", "west < east AND south < north"),
    )
    of_survey = {"columns": ["survey_id"], "refcolumns": ["survey.survey_id"], "ondelete": "CASCADE"}
    op.create_table(
        "run",
        row_id("run_id"),
        *integers("survey_id"),
        *words("method", "profile", "version"),
        *documents("parameters", "counts", "timings", "notices"),
        *words("content_sha256"),
        sa.PrimaryKeyConstraint("run_id", name=op.f("pk_run")),
        sa.UniqueConstraint("survey_id", "method", name=op.f("uq_run")),
        sa.ForeignKeyConstraint(**of_survey, name=op.f("fk_run_survey")),
    )
    op.create_table(
        "source",
        *integers("survey_id"),
        number_32("number"),
        *words("name", "role", "sha256"),
        *integers("bytes"),
        sa.PrimaryKeyConstraint("survey_id", "number", name=op.f("pk_source")),
        check("source", "bytes", "bytes >= 0"),
        sa.ForeignKeyConstraint(**of_survey, name=op.f("fk_source_survey")),
    )
    op.create_table(
        "run_state",
        *integers("run_id"),
        *words("name", "dtype"),
        *documents("shape"),
        sa.Column("data", sa.LargeBinary(), nullable=False),
        sa.PrimaryKeyConstraint("run_id", "name", name=op.f("pk_run_state")),
        of_run("run_state"),
    )


def create_classes() -> None:
    """Create scale, spectral_class and spectral_class_band."""
    op.create_table(
        "scale",
        *integers("run_id", "scale", "threshold_px"),
        *numbers("threshold_m2"),
        sa.PrimaryKeyConstraint("run_id", "scale", name=op.f("pk_scale")),
        check("scale", "scale", "scale >= 1"),
        check("scale", "threshold", "threshold_px >= 1 AND threshold_m2 > 0"),
        of_run("scale"),
    )
    op.create_table(
        "spectral_class",
        *integers("run_id", "speindex"),
        *words("label", "labelled_by", "source"),
        *integers("cells"),
        *numbers("share"),
        *numbers("ndvi", "brightness", "roughness_m", nullable=True),
        *numbers("height_m"),
        sa.PrimaryKeyConstraint("run_id", "speindex", name=op.f("pk_spectral_class")),
        check("spectral_class", "speindex", "speindex >= 1"),
        check("spectral_class", "cells", "cells >= 0 AND share >= 0"),
        check("spectral_class", "label", "label IN ('building', 'vegetation', 'shadow', 'water', 'other')"),
        check("spectral_class", "labelled_by", "labelled_by IN ('automatic', 'operator')"),
        check("spectral_class", "source", "source IN ('spectral', 'structure')"),
        of_run("spectral_class"),
    )
    op.create_table(
        "spectral_class_band",
        *integers("run_id", "speindex"),
        *words("band"),
        *numbers("mean"),
        sa.PrimaryKeyConstraint("run_id", "speindex", "band", name=op.f("pk_spectral_class_band")),
        of_class("spectral_class_band", "speindex", ondelete="CASCADE"),
    )


def of_class(table: str, column: str, ondelete: str | None = None) -> sa.ForeignKeyConstraint:
    """Return the key to the run's spectral classes."""
    return sa.ForeignKeyConstraint(
        ["run_id", column],
        ["spectral_class.run_id", "spectral_class.speindex"],
        name=op.f(f"fk_{table}_spectral_class"),
        ondelete=ondelete,
    )


def create_parts() -> None:
    """Create part, whose keys and checks hold the forest (V33)."""
    op.create_table(
        "part",
        row_id("part_id"),
        *integers("run_id", "supid"),
        generated("father_id", "nullif(supid, 0)"),
        *integers("supscale", "root_id", "scale", "hindex", "hzone", "speindex"),
        generated("class_id", "nullif(speindex, 0)"),
        *numbers("xo", "yo", "xcen", "ycen", "xin", "yin"),
        *integers("area_px"),
        *numbers("area_m2"),
        *numbers("stddis", nullable=True),
        *numbers("h_max", "h_mean", "h_p50", "h_p90", "h_std", "building_share"),
        sa.PrimaryKeyConstraint("part_id", name=op.f("pk_part")),
        sa.UniqueConstraint("part_id", "scale", "root_id", "run_id", name=op.f("uq_part")),
        sa.ForeignKeyConstraint(
            ["father_id", "supscale", "root_id", "run_id"],
            ["part.part_id", "part.scale", "part.root_id", "part.run_id"],
            name=op.f("fk_part_part"),
            deferrable=True,
            initially="DEFERRED",
        ),
        sa.ForeignKeyConstraint(["run_id", "scale"], ["scale.run_id", "scale.scale"], name=op.f("fk_part_scale")),
        of_class("part", "class_id"),
        check("part", "part_id", "part_id > 0"),
        check(
            "part",
            "father",
            "(supid = 0 AND supscale = 0 AND root_id = part_id) OR (supid > 0 AND supscale > 0 AND supscale < scale)",
        ),
        check("part", "area", "area_px > 0 AND area_m2 > 0"),
        check("part", "storeys", "hindex >= 0 AND hzone >= 0"),
        check("part", "building_share", "building_share >= 0 AND building_share <= 1"),
        of_run("part"),
    )
    create_indexes(
        "part",
        ("father_id", "supscale", "root_id", "run_id"),
        ("root_id",),
        ("run_id", "scale"),
        ("run_id", "class_id"),
    )


def create_buildings() -> None:
    """Create building."""
    op.create_table(
        "building",
        row_id("building_id"),
        *integers("run_id", "root_id"),
        *words("state"),
        *integers("storeys"),
        *numbers("h_max", "h_mean", "h_p50", "h_p90", "area_m2", "volume_m3"),
        *integers("parts", "scales", "speindex"),
        generated("class_id", "nullif(speindex, 0)"),
        sa.PrimaryKeyConstraint("building_id", name=op.f("pk_building")),
        sa.UniqueConstraint("root_id", name=op.f("uq_building")),
        sa.ForeignKeyConstraint(
            ["root_id"], ["part.part_id"], name=op.f("fk_building_part"), deferrable=True, initially="DEFERRED"
        ),
        of_class("building", "class_id"),
        check("building", "building_id", "building_id > 0"),
        check("building", "state", "state IN ('confirmed', 'unsure', 'refuted')"),
        check("building", "size", "storeys >= 0 AND area_m2 > 0"),
        check("building", "parts", "parts >= 1 AND scales >= 1"),
        of_run("building"),
    )
    create_indexes("building", ("run_id", "class_id"))


def create_rejections() -> None:
    """Create rejection, the ledger."""
    op.create_table(
        "rejection",
        row_id("rejection_id"),
        *integers("run_id", "region_id"),
        *words("stage", "reason"),
        *integers("scale"),
        *numbers("area_m2", "xcen", "ycen"),
        sa.PrimaryKeyConstraint("rejection_id", name=op.f("pk_rejection")),
        check("rejection", "reason", "stage <> '' AND reason <> ''"),
        check("rejection", "area", "scale >= 0 AND area_m2 >= 0"),
        of_run("rejection"),
    )
    create_indexes("rejection", ("run_id", "stage", "reason"))


def create_indexes(table: str, *groups: tuple[str, ...]) -> None:
    """Create an index for each group of columns."""
    for columns in groups:
        op.create_index(op.f(f"ix_{table}_{'_'.join(columns)}"), table, list(columns))


FOOTPRINT = """
SELECT p.part_id, s.name AS survey, r.method, b.state, p.scale, p.hindex, p.speindex, p.area_m2,
       p.h_max, p.h_mean, p.h_p50, p.h_p90, p.xin, p.yin, p.geometry
FROM part AS p
JOIN run AS r ON r.run_id = p.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
LEFT JOIN building AS b ON b.root_id = p.part_id
WHERE p.supid = 0
""".strip()

PART_TREE = """
WITH RECURSIVE tree (part_id, depth, path) AS (
  SELECT part_id, 0, CAST(part_id AS TEXT) FROM part WHERE supid = 0
  UNION ALL
  SELECT child.part_id, tree.depth + 1, tree.path || '/' || CAST(child.part_id AS TEXT)
  FROM tree JOIN part AS child ON child.father_id = tree.part_id
)
SELECT p.part_id, s.name AS survey, r.method, p.root_id, p.supid, p.supscale, p.scale, tree.depth, tree.path,
       p.hindex, p.speindex, p.area_m2, p.stddis, p.h_max, p.h_p90, p.geometry
FROM tree
JOIN part AS p ON p.part_id = tree.part_id
JOIN run AS r ON r.run_id = p.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
""".strip()

BUILDING_SUMMARY = """
SELECT b.building_id, s.name AS survey, s.date AS survey_date, r.method, b.root_id, b.state, b.storeys,
       b.h_max, b.h_mean, b.h_p50, b.h_p90, b.area_m2, b.volume_m3,
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
""".strip()

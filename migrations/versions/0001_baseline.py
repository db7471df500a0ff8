"""The baseline: surveys, runs, buildings as trees, regions, the ledger, the living inventory, and the views.

It is frozen: what a later version of msbdb changes is in a later migration. Texts of views are in ``migrations/sql``,
in the folder of the migration that brought them.
"""

from pathlib import Path

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None

TEXTS = Path(__file__).parents[1] / "sql" / revision
RowId = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
SHARES = ("flat_share", "area3d_share", "adaptive_share")
SPATIAL = {
    "part": "MULTIPOLYGON",
    "building": "MULTIPOLYGON",
    "rejection": "POINT",
    "flat_region": "MULTIPOLYGON",
    "candidate_region": "MULTIPOLYGON",
    "building_version": "MULTIPOLYGON",
    "inventory_event": "MULTIPOLYGON",
    "roof_sample": "POINT",
}
DIGESTED = (
    "inventory_building", "building_version", "building_change", "survey_offset", "inventory_event", "operator_state",
    "roof_sample",
)  # fmt: skip
VIEWS = {
    "footprint": ("part_id", "part"),
    "part_tree": ("part_id", "part"),
    "building_summary": ("building_id", "building"),
    "part_evidence": ("part_id", "part"),
    "unexplained_flat_region": ("region_id", "flat_region"),
    "candidate_evidence": ("candidate_id", "candidate_region"),
    "unexplained_candidate": ("candidate_id", "candidate_region"),
    "building_evidence": ("building_id", "building"),
    "footprint_current": ("version_id", "building_version"),
    "building_history": ("version_id", "building_version"),
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
    create_flat_regions()
    create_candidates()
    create_versions()
    create_changes()
    create_events()
    create_words()
    for table, kind in SPATIAL.items():
        run_all(hooks.geometry_ddl(table, kind, srid))
    run_all([f"ALTER TABLE {table} ADD COLUMN row_digest BIGINT" for table in DIGESTED])
    for view, (key, base) in VIEWS.items():
        op.execute(f"CREATE VIEW {view} AS\n{text_of(view)}")
        run_all(hooks.view_ddl(view, key, base))
    op.execute(f"CREATE VIEW roof_material_by_class AS\n{text_of('roof_material_by_class')}")
    if op.get_bind().dialect.name == "postgresql":
        op.execute(text_of("footprint_at"))


def text_of(name: str) -> str:
    """Return the statement of a file, without its comment."""
    lines = (TEXTS / f"{name}.sql").read_text(encoding="utf-8").splitlines()
    return "\n".join(line for line in lines if not line.startswith("--")).strip().rstrip(";")


def run_all(statements: list[str]) -> None:
    """Run statements."""
    for statement in statements:
        op.execute(statement)


def row_id(name: str) -> sa.Column:
    """Return a primary key of one column, in SQLite the row's own number."""
    return sa.Column(name, RowId, autoincrement=False, nullable=False)


def integers(*names: str, nullable: bool = False) -> list[sa.Column]:
    """Return 64-bit columns."""
    return [sa.Column(name, sa.BigInteger(), autoincrement=False, nullable=nullable) for name in names]


def number_32(name: str) -> sa.Column:
    """Return a 32-bit column."""
    return sa.Column(name, sa.Integer(), autoincrement=False, nullable=False)


def numbers(*names: str, nullable: bool = False) -> list[sa.Column]:
    """Return columns of floating-point numbers."""
    return [sa.Column(name, sa.Double(), nullable=nullable) for name in names]


def words(*names: str, nullable: bool = False) -> list[sa.Column]:
    """Return columns of text."""
    return [sa.Column(name, sa.Text(), nullable=nullable) for name in names]


def documents(*names: str, nullable: bool = False) -> list[sa.Column]:
    """Return columns of JSON."""
    return [sa.Column(name, sa.JSON(), nullable=nullable) for name in names]


def flags(*names: str) -> list[sa.Column]:
    """Return columns of yes or no."""
    return [sa.Column(name, sa.Boolean(), nullable=False) for name in names]


def generated(name: str, expression: str) -> sa.Column:
    """Return a column that the database computes."""
    return sa.Column(name, sa.BigInteger(), sa.Computed(expression, persisted=True), autoincrement=False, nullable=True)


def key(table: str, *columns: str) -> sa.PrimaryKeyConstraint:
    """Return the primary key."""
    return sa.PrimaryKeyConstraint(*columns, name=op.f(f"pk_{table}"))


def check(table: str, name: str, rule: str) -> sa.CheckConstraint:
    """Return a named check."""
    return sa.CheckConstraint(rule, name=op.f(f"ck_{table}_{name}"))


def shares(table: str, *names: str) -> list[sa.CheckConstraint]:
    """Return the checks of shares, from 0 to 1 or null."""
    return [check(table, name, f"{name} >= 0 AND {name} <= 1") for name in names]


def refers(table: str, column: str, to: str, name: str = "", *, cascade: bool = True) -> sa.ForeignKeyConstraint:
    """Return a key of one column; with ``cascade`` a row goes when the row goes that it refers to."""
    return sa.ForeignKeyConstraint(
        [column], [to], name=op.f(name or f"fk_{table}_{to.partition('.')[0]}"), ondelete="CASCADE" if cascade else None
    )


def of_run(table: str) -> sa.ForeignKeyConstraint:
    """Return the key by which rows go when their run goes."""
    return refers(table, "run_id", "run.run_id")


def of_class(table: str, column: str, ondelete: str | None = None) -> sa.ForeignKeyConstraint:
    """Return the key to the run's spectral classes."""
    return sa.ForeignKeyConstraint(
        ["run_id", column],
        ["spectral_class.run_id", "spectral_class.speindex"],
        name=op.f(f"fk_{table}_spectral_class"),
        ondelete=ondelete,
    )


def create_indexes(table: str, *groups: tuple[str, ...], unique: bool = False) -> None:
    """Create an index for each group of columns."""
    for columns in groups:
        op.create_index(op.f(f"ix_{table}_{'_'.join(columns)}"), table, list(columns), unique=unique)


def create_provenance() -> None:
    """Create survey, source, run, its extractors and its rasters."""
    op.create_table(
        "survey",
        row_id("survey_id"),
        *words("name", "date"),
        number_32("epsg"),
        *words("crs_wkt", "vertical_crs"),
        *numbers("density", "cell_m", "west", "south", "east", "north"),
        key("survey", "survey_id"),
        sa.UniqueConstraint("name", name=op.f("uq_survey")),
        check("survey", "name", "name <> ''"),
        check("survey", "density", "density >= 0 AND cell_m > 0"),
        check("survey", "bounds", "west < east AND south < north"),
    )
    op.create_table(
        "run",
        row_id("run_id"),
        *integers("survey_id"),
        *words("profile", "version"),
        *documents("parameters", "counts", "timings", "notices"),
        *words("content_sha256"),
        key("run", "run_id"),
        refers("run", "survey_id", "survey.survey_id"),
    )
    create_indexes("run", ("survey_id",), unique=True)
    op.create_table(
        "run_method",
        *integers("run_id"),
        *words("method"),
        key("run_method", "run_id", "method"),
        check("run_method", "method", "method IN ('multiscale', 'flatregions', 'area3d', 'adaptive')"),
        of_run("run_method"),
    )
    op.create_table(
        "source",
        *integers("survey_id"),
        number_32("number"),
        *words("name", "role", "sha256"),
        *integers("bytes"),
        key("source", "survey_id", "number"),
        check("source", "bytes", "bytes >= 0"),
        refers("source", "survey_id", "survey.survey_id"),
    )
    op.create_table(
        "run_state",
        *integers("run_id"),
        *words("name", "dtype"),
        *documents("shape"),
        sa.Column("data", sa.LargeBinary(), nullable=False),
        key("run_state", "run_id", "name"),
        of_run("run_state"),
    )


def create_classes() -> None:
    """Create scale, spectral_class and spectral_class_band."""
    op.create_table(
        "scale",
        *integers("run_id", "scale", "threshold_px"),
        *numbers("threshold_m2"),
        key("scale", "run_id", "scale"),
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
        key("spectral_class", "run_id", "speindex"),
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
        key("spectral_class_band", "run_id", "speindex", "band"),
        of_class("spectral_class_band", "speindex", ondelete="CASCADE"),
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
        key("part", "part_id"),
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
        *shares("part", "building_share"),
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
        *numbers(*SHARES, nullable=True),
        key("building", "building_id"),
        sa.UniqueConstraint("root_id", name=op.f("uq_building")),
        sa.ForeignKeyConstraint(
            ["root_id"], ["part.part_id"], name=op.f("fk_building_part"), deferrable=True, initially="DEFERRED"
        ),
        of_class("building", "class_id"),
        check("building", "building_id", "building_id > 0"),
        check("building", "state", "state IN ('confirmed', 'unsure', 'refuted')"),
        check("building", "size", "storeys >= 0 AND area_m2 > 0"),
        check("building", "parts", "parts >= 1 AND scales >= 1"),
        *shares("building", *SHARES),
        of_run("building"),
    )
    create_indexes("building", ("run_id", "class_id"))


def create_rejections() -> None:
    """Create rejection, the ledger."""
    op.create_table(
        "rejection",
        row_id("rejection_id"),
        *integers("run_id", "region_id"),
        *words("method", "stage", "reason"),
        *integers("scale"),
        *numbers("area_m2", "xcen", "ycen"),
        key("rejection", "rejection_id"),
        check("rejection", "method", "method IN ('multiscale', 'flatregions', 'area3d', 'adaptive')"),
        check("rejection", "reason", "stage <> '' AND reason <> ''"),
        check("rejection", "area", "scale >= 0 AND area_m2 >= 0"),
        of_run("rejection"),
    )
    create_indexes("rejection", ("run_id", "method", "stage", "reason"))


def create_flat_regions() -> None:
    """Create flat_region and its links to parts."""
    op.create_table(
        "flat_region",
        row_id("region_id"),
        *integers("run_id", "zone"),
        *numbers("lambda_low_m2", "lambda_m2", "gradient_sum", "mean_gradient", "area_m2", "perimeter_m"),
        *numbers("compactness", "h_max", "h_mean", "h_p50", "h_p90", "h_std", "xcen", "ycen"),
        key("flat_region", "region_id"),
        check("flat_region", "region_id", "region_id > 0"),
        check("flat_region", "zone", "zone >= 0 AND lambda_low_m2 >= 0 AND lambda_low_m2 <= lambda_m2"),
        check("flat_region", "gradient", "gradient_sum >= 0 AND mean_gradient >= 0"),
        check("flat_region", "shape", "area_m2 > 0 AND perimeter_m > 0 AND compactness > 0"),
        of_run("flat_region"),
    )
    create_indexes("flat_region", ("run_id", "zone"))
    create_links("part_flat_region", ("part_id", "part", "part_share"), ("region_id", "flat_region", "region_share"))


def create_candidates() -> None:
    """Create candidate_region and its links to parts and flat regions."""
    table = "candidate_region"
    op.create_table(
        table,
        row_id("candidate_id"),
        *integers("run_id"),
        *words("method", "rule"),
        *numbers("height_scale_m", nullable=True),
        *integers("points"),
        *numbers("area_m2"),
        *integers("perimeter"),
        *numbers("mbr_m2", "rectangularity"),
        *numbers("compactness", "linearity", "direction_1", "direction_2", "ndvi", nullable=True),
        *numbers("h_max", "h_mean", "h_p50", "h_p90", "h_std", "xcen", "ycen"),
        key(table, "candidate_id"),
        check(table, "candidate_id", "candidate_id > 0"),
        check(table, "method", "method IN ('area3d', 'adaptive')"),
        check(table, "rule", "rule <> ''"),
        check(table, "height_scale", "height_scale_m IS NULL OR method = 'area3d'"),
        check(table, "points", "points > 0 AND perimeter >= 0"),
        check(table, "shape", "area_m2 > 0 AND mbr_m2 >= 0 AND rectangularity >= 0 AND compactness >= 0"),
        *shares(table, "linearity"),
        check(table, "direction_1", "direction_1 >= 0 AND direction_1 <= 180"),
        check(table, "direction_2", "direction_2 >= 0 AND direction_2 <= 180"),
        check(table, "ndvi", "ndvi >= -1 AND ndvi <= 1"),
        of_run(table),
    )
    create_indexes(table, ("run_id", "method"))
    candidate = ("candidate_id", "candidate_region", "candidate_share")
    create_links("part_candidate", ("part_id", "part", "part_share"), candidate)
    create_links("flat_region_candidate", ("region_id", "flat_region", "region_share"), candidate)


def create_links(table: str, one: tuple[str, str, str], two: tuple[str, str, str]) -> None:
    """Create the table of pairs of rows that share cells; each side is its key, table and share."""
    op.create_table(
        table,
        *integers(one[0], two[0], "run_id"),
        *numbers("overlap_m2", one[2], two[2]),
        key(table, one[0], two[0]),
        check(table, "overlap", "overlap_m2 > 0"),
        *(check(table, side[2], f"{side[2]} > 0 AND {side[2]} <= 1") for side in (one, two)),
        *(refers(table, side[0], f"{side[1]}.{side[0]}") for side in (one, two)),
        of_run(table),
    )
    create_indexes(table, (two[0],), ("run_id",))


def create_versions() -> None:
    """Create the buildings of the inventory and their versions."""
    table = "inventory_building"
    op.create_table(table, row_id("uid"), *words("source"), key(table, "uid"), check(table, "uid", "uid > 0"))
    table = "building_version"
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
        *numbers(*SHARES, nullable=True),
        *documents("attributes", nullable=True),
        key(table, "version_id"),
        check(table, "version_id", "version_id > 0"),
        check(table, "valid_from", "length(valid_from) = 10"),
        check(table, "valid_to", "valid_to IS NULL OR (length(valid_to) = 10 AND valid_to >= valid_from)"),
        check(table, "source", "source IN ('survey', 'import')"),
        check(table, "survey", "(source = 'survey') = (survey_id IS NOT NULL)"),
        check(table, "closed_by", "closed_by IS NULL OR valid_to IS NOT NULL"),
        check(table, "state", "state IN ('confirmed', 'unsure', 'refuted')"),
        check(table, "area", "area_m2 > 0"),
        check(table, "parts", "storeys >= 0 AND parts >= 1"),
        *shares(table, *SHARES),
        refers(table, "uid", "inventory_building.uid", cascade=False),
        refers(table, "survey_id", "survey.survey_id", cascade=False),
        refers(table, "closed_by", "survey.survey_id", "fk_building_version_closed_by", cascade=False),
    )
    create_indexes(table, ("uid", "valid_from"), ("survey_id",), ("closed_by",))
    current = sa.text("valid_to IS NULL")
    op.create_index(
        "ix_building_version_current", table, ["uid"], unique=True, sqlite_where=current, postgresql_where=current
    )


def create_changes() -> None:
    """Create what surveys did to the buildings, and how each survey lies to the inventory."""
    table = "building_change"
    sides = {
        "uid_before": "inventory_building.uid",
        "uid_after": "inventory_building.uid",
        "version_before": "building_version.version_id",
        "version_after": "building_version.version_id",
    }
    op.create_table(
        table,
        row_id("change_id"),
        *integers("survey_id"),
        *words("kind"),
        *integers(*sides, nullable=True),
        *flags("outline", "height", "parts"),
        *numbers("overlap_m2", "iou"),
        *numbers("dh_m", nullable=True),
        *numbers("darea_m2"),
        *words("note"),
        key(table, "change_id"),
        check(table, "change_id", "change_id > 0"),
        check(table, "kind", "kind IN ('unchanged', 'modified', 'new', 'demolished', 'merged', 'split')"),
        check(table, "uid", "uid_before IS NOT NULL OR uid_after IS NOT NULL"),
        check(
            table,
            "version",
            "(uid_before IS NULL) = (version_before IS NULL) AND (uid_after IS NULL) = (version_after IS NULL)",
        ),
        check(table, "overlap", "overlap_m2 >= 0 AND iou >= 0 AND iou <= 1"),
        refers(table, "survey_id", "survey.survey_id", cascade=False),
        *(refers(table, name, to, f"fk_building_change_{name}", cascade=False) for name, to in sides.items()),
    )
    create_indexes(table, ("survey_id", "kind"), *((name,) for name in sides))
    table = "survey_offset"
    op.create_table(
        table,
        *integers("survey_id"),
        *numbers("dx_m", "dy_m", "dz_m"),
        *integers("pairs"),
        *numbers("spread_m", nullable=True),
        key(table, "survey_id"),
        check(table, "pairs", "pairs >= 0"),
        refers(table, "survey_id", "survey.survey_id", cascade=False),
    )


def create_events() -> None:
    """Create what was applied to the inventory, in which order."""
    table = "inventory_event"
    op.create_table(
        table,
        row_id("number"),
        *words("kind", "name", "date"),
        *integers("survey_id", nullable=True),
        *documents("counts"),
        *words("content_sha256"),
        key(table, "number"),
        check(table, "number", "number > 0"),
        check(table, "kind", "kind IN ('import', 'update')"),
        check(table, "name", "name <> ''"),
        check(table, "date", "length(date) = 10"),
        check(table, "survey", "(kind = 'update') = (survey_id IS NOT NULL)"),
        refers(table, "survey_id", "survey.survey_id", cascade=False),
    )
    create_indexes(table, ("survey_id",), unique=True)


def create_words() -> None:
    """Create what people decide and know: operators' states, and roof samples."""
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
        *documents("attributes", nullable=True),
        key(table, "sample_id"),
        check(table, "sample_id", "sample_id > 0"),
        check(table, "material", "material <> ''"),
    )

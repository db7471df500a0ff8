"""Buildings as objects: an island of roots is one building, and each part names the building in which it stands.

A building of the baseline has one root. It keeps its id, and its tree stands in it. Six tables are made anew and filled
from copies, because SQLite cannot add or drop keys of a table. Runs keep a digest of their content. It is computed
again where it was right before, so that an edit by another program is found after the upgrade, too.

There is no way back: a building with several trees has no place in the baseline.
"""

from pathlib import Path
from types import ModuleType

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"

TEXTS = Path(__file__).parents[1] / "sql"
SPATIAL = ("part", "building", "building_version")
MADE_ANEW = ("building", "part", "part_flat_region", "part_candidate", "building_version", "building_change")
"""The tables in the order in which they are filled: each refers to tables before it."""

DROPPED = ("building_change", "building_version", "part_candidate", "part_flat_region", "building", "part")
"""The same in the order in which they go: in the baseline a building refers to its root."""

DIGESTED = ("building_version", "building_change")
VIEWS = {
    "footprint": ("building_id", "building"),
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
FILLED = {
    "building": """
        (building_id, run_id, state, storeys, h_max, h_mean, h_p50, h_p90, area_m2, volume_m3, trees, parts, scales,
         speindex, building_share, xcen, ycen, xin, yin, flat_share, area3d_share, adaptive_share, geometry)
        SELECT b.building_id, b.run_id, b.state, b.storeys, b.h_max, b.h_mean, b.h_p50, b.h_p90, b.area_m2,
               b.volume_m3, 1, b.parts, b.scales, b.speindex, p.building_share, p.xcen, p.ycen, p.xin, p.yin,
               b.flat_share, b.area3d_share, b.adaptive_share, b.geometry
        FROM old_building AS b JOIN old_part AS p ON p.part_id = b.root_id
    """,
    "part": """
        (part_id, run_id, supid, supscale, root_id, building_id, scale, hindex, hzone, speindex, xo, yo, xcen, ycen,
         xin, yin, area_px, area_m2, stddis, h_max, h_mean, h_p50, h_p90, h_std, building_share, geometry)
        SELECT p.part_id, p.run_id, p.supid, p.supscale, p.root_id, b.building_id, p.scale, p.hindex, p.hzone,
               p.speindex, p.xo, p.yo, p.xcen, p.ycen, p.xin, p.yin, p.area_px, p.area_m2, p.stddis, p.h_max,
               p.h_mean, p.h_p50, p.h_p90, p.h_std, p.building_share, p.geometry
        FROM old_part AS p JOIN old_building AS b ON b.root_id = p.root_id
    """,
    "part_flat_region": """
        (part_id, region_id, run_id, overlap_m2, part_share, region_share)
        SELECT part_id, region_id, run_id, overlap_m2, part_share, region_share FROM old_part_flat_region
    """,
    "part_candidate": """
        (part_id, candidate_id, run_id, overlap_m2, part_share, candidate_share)
        SELECT part_id, candidate_id, run_id, overlap_m2, part_share, candidate_share FROM old_part_candidate
    """,
    "building_version": """
        (version_id, uid, valid_from, valid_to, source, survey_id, closed_by, building_id, state, storeys, h_max,
         h_mean, h_p50, h_p90, area_m2, volume_m3, parts, flat_share, area3d_share, adaptive_share, attributes,
         row_digest, geometry)
        SELECT version_id, uid, valid_from, valid_to, source, survey_id, closed_by, building_id, state, storeys, h_max,
               h_mean, h_p50, h_p90, area_m2, volume_m3, parts, flat_share, area3d_share, adaptive_share, attributes,
               row_digest, geometry
        FROM old_building_version
    """,
    "building_change": """
        (change_id, survey_id, kind, uid_before, uid_after, version_before, version_after, outline, height, parts,
         overlap_m2, iou, dh_m, darea_m2, note, row_digest)
        SELECT change_id, survey_id, kind, uid_before, uid_after, version_before, version_after, outline, height, parts,
               overlap_m2, iou, dh_m, darea_m2, note, row_digest
        FROM old_building_change
    """,
}
"""The columns of each table, and the query of their values."""

CONTENT: dict[str, tuple[str | None, str]] = {
    "scale": (None, "*scale:i threshold_px:i threshold_m2:f"),
    "part": (
        "MULTIPOLYGON",
        (
            "*part_id:i supid:i supscale:i root_id:i building_id:i scale:i hindex:i hzone:i speindex:i xo:f yo:f "
            "xcen:f ycen:f xin:f yin:f area_px:i area_m2:f stddis:f h_max:f h_mean:f h_p50:f h_p90:f h_std:f "
            "building_share:f"
        ),
    ),
    "spectral_class": (
        None,
        "*speindex:i label:s labelled_by:s source:s cells:i share:f ndvi:f brightness:f roughness_m:f height_m:f",
    ),
    "spectral_class_band": (None, "*speindex:i *band:s mean:f"),
    "rejection": ("POINT", "region_id:i method:s stage:s reason:s scale:i area_m2:f xcen:f ycen:f"),
    "building": (
        "MULTIPOLYGON",
        (
            "*building_id:i state:s probability:f storeys:i h_max:f h_mean:f h_p50:f h_p90:f area_m2:f volume_m3:f "
            "trees:i parts:i scales:i speindex:i building_share:f xcen:f ycen:f xin:f yin:f multiscale_share:f "
            "flat_share:f area3d_share:f adaptive_share:f"
        ),
    ),
    "flat_region": (
        "MULTIPOLYGON",
        (
            "*region_id:i zone:i lambda_low_m2:f lambda_m2:f gradient_sum:f mean_gradient:f area_m2:f perimeter_m:f "
            "compactness:f h_max:f h_mean:f h_p50:f h_p90:f h_std:f xcen:f ycen:f"
        ),
    ),
    "part_flat_region": (None, "*part_id:i *region_id:i overlap_m2:f part_share:f region_share:f"),
    "candidate_region": (
        "MULTIPOLYGON",
        (
            "*candidate_id:i method:s rule:s height_scale_m:f points:i area_m2:f perimeter:i mbr_m2:f rectangularity:f "
            "compactness:f linearity:f direction_1:f direction_2:f ndvi:f h_max:f h_mean:f h_p50:f h_p90:f h_std:f "
            "xcen:f ycen:f"
        ),
    ),
    "part_candidate": (None, "*part_id:i *candidate_id:i overlap_m2:f part_share:f candidate_share:f"),
    "flat_region_candidate": (None, "*region_id:i *candidate_id:i overlap_m2:f region_share:f candidate_share:f"),
}
"""The tables of a run's content: type of geometry, and columns with their kinds; a star is before those of the key."""

ADDED = {
    "part": ("building_id",),
    "building": ("probability", "multiscale_share", "trees", "building_share", "xcen", "ycen", "xin", "yin"),
}
"""The columns of the content that the baseline has not."""

FUSE = ("edge_cost", "edge_height_m", "piece_m2")
"""The parameters of the fusion that are still there."""


def upgrade() -> None:
    """Copy, drop, create, fill, and compute the digests again."""
    opts = op.get_context().opts
    hooks, srid = opts["hooks"], opts["srid"]
    baseline = op.get_context().script.get_revision(down_revision).module
    right = right_runs()
    drop_views(hooks)
    for table in MADE_ANEW:
        op.execute(f"CREATE TEMPORARY TABLE old_{table} AS SELECT * FROM {table}")  # noqa: S608  (our own names)
    for table in DROPPED:
        for statement in hooks.drop_geometry_ddl(table) if table in SPATIAL else ():
            op.execute(statement)
        op.drop_table(table)
    create_buildings(baseline)
    create_parts(baseline)
    one = ("part_id", "part", "part_share")
    baseline.create_links("part_flat_region", one, ("region_id", "flat_region", "region_share"))
    baseline.create_links("part_candidate", one, ("candidate_id", "candidate_region", "candidate_share"))
    create_versions(baseline)
    create_changes(baseline)
    for table in SPATIAL:
        baseline.run_all(hooks.geometry_ddl(table, "MULTIPOLYGON", srid))
    baseline.run_all([f"ALTER TABLE {table} ADD COLUMN row_digest BIGINT" for table in DIGESTED])
    for table in MADE_ANEW:
        fill(table)
    create_views(baseline, hooks)
    change_runs()
    settle_runs(right)


def fill(table: str) -> None:
    """Fill a table from the copies, and drop its own one.

    Raises
    ------
    DatabaseError
        When rows have no place: roots without a building, or buildings without a root.
    """
    from msbdb.errors import DatabaseError

    op.execute(f"INSERT INTO {table} {FILLED[table]}")
    held, kept = (count_rows(name) for name in (f"old_{table}", table))
    if held != kept:
        msg = (
            f"The database cannot be upgraded: {held - kept} of {held} rows of {table} refer to rows that are missing. "
            "Nothing was changed. Run 'msbdb db check' with the msbdb that wrote it, and build the survey again."
        )
        raise DatabaseError(msg)
    if table != "building":
        op.execute(f"DROP TABLE old_{table}")
    if table == "part":
        op.execute("DROP TABLE old_building")


def count_rows(table: str) -> int:
    """Return the number of rows of a table."""
    return op.get_bind().scalar(sa.select(sa.func.count()).select_from(sa.table(table)))


def drop_views(hooks: object) -> None:
    """Drop all views, and the function of PostGIS."""
    if op.get_bind().dialect.name == "postgresql":
        op.execute("DROP FUNCTION footprint_at(date)")
    op.execute("DROP VIEW roof_material_by_class")
    for view in VIEWS:
        for statement in hooks.drop_view_ddl(view):
            op.execute(statement)
        op.execute(f"DROP VIEW {view}")


def create_views(baseline: ModuleType, hooks: object) -> None:
    """Create all views, and the function of PostGIS."""
    for view, (key, base) in VIEWS.items():
        op.execute(f"CREATE VIEW {view} AS\n{text_of(baseline, view)}")
        baseline.run_all(hooks.view_ddl(view, key, base))
    op.execute(f"CREATE VIEW roof_material_by_class AS\n{text_of(baseline, 'roof_material_by_class')}")
    if op.get_bind().dialect.name == "postgresql":
        op.execute(text_of(baseline, "footprint_at"))


def text_of(baseline: ModuleType, name: str) -> str:
    """Return the statement of a view: its text of this migration, or that of the baseline."""
    path = TEXTS / revision / f"{name}.sql"
    if not path.is_file():
        return baseline.text_of(name)
    lines = path.read_text(encoding="utf-8").splitlines()
    return "\n".join(line for line in lines if not line.startswith("--")).strip().rstrip(";")


def create_buildings(baseline: ModuleType) -> None:
    """Create building, without a root of its own."""
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


def create_parts(baseline: ModuleType) -> None:
    """Create part, with its building."""
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


def create_versions(baseline: ModuleType) -> None:
    """Create building_version, with the probability."""
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
        *baseline.integers("storeys", nullable=True),
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


def create_changes(baseline: ModuleType) -> None:
    """Create building_change as it was."""
    table, check, refers = "building_change", baseline.check, baseline.refers
    sides = {
        "uid_before": "inventory_building.uid",
        "uid_after": "inventory_building.uid",
        "version_before": "building_version.version_id",
        "version_after": "building_version.version_id",
    }
    same = "(uid_before IS NULL) = (version_before IS NULL) AND (uid_after IS NULL) = (version_after IS NULL)"
    op.create_table(
        table,
        baseline.row_id("change_id"),
        *baseline.integers("survey_id"),
        *baseline.words("kind"),
        *baseline.integers(*sides, nullable=True),
        *baseline.flags("outline", "height", "parts"),
        *baseline.numbers("overlap_m2", "iou"),
        *baseline.numbers("dh_m", nullable=True),
        *baseline.numbers("darea_m2"),
        *baseline.words("note"),
        baseline.key(table, "change_id"),
        check(table, "change_id", "change_id > 0"),
        check(table, "kind", "kind IN ('unchanged', 'modified', 'new', 'demolished', 'merged', 'split')"),
        check(table, "uid", "uid_before IS NOT NULL OR uid_after IS NOT NULL"),
        check(table, "version", same),
        check(table, "overlap", "overlap_m2 >= 0 AND iou >= 0 AND iou <= 1"),
        refers(table, "survey_id", "survey.survey_id", cascade=False),
        *(refers(table, name, to, f"fk_building_change_{name}", cascade=False) for name, to in sides.items()),
    )
    baseline.create_indexes(table, ("survey_id", "kind"), *((name,) for name in sides))


def change_runs() -> None:
    """Drop the former fused footprints and their parameters; in these runs the multi-scale detector decided alone."""
    state = sa.table("run_state", sa.column("name"))
    op.execute(state.delete().where(state.c.name.in_(("together", "flat_firm"))))
    run = sa.table("run", sa.column("run_id"), sa.column("parameters", sa.JSON()))
    for run_id, parameters in op.get_bind().execute(sa.select(run.c.run_id, run.c.parameters)).all():
        known = {name: value for name, value in parameters.get("fuse", {}).items() if name in FUSE}
        known["votes"] = bool(parameters.get("fuse", {}).get("cells", False))
        changed = {**parameters, "fuse": known}
        op.execute(run.update().where(run.c.run_id == run_id).values(parameters=changed))


def right_runs() -> list[int]:
    """Return the runs whose content has the digest that was kept with it."""
    return [run_id for run_id, kept, found in run_digests(old=True) if kept == found]


def settle_runs(right: list[int]) -> None:
    """Write the digests of the upgraded content, of the runs that were right."""
    run = sa.table("run", sa.column("run_id"), sa.column("content_sha256"))
    for run_id, _, found in run_digests(old=False):
        if run_id in right:
            op.execute(run.update().where(run.c.run_id == run_id).values(content_sha256=found))


def run_digests(*, old: bool) -> list[tuple[int, str, str | None]]:
    """Return each run with its kept digest, and that of its rows; None where they cannot be read."""
    from msbdb.database.admin.contentchecks import UNREADABLE
    from msbdb.database.runs.reading import content_of

    connection = op.get_bind()
    query = "SELECT r.run_id, r.content_sha256, s.name FROM run AS r JOIN survey AS s ON s.survey_id = r.survey_id"
    runs = connection.execute(sa.text(query)).all()
    tables = content_tables(old=old)
    found = []
    for run_id, kept, survey in runs:
        try:
            digest = content_of(connection, survey, tables).digest()
        except UNREADABLE:
            digest = None
        found.append((run_id, kept, digest))
    return found


def content_tables(*, old: bool) -> list[object]:
    """Return the declarations of a run's content, of this schema or of the baseline."""
    from msbdb.tables import Column, Table

    kinds = {"i": "int64", "f": "float64", "s": "str"}
    tables = []
    for name, (geometry, words) in CONTENT.items():
        columns = [word.partition(":") for word in words.split()]
        if old:
            columns = [own for own in columns if own[0] not in ADDED.get(name, ())]
            columns[1:1] = [("root_id", ":", "i")] if name == "building" else []
        stored = tuple(
            Column(column.lstrip("*"), kinds[kind], "-", "", primary=column.startswith("*"))
            for column, _, kind in columns
        )
        tables.append(Table(name, "", stored, geometry=geometry))
    return tables

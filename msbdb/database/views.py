"""The views: one text for both dialects."""

from dataclasses import dataclass

from msbdb.database.inventory_views import BUILDING_HISTORY as HISTORY_SQL
from msbdb.database.inventory_views import FOOTPRINT_CURRENT as CURRENT_SQL
from msbdb.database.inventory_views import ROOF_MATERIAL_BY_CLASS as MATERIAL_SQL
from msbdb.tables import CONFIRMING_CLASS_SHARE, CONFIRMING_COVER

EXPLAINED_SHARE = 0.5
"""Share of a flat or candidate region from which the root parts on it explain it."""

# Sums of links are subqueries of a row, not joined tables of all rows: a view is asked for a window or a survey, and
# neither dialect takes such a question into a grouped join.

_REGION_EXPLAINED = """COALESCE((
         SELECT SUM(l.region_share) FROM part_flat_region AS l JOIN part AS root ON root.part_id = l.part_id
         WHERE l.region_id = f.region_id AND root.supid = 0), 0.0)"""

_CANDIDATE_EXPLAINED = """COALESCE((
         SELECT SUM(l.candidate_share) FROM part_candidate AS l JOIN part AS root ON root.part_id = l.part_id
         WHERE l.candidate_id = k.candidate_id AND root.supid = 0), 0.0)"""


@dataclass(frozen=True, slots=True)
class View:
    """A view: its key and geometry are those of a base table; one without geometry has neither base nor key.

    ``key`` is both the view's and the base table's key column, by which the base table's spatial index serves the view.
    A ``complete`` view has one row for every row of its base table, and so its extent.
    """

    name: str
    key: str
    base: str
    complete: bool
    doc: str
    sql: str


FOOTPRINT = View(
    "footprint",
    key="part_id",
    base="part",
    complete=False,
    doc="The footprints: the root parts, coarsest of their trees (V49), with the state of their building.",
    sql="""
SELECT p.part_id, s.name AS survey, r.method, b.state, p.scale, p.hindex, p.speindex, p.area_m2,
       p.h_max, p.h_mean, p.h_p50, p.h_p90, p.xin, p.yin, p.geometry
FROM part AS p
JOIN run AS r ON r.run_id = p.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
LEFT JOIN building AS b ON b.root_id = p.part_id
WHERE p.supid = 0
""".strip(),
)

PART_TREE = View(
    "part_tree",
    key="part_id",
    base="part",
    complete=True,
    doc="The parts as trees: the depth below the root, and the path of ids from the root down.",
    sql="""
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
""".strip(),
)

BUILDING_SUMMARY = View(
    "building_summary",
    key="building_id",
    base="building",
    complete=True,
    doc=(
        "One row a building for maps and tables: place, heights, volume, class, the shares that other extractors "
        "cover, and floor_area_m2, an estimate: each part counts its area once for every storey by which it rises "
        "above its father."
    ),
    sql="""
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
""".strip(),
)

PART_EVIDENCE = View(
    "part_evidence",
    key="part_id",
    base="part",
    complete=True,
    doc=(
        "The parts with what other extractors say of them: the share of each that flat regions, candidates of area3d "
        "and candidates of adaptive cover, and their numbers; null for an extractor that was not run."
    ),
    sql="""
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
""".strip(),
)

UNEXPLAINED_FLAT_REGION = View(
    "unexplained_flat_region",
    key="region_id",
    base="flat_region",
    complete=False,
    doc=(
        f"The flat regions that no part explains: root parts cover less than {EXPLAINED_SHARE} of them; "
        "explained_share is what they cover."
    ),
    sql=f"""
SELECT f.region_id, s.name AS survey, r.method, f.zone, f.lambda_low_m2, f.lambda_m2, f.gradient_sum, f.mean_gradient,
       f.area_m2, f.perimeter_m, f.compactness, f.h_max, f.h_mean, f.h_p50, f.h_p90, f.h_std, f.xcen, f.ycen,
       {_REGION_EXPLAINED} AS explained_share, f.geometry
FROM flat_region AS f
JOIN run AS r ON r.run_id = f.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
WHERE {_REGION_EXPLAINED} < {EXPLAINED_SHARE}
""".strip(),  # noqa: S608  (number and expression are ours)
)

CANDIDATE_EVIDENCE = View(
    "candidate_evidence",
    key="candidate_id",
    base="candidate_region",
    complete=True,
    doc=(
        "The candidate regions with what other extractors say of them: explained_share is what root parts cover, "
        "flat_share what flat regions cover; null for an extractor that was not run."
    ),
    sql=f"""
SELECT k.candidate_id, s.name AS survey, k.method, k.rule, k.height_scale_m, k.points, k.area_m2, k.rectangularity,
       k.compactness, k.linearity, k.ndvi, k.h_p50, k.h_p90, k.h_std, k.xcen, k.ycen,
       CASE WHEN ',' || r.method || ',' LIKE '%,multiscale,%' THEN {_CANDIDATE_EXPLAINED} END
         AS explained_share,
       CASE WHEN ',' || r.method || ',' LIKE '%,flatregions,%' THEN COALESCE((
         SELECT SUM(l.candidate_share) FROM flat_region_candidate AS l WHERE l.candidate_id = k.candidate_id), 0.0) END
         AS flat_share,
       k.geometry
FROM candidate_region AS k
JOIN run AS r ON r.run_id = k.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
""".strip(),  # noqa: S608  (the expression is ours)
)

UNEXPLAINED_CANDIDATE = View(
    "unexplained_candidate",
    key="candidate_id",
    base="candidate_region",
    complete=False,
    doc=(
        f"The candidate regions that no part explains: root parts cover less than {EXPLAINED_SHARE} of them; "
        "explained_share is what they cover."
    ),
    sql=f"""
SELECT k.candidate_id, s.name AS survey, k.method, k.rule, k.height_scale_m, k.points, k.area_m2, k.rectangularity,
       k.compactness, k.linearity, k.ndvi, k.h_max, k.h_mean, k.h_p50, k.h_p90, k.h_std, k.xcen, k.ycen,
       {_CANDIDATE_EXPLAINED} AS explained_share, k.geometry
FROM candidate_region AS k
JOIN run AS r ON r.run_id = k.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
WHERE {_CANDIDATE_EXPLAINED} < {EXPLAINED_SHARE}
""".strip(),  # noqa: S608  (number and expression are ours)
)

BUILDING_EVIDENCE = View(
    "building_evidence",
    key="building_id",
    base="building",
    complete=True,
    doc=(
        "The buildings with their witnesses: whether the classes speak for each (1 or 0), and how many of the other "
        f"extractors were heard and speak for it, covering at least {CONFIRMING_COVER} of it."
    ),
    sql=f"""
SELECT b.building_id, s.name AS survey, r.method, b.state, b.storeys, b.h_p90, b.area_m2, root.building_share,
       b.flat_share, b.area3d_share, b.adaptive_share,
       CASE WHEN root.building_share >= {CONFIRMING_CLASS_SHARE} THEN 1 ELSE 0 END AS classes_for,
       CASE WHEN b.flat_share IS NULL THEN 0 ELSE 1 END + CASE WHEN b.area3d_share IS NULL THEN 0 ELSE 1 END
         + CASE WHEN b.adaptive_share IS NULL THEN 0 ELSE 1 END AS extractors_heard,
       CASE WHEN b.flat_share >= {CONFIRMING_COVER} THEN 1 ELSE 0 END
         + CASE WHEN b.area3d_share >= {CONFIRMING_COVER} THEN 1 ELSE 0 END
         + CASE WHEN b.adaptive_share >= {CONFIRMING_COVER} THEN 1 ELSE 0 END AS extractors_for,
       b.geometry
FROM building AS b
JOIN run AS r ON r.run_id = b.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
JOIN part AS root ON root.part_id = b.root_id
""".strip(),  # noqa: S608  (the numbers are ours)
)

FOOTPRINT_CURRENT = View(
    "footprint_current",
    key="version_id",
    base="building_version",
    complete=False,
    doc=(
        "The inventory as it is now: the current version of each building, with the operators' states winning over "
        "those found (found_state)."
    ),
    sql=CURRENT_SQL,
)

BUILDING_HISTORY = View(
    "building_history",
    key="version_id",
    base="building_version",
    complete=True,
    doc="All versions of the inventory's buildings, with the change by which each began and ended.",
    sql=HISTORY_SQL,
)

ROOF_MATERIAL_BY_CLASS = View(
    "roof_material_by_class",
    key="",
    base="",
    complete=False,
    doc=(
        "Cross table of roof materials and classes (V53): how many samples lie on finest parts of each class, by "
        "survey; samples beside all parts are not counted."
    ),
    sql=MATERIAL_SQL,
)

VIEWS = (
    FOOTPRINT,
    PART_TREE,
    BUILDING_SUMMARY,
    PART_EVIDENCE,
    UNEXPLAINED_FLAT_REGION,
    CANDIDATE_EVIDENCE,
    UNEXPLAINED_CANDIDATE,
    BUILDING_EVIDENCE,
    FOOTPRINT_CURRENT,
    BUILDING_HISTORY,
)
"""The views with a geometry, which are layers of GIS clients."""

TABLE_VIEWS = (ROOF_MATERIAL_BY_CLASS,)
"""The views without one."""

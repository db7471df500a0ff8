"""The views: one text for both dialects."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class View:
    """A view with a geometry: its key and geometry are those of a base table.

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
        "One row a building for maps and tables: place, heights, volume, class, and floor_area_m2, an estimate: "
        "each part counts its area once for every storey by which it rises above its father."
    ),
    sql="""
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
""".strip(),
)

VIEWS = (FOOTPRINT, PART_TREE, BUILDING_SUMMARY)

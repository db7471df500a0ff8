-- The parts as trees: the depth below the root, and the path of ids from the root down.
WITH RECURSIVE tree (part_id, depth, path) AS (
  SELECT part_id, 0, CAST(part_id AS TEXT) FROM part WHERE supid = 0
  UNION ALL
  SELECT child.part_id, tree.depth + 1, tree.path || '/' || CAST(child.part_id AS TEXT)
  FROM tree JOIN part AS child ON child.father_id = tree.part_id
)
SELECT p.part_id, s.name AS survey, p.building_id, p.root_id, p.supid, p.supscale, p.scale, tree.depth, tree.path,
       p.hindex, p.speindex, p.area_m2, p.stddis, p.h_max, p.h_p90, p.outline_source, p.geometry
FROM tree
JOIN part AS p ON p.part_id = tree.part_id
JOIN run AS r ON r.run_id = p.run_id
JOIN survey AS s ON s.survey_id = r.survey_id;

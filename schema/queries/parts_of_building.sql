-- Which parts does a building have? Its trees, fathers before children, each part below its father.
WITH RECURSIVE param AS (  -- the values to edit
  SELECT
    CAST(NULL AS BIGINT) AS building_id  -- the building; NULL takes the one of most parts
), chosen AS (
  SELECT building_id FROM building
  WHERE building_id = COALESCE(
    (SELECT building_id FROM param), (SELECT building_id FROM building ORDER BY parts DESC, building_id LIMIT 1)
  )
), tree (part_id, depth, path) AS (
  SELECT part_id, 0, CAST(part_id AS TEXT) FROM part
  WHERE building_id = (SELECT building_id FROM chosen) AND supid = 0
  UNION ALL
  SELECT child.part_id, tree.depth + 1, tree.path || '/' || CAST(child.part_id AS TEXT)
  FROM tree JOIN part AS child ON child.father_id = tree.part_id
)
SELECT tree.depth, p.part_id, p.supid, p.scale, s.threshold_m2, p.hindex, p.h_max, p.area_m2, p.speindex, tree.path
FROM tree
JOIN part AS p ON p.part_id = tree.part_id
JOIN scale AS s ON s.run_id = p.run_id AND s.scale = p.scale
ORDER BY tree.depth, tree.path;

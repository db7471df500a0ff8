-- Which buildings enclose courtyards, how many, and how large are they?
--
-- :min_area_m2 = 10  smallest courtyard that counts, square metres
WITH RECURSIVE polygon (building_id, number, outline) AS (
  SELECT building_id, 1, ST_GeometryN(geometry, 1) FROM building
  UNION ALL
  SELECT b.building_id, p.number + 1, ST_GeometryN(b.geometry, p.number + 1)
  FROM polygon AS p JOIN building AS b ON b.building_id = p.building_id
  WHERE p.number < ST_NumGeometries(b.geometry)
), ring (building_id, number, hole, outline) AS (
  SELECT building_id, number, 1, outline FROM polygon WHERE ST_NumInteriorRing(outline) >= 1
  UNION ALL
  SELECT building_id, number, hole + 1, outline FROM ring WHERE hole < ST_NumInteriorRing(outline)
), courtyard AS (
  SELECT building_id, ST_Area(ST_MakePolygon(ST_InteriorRingN(outline, hole))) AS area_m2 FROM ring
)
SELECT b.building_id, b.survey, b.storeys, b.area_m2, COUNT(*) AS courtyards, SUM(c.area_m2) AS courtyard_m2
FROM courtyard AS c JOIN building_summary AS b ON b.building_id = c.building_id
WHERE c.area_m2 >= :min_area_m2
GROUP BY b.building_id, b.survey, b.storeys, b.area_m2
ORDER BY courtyard_m2 DESC, b.building_id;

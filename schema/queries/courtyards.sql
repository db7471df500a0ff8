-- Which buildings enclose courtyards, how many, and how large are they?
WITH RECURSIVE param AS (  -- the values to edit
  SELECT
    CAST(10 AS DOUBLE PRECISION) AS min_area_m2,  -- smallest courtyard that counts, square metres
    CAST(NULL AS TEXT) AS survey  -- name of a survey; NULL takes all
), chosen AS MATERIALIZED (
  SELECT b.building_id, s.name AS survey, b.storeys, b.area_m2, b.geometry, ST_NumGeometries(b.geometry) AS polygons
  FROM building AS b JOIN run AS r ON r.run_id = b.run_id JOIN survey AS s ON s.survey_id = r.survey_id
  WHERE ((SELECT survey FROM param) IS NULL OR s.name = (SELECT survey FROM param))
    AND ST_NRings(b.geometry) > ST_NumGeometries(b.geometry)
), polygon_number (n) AS (
  SELECT 1 UNION ALL SELECT n + 1 FROM polygon_number WHERE n < (SELECT MAX(polygons) FROM chosen)
), polygon AS MATERIALIZED (
  SELECT c.building_id, ST_GeometryN(c.geometry, k.n) AS outline
  FROM chosen AS c JOIN polygon_number AS k ON k.n <= c.polygons
), holed AS MATERIALIZED (
  SELECT building_id, outline, ST_NumInteriorRing(outline) AS holes FROM polygon
), hole_number (n) AS (
  SELECT 1 UNION ALL SELECT n + 1 FROM hole_number WHERE n < (SELECT MAX(holes) FROM holed)
), courtyard AS (
  SELECT p.building_id, ST_Area(ST_MakePolygon(ST_InteriorRingN(p.outline, k.n))) AS area_m2
  FROM holed AS p JOIN hole_number AS k ON k.n <= p.holes
)
SELECT b.building_id, b.survey, b.storeys, b.area_m2, COUNT(*) AS courtyards, SUM(c.area_m2) AS courtyard_m2
FROM courtyard AS c JOIN chosen AS b ON b.building_id = c.building_id
WHERE c.area_m2 >= (SELECT min_area_m2 FROM param)
GROUP BY b.building_id, b.survey, b.storeys, b.area_m2
ORDER BY courtyard_m2 DESC, b.building_id;

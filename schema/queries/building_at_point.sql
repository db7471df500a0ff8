-- Which building stands at a point, and what is known of it? The point is looked for in the outlines themselves.
--
-- :easting = null  easting of the point, metres; null takes a point on the building of most parts
-- :northing = null  northing of the point, metres; null takes a point on the building of most parts
WITH richest AS (
  SELECT xin, yin FROM building_summary ORDER BY parts DESC, building_id LIMIT 1
), place AS (
  SELECT COALESCE(CAST(:easting AS DOUBLE PRECISION), xin) AS easting,
         COALESCE(CAST(:northing AS DOUBLE PRECISION), yin) AS northing
  FROM richest
)
SELECT b.building_id, b.survey, b.state, b.storeys, b.h_max, b.area_m2, b.volume_m3, b.parts, b.class_label
FROM building_summary AS b CROSS JOIN place AS p
WHERE ST_Intersects(
  b.geometry,
  ST_GeomFromText('POINT(' || CAST(p.easting AS TEXT) || ' ' || CAST(p.northing AS TEXT) || ')', ST_SRID(b.geometry))
)
ORDER BY b.building_id;

-- Which buildings of at least so many storeys stand within a distance of a point, the nearest first?
--
-- :storeys = 5  fewest storeys
-- :easting = null  easting of the point, metres; null takes the middle of all buildings
-- :northing = null  northing of the point, metres; null takes the middle of all buildings
-- :radius_m = 1000  distance, metres
WITH place AS (
  SELECT COALESCE(CAST(:easting AS DOUBLE PRECISION), (SELECT AVG(xcen) FROM building_summary)) AS easting,
         COALESCE(CAST(:northing AS DOUBLE PRECISION), (SELECT AVG(ycen) FROM building_summary)) AS northing
), near AS (
  SELECT b.building_id, b.survey, b.storeys, b.h_max, b.area_m2,
         SQRT((b.xcen - p.easting) * (b.xcen - p.easting) + (b.ycen - p.northing) * (b.ycen - p.northing)) AS distance_m
  FROM building_summary AS b CROSS JOIN place AS p
  WHERE b.storeys >= :storeys
)
SELECT * FROM near WHERE distance_m <= :radius_m ORDER BY distance_m, building_id;

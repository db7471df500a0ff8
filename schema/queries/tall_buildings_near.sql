-- Which buildings of at least so many storeys, towers on podiums among them, are within a distance of a point, the nearest outline first?
--
-- :storeys = 5  fewest storeys
-- :easting = null  easting of the point, metres; null takes the middle of all buildings
-- :northing = null  northing of the point, metres; null takes the middle of all buildings
-- :radius_m = 1000  distance, metres
WITH place AS (
  SELECT COALESCE(CAST(:easting AS DOUBLE PRECISION), (SELECT AVG(xcen) FROM building_summary)) AS easting,
         COALESCE(CAST(:northing AS DOUBLE PRECISION), (SELECT AVG(ycen) FROM building_summary)) AS northing
), spot AS (
  SELECT ST_GeomFromText('POINT(' || CAST(easting AS TEXT) || ' ' || CAST(northing AS TEXT) || ')',
                         (SELECT ST_SRID(geometry) FROM building LIMIT 1)) AS point
  FROM place
), near AS MATERIALIZED (
  SELECT b.building_id, b.survey, b.storeys, COALESCE(b.storeys_top, b.storeys) AS storeys_top, b.ridge, b.h_max, b.area_m2, ST_Distance(b.geometry, spot.point) AS distance_m
  FROM spot
  JOIN building_summary AS b ON ST_Intersects(b.geometry, ST_Expand(spot.point, CAST(:radius_m AS DOUBLE PRECISION)))
  WHERE COALESCE(b.storeys_top, b.storeys) >= :storeys
)
SELECT * FROM near WHERE distance_m <= :radius_m ORDER BY distance_m, building_id;

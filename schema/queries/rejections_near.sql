-- What was rejected near a point: regions that could have been a building, with the reason, the nearest centroid first?
--
-- :easting = null  easting of the point, metres; null takes the middle of the largest rejected region
-- :northing = null  northing of the point, metres; null takes the middle of the largest rejected region
-- :radius_m = 50  distance, metres
WITH place AS (
  SELECT COALESCE(CAST(:easting AS DOUBLE PRECISION), (
           SELECT xcen FROM rejection ORDER BY area_m2 DESC, rejection_id LIMIT 1
         )) AS easting,
         COALESCE(CAST(:northing AS DOUBLE PRECISION), (
           SELECT ycen FROM rejection ORDER BY area_m2 DESC, rejection_id LIMIT 1
         )) AS northing
), spot AS (
  SELECT ST_GeomFromText('POINT(' || CAST(easting AS TEXT) || ' ' || CAST(northing AS TEXT) || ')',
                         (SELECT ST_SRID(geometry) FROM rejection LIMIT 1)) AS point
  FROM place
), near AS MATERIALIZED (
  SELECT s.name AS survey, j.method, j.stage, j.reason, j.area_m2, j.xcen, j.ycen, j.rejection_id,
         ST_Distance(j.geometry, spot.point) AS distance_m
  FROM spot
  JOIN rejection AS j ON ST_Intersects(j.geometry, ST_Expand(spot.point, CAST(:radius_m AS DOUBLE PRECISION)))
  JOIN run AS r ON r.run_id = j.run_id
  JOIN survey AS s ON s.survey_id = r.survey_id
)
SELECT survey, method, stage, reason, area_m2, xcen, ycen, distance_m
FROM near WHERE distance_m <= :radius_m ORDER BY distance_m, method, stage, reason, rejection_id;

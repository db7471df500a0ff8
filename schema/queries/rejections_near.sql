-- What was rejected near a point: regions that could have been a building, with the reason, the nearest centroid first?
WITH param AS (  -- the values to edit
  SELECT
    CAST(NULL AS DOUBLE PRECISION) AS easting,  -- easting, metres; NULL takes the middle of the largest rejection
    CAST(NULL AS DOUBLE PRECISION) AS northing,  -- northing, metres; NULL takes the middle of the largest rejection
    CAST(50 AS DOUBLE PRECISION) AS radius_m  -- distance, metres
), place AS (
  SELECT COALESCE((SELECT easting FROM param), (
           SELECT xcen FROM rejection ORDER BY area_m2 DESC, rejection_id LIMIT 1
         )) AS easting,
         COALESCE((SELECT northing FROM param), (
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
  JOIN rejection AS j ON ST_Intersects(j.geometry, ST_Expand(spot.point, (SELECT radius_m FROM param)))
  JOIN run AS r ON r.run_id = j.run_id
  JOIN survey AS s ON s.survey_id = r.survey_id
)
SELECT survey, method, stage, reason, area_m2, xcen, ycen, distance_m
FROM near WHERE distance_m <= (SELECT radius_m FROM param) ORDER BY distance_m, method, stage, reason, rejection_id;

-- Which buildings of at least so many storeys, towers on podiums among them, are within a distance of a point, the
-- nearest outline first?
WITH param AS (  -- the values to edit
  SELECT
    CAST(5 AS INTEGER) AS storeys,  -- fewest storeys
    CAST(NULL AS DOUBLE PRECISION) AS easting,  -- easting, metres; NULL takes the middle of all buildings
    CAST(NULL AS DOUBLE PRECISION) AS northing,  -- northing, metres; NULL takes the middle of all buildings
    CAST(1000 AS DOUBLE PRECISION) AS radius_m  -- distance, metres
), place AS (
  SELECT COALESCE((SELECT easting FROM param), (SELECT AVG(xcen) FROM building_summary)) AS easting,
         COALESCE((SELECT northing FROM param), (SELECT AVG(ycen) FROM building_summary)) AS northing
), spot AS (
  SELECT ST_GeomFromText('POINT(' || CAST(easting AS TEXT) || ' ' || CAST(northing AS TEXT) || ')',
                         (SELECT ST_SRID(geometry) FROM building LIMIT 1)) AS point
  FROM place
), near AS MATERIALIZED (
  SELECT b.building_id, b.survey, b.storeys, COALESCE(b.storeys_top, b.storeys) AS storeys_top,
         b.ridge, b.h_max, b.area_m2, ST_Distance(b.geometry, spot.point) AS distance_m
  FROM spot
  JOIN building_summary AS b ON ST_Intersects(b.geometry, ST_Expand(spot.point, (SELECT radius_m FROM param)))
  WHERE COALESCE(b.storeys_top, b.storeys) >= (SELECT storeys FROM param)
)
SELECT * FROM near WHERE distance_m <= (SELECT radius_m FROM param) ORDER BY distance_m, building_id;

-- Which building is at a point, and what are its attributes? The point must be inside the outline.
WITH param AS (  -- the values to edit
  SELECT
    CAST(NULL AS DOUBLE PRECISION) AS easting,  -- easting, metres; NULL takes a point on the building of most parts
    CAST(NULL AS DOUBLE PRECISION) AS northing  -- northing, metres; NULL takes a point on the building of most parts
), place AS (
  SELECT COALESCE((SELECT easting FROM param), (
           SELECT xin FROM building ORDER BY parts DESC, building_id LIMIT 1
         )) AS easting,
         COALESCE((SELECT northing FROM param), (
           SELECT yin FROM building ORDER BY parts DESC, building_id LIMIT 1
         )) AS northing
), spot AS (
  SELECT ST_GeomFromText('POINT(' || CAST(easting AS TEXT) || ' ' || CAST(northing AS TEXT) || ')',
                         (SELECT ST_SRID(geometry) FROM building LIMIT 1)) AS point
  FROM place
)
SELECT b.building_id, b.survey, b.state, b.probability, b.storeys, b.z_ground, b.eaves, b.ridge, b.h_max,
       b.area_m2, b.volume_m3, b.trees, b.parts, b.class_label
FROM spot JOIN building_summary AS b ON ST_Intersects(b.geometry, spot.point)
ORDER BY b.building_id;

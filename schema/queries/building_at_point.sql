-- Which building is at a point, and what are its attributes? The point must be inside the outline.
--
-- :easting = null  easting of the point, metres; null takes a point on the building of most parts
-- :northing = null  northing of the point, metres; null takes a point on the building of most parts
WITH place AS (
  SELECT COALESCE(CAST(:easting AS DOUBLE PRECISION), (
           SELECT xin FROM building ORDER BY parts DESC, building_id LIMIT 1
         )) AS easting,
         COALESCE(CAST(:northing AS DOUBLE PRECISION), (
           SELECT yin FROM building ORDER BY parts DESC, building_id LIMIT 1
         )) AS northing
), spot AS (
  SELECT ST_GeomFromText('POINT(' || CAST(easting AS TEXT) || ' ' || CAST(northing AS TEXT) || ')',
                         (SELECT ST_SRID(geometry) FROM building LIMIT 1)) AS point
  FROM place
)
SELECT b.building_id, b.survey, b.state, b.probability, b.storeys, b.z_ground, b.eaves, b.ridge, b.h_max, b.area_m2, b.volume_m3, b.trees, b.parts, b.class_label
FROM spot JOIN building_summary AS b ON ST_Intersects(b.geometry, spot.point)
ORDER BY b.building_id;

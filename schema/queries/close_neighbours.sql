-- Which buildings are within a distance of one building, from outline to outline, the nearest first?
--
-- :building_id = null  the building; null takes the one of most parts
-- :gap_m = 25  distance, metres
WITH near AS MATERIALIZED (
  SELECT b.building_id, b.survey, b.storeys, b.h_max, ST_Distance(a.geometry, b.geometry) AS distance_m
  FROM building AS a
  JOIN building_summary AS b ON ST_Intersects(b.geometry, ST_Expand(a.geometry, CAST(:gap_m AS DOUBLE PRECISION)))
  WHERE a.building_id = COALESCE(
          CAST(:building_id AS BIGINT), (SELECT building_id FROM building ORDER BY parts DESC, building_id LIMIT 1)
        )
    AND b.building_id <> a.building_id
)
SELECT * FROM near WHERE distance_m <= :gap_m ORDER BY distance_m, building_id;

-- Which buildings are within a distance of one building, from outline to outline, the nearest first?
WITH param AS (  -- the values to edit
  SELECT
    CAST(NULL AS BIGINT) AS building_id,  -- the building; NULL takes the one of most parts
    CAST(25 AS DOUBLE PRECISION) AS gap_m  -- distance, metres
), near AS MATERIALIZED (
  SELECT b.building_id, b.survey, b.storeys, b.h_max, ST_Distance(a.geometry, b.geometry) AS distance_m
  FROM building AS a
  JOIN building_summary AS b ON ST_Intersects(b.geometry, ST_Expand(a.geometry, (SELECT gap_m FROM param)))
  WHERE a.building_id = COALESCE(
          (SELECT building_id FROM param), (SELECT building_id FROM building ORDER BY parts DESC, building_id LIMIT 1)
        )
    AND b.building_id <> a.building_id
)
SELECT * FROM near WHERE distance_m <= (SELECT gap_m FROM param) ORDER BY distance_m, building_id;

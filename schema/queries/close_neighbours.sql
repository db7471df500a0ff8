-- Which buildings stand within a distance of one building, outline to outline, the nearest first?
--
-- :building_id = null  the building; null takes the one of most parts
-- :gap_m = 25  distance, metres
SELECT b.building_id, b.survey, b.storeys, b.h_max, ST_Distance(a.geometry, b.geometry) AS distance_m
FROM building AS a
JOIN building_summary AS b ON b.building_id <> a.building_id
WHERE a.building_id = COALESCE(
        CAST(:building_id AS BIGINT), (SELECT building_id FROM building ORDER BY parts DESC, building_id LIMIT 1)
      )
  AND ST_Distance(a.geometry, b.geometry) <= :gap_m
ORDER BY distance_m, b.building_id;

-- Which buildings have no parts on finer scales: large but plain roofs?
--
-- :min_area_m2 = 50  smallest building that counts, square metres
-- :survey = null  name of a survey; null takes all
SELECT f.building_id, f.survey, f.state, f.storeys, f.trees, f.area_m2, f.h_max
FROM footprint AS f
WHERE f.area_m2 >= :min_area_m2 AND (CAST(:survey AS TEXT) IS NULL OR f.survey = :survey)
  AND f.parts = f.trees
ORDER BY f.area_m2 DESC, f.building_id;

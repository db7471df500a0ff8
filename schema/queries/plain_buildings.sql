-- Which footprints have no parts on finer scales: large but plain roofs?
--
-- :min_area_m2 = 50  smallest footprint that counts, square metres
-- :survey = null  name of a survey; null takes all
SELECT f.part_id, f.survey, f.state, f.scale, f.hindex, f.area_m2, f.h_max
FROM footprint AS f
WHERE f.area_m2 >= :min_area_m2 AND (CAST(:survey AS TEXT) IS NULL OR f.survey = :survey)
  AND NOT EXISTS (SELECT 1 FROM part AS child WHERE child.father_id = f.part_id)
ORDER BY f.area_m2 DESC, f.part_id;

-- Which are the tallest buildings?
--
-- :count = 10  how many to list
-- :survey = null  name of a survey; null takes all
SELECT building_id, survey, storeys, h_max, h_p90, area_m2, class_label, xcen, ycen
FROM building_summary
WHERE (CAST(:survey AS TEXT) IS NULL OR survey = :survey)
ORDER BY h_max DESC, building_id
LIMIT :count;

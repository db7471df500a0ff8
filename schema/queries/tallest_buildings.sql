-- Which are the tallest buildings, by their ridge? Those of older runs, which have none, by their largest height.
--
-- :count = 10  how many to list
-- :survey = null  name of a survey; null takes all
SELECT building_id, survey, storeys, storeys_top, eaves, ridge, z_ridge, h_max, h_p90, area_m2, class_label, xcen, ycen
FROM building_summary
WHERE (CAST(:survey AS TEXT) IS NULL OR survey = :survey)
ORDER BY COALESCE(ridge, h_max) DESC, building_id
LIMIT :count;

-- Which buildings have no flat region on their footprint, or almost none?
--
-- :share = 0  largest share of the footprint that flat regions may cover
-- :survey = null  name of a survey; null takes all
SELECT building_id, survey, state, flat_share, storeys, h_p90, area_m2, class_label
FROM building_summary
WHERE flat_share <= :share AND (CAST(:survey AS TEXT) IS NULL OR survey = :survey)
ORDER BY area_m2 DESC, building_id;

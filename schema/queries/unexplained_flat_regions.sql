-- Which flat regions does no part explain, the largest first?
--
-- :min_area_m2 = 50  smallest region that counts, square metres
-- :survey = null  name of a survey; null takes all
SELECT region_id, survey, zone, area_m2, compactness, h_p50, explained_share, xcen, ycen
FROM unexplained_flat_region
WHERE area_m2 >= :min_area_m2 AND (CAST(:survey AS TEXT) IS NULL OR survey = :survey)
ORDER BY area_m2 DESC, region_id;

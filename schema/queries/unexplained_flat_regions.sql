-- Which flat regions does no part explain, the largest first?
--
-- :min_area_m2 = 50  smallest region that counts, square metres
SELECT region_id, survey, zone, area_m2, compactness, h_p50, explained_share, xcen, ycen
FROM unexplained_flat_region
WHERE area_m2 >= :min_area_m2
ORDER BY area_m2 DESC, region_id;

-- Which are the tallest buildings?
--
-- :count = 10  how many to list
SELECT building_id, survey, storeys, h_max, h_p90, area_m2, class_label, xcen, ycen
FROM building_summary
ORDER BY h_max DESC, building_id
LIMIT :count;

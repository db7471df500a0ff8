-- Which are the tallest buildings, by their ridge? Those of older runs, which have none, by their largest height.
WITH param AS (  -- the values to edit
  SELECT
    CAST(10 AS INTEGER) AS count,  -- how many to list
    CAST(NULL AS TEXT) AS survey  -- name of a survey; NULL takes all
)
SELECT building_id, survey, storeys, storeys_top, eaves, ridge, z_ridge, h_max, h_p90, area_m2, class_label, xcen, ycen
FROM building_summary
WHERE ((SELECT survey FROM param) IS NULL OR survey = (SELECT survey FROM param))
ORDER BY COALESCE(ridge, h_max) DESC, building_id
LIMIT (SELECT count FROM param);

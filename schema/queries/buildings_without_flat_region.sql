-- Which buildings have no flat region on their footprint, or almost none?
WITH param AS (  -- the values to edit
  SELECT
    CAST(0 AS DOUBLE PRECISION) AS share,  -- largest share of the footprint that flat regions may cover
    CAST(NULL AS TEXT) AS survey  -- name of a survey; NULL takes all
)
SELECT building_id, survey, state, flat_share, storeys, h_p90, area_m2, class_label
FROM building_summary
WHERE flat_share <= (SELECT share FROM param)
  AND ((SELECT survey FROM param) IS NULL OR survey = (SELECT survey FROM param))
ORDER BY area_m2 DESC, building_id;

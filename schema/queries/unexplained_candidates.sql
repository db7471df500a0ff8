-- Which candidate regions does no part explain, the largest first?
WITH param AS (  -- the values to edit
  SELECT
    CAST(50 AS DOUBLE PRECISION) AS min_area_m2,  -- smallest region that counts, square metres
    CAST(NULL AS TEXT) AS survey  -- name of a survey; NULL takes all
)
SELECT candidate_id, survey, method, rule, area_m2, rectangularity, h_p50, explained_share, xcen, ycen
FROM unexplained_candidate
WHERE area_m2 >= (SELECT min_area_m2 FROM param)
  AND ((SELECT survey FROM param) IS NULL OR survey = (SELECT survey FROM param))
ORDER BY area_m2 DESC, candidate_id;

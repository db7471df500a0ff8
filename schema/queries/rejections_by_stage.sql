-- Which regions were dropped: number and area by detector, stage and reason, and how many are too small for a row?
WITH param AS (  -- the values to edit
  SELECT
    CAST(NULL AS TEXT) AS survey  -- name of a survey; NULL takes all
)
SELECT s.name AS survey, c.method, c.stage, c.reason, c.regions, c.area_m2, c.small, c.small_m2
FROM rejection_count AS c
JOIN run AS r ON r.run_id = c.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
WHERE ((SELECT survey FROM param) IS NULL OR s.name = (SELECT survey FROM param))
ORDER BY c.regions DESC, survey, c.method, c.number;

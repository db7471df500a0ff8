-- How many buildings do the classes confirm, and how many of the other detectors that were run?
WITH param AS (  -- the values to edit
  SELECT
    CAST(NULL AS TEXT) AS survey  -- name of a survey; NULL takes all
)
SELECT survey, state, classes_for, extractors_heard, extractors_for, COUNT(*) AS buildings, SUM(area_m2) AS area_m2
FROM building_evidence
WHERE ((SELECT survey FROM param) IS NULL OR survey = (SELECT survey FROM param))
GROUP BY survey, state, classes_for, extractors_heard, extractors_for
ORDER BY survey, state, classes_for, extractors_heard, extractors_for;

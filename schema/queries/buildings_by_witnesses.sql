-- How many buildings do the classes confirm, and how many of the other detectors that were run?
--
-- :survey = null  name of a survey; null takes all
SELECT survey, state, classes_for, extractors_heard, extractors_for, COUNT(*) AS buildings, SUM(area_m2) AS area_m2
FROM building_evidence
WHERE (CAST(:survey AS TEXT) IS NULL OR survey = :survey)
GROUP BY survey, state, classes_for, extractors_heard, extractors_for
ORDER BY survey, state, classes_for, extractors_heard, extractors_for;

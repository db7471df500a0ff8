-- Which regions were dropped: number and area by detector, stage and reason?
--
-- :survey = null  name of a survey; null takes all
SELECT s.name AS survey, j.method, j.stage, j.reason,
       COUNT(*) AS regions, SUM(j.area_m2) AS area_m2, MAX(j.area_m2) AS largest_m2
FROM rejection AS j
JOIN run AS r ON r.run_id = j.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
WHERE (CAST(:survey AS TEXT) IS NULL OR s.name = :survey)
GROUP BY s.name, j.method, j.stage, j.reason
ORDER BY regions DESC, survey, j.method, j.stage, j.reason;

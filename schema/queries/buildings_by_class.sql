-- How many buildings have each roof class, and how do the classes differ in size, height and colour?
--
-- :survey = null  name of a survey; null takes all
SELECT s.name AS survey, b.speindex, c.label, c.labelled_by, c.brightness, c.ndvi,
       COUNT(*) AS buildings, SUM(b.area_m2) AS area_m2, AVG(b.storeys * 1.0) AS mean_storeys
FROM building AS b
JOIN run AS r ON r.run_id = b.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
LEFT JOIN spectral_class AS c ON c.run_id = b.run_id AND c.speindex = b.class_id
WHERE (CAST(:survey AS TEXT) IS NULL OR s.name = :survey)
GROUP BY s.name, b.speindex, c.label, c.labelled_by, c.brightness, c.ndvi
ORDER BY survey, b.speindex;

-- How many buildings have each roof class, and how do the classes differ in size, height and colour?
WITH param AS (  -- the values to edit
  SELECT
    CAST(NULL AS TEXT) AS survey  -- name of a survey; NULL takes all
)
SELECT s.name AS survey, b.speindex, c.label, c.labelled_by, c.brightness, c.ndvi,
       COUNT(*) AS buildings, SUM(b.area_m2) AS area_m2, AVG(b.storeys * 1.0) AS mean_storeys
FROM building AS b
JOIN run AS r ON r.run_id = b.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
LEFT JOIN spectral_class AS c ON c.run_id = b.run_id AND c.speindex = b.class_id
WHERE ((SELECT survey FROM param) IS NULL OR s.name = (SELECT survey FROM param))
GROUP BY s.name, b.speindex, c.label, c.labelled_by, c.brightness, c.ndvi
ORDER BY survey, b.speindex;

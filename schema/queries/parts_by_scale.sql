-- How many parts does each scale have, how many of them are roots, and how large are they?
WITH param AS (  -- the values to edit
  SELECT
    CAST(NULL AS TEXT) AS survey  -- name of a survey; NULL takes all
)
SELECT s.name AS survey, c.scale, c.threshold_m2, COUNT(p.part_id) AS parts,
       COALESCE(SUM(CASE WHEN p.supid = 0 THEN 1 ELSE 0 END), 0) AS roots,
       AVG(p.area_m2) AS mean_area_m2, AVG(p.h_p90) AS mean_height_m
FROM scale AS c
JOIN run AS r ON r.run_id = c.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
LEFT JOIN part AS p ON p.run_id = c.run_id AND p.scale = c.scale
WHERE ((SELECT survey FROM param) IS NULL OR s.name = (SELECT survey FROM param))
GROUP BY s.name, c.scale, c.threshold_m2
ORDER BY survey, c.scale;

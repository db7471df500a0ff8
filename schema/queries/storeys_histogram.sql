-- How many buildings have one storey, two storeys, and so on, and how much ground do they cover? Doubtful are those whose
-- eaves fit another number, too.
WITH param AS (  -- the values to edit
  SELECT
    CAST(NULL AS TEXT) AS survey  -- name of a survey; NULL takes all
)
SELECT survey, storeys, COUNT(*) AS buildings, SUM(area_m2) AS area_m2,
       SUM(CASE WHEN storeys_min < storeys_max THEN 1 ELSE 0 END) AS doubtful
FROM building_summary
WHERE ((SELECT survey FROM param) IS NULL OR survey = (SELECT survey FROM param))
GROUP BY survey, storeys
ORDER BY survey, storeys;

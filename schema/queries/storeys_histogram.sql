-- How many buildings have one storey, two storeys, and so on, and how much ground do they cover? Doubtful are those whose
-- eaves fit another number, too.
--
-- :survey = null  name of a survey; null takes all
SELECT survey, storeys, COUNT(*) AS buildings, SUM(area_m2) AS area_m2,
       SUM(CASE WHEN storeys_min < storeys_max THEN 1 ELSE 0 END) AS doubtful
FROM building_summary
WHERE (CAST(:survey AS TEXT) IS NULL OR survey = :survey)
GROUP BY survey, storeys
ORDER BY survey, storeys;

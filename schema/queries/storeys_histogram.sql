-- How many buildings have one storey, two storeys, and so on, and how much ground do they cover?
SELECT survey, storeys, COUNT(*) AS buildings, SUM(area_m2) AS area_m2
FROM building_summary
GROUP BY survey, storeys
ORDER BY survey, storeys;

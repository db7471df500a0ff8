-- How many parts of each scale does a flat region confirm, and which share of their area is on flat regions?
--
-- :share = 0.5  smallest share of a part that flat regions must cover
-- :survey = null  name of a survey; null takes all
WITH found AS MATERIALIZED (
  SELECT survey, scale, area_m2, flat_share
  FROM part_evidence
  WHERE (CAST(:survey AS TEXT) IS NULL OR survey = :survey)
)
SELECT survey, scale, COUNT(*) AS parts, SUM(CASE WHEN flat_share >= :share THEN 1 ELSE 0 END) AS confirmed,
       SUM(flat_share * area_m2) / SUM(area_m2) AS flat_share
FROM found
WHERE flat_share IS NOT NULL
GROUP BY survey, scale
ORDER BY survey, scale;

-- How many candidate regions did each detector on the points accept by each rule, and how many does no part explain?
--
-- :share = 0.5  smallest share of a region from which root parts explain it
-- :survey = null  name of a survey; null takes all
WITH found AS MATERIALIZED (
  SELECT survey, method, rule, area_m2, explained_share
  FROM candidate_evidence
  WHERE (CAST(:survey AS TEXT) IS NULL OR survey = :survey)
)
SELECT survey, method, rule, COUNT(*) AS regions, SUM(area_m2) AS area_m2,
       SUM(CASE WHEN explained_share < :share THEN 1 ELSE 0 END) AS unexplained
FROM found
GROUP BY survey, method, rule
ORDER BY survey, method, rule;

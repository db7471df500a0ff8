-- How many candidate regions did each detector on the points accept by each rule, and how many does no part explain?
WITH param AS (  -- the values to edit
  SELECT
    CAST(0.5 AS DOUBLE PRECISION) AS share,  -- smallest share of a region from which root parts explain it
    CAST(NULL AS TEXT) AS survey  -- name of a survey; NULL takes all
), found AS MATERIALIZED (
  SELECT survey, method, rule, area_m2, explained_share
  FROM candidate_evidence
  WHERE ((SELECT survey FROM param) IS NULL OR survey = (SELECT survey FROM param))
)
SELECT survey, method, rule, COUNT(*) AS regions, SUM(area_m2) AS area_m2,
       SUM(CASE WHEN explained_share < (SELECT share FROM param) THEN 1 ELSE 0 END) AS unexplained
FROM found
GROUP BY survey, method, rule
ORDER BY survey, method, rule;

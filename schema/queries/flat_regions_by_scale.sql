-- How many parts of each scale does a flat region confirm, and which share of their area is on flat regions?
WITH param AS (  -- the values to edit
  SELECT
    CAST(0.5 AS DOUBLE PRECISION) AS share,  -- smallest share of a part that flat regions must cover
    CAST(NULL AS TEXT) AS survey  -- name of a survey; NULL takes all
), found AS MATERIALIZED (
  SELECT survey, scale, area_m2, flat_share
  FROM part_evidence
  WHERE ((SELECT survey FROM param) IS NULL OR survey = (SELECT survey FROM param))
)
SELECT survey, scale, COUNT(*) AS parts,
       SUM(CASE WHEN flat_share >= (SELECT share FROM param) THEN 1 ELSE 0 END) AS confirmed,
       SUM(flat_share * area_m2) / SUM(area_m2) AS flat_share
FROM found
WHERE flat_share IS NOT NULL
GROUP BY survey, scale
ORDER BY survey, scale;

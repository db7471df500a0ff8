-- Which parts of the scale-space does a flat region confirm?
--
-- :share = 0.5  smallest share of a part that flat regions must cover
-- :survey = null  name of a survey; null takes all
WITH found AS MATERIALIZED (
  SELECT part_id, survey, root_id, scale, hindex, area_m2, flat_share, flat_regions
  FROM part_evidence
  WHERE (CAST(:survey AS TEXT) IS NULL OR survey = :survey)
)
SELECT * FROM found
WHERE flat_share >= :share
ORDER BY flat_share DESC, part_id;

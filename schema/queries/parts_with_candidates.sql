-- Which parts of the scale-space do both detectors on the points confirm?
--
-- :share = 0.5  smallest share of a part that the candidate regions of each must cover
-- :survey = null  name of a survey; null takes all
WITH found AS MATERIALIZED (
  SELECT part_id, survey, root_id, scale, hindex, area_m2, area3d_share, adaptive_share
  FROM part_evidence
  WHERE (CAST(:survey AS TEXT) IS NULL OR survey = :survey)
)
SELECT * FROM found
WHERE area3d_share >= :share AND adaptive_share >= :share
ORDER BY part_id;

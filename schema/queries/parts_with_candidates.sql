-- Which parts of the scale-space do both detectors on the points confirm?
WITH param AS (  -- the values to edit
  SELECT
    CAST(0.5 AS DOUBLE PRECISION) AS share,  -- smallest share of a part that the candidate regions of each must cover
    CAST(NULL AS TEXT) AS survey  -- name of a survey; NULL takes all
), found AS MATERIALIZED (
  SELECT part_id, survey, root_id, scale, hindex, area_m2, area3d_share, adaptive_share
  FROM part_evidence
  WHERE ((SELECT survey FROM param) IS NULL OR survey = (SELECT survey FROM param))
)
SELECT * FROM found
WHERE area3d_share >= (SELECT share FROM param) AND adaptive_share >= (SELECT share FROM param)
ORDER BY part_id;

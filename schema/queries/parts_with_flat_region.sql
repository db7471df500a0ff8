-- Which parts of the scale-space does a flat region confirm?
WITH param AS (  -- the values to edit
  SELECT
    CAST(0.5 AS DOUBLE PRECISION) AS share,  -- smallest share of a part that flat regions must cover
    CAST(NULL AS TEXT) AS survey  -- name of a survey; NULL takes all
), found AS MATERIALIZED (
  SELECT part_id, survey, root_id, scale, hindex, area_m2, flat_share, flat_regions
  FROM part_evidence
  WHERE ((SELECT survey FROM param) IS NULL OR survey = (SELECT survey FROM param))
)
SELECT * FROM found
WHERE flat_share >= (SELECT share FROM param)
ORDER BY flat_share DESC, part_id;

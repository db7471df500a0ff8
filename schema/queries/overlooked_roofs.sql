-- Which roofs do the parts lack, although a detector on the points and the flat regions both found them?
--
-- :explained = 0.5  root parts must cover less than this share of the candidate region
-- :flat = 0.5  smallest share of it that flat regions must cover
-- :survey = null  name of a survey; null takes all
WITH found AS MATERIALIZED (
  SELECT candidate_id, survey, method, area_m2, h_p50, explained_share, flat_share, xcen, ycen
  FROM candidate_evidence
  WHERE (CAST(:survey AS TEXT) IS NULL OR survey = :survey)
)
SELECT * FROM found
WHERE explained_share < :explained AND flat_share >= :flat
ORDER BY area_m2 DESC, candidate_id;

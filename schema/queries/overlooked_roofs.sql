-- Which roofs do the parts lack, although a detector on the points and the flat regions both found them?
WITH param AS (  -- the values to edit
  SELECT
    CAST(0.5 AS DOUBLE PRECISION) AS explained,  -- root parts must cover less than this share of the candidate region
    CAST(0.5 AS DOUBLE PRECISION) AS flat,  -- smallest share of it that flat regions must cover
    CAST(NULL AS TEXT) AS survey  -- name of a survey; NULL takes all
), found AS MATERIALIZED (
  SELECT candidate_id, survey, method, area_m2, h_p50, explained_share, flat_share, xcen, ycen
  FROM candidate_evidence
  WHERE ((SELECT survey FROM param) IS NULL OR survey = (SELECT survey FROM param))
)
SELECT * FROM found
WHERE explained_share < (SELECT explained FROM param) AND flat_share >= (SELECT flat FROM param)
ORDER BY area_m2 DESC, candidate_id;

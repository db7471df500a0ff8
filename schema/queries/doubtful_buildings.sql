-- Which buildings do only few of the detectors confirm, the largest first?
WITH param AS (  -- the values to edit
  SELECT
    CAST(2 AS INTEGER) AS witnesses,  -- number of detectors from which a building counts as certain
    CAST(NULL AS TEXT) AS survey  -- name of a survey; NULL takes all
)
SELECT building_id, survey, state, extractors_for, extractors_heard, flat_share, area3d_share, adaptive_share, area_m2
FROM building_evidence
WHERE extractors_for < (SELECT witnesses FROM param) AND extractors_heard >= (SELECT witnesses FROM param)
  AND ((SELECT survey FROM param) IS NULL OR survey = (SELECT survey FROM param))
ORDER BY area_m2 DESC, building_id;

-- Which buildings do only few of the detectors confirm, the largest first?
--
-- :witnesses = 2  number of detectors from which a building counts as certain
-- :survey = null  name of a survey; null takes all
SELECT building_id, survey, state, extractors_for, extractors_heard, flat_share, area3d_share, adaptive_share, area_m2
FROM building_evidence
WHERE extractors_for < :witnesses AND extractors_heard >= :witnesses AND (CAST(:survey AS TEXT) IS NULL OR survey = :survey)
ORDER BY area_m2 DESC, building_id;

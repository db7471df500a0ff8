-- The buildings with their evidence: whether the classes confirm each (1 or 0), how many other detectors were run, and
-- how many of these confirm it by covering at least 0.1 of it.
SELECT b.building_id, s.name AS survey, b.state, b.probability, b.storeys, b.h_p90, b.area_m2, b.building_share,
       b.multiscale_share, b.flat_share, b.area3d_share, b.adaptive_share,
       CASE WHEN b.building_share >= 0.5 THEN 1 ELSE 0 END AS classes_for,
       CASE WHEN b.flat_share IS NULL THEN 0 ELSE 1 END + CASE WHEN b.area3d_share IS NULL THEN 0 ELSE 1 END
         + CASE WHEN b.adaptive_share IS NULL THEN 0 ELSE 1 END AS extractors_heard,
       CASE WHEN b.flat_share >= 0.1 THEN 1 ELSE 0 END
         + CASE WHEN b.area3d_share >= 0.1 THEN 1 ELSE 0 END
         + CASE WHEN b.adaptive_share >= 0.1 THEN 1 ELSE 0 END AS extractors_for,
       b.geometry
FROM building AS b
JOIN run AS r ON r.run_id = b.run_id
JOIN survey AS s ON s.survey_id = r.survey_id;

-- The present inventory: the current version of each building. An operator's decision has priority over the detected
-- state (found_state).
SELECT v.version_id, v.uid, v.valid_from, v.valid_to, v.source, s.name AS survey, COALESCE(o.state, v.state) AS state,
       v.state AS found_state, o.operator, o.note, v.storeys, v.storeys_min, v.storeys_max, v.storeys_top, v.z_ground,
       v.eaves, v.ridge, v.z_eaves, v.z_ridge, v.h_max, v.h_mean, v.h_p50, v.h_p90, v.area_m2, v.volume_m3,
       v.parts, v.flat_share, v.area3d_share, v.adaptive_share, v.probability, v.building_id,
       COALESCE(v.attributes, '{}') AS attributes,
       v.geometry
FROM building_version AS v
LEFT JOIN survey AS s ON s.survey_id = v.survey_id
LEFT JOIN operator_state AS o ON o.uid = v.uid
WHERE v.valid_to IS NULL;

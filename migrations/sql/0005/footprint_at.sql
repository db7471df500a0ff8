-- The inventory on a day, with the columns of footprint_current; operators' decisions have priority over detected states.
-- For PostGIS.
CREATE FUNCTION footprint_at(day date)
RETURNS TABLE (
  version_id bigint, uid bigint, valid_from text, valid_to text, source text, survey text, state text,
  found_state text, operator text, note text, storeys bigint, storeys_min bigint, storeys_max bigint,
  storeys_top bigint, z_ground double precision, eaves double precision, ridge double precision,
  z_eaves double precision, z_ridge double precision, h_max double precision, h_mean double precision,
  h_p50 double precision, h_p90 double precision, area_m2 double precision, volume_m3 double precision, parts bigint,
  flat_share double precision, area3d_share double precision, adaptive_share double precision,
  probability double precision, building_id bigint, attributes json, geometry geometry
)
LANGUAGE sql STABLE AS $$
SELECT v.version_id, v.uid, v.valid_from, v.valid_to, v.source, s.name AS survey, COALESCE(o.state, v.state) AS state,
       v.state AS found_state, o.operator, o.note, v.storeys, v.storeys_min, v.storeys_max, v.storeys_top, v.z_ground,
       v.eaves, v.ridge, v.z_eaves, v.z_ridge, v.h_max, v.h_mean, v.h_p50, v.h_p90, v.area_m2, v.volume_m3,
       v.parts, v.flat_share, v.area3d_share, v.adaptive_share, v.probability, v.building_id,
       COALESCE(v.attributes, '{}') AS attributes,
       v.geometry
FROM building_version AS v
LEFT JOIN survey AS s ON s.survey_id = v.survey_id
LEFT JOIN operator_state AS o ON o.uid = v.uid
WHERE v.valid_from <= to_char(day, 'YYYY-MM-DD')
  AND (v.valid_to IS NULL OR v.valid_to > to_char(day, 'YYYY-MM-DD'))
$$;

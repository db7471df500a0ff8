"""The views of the living inventory, and the state of the inventory at a date: one text for both dialects."""

FOOTPRINT_COLUMNS = """
SELECT v.version_id, v.uid, v.valid_from, v.valid_to, v.source, s.name AS survey, COALESCE(o.state, v.state) AS state,
       v.state AS found_state, o.operator, o.note, v.storeys, v.h_max, v.h_mean, v.h_p50, v.h_p90, v.area_m2,
       v.volume_m3, v.parts, v.flat_share, v.area3d_share, v.adaptive_share, v.building_id, v.attributes, v.geometry
FROM building_version AS v
LEFT JOIN survey AS s ON s.survey_id = v.survey_id
LEFT JOIN operator_state AS o ON o.uid = v.uid
""".strip()
"""The versions as footprints, with the operators' states winning over the found ones."""

FOOTPRINT_AT = f"{FOOTPRINT_COLUMNS}\nWHERE v.valid_from <= :date AND (v.valid_to IS NULL OR v.valid_to > :date)"
"""The footprints at the date ``:date``, a day by ISO 8601."""

FOOTPRINT_AT_FUNCTION = f"""
CREATE FUNCTION footprint_at(day date)
RETURNS TABLE (
  version_id bigint, uid bigint, valid_from text, valid_to text, source text, survey text, state text,
  found_state text, operator text, note text, storeys bigint, h_max double precision, h_mean double precision,
  h_p50 double precision, h_p90 double precision, area_m2 double precision, volume_m3 double precision, parts bigint,
  flat_share double precision, area3d_share double precision, adaptive_share double precision, building_id bigint,
  attributes json, geometry geometry
)
LANGUAGE sql STABLE AS $$
{FOOTPRINT_COLUMNS}
WHERE v.valid_from <= to_char(day, 'YYYY-MM-DD')
  AND (v.valid_to IS NULL OR v.valid_to > to_char(day, 'YYYY-MM-DD'))
$$
""".strip()
"""The same as a function of PostGIS; being one statement, it is planned as a part of the query that calls it."""

FOOTPRINT_CURRENT = f"{FOOTPRINT_COLUMNS}\nWHERE v.valid_to IS NULL"

BUILDING_HISTORY = """
SELECT v.version_id, v.uid, v.valid_from, v.valid_to, v.source, s.name AS survey,
       COALESCE((SELECT MIN(c.kind) FROM building_change AS c
                 WHERE c.version_after = v.version_id AND c.survey_id = v.survey_id), 'imported') AS began_as,
       e.name AS ended_in,
       (SELECT MIN(c.kind) FROM building_change AS c
        WHERE c.version_before = v.version_id AND c.survey_id = v.closed_by) AS ended_as,
       v.state, v.storeys, v.h_max, v.h_p90, v.area_m2, v.volume_m3, v.geometry
FROM building_version AS v
LEFT JOIN survey AS s ON s.survey_id = v.survey_id
LEFT JOIN survey AS e ON e.survey_id = v.closed_by
""".strip()

ROOF_MATERIAL_BY_CLASS = """
SELECT s.name AS survey, m.material, p.speindex, c.label AS class_label, COUNT(*) AS samples
FROM roof_sample AS m
JOIN part AS p ON ST_Intersects(p.geometry, m.geometry)
JOIN run AS r ON r.run_id = p.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
LEFT JOIN spectral_class AS c ON c.run_id = p.run_id AND c.speindex = p.class_id
WHERE NOT EXISTS (
  SELECT 1 FROM part AS f
  WHERE f.root_id = p.root_id AND f.scale > p.scale AND ST_Intersects(f.geometry, m.geometry)
)
GROUP BY s.name, m.material, p.speindex, c.label
""".strip()

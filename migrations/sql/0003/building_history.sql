-- All versions of the inventory's buildings, with the change by which each began and ended.
SELECT v.version_id, v.uid, v.valid_from, v.valid_to, v.source, s.name AS survey,
       COALESCE((SELECT MIN(c.kind) FROM building_change AS c
                 WHERE c.version_after = v.version_id AND c.survey_id = v.survey_id), 'imported') AS began_as,
       e.name AS ended_in,
       (SELECT MIN(c.kind) FROM building_change AS c
        WHERE c.version_before = v.version_id AND c.survey_id = v.closed_by) AS ended_as,
       v.state, v.probability, v.storeys, v.eaves, v.ridge, v.z_ground, v.h_max, v.h_p90, v.area_m2, v.volume_m3, v.geometry
FROM building_version AS v
LEFT JOIN survey AS s ON s.survey_id = v.survey_id
LEFT JOIN survey AS e ON e.survey_id = v.closed_by;

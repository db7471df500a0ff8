-- The footprints: a row for each building, with its state, its probability, its heights and its outline of roof edges.
-- Levels z_ are in the survey's vertical reference; eaves and ridge are above z_ground.
SELECT b.building_id, s.name AS survey, b.state, b.probability, b.storeys, b.storeys_min, b.storeys_max,
       b.storeys_top, b.z_ground, b.eaves, b.ridge, b.z_eaves, b.z_ridge, b.speindex, b.area_m2,
       b.h_max, b.h_mean, b.h_p50, b.h_p90, b.trees, b.parts, b.divided_by, b.outline_source, b.xin, b.yin, b.geometry
FROM building AS b
JOIN run AS r ON r.run_id = b.run_id
JOIN survey AS s ON s.survey_id = r.survey_id;

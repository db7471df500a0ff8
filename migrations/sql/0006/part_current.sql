-- The parts of the present inventory. building_id is that of the building in footprint_current, also of a part that another
-- survey found beyond the border that cuts the building.
SELECT p.part_id, s.name AS survey, v.building_id, p.supid, p.supscale, p.root_id, p.scale, p.hindex, p.hzone,
       p.speindex, p.xo, p.yo, p.xcen, p.ycen, p.xin, p.yin, p.area_px, p.area_m2, p.stddis, p.h_max, p.h_mean,
       p.h_p50, p.h_p90, p.h_std, p.building_share, p.outline_source, p.geometry
FROM part AS p
JOIN building_piece AS b ON b.building_id = p.building_id
JOIN building_version AS v ON v.version_id = b.version_id
JOIN run AS r ON r.run_id = p.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
WHERE v.valid_to IS NULL;

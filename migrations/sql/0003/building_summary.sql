-- One row for each building, for maps and tables: place, storeys, heights, volume, class, and how well it was seen. Levels
-- z_ are in the vertical reference of the survey, vertical_crs where it is known. floor_area_m2 is an estimate: where a
-- run of an older msbdb has none, each part counts its area once for every storey by which it rises above its father.
SELECT b.building_id, s.name AS survey, s.date AS survey_date, b.state, b.probability, b.storeys,
       b.storeys_min, b.storeys_max, b.storeys_top, b.z_ground, b.z_ground_min, b.z_ground_max, b.eaves, b.ridge,
       b.z_eaves, b.z_ridge, s.vertical_crs, b.coverage, b.nodata_share, b.density,
       b.multiscale_share, b.flat_share, b.area3d_share, b.adaptive_share, b.h_max, b.h_mean, b.h_p50, b.h_p90,
       b.area_m2, b.volume_m3,
       COALESCE(b.floor_area_m2,
       (SELECT SUM(p.area_m2 * CASE WHEN p.hindex > COALESCE(f.hindex, 0)
                               THEN p.hindex - COALESCE(f.hindex, 0) ELSE 0 END)
        FROM part AS p LEFT JOIN part AS f ON f.part_id = p.father_id
        WHERE p.building_id = b.building_id)) AS floor_area_m2,
       b.trees, b.parts, b.scales, b.speindex, c.label AS class_label, b.divided_by, b.outline_source,
       b.xcen, b.ycen, b.xin, b.yin, b.geometry
FROM building AS b
JOIN run AS r ON r.run_id = b.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
LEFT JOIN spectral_class AS c ON c.run_id = b.run_id AND c.speindex = b.class_id;

-- One row for each building, for maps and tables: place, heights, volume, class, the shares that other detectors cover,
-- and floor_area_m2, an estimate: each part counts its area once for every storey by which it rises above its father.
SELECT b.building_id, s.name AS survey, s.date AS survey_date, b.state, b.probability, b.storeys,
       b.multiscale_share, b.flat_share, b.area3d_share, b.adaptive_share, b.h_max, b.h_mean, b.h_p50, b.h_p90,
       b.area_m2, b.volume_m3,
       (SELECT SUM(p.area_m2 * CASE WHEN p.hindex > COALESCE(f.hindex, 0)
                               THEN p.hindex - COALESCE(f.hindex, 0) ELSE 0 END)
        FROM part AS p LEFT JOIN part AS f ON f.part_id = p.father_id
        WHERE p.building_id = b.building_id) AS floor_area_m2,
       b.trees, b.parts, b.scales, b.speindex, c.label AS class_label, b.outline_source,
       b.xcen, b.ycen, b.xin, b.yin, b.geometry
FROM building AS b
JOIN run AS r ON r.run_id = b.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
LEFT JOIN spectral_class AS c ON c.run_id = b.run_id AND c.speindex = b.class_id;

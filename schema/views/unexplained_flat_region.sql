-- The flat regions that no part explains: root parts cover less than 0.5 of them; explained_share is that share.
SELECT f.region_id, s.name AS survey, f.zone, f.lambda_low_m2, f.lambda_m2, f.gradient_sum, f.mean_gradient,
       f.area_m2, f.perimeter_m, f.compactness, f.h_max, f.h_mean, f.h_p50, f.h_p90, f.h_std, f.xcen, f.ycen,
       COALESCE((
         SELECT SUM(l.region_share) FROM part_flat_region AS l JOIN part AS root ON root.part_id = l.part_id
         WHERE l.region_id = f.region_id AND root.supid = 0), 0.0) AS explained_share, f.geometry
FROM flat_region AS f
JOIN run AS r ON r.run_id = f.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
WHERE COALESCE((
         SELECT SUM(l.region_share) FROM part_flat_region AS l JOIN part AS root ON root.part_id = l.part_id
         WHERE l.region_id = f.region_id AND root.supid = 0), 0.0) < 0.5;

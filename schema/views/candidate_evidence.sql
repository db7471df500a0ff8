-- The candidate regions with evidence from other detectors: explained_share is the share that root parts cover,
-- flat_share the share that flat regions cover; null for a detector that was not run.
SELECT k.candidate_id, s.name AS survey, k.method, k.rule, k.height_scale_m, k.points, k.area_m2, k.rectangularity,
       k.compactness, k.linearity, k.ndvi, k.h_p50, k.h_p90, k.h_std, k.xcen, k.ycen,
       CASE WHEN multiscale.method IS NOT NULL THEN COALESCE((
         SELECT SUM(l.candidate_share) FROM part_candidate AS l JOIN part AS root ON root.part_id = l.part_id
         WHERE l.candidate_id = k.candidate_id AND root.supid = 0), 0.0) END AS explained_share,
       CASE WHEN flat.method IS NOT NULL THEN COALESCE((
         SELECT SUM(l.candidate_share) FROM flat_region_candidate AS l WHERE l.candidate_id = k.candidate_id), 0.0) END
         AS flat_share,
       k.geometry
FROM candidate_region AS k
JOIN run AS r ON r.run_id = k.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
LEFT JOIN run_method AS multiscale ON multiscale.run_id = k.run_id AND multiscale.method = 'multiscale'
LEFT JOIN run_method AS flat ON flat.run_id = k.run_id AND flat.method = 'flatregions';

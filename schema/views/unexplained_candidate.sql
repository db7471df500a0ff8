-- The candidate regions that no part explains: root parts cover less than 0.5 of them; explained_share is the
-- share that they cover.
SELECT k.candidate_id, s.name AS survey, k.method, k.rule, k.height_scale_m, k.points, k.area_m2, k.rectangularity,
       k.compactness, k.linearity, k.ndvi, k.h_max, k.h_mean, k.h_p50, k.h_p90, k.h_std, k.xcen, k.ycen,
       COALESCE((
         SELECT SUM(l.candidate_share) FROM part_candidate AS l JOIN part AS root ON root.part_id = l.part_id
         WHERE l.candidate_id = k.candidate_id AND root.supid = 0), 0.0) AS explained_share, k.geometry
FROM candidate_region AS k
JOIN run AS r ON r.run_id = k.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
WHERE COALESCE((
         SELECT SUM(l.candidate_share) FROM part_candidate AS l JOIN part AS root ON root.part_id = l.part_id
         WHERE l.candidate_id = k.candidate_id AND root.supid = 0), 0.0) < 0.5;

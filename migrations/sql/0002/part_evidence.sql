-- The parts with evidence from other detectors: the share that flat regions, candidates of area3d and candidates of
-- adaptive cover, and the number of these regions; null for a detector that was not run.
SELECT p.part_id, s.name AS survey, p.building_id, p.root_id, p.supid, p.scale, p.hindex, p.area_m2, p.building_share,
       CASE WHEN flat.method IS NOT NULL THEN COALESCE((
         SELECT SUM(l.part_share) FROM part_flat_region AS l WHERE l.part_id = p.part_id), 0.0) END AS flat_share,
       CASE WHEN flat.method IS NOT NULL THEN (
         SELECT COUNT(*) FROM part_flat_region AS l WHERE l.part_id = p.part_id) END AS flat_regions,
       CASE WHEN area3d.method IS NOT NULL THEN COALESCE((
         SELECT SUM(l.part_share) FROM part_candidate AS l JOIN candidate_region AS k ON k.candidate_id = l.candidate_id
         WHERE l.part_id = p.part_id AND k.method = 'area3d'), 0.0) END AS area3d_share,
       CASE WHEN area3d.method IS NOT NULL THEN (
         SELECT COUNT(*) FROM part_candidate AS l JOIN candidate_region AS k ON k.candidate_id = l.candidate_id
         WHERE l.part_id = p.part_id AND k.method = 'area3d') END AS area3d_regions,
       CASE WHEN adaptive.method IS NOT NULL THEN COALESCE((
         SELECT SUM(l.part_share) FROM part_candidate AS l JOIN candidate_region AS k ON k.candidate_id = l.candidate_id
         WHERE l.part_id = p.part_id AND k.method = 'adaptive'), 0.0) END AS adaptive_share,
       CASE WHEN adaptive.method IS NOT NULL THEN (
         SELECT COUNT(*) FROM part_candidate AS l JOIN candidate_region AS k ON k.candidate_id = l.candidate_id
         WHERE l.part_id = p.part_id AND k.method = 'adaptive') END AS adaptive_regions,
       p.geometry
FROM part AS p
JOIN run AS r ON r.run_id = p.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
LEFT JOIN run_method AS flat ON flat.run_id = p.run_id AND flat.method = 'flatregions'
LEFT JOIN run_method AS area3d ON area3d.run_id = p.run_id AND area3d.method = 'area3d'
LEFT JOIN run_method AS adaptive ON adaptive.run_id = p.run_id AND adaptive.method = 'adaptive';

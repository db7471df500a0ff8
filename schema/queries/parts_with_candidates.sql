-- Which parts of the scale-space do both extractors on the points confirm?
--
-- :share = 0.5  smallest share of a part that the candidate regions of each must cover
SELECT part_id, survey, root_id, scale, hindex, area_m2, area3d_share, adaptive_share
FROM part_evidence
WHERE area3d_share >= :share AND adaptive_share >= :share
ORDER BY part_id;

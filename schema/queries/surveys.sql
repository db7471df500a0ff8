-- Which surveys does this database have, by which detectors (1 or 0) and version, and how many objects?
WITH param AS (  -- the values to edit
  SELECT
    CAST(NULL AS TEXT) AS survey  -- name of a survey; NULL takes all
)
SELECT s.name AS survey, s.date, s.epsg, s.density, s.cell_m, r.profile, r.version,
       (SELECT COUNT(*) FROM run_method AS m WHERE m.run_id = r.run_id AND m.method = 'multiscale') AS multiscale,
       (SELECT COUNT(*) FROM run_method AS m WHERE m.run_id = r.run_id AND m.method = 'flatregions') AS flatregions,
       (SELECT COUNT(*) FROM run_method AS m WHERE m.run_id = r.run_id AND m.method = 'area3d') AS area3d,
       (SELECT COUNT(*) FROM run_method AS m WHERE m.run_id = r.run_id AND m.method = 'adaptive') AS adaptive,
       (SELECT COUNT(*) FROM building AS b WHERE b.run_id = r.run_id) AS buildings,
       (SELECT COUNT(*) FROM part AS p WHERE p.run_id = r.run_id) AS parts,
       (SELECT COUNT(*) FROM rejection AS j WHERE j.run_id = r.run_id) AS rejections,
       (SELECT COUNT(*) FROM flat_region AS f WHERE f.run_id = r.run_id) AS flat_regions,
       (SELECT COUNT(*) FROM candidate_region AS k WHERE k.run_id = r.run_id) AS candidates
FROM run AS r JOIN survey AS s ON s.survey_id = r.survey_id
WHERE ((SELECT survey FROM param) IS NULL OR s.name = (SELECT survey FROM param))
ORDER BY survey;

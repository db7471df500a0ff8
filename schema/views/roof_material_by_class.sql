-- Cross table of roof materials and classes (V53): the number of samples on finest parts of each class, by survey;
-- samples outside of all parts are not counted.
SELECT s.name AS survey, m.material, p.speindex, c.label AS class_label, COUNT(*) AS samples
FROM roof_sample AS m
JOIN part AS p ON ST_Intersects(p.geometry, m.geometry)
JOIN run AS r ON r.run_id = p.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
LEFT JOIN spectral_class AS c ON c.run_id = p.run_id AND c.speindex = p.class_id
WHERE NOT EXISTS (
  SELECT 1 FROM part AS f
  WHERE f.building_id = p.building_id AND f.root_id = p.root_id AND f.scale > p.scale
    AND ST_Intersects(f.geometry, m.geometry)
)
GROUP BY s.name, m.material, p.speindex, c.label;

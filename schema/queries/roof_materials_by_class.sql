-- Which classes do roofs of known material have? The cross table of Vu et al. 2009, by samples.
SELECT survey, material, speindex, class_label, samples
FROM roof_material_by_class
ORDER BY survey, material, samples DESC, speindex;

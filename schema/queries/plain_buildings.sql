-- Which buildings have no parts on finer scales: large but plain roofs?
WITH param AS (  -- the values to edit
  SELECT
    CAST(50 AS DOUBLE PRECISION) AS min_area_m2,  -- smallest building that counts, square metres
    CAST(NULL AS TEXT) AS survey  -- name of a survey; NULL takes all
)
SELECT f.building_id, f.survey, f.state, f.storeys, f.trees, f.area_m2, f.h_max
FROM footprint AS f
WHERE f.area_m2 >= (SELECT min_area_m2 FROM param)
  AND ((SELECT survey FROM param) IS NULL OR f.survey = (SELECT survey FROM param))
  AND f.parts = f.trees
ORDER BY f.area_m2 DESC, f.building_id;

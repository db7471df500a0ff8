-- Which parts are much higher than their father: towers on podiums, lift houses on roofs?
WITH param AS (  -- the values to edit
  SELECT
    CAST(2 AS INTEGER) AS storeys,  -- fewest storeys by which a part rises above its father
    CAST(NULL AS TEXT) AS survey  -- name of a survey; NULL takes all
)
SELECT tower.part_id, tower.building_id, tower.hindex - podium.hindex AS rises_storeys, tower.h_max, tower.area_m2,
       podium.part_id AS podium_id, podium.hindex AS podium_storeys, tower.area_m2 / podium.area_m2 AS area_share
FROM part AS tower
JOIN part AS podium ON podium.part_id = tower.father_id
JOIN run AS r ON r.run_id = tower.run_id
JOIN survey AS s ON s.survey_id = r.survey_id
WHERE tower.hindex - podium.hindex >= (SELECT storeys FROM param)
  AND ((SELECT survey FROM param) IS NULL OR s.name = (SELECT survey FROM param))
ORDER BY rises_storeys DESC, tower.part_id;

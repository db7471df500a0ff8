-- Which parts rise far above the part that carries them: towers on podiums, lift houses on roofs?
--
-- :storeys = 2  fewest storeys by which a part rises above its father
SELECT tower.part_id, tower.root_id, tower.hindex - podium.hindex AS rises_storeys, tower.h_max, tower.area_m2,
       podium.part_id AS podium_id, podium.hindex AS podium_storeys, tower.area_m2 / podium.area_m2 AS area_share
FROM part AS tower
JOIN part AS podium ON podium.part_id = tower.father_id
WHERE tower.hindex - podium.hindex >= :storeys
ORDER BY rises_storeys DESC, tower.part_id;

-- How much floor area is there in each square block? An estimate: each part counts its area once for every storey by
-- which it rises above its father. The floor area ratio is the floor area over the block's area.
--
-- :block_m = 100  side of a block, metres
WITH block AS (
  SELECT CAST(:block_m AS DOUBLE PRECISION) AS side
)
SELECT survey,
       FLOOR(xcen / side) * side AS west, FLOOR(ycen / side) * side AS south,
       COUNT(*) AS buildings, SUM(floor_area_m2) AS floor_area_m2,
       SUM(floor_area_m2) / (side * side) AS floor_area_ratio
FROM building_summary CROSS JOIN block
GROUP BY survey, side, FLOOR(xcen / side), FLOOR(ycen / side)
ORDER BY floor_area_m2 DESC, west, south;

-- How much floor area is there in each square block? An estimate: each roof counts its area once for every storey
-- below its eaves. The floor area ratio is the floor area over the block's area.
--
-- :block_m = 100  side of a block, metres
-- :survey = null  name of a survey; null takes all
WITH block AS (
  SELECT CAST(:block_m AS DOUBLE PRECISION) AS side
), found AS MATERIALIZED (
  SELECT survey, xcen, ycen, floor_area_m2
  FROM building_summary
  WHERE (CAST(:survey AS TEXT) IS NULL OR survey = :survey)
)
SELECT survey,
       FLOOR(xcen / side) * side AS west, FLOOR(ycen / side) * side AS south,
       COUNT(*) AS buildings, SUM(floor_area_m2) AS floor_area_m2,
       SUM(floor_area_m2) / (side * side) AS floor_area_ratio
FROM found CROSS JOIN block
GROUP BY survey, side, FLOOR(xcen / side), FLOOR(ycen / side)
ORDER BY floor_area_m2 DESC, west, south;

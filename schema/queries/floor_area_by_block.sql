-- How much floor area is there in each square block? An estimate: each roof counts its area once for every storey
-- below its eaves. The floor area ratio is the floor area over the block's area.
WITH param AS (  -- the values to edit
  SELECT
    CAST(100 AS DOUBLE PRECISION) AS block_m,  -- side of a block, metres
    CAST(NULL AS TEXT) AS survey  -- name of a survey; NULL takes all
), block AS (
  SELECT (SELECT block_m FROM param) AS side
), found AS MATERIALIZED (
  SELECT survey, xcen, ycen, floor_area_m2
  FROM building_summary
  WHERE ((SELECT survey FROM param) IS NULL OR survey = (SELECT survey FROM param))
)
SELECT survey,
       FLOOR(xcen / side) * side AS west, FLOOR(ycen / side) * side AS south,
       COUNT(*) AS buildings, SUM(floor_area_m2) AS floor_area_m2,
       SUM(floor_area_m2) / (side * side) AS floor_area_ratio
FROM found CROSS JOIN block
GROUP BY survey, side, FLOOR(xcen / side), FLOOR(ycen / side)
ORDER BY floor_area_m2 DESC, west, south;

-- What is the volume of buildings in each square block of the map? Buildings count where their centroid is.
--
-- :block_m = 100  side of a block, metres
-- :survey = null  name of a survey; null takes all
WITH block AS (
  SELECT CAST(:block_m AS DOUBLE PRECISION) AS side
)
SELECT survey,
       FLOOR(xcen / side) * side AS west, FLOOR(ycen / side) * side AS south,
       COUNT(*) AS buildings, SUM(volume_m3) AS volume_m3, SUM(volume_m3) / (side * side) AS volume_m3_per_m2
FROM building_summary CROSS JOIN block
WHERE (CAST(:survey AS TEXT) IS NULL OR survey = :survey)
GROUP BY survey, side, FLOOR(xcen / side), FLOOR(ycen / side)
ORDER BY volume_m3 DESC, west, south;

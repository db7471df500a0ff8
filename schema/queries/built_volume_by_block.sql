-- What is the volume of buildings in each square block of the map? Buildings count where their centroid is.
WITH param AS (  -- the values to edit
  SELECT
    CAST(100 AS DOUBLE PRECISION) AS block_m,  -- side of a block, metres
    CAST(NULL AS TEXT) AS survey  -- name of a survey; NULL takes all
), block AS (
  SELECT (SELECT block_m FROM param) AS side
)
SELECT survey,
       FLOOR(xcen / side) * side AS west, FLOOR(ycen / side) * side AS south,
       COUNT(*) AS buildings, SUM(volume_m3) AS volume_m3, SUM(volume_m3) / (side * side) AS volume_m3_per_m2
FROM building_summary CROSS JOIN block
WHERE ((SELECT survey FROM param) IS NULL OR survey = (SELECT survey FROM param))
GROUP BY survey, side, FLOOR(xcen / side), FLOOR(ycen / side)
ORDER BY volume_m3 DESC, west, south;

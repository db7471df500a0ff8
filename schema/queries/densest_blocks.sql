-- Which square blocks have the largest built-up share? A footprint counts completely where its centroid is, so the
-- share may exceed 1 in small blocks.
--
-- :block_m = 100  side of a block, metres
-- :count = 10  how many to list
-- :survey = null  name of a survey; null takes all
WITH block AS (
  SELECT CAST(:block_m AS DOUBLE PRECISION) AS side
)
SELECT survey,
       FLOOR(xcen / side) * side AS west, FLOOR(ycen / side) * side AS south,
       COUNT(*) AS buildings, SUM(area_m2) / (side * side) AS built_share, MAX(COALESCE(storeys_top, storeys)) AS most_storeys
FROM building_summary CROSS JOIN block
WHERE (CAST(:survey AS TEXT) IS NULL OR survey = :survey)
GROUP BY survey, side, FLOOR(xcen / side), FLOOR(ycen / side)
ORDER BY built_share DESC, west, south
LIMIT :count;

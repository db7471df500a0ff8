-- Which square blocks have the largest built-up share? A footprint counts completely where its centroid is, so the
-- share may exceed 1 in small blocks.
WITH param AS (  -- the values to edit
  SELECT
    CAST(100 AS DOUBLE PRECISION) AS block_m,  -- side of a block, metres
    CAST(10 AS INTEGER) AS count,  -- how many to list
    CAST(NULL AS TEXT) AS survey  -- name of a survey; NULL takes all
), block AS (
  SELECT (SELECT block_m FROM param) AS side
)
SELECT survey,
       FLOOR(xcen / side) * side AS west, FLOOR(ycen / side) * side AS south,
       COUNT(*) AS buildings, SUM(area_m2) / (side * side) AS built_share,
       MAX(COALESCE(storeys_top, storeys)) AS most_storeys
FROM building_summary CROSS JOIN block
WHERE ((SELECT survey FROM param) IS NULL OR survey = (SELECT survey FROM param))
GROUP BY survey, side, FLOOR(xcen / side), FLOOR(ycen / side)
ORDER BY built_share DESC, west, south
LIMIT (SELECT count FROM param);

-- How much floor area is there in each square block? An estimate: each part counts its area once for every storey by
-- which it rises above its father. The floor area ratio is the floor area over the block's area.
--
-- :block_m = 100  side of a block, metres
SELECT survey,
       FLOOR(xcen / :block_m) * :block_m AS west, FLOOR(ycen / :block_m) * :block_m AS south,
       COUNT(*) AS buildings, SUM(floor_area_m2) AS floor_area_m2,
       SUM(floor_area_m2) / (:block_m * :block_m) AS floor_area_ratio
FROM building_summary
GROUP BY survey, FLOOR(xcen / :block_m), FLOOR(ycen / :block_m)
ORDER BY floor_area_m2 DESC, west, south;

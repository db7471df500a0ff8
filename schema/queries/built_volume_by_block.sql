-- How much volume is built in each square block of the map? Buildings count where their centroid lies.
--
-- :block_m = 100  side of a block, metres
SELECT survey,
       FLOOR(xcen / :block_m) * :block_m AS west, FLOOR(ycen / :block_m) * :block_m AS south,
       COUNT(*) AS buildings, SUM(volume_m3) AS volume_m3, SUM(volume_m3) / (:block_m * :block_m) AS volume_m3_per_m2
FROM building_summary
GROUP BY survey, FLOOR(xcen / :block_m), FLOOR(ycen / :block_m)
ORDER BY volume_m3 DESC, west, south;

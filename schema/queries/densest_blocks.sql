-- Which square blocks are built up the most? The share of the block's ground that footprints cover; a footprint counts
-- whole where its centroid lies, so that a share may exceed 1 in small blocks.
--
-- :block_m = 100  side of a block, metres
-- :count = 10  how many to list
SELECT survey,
       FLOOR(xcen / :block_m) * :block_m AS west, FLOOR(ycen / :block_m) * :block_m AS south,
       COUNT(*) AS buildings, SUM(area_m2) / (:block_m * :block_m) AS built_share, MAX(storeys) AS most_storeys
FROM building_summary
GROUP BY survey, FLOOR(xcen / :block_m), FLOOR(ycen / :block_m)
ORDER BY built_share DESC, west, south
LIMIT :count;

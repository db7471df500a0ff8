-- Which buildings existed on a day, by state and source: number, area and volume?
WITH param AS (  -- the values to edit
  SELECT
    CAST('9999-12-31' AS TEXT) AS date  -- the day, ISO 8601; the default takes the present inventory
)
SELECT COALESCE(o.state, v.state) AS state, v.source, COUNT(*) AS buildings, SUM(v.area_m2) AS area_m2,
       SUM(v.volume_m3) AS volume_m3
FROM building_version AS v
LEFT JOIN operator_state AS o ON o.uid = v.uid
WHERE v.valid_from <= (SELECT date FROM param) AND (v.valid_to IS NULL OR v.valid_to > (SELECT date FROM param))
GROUP BY COALESCE(o.state, v.state), v.source
ORDER BY state, v.source;

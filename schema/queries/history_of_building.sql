-- What is the history of one building: its versions, the changes that began and ended each, and its height?
WITH param AS (  -- the values to edit
  SELECT
    CAST(NULL AS BIGINT) AS uid  -- the building of the inventory; NULL takes the one of most versions
)
SELECT h.uid, h.valid_from, h.valid_to, h.survey, h.began_as, h.ended_as, h.state, h.storeys,
       h.eaves, h.ridge, h.h_p90, h.area_m2
FROM building_history AS h
WHERE h.uid = COALESCE(
  (SELECT uid FROM param), (SELECT uid FROM building_version GROUP BY uid ORDER BY COUNT(*) DESC, uid LIMIT 1)
)
ORDER BY h.valid_from, h.version_id;

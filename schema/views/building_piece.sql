-- The buildings of runs that each version of the inventory was copied from. It is one building, or several where a border
-- of surveys cuts it: then each survey has a piece. A version that no survey measured has none.
WITH RECURSIVE piece (version_id, member_id) AS (
  SELECT version_after, version_before FROM building_change WHERE note LIKE 'across a border: %'
  UNION
  SELECT piece.version_id, c.version_before
  FROM piece JOIN building_change AS c ON c.version_after = piece.member_id AND c.note LIKE 'across a border: %'
)
SELECT version_id, building_id FROM building_version WHERE building_id IS NOT NULL
UNION ALL
SELECT DISTINCT v.version_id, m.building_id
FROM piece
JOIN building_version AS v ON v.version_id = piece.version_id
JOIN building_version AS m ON m.version_id = piece.member_id
WHERE m.building_id <> v.building_id;

-- How did each survey change the inventory: number of buildings and area by kind of change?
SELECT e.number, e.date, s.name AS survey, c.kind, COUNT(*) AS changes, SUM(c.darea_m2) AS darea_m2
FROM building_change AS c
JOIN survey AS s ON s.survey_id = c.survey_id
JOIN inventory_event AS e ON e.survey_id = c.survey_id
GROUP BY e.number, e.date, s.name, c.kind
ORDER BY e.number, c.kind;

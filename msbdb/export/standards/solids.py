"""Watertight blocks over outlines: closed shells of a bottom, a top and one wall an edge, on a grid of millimetres.

A shell is closed when each edge belongs to two faces, which run through it in opposite directions. An outline that
touches itself in a point, such as a courtyard that reaches the border in a corner, breaks this: four walls would meet
in one vertical edge. Such a point is cut open by a square of 2 cm.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

GRID_M = 0.001
"""Steps of the coordinates, metres."""

CUT_M = 0.01
"""Half the side of the square that is cut out where an outline touches itself, metres (ours)."""

SLIVER_M = 0.1
"""Pieces nowhere wider than this are left out, metres (ours): they are gaps between outlines, not roofs."""

Ring = list[int]

Face = list[Ring]
"""An outer ring and its holes, as numbers of vertices; without a repeated end."""

Point = tuple[int, int, int]


@dataclass(frozen=True, slots=True)
class Block:
    """The faces of a block: the bottom, the top, then the walls; all are seen counter-clockwise from outside."""

    faces: list[Face]


class Vertices:
    """Numbers of vertices; equal coordinates have one number.

    Parameters
    ----------
    origin : (3,) array of float
        What is subtracted before coordinates are counted in steps, metres.
    """

    def __init__(self, origin: NDArray[np.float64]) -> None:
        self.origin = origin
        self._numbers: dict[Point, int] = {}

    def number(self, vertex: Point) -> int:
        """Return the number of a vertex, in steps from the origin; a new one if it is new."""
        return self._numbers.setdefault(vertex, len(self._numbers))

    def steps(self, values_m: float | NDArray[np.float64], axis: int) -> NDArray[np.int64]:
        """Return coordinates of an axis as steps from the origin."""
        return np.asarray(np.rint((np.asarray(values_m) - self.origin[axis]) / GRID_M), dtype=np.int64)

    def coordinates(self) -> list[list[int]]:
        """Return all vertices in order of their numbers."""
        return [list(vertex) for vertex in self._numbers]


def on_grid(geometries: NDArray[np.object_]) -> NDArray[np.object_]:
    """Return polygons rounded to the grid and valid; what is lost by rounding is empty.

    Parameters
    ----------
    geometries : (N,) ndarray of object
        Polygons or multipolygons, metres.
    """
    rounded: NDArray[np.object_] = shapely.set_precision(geometries, GRID_M)
    return rounded


def outlines_of(geometry: shapely.Geometry) -> list[shapely.Polygon]:
    """Return the polygons of an outline that can be the base of a block: wide enough, and touching themselves nowhere.

    Parameters
    ----------
    geometry : Geometry
        On the grid, from `on_grid`.

    Returns
    -------
    list of Polygon
        Shells counter-clockwise, holes clockwise; empty where nothing is wide enough.
    """
    return [
        shapely.orient_polygons(polygon)
        for part in _polygons(geometry)
        for polygon in _polygons(_opened(part))
        if not shapely.is_empty(shapely.buffer(polygon, -SLIVER_M / 2, join_style="mitre"))
    ]


def block_of(polygon: shapely.Polygon, low_m: float, high_m: float, vertices: Vertices) -> Block | None:
    """Return the block over an outline between two levels.

    Parameters
    ----------
    polygon : Polygon
        From `outlines_of`.
    low_m, high_m : float
        Levels of its bottom and its top, metres.
    vertices : Vertices
        Takes the new vertices.

    Returns
    -------
    Block or None
        None where the top is not above the bottom.
    """
    low, high = int(vertices.steps(low_m, 2)), int(vertices.steps(high_m, 2))
    if high <= low:
        return None
    top: Face = []
    bottom: Face = []
    walls: list[Face] = []
    for ring in (polygon.exterior, *polygon.interiors):
        xy = shapely.get_coordinates(ring)[:-1]
        x, y = vertices.steps(xy[:, 0], 0).tolist(), vertices.steps(xy[:, 1], 1).tolist()
        below = [vertices.number((*place, low)) for place in zip(x, y, strict=True)]
        above = [vertices.number((*place, high)) for place in zip(x, y, strict=True)]
        top.append(above)
        bottom.append(below[::-1])
        # The roof lies to the left of its rings, so the outer side of each wall is on the right.
        ends = [*range(1, len(below)), 0]
        walls += [[[below[a], below[b], above[b], above[a]]] for a, b in enumerate(ends)]
    return Block([bottom, top, *walls])


def _polygons(geometry: shapely.Geometry) -> Iterator[shapely.Polygon]:
    """Yield the polygons of a geometry that have an area."""
    for part in shapely.get_parts(geometry):
        if isinstance(part, shapely.Polygon) and not part.is_empty:
            yield part
        elif isinstance(part, shapely.MultiPolygon):
            yield from _polygons(part)


def _opened(polygon: shapely.Geometry) -> shapely.Geometry:
    """Return a polygon without the points in which it touches itself."""
    while len(touching := _touching(polygon)):
        squares = shapely.box(*(touching - CUT_M).T, *(touching + CUT_M).T)
        polygon = shapely.difference(polygon, shapely.union_all(squares), grid_size=GRID_M)
    return polygon


def _touching(geometry: shapely.Geometry) -> NDArray[np.float64]:
    """Return the vertices that appear twice in a polygon of the geometry, (N, 2)."""
    found = [np.empty((0, 2))]
    for polygon in _polygons(geometry):
        rings = [shapely.get_coordinates(ring)[:-1] for ring in (polygon.exterior, *polygon.interiors)]
        places, times = np.unique(np.concatenate(rings), axis=0, return_counts=True)
        found.append(places[times > 1])
    return np.concatenate(found)

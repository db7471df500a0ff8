"""Polygons as drawing paths."""

from itertools import pairwise

import numpy as np
import shapely
from matplotlib.path import Path as Outline
from numpy.typing import NDArray


def outlines(geometries: NDArray[np.object_]) -> list[Outline]:
    """Return polygons as drawing paths, with holes left open.

    Parameters
    ----------
    geometries : (N,) ndarray of shapely Polygon or MultiPolygon
        Empty ones give empty paths.

    Returns
    -------
    list of matplotlib.path.Path
        One a geometry. Shells and holes turn in opposite senses, as the non-zero fill rule asks.
    """
    if not len(geometries):
        return []
    oriented = shapely.orient_polygons(geometries)
    whole = np.array(
        [shapely.MultiPolygon(shapely.get_parts(geometry).tolist()) for geometry in oriented], dtype=object
    )
    _, xy, (rings, polygons, wholes) = shapely.to_ragged_array(whole, include_z=False)
    codes = np.full(len(xy), Outline.LINETO, dtype=Outline.code_type)
    codes[rings[:-1]] = Outline.MOVETO
    codes[rings[1:] - 1] = Outline.CLOSEPOLY
    stops = rings[polygons[wholes]]
    return [Outline(xy[a:b], codes[a:b]) for a, b in pairwise(stops)]

"""A frame for the points of a cloud: a near origin, empty stretches shortened, and cells to find neighbours by."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msbdb.errors import InputError, NodataError
from msbdb.order import ranks
from msbdb.params import GroundParams
from msbdb.pointcloud import PointCloud
from msbdb.surface.gridding import cell_size

Floats = NDArray[np.float64]

CELL_SPACINGS = 1.5
"""Least side of a cell in point spacings: nine of ten cells hold a point then."""
MOST_CELLS = 64
"""Most cells a point: beyond, the cloud is a thin line across a wide box, and its cells would fill the memory."""
SPARE_CELLS = 1_000_000
"""Cells that any cloud may have."""


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """Points in local metres, from the corner of the cloud's south-western cell and its lowest point.

    Parameters
    ----------
    u, v : (N,) ndarray of float64, metres
        Eastings and northings; long empty stretches along an axis are shortened.
    z : (N,) ndarray of float64, metres
        Heights.
    cell_m : float
        Side of the cells, metres; cell (i, j) holds the points with i = floor(v / cell_m), j = floor(u / cell_m).
    shape : tuple of int
        Cells from south to north and from west to east.
    """

    u: Floats
    v: Floats
    z: Floats
    cell_m: float
    shape: tuple[int, int]


def cell_side(first_m2: float, params: GroundParams) -> float:
    """Return the side of the cells of which the lowest point counts, for a density of first echoes.

    It is ``ground_cell_m``, or for few points a larger round value: so that tiles of one survey have the same.
    """
    return max(params.ground_cell_m, cell_size(first_m2 / CELL_SPACINGS**2))


def frame(points: PointCloud, cell_m: float, gap_m: float) -> Frame:
    """Put the points into a local frame.

    Windows of at most ``gap_m`` hold the same points in it as in the world: so islands however far apart cost no
    memory, and huge offsets no digits.

    Raises
    ------
    InputError
        When the points are so scattered that their cells would fill the memory.
    """
    arrays = (points.x, points.y, points.z)
    u, v = (shorten(a, cell_m, gap_m) for a in arrays[:2])
    rows, cols = (int(np.floor(float(a.max()) / cell_m)) + 1 for a in (v, u))
    most = MOST_CELLS * len(points) + SPARE_CELLS
    if rows * cols > most:
        msg = (
            f"{len(points)} points would need {rows} x {cols} cells of {cell_m:g} m and at most {most} are kept; "
            "take larger cells (ground.ground_cell_m), or parts of the survey one by one."
        )
        raise InputError(msg)
    return Frame(u, v, points.z - float(points.z.min()), cell_m, (rows, cols))


def require_points(points: PointCloud) -> None:
    """Refuse clouds that no ground can be told of.

    Raises
    ------
    NodataError
        When there are no points.
    InputError
        When a coordinate is not finite.
    """
    if len(points) == 0:
        msg = "The ground filter got no points; check what was left out before it."
        raise NodataError(msg)
    wrong = sum(int(np.count_nonzero(~np.isfinite(a))) for a in (points.x, points.y, points.z))
    if wrong:
        msg = f"The ground filter needs finite coordinates and {wrong} are NaN or infinite; drop these points."
        raise InputError(msg)


def shorten(values: Floats, cell_m: float, gap_m: float) -> Floats:
    """Shift coordinates by whole cells to start near 0, with long empty stretches shortened, again by whole cells.

    Cells of the result are cells of the world's lattice: so neighbouring tiles of a survey are cut alike.

    Parameters
    ----------
    values : (N,) ndarray of float64, metres
        Coordinates along one axis, in any order.
    cell_m : float
        Side of a cell.
    gap_m : float
        What stays of a stretch of more than twice that, at least.

    Examples
    --------
    >>> shorten(np.array([5_000_107.5, 100.0, 101.0]), 2.0, 10.0)
    array([11.5,  0. ,  1. ])
    """
    local = values - np.floor(float(values.min()) / cell_m) * cell_m
    blocks = np.floor(local / gap_m).astype(np.int64)
    used, inverse = ranks(blocks)
    if used.size == used[-1] + 1:
        return np.asarray(local)
    first, last = np.full(used.size, np.inf), np.full(used.size, -np.inf)
    np.minimum.at(first, inverse, local)
    np.maximum.at(last, inverse, local)
    empty = np.diff(used) > 1
    excess = np.where(empty, np.floor(np.maximum(first[1:] - last[:-1] - gap_m, 0.0) / cell_m) * cell_m, 0.0)
    return np.asarray(local - np.concatenate([[0.0], np.cumsum(excess)])[inverse])

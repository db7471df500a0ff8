"""Density of the points: the mean spacing, and the area that each point stands for."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msbdb.points.cellindex import CellIndex, index_cells

FIRST_CELL_M = 2.0
"""Cells on which the covered area is counted first; smaller ones would count the street beside a roof as empty."""

LEAST_A_CELL = 4.0
"""With fewer points a cell on average, cells without any would be many by chance: they are taken larger."""

LARGEST_CELL_M = 100.0
"""Beyond it there is no survey, but single points."""


@dataclass(frozen=True, slots=True, eq=False)
class Density:
    """How dense a cloud is.

    Parameters
    ----------
    spacing_m : float
        Mean spacing of the points in plan, 1/sqrt(density).
    area_m2 : (N,) ndarray of float64
        Area that each point stands for: one over the local density (A17).
    """

    spacing_m: float
    area_m2: NDArray[np.float64]


def measure_density(x: NDArray[np.float64], y: NDArray[np.float64], first_echo: NDArray[np.bool_]) -> Density:
    """Measure the spacing of the first echoes, and share the ground out among all points (A17).

    Parameters
    ----------
    x, y : (N,) ndarray of float64, metres
    first_echo : (N,) ndarray of bool
        The points that tell the spacing; later echoes of a pulse lie at the same place and make nothing denser. All
        points where none is a first echo.

    Returns
    -------
    Density
        Of spacing 1 m where there is no point.

    Notes
    -----
    The density is that of the covered cells of 2 m, or of larger ones where these hold fewer than four points. The
    area of a point is that of its cell of two spacings over the number of points in the cell, so the areas of all
    points sum up to the covered area: a strip scanned twice, walls, and all echoes of a crown count the ground once.
    So T_a is compared in m2, without asking how dense the survey is.
    """
    if not len(x):
        return Density(1.0, np.zeros(0))
    chosen = first_echo if first_echo.any() else np.ones(len(x), dtype=np.bool_)
    east, north = x[chosen], y[chosen]
    cell_m = FIRST_CELL_M
    cells = index_cells(east, north, cell_m)
    while cells.order.size < LEAST_A_CELL * cells.keys.size and cell_m < LARGEST_CELL_M:
        cell_m *= 1.5
        cells = index_cells(east, north, cell_m)
    spacing_m = cell_m * math.sqrt(cells.keys.size / cells.order.size)
    return Density(spacing_m, _areas(index_cells(x, y, 2 * spacing_m)))


def _areas(cells: CellIndex) -> NDArray[np.float64]:
    """Share the area of each cell among its points."""
    points = np.diff(cells.starts)
    area = np.empty(cells.order.size)
    area[cells.order] = np.repeat(cells.cell_m**2 / points, points)
    return area

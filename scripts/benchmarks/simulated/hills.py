"""Towns laid over hills: the points of a real tile are lifted onto another relief, and their houses stay level."""

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label

from msbdb.grid import Grid

Array = NDArray[np.float64]
Relief = Callable[[Array, Array], Array]
"""From metres to the east and to the north of a corner to metres above it."""

GROUND, BUILDING = 2, 6

CELL_M = 1.0
"""Cells on which the points of class 6 are joined into houses."""

BLOCK_M2 = 600.0
"""Larger blocks are cut into pieces, whose roofs step with the relief as a row of houses does."""

PIECE_M = 18.0
"""Side of the pieces."""


def slope(east: Array, north: Array) -> Array:
    """Rise evenly by 30 % towards the east-north-east."""
    return 0.3 * (0.8 * east + 0.6 * north)


def steep_slope(east: Array, north: Array) -> Array:
    """Rise twice as much."""
    return 2 * slope(east, north)


def treads(tread_m: float, wall_m: float, wall_share: float, *, fading: bool = False) -> Relief:
    """Return level treads between walls that bend along the slope.

    Parameters
    ----------
    tread_m, wall_m : float
        Depth of a tread and height of a wall, metres.
    wall_share : float
        Share of the depth in which a wall rises.
    fading : bool
        Walls fade into slopes along the hillside, and back into walls.
    """

    def relief(east: Array, north: Array) -> Array:
        along = (0.9 * east + 0.3 * north + 6 * np.sin(north / 35)) / tread_m
        share = wall_share + (1 - wall_share) * np.clip(np.sin(north / 60), 0, 1) * fading
        tread = np.floor(along)
        return np.asarray(wall_m * (tread + np.clip((along - tread - (1 - share)) / share, 0, 1)))

    return relief


def waves(east: Array, north: Array) -> Array:
    """Rise and fall by 12 m over some 40 m, on a gentle slope."""
    return np.asarray(12 * np.sin(east / 40) * np.cos(north / 55) + 0.1 * east)


def relief_of(terrain: Grid) -> Relief:
    """Return the relief of a real terrain from its south-western corner; beyond its borders it is mirrored.

    Parameters
    ----------
    terrain : Grid
        Elevations without gaps, metres.
    """
    values = np.asarray(terrain.values, dtype=np.float64)[::-1]
    values = values - values.min()

    def relief(east: Array, north: Array) -> Array:
        cells = (
            _mirrored((place / terrain.spec.cell_m).astype(np.int64), size)
            for place, size in zip((north, east), values.shape, strict=True)
        )
        return np.asarray(values[tuple(cells)])

    return relief


def _mirrored(number: NDArray[np.int64], size: int) -> NDArray[np.int64]:
    """Return the cells of 0 to size - 1 that lie at numbers beyond them, mirrored at both borders."""
    number = number % (2 * size)
    return np.asarray(np.where(number < size, number, 2 * size - 1 - number))


TERRACES = treads(14.0, 3.5, 0.07)
"""They rise by 25 %."""

RELIEFS: Mapping[str, Relief] = {"terraces": TERRACES, "slope": slope, "waves": waves}

STEEPER: Mapping[str, Relief] = {
    "treads of 8 m, walls of 2 m": treads(8, 2, 0.1),
    "treads of 14 m, walls of 3.5 m": TERRACES,
    "treads of 25 m, walls of 3 m": treads(25, 3, 0.04),
    "treads of 35 m, walls of 5 m": treads(35, 5, 0.03),
    "treads of 60 m, walls of 6 m": treads(60, 6, 0.02),
    "treads of 25 m, walls of 7 m": treads(25, 7, 0.04),
    "walls of 4 m that fade into slopes": treads(25, 4, 0.04, fading=True),
    "walls of 5 m that fade into slopes": treads(40, 5, 0.03, fading=True),
    "slope of 30 %": slope,
    "slope of 60 %": steep_slope,
    "waves": waves,
}
"""Reliefs on which ground filters fail."""


def lifted(x: Array, y: Array, z: Array, classes: NDArray[np.uint8], relief: Relief) -> Array:
    """Lay a town over a relief.

    Parameters
    ----------
    x, y, z : (N,) ndarray of float64, metres
    classes : (N,) ndarray of uint8
        Ground is 2, building is 6.
    relief : callable
        From metres to the east and north of the south-western corner of all points to metres.

    Returns
    -------
    (N,) ndarray of float64, metres
        The new elevations.

    Notes
    -----
    Houses are connected cells of 1 m with points of class 6, and pieces of 18 m of larger blocks. Each is lifted by
    the mean of the relief under its points, with all that lies over it. So its roof keeps its form, and the ground
    meets its walls higher or lower. Where the ground rises above a low roof, points of class 6 lie below it.
    """
    east, north = x - x.min(), y - y.min()
    rise = relief(east, north)
    col, row = (np.floor(place / CELL_M).astype(np.int64) for place in (east, north))
    houses = np.zeros((row.max() + 1, col.max() + 1), dtype=np.bool_)
    houses[row[classes == BUILDING], col[classes == BUILDING]] = True
    labels, count = label(houses)
    large = np.bincount(labels.ravel(), minlength=count + 1) * CELL_M**2 > BLOCK_M2
    rows, cols = np.indices(houses.shape) // int(PIECE_M / CELL_M)
    wide = cols.max() + 1
    # A number of its own for each house, and for each piece of a larger one.
    piece = labels.astype(np.int64) * (wide * (rows.max() + 1)) + np.where(large[labels], rows * wide + cols, 0)
    _, of = np.unique(piece[row, col], return_inverse=True)
    level = np.bincount(of, rise) / np.bincount(of)
    over = houses[row, col] & (classes != GROUND)
    return np.asarray(z + np.where(over, level[of], rise))

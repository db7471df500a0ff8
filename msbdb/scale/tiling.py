"""Tiles on the absolute lattice: which ground is a tile's own, how far it sees beyond, and what belongs to it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray

from msbdb.errors import ParameterError
from msbdb.grid import LATTICE_TOLERANCE, Bounds, GridSpec
from msbdb.labels import Labels, label_zones

HALO_M = 100.0
"""Ours: how far a tile sees beyond its own ground at first, metres (docs/scale.md has what this gives)."""

GUARD_M = 20.0
"""Ours: an island of roofs is whole where it ends so far inside of the window; near its edge the ground is unsure."""

STEP_M = 50.0
"""Ours: sides that are chosen are multiples of this."""

LEAST_TILE_M = 50.0
"""Ours: smaller tiles would be halo for the most part."""

WORKING_BYTES = 1.65 * 2**30
"""Ours: what a window may take of 2 GiB beside the program."""

POINT_BYTES, CELL_BYTES, LARGEST_CELL_BYTES = 65, 95, 300
"""Ours, measured (docs/scale.md): what a detector takes for each point, and for each cell beside it; and what the steps
on cells take for each."""

ECHOES = 1.3
"""Ours: echoes a pulse, in towns with trees."""

SIDES_M = (200.0, 2000.0)
"""Ours: least and largest side that is chosen; larger tiles hardly save halo."""


@dataclass(frozen=True, slots=True, order=True)
class Tile:
    """A square of ground: row and column count northwards and eastwards from the origin of the CRS.

    Parameters
    ----------
    row, column : int
        The place.
    side_m : float
        Side, metres.
    beside : tuple of float
        How far all tiles lie beside the origin, eastwards and northwards, metres: their edges are those of cells of a
        raster that lies so.

    Examples
    --------
    >>> tile = Tile(2, 5, 100.0)
    >>> tile.bounds, tile.window(20.0)
    ((500.0, 200.0, 600.0, 300.0), (480.0, 180.0, 620.0, 320.0))
    """

    row: int
    column: int
    side_m: float
    beside: tuple[float, float] = (0.0, 0.0)

    @property
    def bounds(self) -> Bounds:
        """West, south, east and north of its own ground, metres; west and south edges belong to it."""
        west, south = self.beside[0] + self.column * self.side_m, self.beside[1] + self.row * self.side_m
        return (west, south, west + self.side_m, south + self.side_m)

    def window(self, halo_m: float) -> Bounds:
        """Return the bounds of what it sees with a halo of this width."""
        west, south, east, north = self.bounds
        return (west - halo_m, south - halo_m, east + halo_m, north + halo_m)

    def owns(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which places lie on its own ground."""
        west, south, east, north = self.bounds
        inside: NDArray[np.bool_] = (x >= west) & (x < east) & (y >= south) & (y < north)
        return inside

    def __str__(self) -> str:
        """Return its row and column."""
        return f"{self.row},{self.column}"


def side_for(density: float, cell_m: float) -> float:
    """Return the side of tiles whose windows take 2 GiB of memory, metres.

    Parameters
    ----------
    density : float
        First echoes a square metre; 0 for rasters of heights.
    cell_m : float
        Side of a cell, metres.

    Examples
    --------
    >>> [side_for(*each) for each in ((1.0, 1.0), (8.0, 0.4), (20.0, 0.25), (20.0, 0.5), (66.0, 0.25))]
    [2000.0, 750.0, 400.0, 700.0, 250.0]
    >>> [side_for(0.0, cell_m) for cell_m in (1.0, 0.5)]
    [2000.0, 1000.0]
    """
    cells = cell_m**-2
    of_points = POINT_BYTES * ECHOES * density + CELL_BYTES * cells
    window_m = math.sqrt(WORKING_BYTES / max(of_points, LARGEST_CELL_BYTES * cells))
    least, most = SIDES_M
    return min(max((window_m - 2 * HALO_M) // STEP_M * STEP_M, least), most)


def tiles_over(
    boxes: Sequence[Bounds],
    side_m: float,
    within: shapely.Geometry | None = None,
    beside: tuple[float, float] = (0.0, 0.0),
) -> tuple[Tile, ...]:
    """Return the tiles that meet boxes, in order of row and column.

    Parameters
    ----------
    boxes : sequence of tuple of float
        West, south, east and north of each file, metres.
    side_m : float
        Side of a tile, metres.
    within : Geometry, optional
        Only tiles that meet it, too.
    beside : tuple of float
        How far the tiles lie beside the origin, eastwards and northwards, metres.

    Raises
    ------
    ParameterError
        For a side that is too small.

    Examples
    --------
    >>> [str(tile) for tile in tiles_over([(90.0, 10.0, 120.0, 20.0)], 100.0)]
    ['0,0', '0,1']
    """
    if not math.isfinite(side_m) or side_m < LEAST_TILE_M:
        msg = f"A tile is at least {LEAST_TILE_M:g} m wide; got {side_m:g} m. Give 500 or 1000 for instance."
        raise ParameterError(msg)
    found = set()
    for west, south, east, north in np.array(boxes) - [*beside, *beside]:
        for row in range(math.floor(south / side_m), math.floor(north / side_m) + 1):
            for column in range(math.floor(west / side_m), math.floor(east / side_m) + 1):
                found.add(Tile(row, column, side_m, beside))
    if within is not None:
        found = {tile for tile in found if shapely.intersects(within, shapely.box(*tile.bounds))}
    return tuple(sorted(found))


def over_cells(cells: GridSpec, side_m: float, within: shapely.Geometry | None = None) -> tuple[Tile, ...]:
    """Return the tiles over a raster, in order of row and column: their edges lie on those of its cells.

    The side is the next multiple of a cell; ``within`` is that of `tiles_over`, as are the errors.

    Examples
    --------
    >>> from affine import Affine
    >>> from pyproj import CRS
    >>> cells = GridSpec((90, 120), Affine(2.0, 0, 101.0, 0, -2.0, 300.5), CRS.from_epsg(2154))
    >>> [tile.bounds for tile in over_cells(cells, 199.0)]
    [(1.0, 0.5, 201.0, 200.5), (201.0, 0.5, 401.0, 200.5), (1.0, 200.5, 201.0, 400.5), (201.0, 200.5, 401.0, 400.5)]
    """
    cell_m, frame = cells.cell_m, cells.frame
    whole_m = math.ceil(side_m / cell_m - LATTICE_TOLERANCE) * cell_m if math.isfinite(side_m) else side_m
    west, south, east, north = cells.bounds
    # The edges of the outer cells may lie on those of tiles, their centres do not.
    box = (west + cell_m / 2, south + cell_m / 2, east - cell_m / 2, north - cell_m / 2)
    return tiles_over([box], whole_m, within, (frame.east_m, frame.north_m))


def first_cells(labels: Labels, count: int, spec: GridSpec) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return easting and northing of the first cell of each label in row order; NaN for a label without cells.

    Parameters
    ----------
    labels : (H, W) ndarray of int32
        0 for none, otherwise 1 to ``count``.
    count : int
        Number of labels.
    spec : GridSpec
        Their lattice.

    Returns
    -------
    easting, northing : (count,) ndarray of float64
        Of the cells' centres, metres.
    """
    numbers, first = np.unique(labels.ravel(), return_index=True)
    x, y = np.full(count, np.nan), np.full(count, np.nan)
    own = numbers > 0
    rows, columns = np.divmod(first[own], labels.shape[1])
    x[numbers[own] - 1], y[numbers[own] - 1] = spec.xy(rows, columns)
    return x, y


def owned_buildings(tile: Tile, parts: pd.DataFrame) -> NDArray[np.int64]:
    """Return the ids of the buildings that belong to a tile: those that begin on its ground, from the north.

    The tile that holds the first cell of a building sees it there also where its window cuts the building. So each
    building has an owner. Which root is the largest one, and gives the id, is known only where all of it is seen.

    Parameters
    ----------
    tile : Tile
        The tile.
    parts : DataFrame
        ``tables.PART``.
    """
    roots = parts[parts["supid"] == 0].sort_values(["yo", "xo"], ascending=[False, True], kind="stable")
    first = roots.drop_duplicates("building_id")
    own = tile.owns(first["xo"].to_numpy(), first["yo"].to_numpy())
    return np.sort(first["building_id"].to_numpy(np.int64)[own])


def cut_islands(tile: Tile, built: NDArray[Any], spec: GridSpec, window: Bounds, survey: Bounds) -> int:
    """Count the islands of roofs, or the buildings, that reach into a tile and end too near to the edge of its window.

    Parameters
    ----------
    tile : Tile
        The tile.
    built : (H, W) ndarray of bool or int32
        The cells of buildings in its window; those that touch, also at corners, are one island. Or their numbers.
    spec : GridSpec
        Their lattice.
    window : tuple of float
        West, south, east and north of the window, metres.
    survey : tuple of float
        Those of the whole survey: beyond them there is nothing to see.
    """
    edges = zip(window, survey, (True, True, False, False), strict=True)
    inner = [own + GUARD_M * (1 if low else -1) for own, _, low in edges]
    for side, (own, whole) in enumerate(zip(window, survey, strict=True)):
        if (own <= whole) if side < 2 else (own >= whole):
            inner[side] = -math.inf if side < 2 else math.inf
    near = (built > 0) & ~spec.holding((inner[0], inner[1], inner[2], inner[3]))
    if not near.any():
        return 0
    islands = label_zones(built, connectivity=8)[0] if built.dtype == np.bool_ else built
    inside = np.unique(islands[spec.holding(tile.bounds)])
    return int(np.intersect1d(inside[inside > 0], islands[near]).size)

"""Windows of a comparison: what a survey knows of its ground, and islands of footprints that no cut divides."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from shapely import STRtree, bounds

from msbdb.grid import Grid, GridSpec
from msbdb.labels import Box

Shapes = NDArray[np.object_]
Ints = NDArray[np.int64]

WINDOW_CELLS = 1000
"""Side of a window, cells: 500 m of cells of 0.5 m. A comparison takes about 66 bytes a cell."""


class Ground(Protocol):
    """What a survey knows of its ground, read window by window."""

    @property
    def spec(self) -> GridSpec:
        """The lattice of the whole survey."""

    def read(self, rows: slice, cols: slice) -> "Heights":
        """Return the cells within two slices."""


@dataclass(frozen=True, slots=True, eq=False)
class Heights:
    """Heights of a survey, or of a window of it; a `Ground` that is in memory.

    Parameters
    ----------
    above_ground : Grid
        Metres.
    above_sea : Grid, optional
        Levels of the same cells, metres; None where the terrain of the survey is not known.
    """

    above_ground: Grid
    above_sea: Grid | None = None

    @property
    def spec(self) -> GridSpec:
        """The lattice."""
        return self.above_ground.spec

    def read(self, rows: slice, cols: slice) -> "Heights":
        """Return the cells within two slices."""
        above_sea = None if self.above_sea is None else self.above_sea.crop(rows, cols)
        return Heights(self.above_ground.crop(rows, cols), above_sea)


def read_around(ground: Ground, place: tuple[float, float, float, float]) -> Heights | None:
    """Return the window of a survey that holds west, south, east and north, metres; None beside the survey."""
    west, south, east, north = place
    row, col = ground.spec.rowcol(np.array([west, east]), np.array([north, south]))
    limits = zip((row.tolist(), col.tolist()), ground.spec.shape, strict=True)
    rows, cols = (slice(max(first, 0), min(last + 1, size)) for (first, last), size in limits)
    return ground.read(rows, cols) if rows.stop > rows.start and cols.stop > cols.start else None


def islands(shapes: Shapes, reach_m: float) -> Ints:
    """Return the number of the island of each footprint: those within reach of each other are of one.

    Examples
    --------
    >>> from shapely import box
    >>> islands(np.array([box(0, 0, 4, 4), box(20, 0, 24, 4), box(5, 0, 9, 4)]), 2.0).tolist()
    [0, 1, 0]
    """
    one, other = STRtree(shapes).query(shapes, predicate="dwithin", distance=reach_m)
    links = coo_array((np.ones(len(one), dtype=np.bool_), (one, other)), shape=(len(shapes), len(shapes)))
    return np.asarray(connected_components(links, directed=False)[1], dtype=np.int64)


def windows(shapes: Shapes, island: Ints, spec: GridSpec, *, around_m: float, side: int) -> Iterator[tuple[Ints, Box]]:
    """Yield windows of a lattice that together have every island once, and as a whole.

    Parameters
    ----------
    shapes : (N,) ndarray of geometries
        Footprints, in the CRS of the lattice.
    island : (N,) ndarray of int
        The number of each footprint's island, from 0 on.
    spec : GridSpec
        The lattice.
    around_m : float
        What each window has around its islands, metres.
    side : int
        Side of the squares of the lattice, cells. The islands whose boxes begin in a square share a window; a larger
        island has one of its own.

    Yields
    ------
    rows : (M,) ndarray of int
        The footprints of the window's islands, ascending. Others that lie in the window as well are not among them.
    box : tuple of slice
        The rows and columns of the window. Islands beside the lattice have none.
    """
    if not len(shapes):
        return
    edges = np.full((int(island.max()) + 1, 4), np.inf)
    np.minimum.at(edges, island, bounds(shapes) * (1, 1, -1, -1))
    west, south, east, north = (edges * (1, 1, -1, -1)).T
    top, left = spec.rowcol(west - around_m, north + around_m)
    bottom, right = spec.rowcol(east + around_m, south - around_m)
    top, left = np.maximum(top, 0), np.maximum(left, 0)
    bottom, right = np.minimum(bottom + 1, spec.shape[0]), np.minimum(right + 1, spec.shape[1])
    number = np.arange(len(edges))
    alone = np.where((bottom - top > side) | (right - left > side), number, -1)
    square = np.unique(np.stack([top // side, left // side, alone]), axis=1, return_inverse=True)[1].ravel()
    square = np.where((bottom > top) & (right > left), square, -1)
    first = np.argsort(square[island], kind="stable")
    cuts = np.flatnonzero(np.diff(square[island][first])) + 1
    for rows in np.split(first, cuts):
        own = np.unique(island[rows])
        if square[own[0]] >= 0:
            yield (
                rows,
                (
                    slice(int(top[own].min()), int(bottom[own].max())),
                    slice(int(left[own].min()), int(right[own].max())),
                ),
            )

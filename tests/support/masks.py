"""Rectangles of cells, and heights on a lattice."""

import numpy as np
from pyproj import CRS

from msbdb.grid import Grid, lattice


def grid(heights, cell_m=1.0):
    """Heights on cells of a size, all valid."""
    rows, cols = heights.shape
    spec = lattice((0, 0.1, (cols - 0.1) * cell_m, rows * cell_m), cell_m, CRS.from_epsg(2154))
    return Grid(np.asarray(heights, dtype=np.float32), np.ones(heights.shape, dtype=bool), spec)


def block(shape, rows, cols):
    """Return a mask of a block of cells."""
    mask = np.zeros(shape, dtype=bool)
    mask[slice(*rows), slice(*cols)] = True
    return mask

"""Gaps of a surface: the nearest measured cell of each empty one, and its height."""

import math

import numpy as np
from numpy.typing import NDArray

from msbdb.surface.gridding import Floats, Mask, Samples
from msbdb.threads import kernel


def fill_gaps(samples: Samples, reach_cells: float) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Fill empty cells with the height of the sample nearest to their centre (V14), up to a distance.

    Parameters
    ----------
    samples : Samples
        First echoes with their true places.
    reach_cells : float
        Largest distance between the centres of an empty cell and of an observed one that may fill it, in cells.

    Returns
    -------
    filled : (H, W) ndarray of float64, metres
        The heights, 0 where neither observed nor filled.
    valid : (H, W) ndarray of bool
        Observed or filled.

    Notes
    -----
    Distances are those of the echoes, not of their cells, so that roofs neither grow nor shrink towards a side. Of
    samples equally near, as in rasters, the lower one counts. In each column the nearest observed cells to the north
    and the south are compared. Cost: linear in the cells times the distance that is searched.

    Examples
    --------
    A gap between a street of 0 m and a roof of 6 m, with samples at the cells' centres; the middle cell is a tie:

    >>> from pyproj import CRS
    >>> from msbdb.grid import lattice
    >>> z, none = np.array([[0.0, np.nan, np.nan, np.nan, 6.0]]), np.zeros((1, 5), dtype=np.float32)
    >>> samples = Samples(z, none, none, lattice((0, 0.1, 4.9, 0.9), 1.0, CRS.from_epsg(2154)))
    >>> fill_gaps(samples, 2.0)[0]
    array([[0., 0., 0., 6., 6.]])
    """
    above, below = _observed_rows(samples.observed)
    offsets = (samples.east, samples.north)
    return _fill(samples.z, offsets, (above, below), samples.spec.cell_m, reach_cells)


def nearest_cells(known: Mask, wanted: NDArray[np.integer], reach_cells: float) -> NDArray[np.int32]:
    """Return the nearest known cell of each wanted one, as a distance transform does, but no farther than a reach.

    Parameters
    ----------
    known : (H, W) ndarray of bool
        The cells that may be found.
    wanted : (N,) ndarray of int
        Flat indices of the cells that look for one.
    reach_cells : float
        Largest distance between the centres of two cells, in cells; infinity is allowed.

    Returns
    -------
    (N,) ndarray of int32
        Flat indices; -1 where no cell is near enough.

    Notes
    -----
    Of cells equally near, the western counts, then the northern: the rule of SciPy's distance transform. That transform
    goes to the end of each gap, and takes several times as long where the reach is a few cells. In each column the
    nearest known cells to the north and the south are compared.

    Examples
    --------
    >>> nearest_cells(np.array([[True, False, True, False, False]]), np.array([1, 3, 4]), 1.0)
    array([ 0,  2, -1], dtype=int32)
    """
    return _nearest_cells(_observed_rows(known), np.asarray(wanted, dtype=np.int64), float(reach_cells))


@kernel
def _nearest_cells(
    rows: tuple[NDArray[np.int32], NDArray[np.int32]], wanted: NDArray[np.int64], reach: float
) -> NDArray[np.int32]:
    """Search the nearest known cells by columns farther and farther away."""
    above, below = rows
    width = above.shape[1]
    found = np.full(wanted.size, np.int32(-1))
    for place in range(wanted.size):
        row, col = wanted[place] // width, wanted[place] % width
        best = np.iinfo(np.int64).max
        nearest_col = -1
        for step in range(width):
            if step > reach or step * step > best:
                break
            for side in range(2 if step else 1):
                c = col + step if side else col - step
                if c < 0 or c >= width:
                    continue
                for r in (above[row, c], below[row, c]):
                    if r < 0:
                        continue
                    squared = step * step + (r - row) ** 2
                    # The northern cell of a column comes first, so that of two it stays.
                    if squared < best or (squared == best and c < nearest_col):
                        best, nearest_col = squared, c
                        found[place] = r * width + c
        if math.sqrt(best) > reach:
            found[place] = -1
    return found


@kernel
def _observed_rows(observed: Mask) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Rows of the nearest observed cells of a column, up to and from each cell; -1 without one."""
    height, width = observed.shape
    above = np.full(observed.shape, np.int32(-1))
    below = np.full(observed.shape, np.int32(-1))
    for row in range(height):
        for col in range(width):
            if observed[row, col]:
                above[row, col] = row
            elif row > 0:
                above[row, col] = above[row - 1, col]
    for row in range(height - 1, -1, -1):
        for col in range(width):
            if observed[row, col]:
                below[row, col] = row
            elif row < height - 1:
                below[row, col] = below[row + 1, col]
    return above, below


@kernel
def _fill(
    z: Floats,
    offsets: tuple[NDArray[np.float32], NDArray[np.float32]],
    rows: tuple[NDArray[np.int32], NDArray[np.int32]],
    cell: float,
    reach: float,
) -> tuple[Floats, Mask]:
    """Take for each empty cell the nearest sample, searched by columns farther and farther away."""
    height, width = z.shape
    east, north = offsets
    above, below = rows
    filled = np.zeros(z.shape)
    valid = np.zeros(z.shape, dtype=np.bool_)
    limit = reach * reach * (1 + 1e-12)  # a distance of just the reach must not miss it by rounding
    for row in range(height):
        for col in range(width):
            if above[row, col] == row:
                filled[row, col] = z[row, col]
                valid[row, col] = True
                continue
            best = np.inf
            for step in range(width):
                # A sample lies at most half a cell nearer than the centre of its column.
                if step * step > limit or (max(step - 0.5, 0.0) * cell) ** 2 > best:
                    break
                for c in (col - step, col + step):
                    if c < 0 or c >= width:
                        continue
                    # Farther observed cells of the column cannot be nearer than these two.
                    for r in (above[row, c], below[row, c]):
                        if r < 0 or step * step + (r - row) ** 2 > limit:
                            continue
                        e = (c - col) * cell + east[r, c]
                        n = (row - r) * cell + north[r, c]
                        d = e * e + n * n
                        if d < best or (d == best and z[r, c] < filled[row, col]):
                            best = d
                            filled[row, col] = z[r, c]
                            valid[row, col] = True
    return filled, valid

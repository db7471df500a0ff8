"""Kernels of the spectral stage: sums of points over cells, filling of gaps, and the nearest centre.

All sums over points are of whole numbers in 64 bits, so that they are exact in any order of the points.
"""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from msbdb.threads import kernel

Frame = tuple[float, float, float]
"""West and north edge and cell size of a lattice, metres."""

STEPS = 256
"""Bilinear weights are whole multiples of 1/256."""

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


@kernel
def cells_of(x: Floats, y: Floats, used: Mask, frame: Frame, shape: tuple[int, int]) -> NDArray[np.int32]:
    """Flat index of the cell that holds each point; -1 for points that are not used or lie outside."""
    west, north, cell = frame
    found = np.full(x.size, np.int32(-1))
    for i in range(x.size):
        if used[i]:
            col = int(np.floor((x[i] - west) / cell))
            row = int(np.floor((north - y[i]) / cell))
            if 0 <= row < shape[0] and 0 <= col < shape[1]:
                found[i] = row * shape[1] + col
    return found


@kernel
def counts(cells: NDArray[np.int32], size: int) -> NDArray[np.int32]:
    """Count the points of each cell."""
    count = np.zeros(size, dtype=np.int32)
    for cell in cells:
        if cell >= 0:
            count[cell] += 1
    return count


@kernel
def means(
    cells: NDArray[np.int32], values: NDArray[np.uint16], count: NDArray[np.int32], out: NDArray[np.float32]
) -> None:
    """Write the mean value of each cell into ``out`` (flat); 0 where there is none."""
    total = np.zeros(out.size, dtype=np.int64)
    for i in range(cells.size):
        if cells[i] >= 0:
            total[cells[i]] += values[i]
    for cell in range(out.size):
        out[cell] = np.float32(total[cell] / max(count[cell], 1))


@kernel
def bilinear(
    xy: tuple[Floats, Floats], used: Mask, values: NDArray[np.uint16], frame: Frame, shape: tuple[int, int]
) -> tuple[NDArray[np.float32], Mask]:
    """Weighted mean of each cell over the points that have it among the four cell centres around them.

    Also returns which cells have any weight; the others are 0.
    """
    x, y = xy
    west, north, cell = frame
    rows, cols = shape
    # Sum and weight side by side, to touch the memory once a cell.
    sums = np.zeros((rows, cols, 2), dtype=np.int64)
    for i in range(x.size):
        if not used[i]:
            continue
        right = int(np.rint((x[i] - west) / cell * STEPS - STEPS / 2))
        down = int(np.rint((north - y[i]) / cell * STEPS - STEPS / 2))
        col, east = right // STEPS, right % STEPS
        row, south = down // STEPS, down % STEPS
        for below in range(2):
            r = row + below
            if r < 0 or r >= rows:
                continue
            for beside in range(2):
                c = col + beside
                if 0 <= c < cols:
                    share = (south if below else STEPS - south) * (east if beside else STEPS - east)
                    sums[r, c, 0] += share * values[i]
                    sums[r, c, 1] += share
    out = np.zeros(shape, dtype=np.float32)
    known = np.zeros(shape, dtype=np.bool_)
    for r in range(rows):
        for c in range(cols):
            if sums[r, c, 1] > 0:
                out[r, c] = np.float32(sums[r, c, 0] / sums[r, c, 1])
                known[r, c] = True
    return out, known


def fill_gaps(values: NDArray[np.float32], measured: Mask, cell_m: float, reach_m: float) -> Mask:
    """Give the cells that were not measured the values of the nearest one that was, within the reach.

    Parameters
    ----------
    values : (B, H, W) ndarray of float32
        Bands; written in place.
    measured : (H, W) ndarray of bool
        Which cells have a value.
    cell_m, reach_m : float
        Side of a cell, and the largest distance between the centres of two cells, metres.

    Returns
    -------
    (H, W) ndarray of bool
        Where there is a value now.

    Notes
    -----
    Of cells equally near, the western counts, then the northern: the rule of SciPy's distance transform.
    """
    valid = measured.copy()
    if not measured.any():
        return valid
    nearest = ndimage.distance_transform_edt(~measured, return_distances=False, return_indices=True)
    gap = np.nonzero(~measured)
    row, col = (index[gap].astype(np.int64) for index in nearest)
    reached = np.sqrt((row - gap[0]) ** 2 + (col - gap[1]) ** 2) * cell_m <= reach_m
    filled = gap[0][reached], gap[1][reached]
    values[:, *filled] = values[:, row[reached], col[reached]]
    valid[filled] = True
    return valid


@kernel
def nearest_centres(values: Floats, low: Floats, span: Floats, centres: Floats) -> NDArray[np.uint8]:
    """Class, from 1, of the centre nearest to each row (N, B), after scaling by ``low`` and ``span`` and clipping.

    Distances are summed a band at a time, so that they are the same on every machine; ties go to the lower class.
    """
    count, bands = values.shape
    nearest = np.zeros(count, dtype=np.uint8)
    scaled = np.empty(bands)
    for i in range(count):
        for band in range(bands):
            scaled[band] = min(max((values[i, band] - low[band]) / span[band], 0.0), 1.0)
        best = np.inf
        for number in range(len(centres)):
            distance = 0.0
            for band in range(bands):
                away = scaled[band] - centres[number, band]
                distance += away * away
            if distance < best:
                best = distance
                nearest[i] = number + 1
    return nearest

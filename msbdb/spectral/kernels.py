"""Kernels of the spectral stage: sums of points over cells, filling of gaps, and the nearest centre.

All sums over points are of whole numbers in 64 bits, so that they are exact in any order of the points.
"""

import numpy as np
from numpy.typing import NDArray

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


@kernel
def fill_gaps(values: NDArray[np.float32], measured: Mask, cell_m: float, reach_m: float) -> Mask:
    """Give the cells that were not measured the values (B, H, W) of the nearest one that was, within the reach.

    Works in place and returns where there is a value now. Of cells equally near, the western counts, then the
    northern. Cost: linear in the cells, times the reach for each gap.
    """
    bands, height, width = values.shape
    rows = _nearest_rows(measured)
    valid = measured.copy()
    for row in range(height):
        for col in range(width):
            if measured[row, col]:
                continue
            best, source = np.int64(-1), -1
            for step in range(width):
                near = np.int64(step) * step
                if np.sqrt(float(near)) * cell_m > reach_m or (source >= 0 and near > best):
                    break
                for side in range(2 if step else 1):
                    c = col + step if side else col - step
                    if c < 0 or c >= width or rows[row, c] < 0:
                        continue
                    away = np.int64(rows[row, c] - row)
                    square = near + away * away
                    if source < 0 or square < best or (square == best and c < source):
                        best, source = square, c
            if source >= 0 and np.sqrt(float(best)) * cell_m <= reach_m:
                valid[row, col] = True
                for band in range(bands):
                    values[band, row, col] = values[band, rows[row, source], source]
    return valid


@kernel
def _nearest_rows(measured: Mask) -> NDArray[np.int32]:
    """Row of the nearest measured cell of each cell's column, the northern of two; -1 where the column has none."""
    height, width = measured.shape
    rows = np.full(measured.shape, np.int32(-1))
    for row in range(height):
        for col in range(width):
            if measured[row, col]:
                rows[row, col] = row
            elif row > 0:
                rows[row, col] = rows[row - 1, col]
    for row in range(height - 2, -1, -1):
        for col in range(width):
            above, below = rows[row, col], rows[row + 1, col]
            if below > row and (above < 0 or below - row < row - above):
                rows[row, col] = below
    return rows


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

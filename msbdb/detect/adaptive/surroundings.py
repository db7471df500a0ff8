"""What lies around each point: the plane through its neighbours in a sphere, and means over a disc.

Several points of a row of cells, or several cells, are worked on side by side, one in each lane of the processor's wide
registers. Each lane sums what it would sum alone, in the same order, so that the results are the same.
"""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from msbdb.labels import look_up
from msbdb.points.cellindex import CellIndex, cell_place, index_cells, strip
from msbdb.threads import in_threads, kernel

Floats = NDArray[np.float64]

LEAST_POINTS = 5
"""A plane always fits fewer points, or nearly."""

SPLITS = 2
"""Cells to the radius of a sphere: finer ones than the radius let the window fit the disc better."""

SHARING = 4
"""Cells to the radius of means: the points of one cell share theirs."""

PARTS = 16
"""The work is cut into so many parts; their borders have no effect on the result."""

LANES = 16
"""So many points or cells are worked on side by side."""


def plane_residuals(x: Floats, y: Floats, z: Floats, radius_m: float) -> NDArray[np.float32]:
    """Return how far the neighbours of each point within a sphere lie from their best plane.

    Parameters
    ----------
    x, y, z : (N,) ndarray of float64, metres
        Finite coordinates.
    radius_m : float
        Radius of the sphere, metres.

    Returns
    -------
    (N,) ndarray of float32, metres
        Distance from the plane of least squares, upright ones included: the root of n/(n - 3) times the smallest
        eigenvalue of the covariance of n neighbours. The plane takes three degrees of freedom, so that crowns are as
        rough under few points as under many. Infinite for fewer than `LEAST_POINTS` points. The point is one of its
        neighbours.
    """
    index = index_cells(x, y, radius_m / SPLITS)
    found = np.empty(len(x), dtype=np.float32)
    sorted_points = Sorted(index, look_up(x, index.order), look_up(y, index.order), radius_m)
    sorted_z = look_up(z, index.order)
    in_threads(lambda part: _residuals(sorted_points, sorted_z, part, found), _parts(index))
    return found


def means_around(x: Floats, y: Floats, values: NDArray[np.float32], radius_m: float) -> NDArray[np.float32]:
    """Return the means over all points within a radius in plan.

    Parameters
    ----------
    x, y : (N,) ndarray of float64, metres
        Finite coordinates.
    values : (N, 3) ndarray of float32
        Finite. Overwritten by the means.
    radius_m : float
        Radius, metres.

    Returns
    -------
    (N, 3) ndarray of float32

    Notes
    -----
    The means vary little over a quarter of the radius. So the points of a cell of that side share one mean, over the
    disc around their own mean place. Where points are dense this takes a fraction of the time.
    """
    index = index_cells(x, y, radius_m / SHARING)
    sorted_points = Sorted(index, look_up(x, index.order), look_up(y, index.order), radius_m)
    sorted_values = np.ascontiguousarray(values[index.order])
    in_threads(lambda part: _means(sorted_points, sorted_values, part, values), _parts(index))
    return values


def _parts(index: CellIndex) -> list[tuple[int, int]]:
    """Cut the cells into parts of about equal numbers of points."""
    wanted = np.linspace(0, index.order.size, PARTS + 1)
    edges = np.unique(np.searchsorted(index.starts, wanted))
    return [(int(a), int(b)) for a, b in pairwise(edges)]


class Sorted(NamedTuple):
    """Points in the order of their cells, and the radius within which others are neighbours; for kernels."""

    cells: CellIndex
    x: Floats
    y: Floats
    radius_m: float


@kernel
def _residuals(points: Sorted, z: Floats, part: tuple[int, int], found: NDArray[np.float32]) -> None:
    """Fill in the residuals of the points of a part of the cells; z comes in the order of the cells."""
    # Each part writes only the points of its own cells, so threads share nothing and the parts have no effect.
    index, x, y, radius_m = points
    limit = radius_m * radius_m
    # Thirteen rows of lanes: the place of each lane's point, then the sums over its neighbours.
    lanes = np.empty(13 * LANES)
    cell = part[0]
    while cell < part[1]:
        row, col = cell_place(index, cell)
        after = _next_group(index, cell, part[1], SPLITS, by_points=True)
        last_col = col + index.keys[after - 1] - index.keys[cell]
        for begin in range(index.starts[cell], index.starts[after], LANES):
            count = min(LANES, index.starts[after] - begin)
            lanes[:] = 0.0
            for lane in range(count):
                lanes[lane], lanes[LANES + lane], lanes[2 * LANES + lane] = (
                    x[begin + lane],
                    y[begin + lane],
                    z[begin + lane],
                )
            # Cells are 1 / SPLITS of the radius wide: these rows hold all neighbours of all points of the cells.
            for other_row in range(row - SPLITS, row + SPLITS + 1):
                first, stop = strip(index, other_row, col - SPLITS, last_col + SPLITS)
                for other in range(first, stop):
                    _add_offsets(lanes, x[other], y[other], z[other], limit)
            for lane in range(count):
                found[index.order[begin + lane]] = _residual(lanes, lane)
        cell = after


@kernel
def _next_group(index: CellIndex, cell: int, stop: int, reach: int, by_points: bool) -> int:
    """Return the cell after those of a row that share the lanes with this one.

    There are as many as fill the lanes, by their points or by their number, without a gap wider than ``reach``.
    """
    row_end = (index.keys[cell] // index.shape[1] + 1) * index.shape[1]
    after = cell + 1
    while after < stop and index.keys[after] < row_end and index.keys[after] - index.keys[after - 1] <= reach:
        filled = index.starts[after + 1] - index.starts[cell] if by_points else after + 1 - cell
        if filled > LANES:
            break
        after += 1
    return after


@kernel
def _add_offsets(lanes: Floats, x: float, y: float, z: float, limit: float) -> None:
    """Add a point to the sums of each lane whose own point is near: its offset, and the offset's products."""
    # Sums of offsets from the lane's point itself, which are small, so that their squares keep their digits. What is
    # not near adds 0 rather than being left out: without a branch the lanes go together.
    for lane in range(LANES):
        dx, dy, dz = x - lanes[lane], y - lanes[LANES + lane], z - lanes[2 * LANES + lane]
        near = 1.0 if dx * dx + dy * dy + dz * dz <= limit else 0.0
        dx, dy, dz = dx * near, dy * near, dz * near
        lanes[3 * LANES + lane] += near
        lanes[4 * LANES + lane] += dx
        lanes[5 * LANES + lane] += dy
        lanes[6 * LANES + lane] += dz
        lanes[7 * LANES + lane] += dx * dx
        lanes[8 * LANES + lane] += dy * dy
        lanes[9 * LANES + lane] += dz * dz
        lanes[10 * LANES + lane] += dx * dy
        lanes[11 * LANES + lane] += dx * dz
        lanes[12 * LANES + lane] += dy * dz


@kernel
def _residual(lanes: Floats, lane: int) -> float:
    """Return the distance of a lane's neighbours from their best plane; infinite for too few of them."""
    n = lanes[3 * LANES + lane]
    if n < LEAST_POINTS:
        return np.inf
    mx, my, mz = lanes[4 * LANES + lane] / n, lanes[5 * LANES + lane] / n, lanes[6 * LANES + lane] / n
    xx, yy, zz = lanes[7 * LANES + lane] / n, lanes[8 * LANES + lane] / n, lanes[9 * LANES + lane] / n
    xy, xz, yz = lanes[10 * LANES + lane] / n, lanes[11 * LANES + lane] / n, lanes[12 * LANES + lane] / n
    squares = (xx - mx * mx, yy - my * my, zz - mz * mz)
    least = _least_eigenvalue(squares, (xy - mx * my, xz - mx * mz, yz - my * mz))
    return math.sqrt(max(least, 0.0) * n / (n - 3))


@kernel
def _least_eigenvalue(squares: tuple[float, float, float], products: tuple[float, float, float]) -> float:
    """Return the smallest eigenvalue of a symmetric matrix of xx, yy, zz and xy, xz, yz (Smith 1961)."""
    xx, yy, zz = squares
    xy, xz, yz = products
    # Without the mean of its diagonal the matrix has trace 0, and its eigenvalues are 2 spread cos(angle + 2πk/3).
    mean = (xx + yy + zz) / 3
    ax, ay, az = xx - mean, yy - mean, zz - mean
    spread = math.sqrt((ax * ax + ay * ay + az * az + 2 * (xy * xy + xz * xz + yz * yz)) / 6)
    if spread <= 0:
        return mean
    determinant = ax * (ay * az - yz * yz) - xy * (xy * az - yz * xz) + xz * (xy * yz - ay * xz)
    # Rounding may bring the cosine just beyond -1 or 1. The angle plus 2π/3 gives the smallest eigenvalue.
    cosine = min(1.0, max(-1.0, determinant / (2 * spread * spread * spread)))
    return mean + 2 * spread * math.cos(math.acos(cosine) / 3 + 2 * math.pi / 3)


@kernel
def _means(points: Sorted, values: NDArray[np.float32], part: tuple[int, int], found: NDArray[np.float32]) -> None:
    """Fill in the means about the points of a part of the cells; the values come in the order of the cells."""
    index, x, y, radius_m = points
    limit = radius_m * radius_m
    # Six rows of lanes: the mean place of each lane's cell, then the sums over the disc around it. Sums in float64 go
    # through the points in the order of the cells, so the means do not depend on the parts.
    lanes = np.empty(6 * LANES)
    cell = part[0]
    while cell < part[1]:
        row, col = cell_place(index, cell)
        after = _next_group(index, cell, part[1], SHARING, by_points=False)
        last_col = col + index.keys[after - 1] - index.keys[cell]
        lanes[:] = 0.0
        for lane in range(after - cell):
            begin, end = index.starts[cell + lane], index.starts[cell + lane + 1]
            lanes[lane], lanes[LANES + lane] = x[begin:end].mean(), y[begin:end].mean()
        for other_row in range(row - SHARING, row + SHARING + 1):
            first, stop = strip(index, other_row, col - SHARING, last_col + SHARING)
            for other in range(first, stop):
                _add_values(lanes, x[other], y[other], values[other], limit)
        for lane in range(after - cell):
            n = lanes[2 * LANES + lane]
            for point in range(index.starts[cell + lane], index.starts[cell + lane + 1]):
                own = found[index.order[point]]
                for value in range(3):
                    own[value] = lanes[(3 + value) * LANES + lane] / n
        cell = after


@kernel
def _add_values(lanes: Floats, x: float, y: float, values: NDArray[np.float32], limit: float) -> None:
    """Add a point's values to the sums of each lane whose cell is near."""
    one, two, three = values[0], values[1], values[2]
    for lane in range(LANES):
        dx, dy = x - lanes[lane], y - lanes[LANES + lane]
        near = 1.0 if dx * dx + dy * dy <= limit else 0.0
        lanes[2 * LANES + lane] += near
        lanes[3 * LANES + lane] += one * near
        lanes[4 * LANES + lane] += two * near
        lanes[5 * LANES + lane] += three * near

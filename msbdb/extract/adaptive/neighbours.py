"""What lies about a point: the residual of the plane through its neighbours, and means over them."""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from msbdb.morphology.points import CellIndex, cell_place, index_cells, strip
from msbdb.threads import in_threads, kernel

Floats = NDArray[np.float64]

LEAST_POINTS = 5
"""Through fewer points a plane fits always, or nearly."""

SPLITS = 2
"""Cells to the radius of a sphere: finer ones than the radius let the window fit the disc better."""

SHARING = 4
"""Cells to the radius of means: the points of one cell share theirs."""

PARTS = 16
"""Work is cut into so many parts; their borders change nothing."""


class Sorted(NamedTuple):
    """Points in the order of their cells, and the radius within which others are neighbours; for kernels."""

    cells: CellIndex
    x: Floats
    y: Floats
    radius_m: float


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
        Root mean square distance from the plane of least squares, upright ones included: the root of the smallest
        eigenvalue of the neighbours' covariance. Infinite for fewer than `LEAST_POINTS` points. The point is one of
        its neighbours.
    """
    index = index_cells(x, y, radius_m / SPLITS)
    found = np.empty(len(x), dtype=np.float32)
    sorted_points = Sorted(index, x[index.order], y[index.order], radius_m)
    sorted_z = z[index.order]
    in_threads(lambda part: _residuals(sorted_points, sorted_z, part, found), _parts(index))
    return found


def means_around(x: Floats, y: Floats, values: NDArray[np.float32], radius_m: float) -> NDArray[np.float32]:
    """Return the means over all points within a radius in plan.

    Parameters
    ----------
    x, y : (N,) ndarray of float64, metres
        Finite coordinates.
    values : (N, K) ndarray of float32
        Finite.
    radius_m : float
        Radius, metres.

    Returns
    -------
    (N, K) ndarray of float32

    Notes
    -----
    The means vary little over a quarter of the radius. So points in a cell of that side share the mean over the disc
    about the middle of them, which takes a fraction of the time where points are dense.
    """
    index = index_cells(x, y, radius_m / SHARING)
    found = np.empty(values.shape, dtype=np.float32)
    sorted_points = Sorted(index, x[index.order], y[index.order], radius_m)
    sorted_values = np.ascontiguousarray(values[index.order])
    in_threads(lambda part: _means(sorted_points, sorted_values, part, found), _parts(index))
    return found


def _parts(index: CellIndex) -> list[tuple[int, int]]:
    """Cut the cells into parts of about equal numbers of points."""
    wanted = np.linspace(0, index.order.size, PARTS + 1)
    edges = np.unique(np.searchsorted(index.starts, wanted))
    return [(int(a), int(b)) for a, b in pairwise(edges)]


@kernel
def _residuals(points: Sorted, z: Floats, part: tuple[int, int], found: NDArray[np.float32]) -> None:
    """Fill in the residuals of the points of a part of the cells; z comes in the order of the cells."""
    index, x, y, radius_m = points
    limit = radius_m * radius_m
    for cell in range(part[0], part[1]):
        row, col = cell_place(index, cell)
        strips = [strip(index, other, col - SPLITS, col + SPLITS) for other in range(row - SPLITS, row + SPLITS + 1)]
        for point in range(index.starts[cell], index.starts[cell + 1]):
            n, sx, sy, sz = 0, 0.0, 0.0, 0.0
            xx, yy, zz, xy, xz, yz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for first, stop in strips:
                for other in range(first, stop):
                    dx, dy, dz = x[other] - x[point], y[other] - y[point], z[other] - z[point]
                    if dx * dx + dy * dy + dz * dz <= limit:
                        n += 1
                        sx, sy, sz = sx + dx, sy + dy, sz + dz
                        xx, yy, zz = xx + dx * dx, yy + dy * dy, zz + dz * dz
                        xy, xz, yz = xy + dx * dy, xz + dx * dz, yz + dy * dz
            if n < LEAST_POINTS:
                found[index.order[point]] = np.inf
            else:
                mx, my, mz = sx / n, sy / n, sz / n
                squares = (xx / n - mx * mx, yy / n - my * my, zz / n - mz * mz)
                products = (xy / n - mx * my, xz / n - mx * mz, yz / n - my * mz)
                least = _least_eigenvalue(squares, products)
                found[index.order[point]] = math.sqrt(max(least, 0.0))


@kernel
def _least_eigenvalue(squares: tuple[float, float, float], products: tuple[float, float, float]) -> float:
    """Return the smallest eigenvalue of a symmetric matrix of xx, yy, zz and xy, xz, yz (Smith 1961)."""
    xx, yy, zz = squares
    xy, xz, yz = products
    mean = (xx + yy + zz) / 3
    ax, ay, az = xx - mean, yy - mean, zz - mean
    spread = math.sqrt((ax * ax + ay * ay + az * az + 2 * (xy * xy + xz * xz + yz * yz)) / 6)
    if spread <= 0:
        return mean
    determinant = ax * (ay * az - yz * yz) - xy * (xy * az - yz * xz) + xz * (xy * yz - ay * xz)
    cosine = min(1.0, max(-1.0, determinant / (2 * spread * spread * spread)))
    return mean + 2 * spread * math.cos(math.acos(cosine) / 3 + 2 * math.pi / 3)


@kernel
def _means(points: Sorted, values: NDArray[np.float32], part: tuple[int, int], found: NDArray[np.float32]) -> None:
    """Fill in the means about the points of a part of the cells; the values come in the order of the cells."""
    index, x, y, radius_m = points
    limit = radius_m * radius_m
    width = values.shape[1]
    sums = np.zeros(width, dtype=np.float64)
    for cell in range(part[0], part[1]):
        row, col = cell_place(index, cell)
        begin, end = index.starts[cell], index.starts[cell + 1]
        east, north = x[begin:end].mean(), y[begin:end].mean()
        sums[:] = 0.0
        n = 0
        for other_row in range(row - SHARING, row + SHARING + 1):
            first, stop = strip(index, other_row, col - SHARING, col + SHARING)
            for other in range(first, stop):
                dx, dy = x[other] - east, y[other] - north
                if dx * dx + dy * dy <= limit:
                    n += 1
                    for k in range(width):
                        sums[k] += values[other, k]
        for point in range(begin, end):
            for k in range(width):
                found[index.order[point], k] = sums[k] / n

"""The adaptive morphological filter of the Bathurst slides, on points (S2-S5)."""

import logging
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msbdb.ground.indicator import Profile, feature_sizes
from msbdb.ground.interpolation import edge_step
from msbdb.ground.lowpoints import LowPoints, PointFrame, cell_side, frame, low_points, require_points
from msbdb.ground.pointwindows import opening
from msbdb.params import GroundParams
from msbdb.points.cellindex import number_along
from msbdb.points.cloud import PointCloud
from msbdb.surface.gridding import density
from msbdb.threads import in_threads, kernel

logger = logging.getLogger(__name__)

Floats = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

DEFAULT_CELLS = 3.0
"""Half-width of the default window in cells: hedges, cars and single stems fit into it."""

SPARE_CELLS = 2
"""Empty cells beyond the default window that are no end of the data yet."""

SETTLED = 1e-3
"""Share of the low points that may still sink when the filter ends."""

CHUNK = 1 << 17
"""Points that a thread takes at a time."""


@dataclass(frozen=True, slots=True)
class AdaptiveWindows:
    """Sizes that the filter takes from the density, automatically (S12).

    Parameters
    ----------
    cell_m : float
        Side of the cells; the lowest point of each counts, metres.
    default_m : float
        Half-width of the default window, metres.
    """

    cell_m: float
    default_m: float


def adaptive_ground(points: PointCloud, params: GroundParams) -> Mask:
    """Detect ground points by openings whose windows follow the size of the feature under each point.

    Parameters
    ----------
    points : PointCloud
        N points, all echoes.
    params : GroundParams
        ``adaptive_*``, ``window_m``, ``height_m``, ``edge_step_m``, ``low_outlier_m`` and ``ground_cell_m``.

    Returns
    -------
    (N,) ndarray of bool
        Ground points.

    Raises
    ------
    NodataError
        Without points, or first echoes among them.
    InputError
        For coordinates that are not finite, or too scattered.

    Notes
    -----
    Only the lowest point of a small cell can be ground, so these points are opened; nothing is rasterised, the cells
    only find neighbours. One iteration has three steps:

    1. Profiles through each point measure the feature under it by their rises and falls (S4, S5).
    2. Its window reaches the foot of this feature; without a feature it is the default window.
    3. The heights are opened with these windows (S3), and enter the next iteration.

    So a tower sinks to its podium, and both to the ground. The iteration ends when less than a thousandth of the points
    sink, or after ``adaptive_iterations``. Points at most ``height_m`` above the opened heights are ground; on slopes
    the limit grows with the way to the cell's lowest point. How the indicator changes the window is ours: the slides
    do not say it.

    Border: the default window shrinks to the end of the data, so that slopes do not sink there; other windows are cut.
    A feature cut by the end of the data needs a fall on one side only.
    Nothing depends on the order of the points. Cost: linear in the points, times the reach of the profiles.
    """
    require_points(points)
    windows = automatic_windows(points, params)
    placed = frame(points, windows.cell_m, 2 * params.window_m + 4 * windows.cell_m)
    low, false = low_points(placed, params.low_outlier_m)
    opened = adaptive_opening(low, windows, params)
    return _near(placed, low, opened, params) & ~false


def automatic_windows(points: PointCloud, params: GroundParams) -> AdaptiveWindows:
    """Take the cell and the default window from the density, where the parameters do not give them."""
    cell_m = cell_side(density(points), params)
    return AdaptiveWindows(cell_m, params.adaptive_default_m or DEFAULT_CELLS * cell_m)


def adaptive_opening(low: LowPoints, windows: AdaptiveWindows, params: GroundParams) -> Floats:
    """Open the low points until they settle; heights (M,) in metres of the frame."""
    step_m = edge_step(params, windows.cell_m)
    profile = Profile(2 * params.window_m, step_m, max(params.adaptive_fall_m, step_m), params.adaptive_slope)
    heights = low.z
    default = _default(low.at, (low.u, low.v), windows.cell_m, windows.default_m)
    half = default
    for number in range(params.adaptive_iterations):
        firm = low.z - heights <= step_m  # points that have not sunk so far
        sizes = feature_sizes(low, heights, firm, windows.cell_m, profile)
        found = np.maximum(np.where(sizes > params.window_m, 0.0, sizes), default)
        # A point that sank keeps its window at least: its opened height no longer shows the feature.
        half = np.where(firm, found, np.maximum(half, found))
        opened = opening(low, heights, half, windows.cell_m)
        sunk = np.count_nonzero(heights - opened > params.height_m)
        logger.debug("adaptive filter, iteration %d: %d of %d points sank", number + 1, sunk, heights.size)
        heights = opened
        if sunk <= SETTLED * heights.size:
            break
    return heights


def _near(placed: PointFrame, low: LowPoints, opened: Floats, params: GroundParams) -> Mask:
    """Return the points that lie near the opened heights."""
    found = np.empty(placed.z.size, dtype=np.bool_)
    slopes = _slopes(low.at, opened, placed.cell_m, params.adaptive_slope)
    cloud, posts = (placed.u, placed.v, placed.z), (low.at, low.u, low.v, low.z, opened, slopes)
    rules = (placed.cell_m, params.height_m)
    spans = [(first, min(first + CHUNK, placed.z.size)) for first in range(0, placed.z.size, CHUNK)]
    in_threads(lambda span: _write_near(cloud, posts, rules, span, found), spans)
    return found


@kernel
def _default(at: Index, places: tuple[Floats, Floats], cell: float, most: float) -> Floats:
    """Half-width of the default window: less where the data end nearer, along a row or column of cells."""
    u, v = places
    reach = int(most / cell) + 1
    half = np.full(u.size, most)
    for row in range(at.shape[0]):
        for col in range(at.shape[1]):
            p = at[row, col]
            if p < 0:
                continue
            for down, across in ((1, 0), (-1, 0), (0, 1), (0, -1)):
                seen = 0.0  # how far the farthest point lies; `SPARE_CELLS` more cells decide whether it is the last
                for i in range(1, reach + SPARE_CELLS + 1):
                    r, c = row + i * down, col + i * across
                    if r < 0 or c < 0 or r >= at.shape[0] or c >= at.shape[1]:
                        break
                    q = at[r, c]
                    if q >= 0:
                        seen = max(abs(u[q] - u[p]), abs(v[q] - v[p]))
                half[p] = min(half[p], seen)
    return half


@kernel
def _slopes(at: Index, z: Floats, cell: float, most: float) -> Floats:
    """Slope of the opened heights about each low point: their range over the cells around, by the way across."""
    slopes = np.zeros(z.size)
    height, width = at.shape
    for row in range(height):
        for col in range(width):
            p = at[row, col]
            if p < 0:
                continue
            lowest, highest = z[p], z[p]
            for r in range(max(row - 1, 0), min(row + 2, height)):
                for c in range(max(col - 1, 0), min(col + 2, width)):
                    q = at[r, c]
                    if q >= 0:
                        lowest, highest = min(lowest, z[q]), max(highest, z[q])
            slopes[p] = min((highest - lowest) / (2 * cell), most)
    return slopes


@kernel
def _write_near(
    cloud: tuple[Floats, Floats, Floats],
    posts: tuple[Index, Floats, Floats, Floats, Floats, Floats],
    rules: tuple[float, float],
    span: tuple[int, int],
    found: Mask,
) -> None:
    """Write which points of a span lie near the opened height of their cell, and have not sunk with its lowest."""
    x, y, z = cloud
    at, u, v, lowest, opened, slopes = posts
    cell, height = rules
    for i in range(span[0], span[1]):
        p = at[int(number_along(y[i], cell)), int(number_along(x[i], cell))]
        if p < 0:
            found[i] = False
            continue
        way = np.sqrt((x[i] - u[p]) ** 2 + (y[i] - v[p]) ** 2)
        # Where even the lowest point of the cell has sunk, no point of the cell is ground.
        ground = lowest[p] - opened[p] <= height + slopes[p] * cell
        found[i] = ground and z[i] - opened[p] <= height + slopes[p] * max(way, cell)

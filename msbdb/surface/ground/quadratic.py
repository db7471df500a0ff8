"""Ground heights of points by quadratic surfaces in sliding windows (Cao & Wu, C13, Eqs. 4 to 6)."""

import logging
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msbdb.morphology.points.graph import PointGraph, connect
from msbdb.order import order_of_points
from msbdb.params import GroundParams
from msbdb.pointcloud import PointCloud
from msbdb.surface.gridding import density
from msbdb.surface.ground.frames import Frame, cell_side, frame, require_points
from msbdb.surface.ground.lowpoints import low_points
from msbdb.surface.ground.slidingfit import slide
from msbdb.threads import in_threads

logger = logging.getLogger(__name__)

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

STRIPES = 4
"""Parts of the rows of windows that threads work on; joined by minima, so that their number changes nothing."""


@dataclass(frozen=True, slots=True)
class Windows:
    """What the windows need.

    Parameters
    ----------
    step_m : float
        Sliding step ss, metres.
    steps : int
        Steps a window is wide; w = steps · ss.
    link_m : float
        T_c: points nearer than this are connected, metres.
    area : int
        T_a: points of the smallest component that stays.
    """

    step_m: float
    steps: int
    link_m: float
    area: int


def quadratic_ground(points: PointCloud, params: GroundParams) -> Mask:
    """Tell ground points: those at most ``height_m`` above their ground height that are no false echoes from below.

    Returns
    -------
    (N,) ndarray of bool
        Ground points.

    Raises
    ------
    NodataError, InputError
        As `ground_heights`.
    """
    gz = ground_heights(points, params)
    cell_m = cell_side(density(points), params)
    _, false = low_points(frame(points, cell_m, 10 * cell_m), params.low_outlier_m)
    return np.asarray(points.z - gz <= params.height_m) & ~false


def ground_heights(points: PointCloud, params: GroundParams) -> Floats:
    """Return the ground height Gz of every point; z - Gz is its height in the normalised cloud nPC (Eq. 6).

    Parameters
    ----------
    points : PointCloud
        N points, all echoes.
    params : GroundParams
        The ``quadratic_*``.

    Returns
    -------
    (N,) ndarray of float64, metres
        Never above the point itself.

    Raises
    ------
    NodataError
        Without points, or first echoes among them.
    InputError
        For coordinates that are not finite, or too scattered.

    Notes
    -----
    In each window h is the median height of its points, and the on-set those at least as high (C1). The on-set is
    opened and then the off-set closed by T_a, with connections inside of the window only (C2 to C6); what opening
    removes joins the off-set and what closing removes the on-set. The quadratic of Eq. 4, fitted to the off-set by
    least squares, gives the points of the on-set their ground, of which the lowest over all windows stays (Eq. 5).
    Off-set points of all windows keep Gz = z.

    A second time over (``quadratic_passes``; the paper's is 1) the windows slide over the ground heights found, and
    what stands ``quadratic_again_m`` above the fit sinks to it: where more than half of a window is built, its median
    is a roof, and only what is higher than that sinks at once.

    Ours: the windows lie on the lattice of the sliding step, so that a survey cut in tiles has the same ones. Where
    fewer than six points are off, or they do not determine the surface (on a line, or a narrow strip), the window
    grows by a step to all sides, ``quadratic_growth`` times; then it is left out. T_a is an area, taken times the
    density (A17), and T_c a number of point spacings.

    Border: windows are cut at the data, by less than a step. Nothing depends on the order of the points.
    Cost: linear in the points, times the windows that hold each, (w / ss)², times the passes.
    """
    require_points(points)
    order = order_of_points(points.x, points.y, [points.z])
    windows = automatic_windows(points, params)
    gap_m = (windows.steps + 2 * params.quadratic_growth + 1) * windows.step_m
    placed = frame(points.take(order), windows.step_m, max(gap_m, 2 * windows.link_m))
    graph = connect(placed.u, placed.v, placed.z, windows.link_m)
    growth = params.quadratic_growth
    ground = np.minimum(placed.z, _slide(placed, placed.z, graph, windows, growth))
    for _ in range(1, params.quadratic_passes):
        fitted = _slide(placed, ground, graph, windows, growth)
        ground = np.where(ground - fitted > params.quadratic_again_m, fitted, ground)
    gz = np.empty(len(points))
    gz[order] = points.z[order] - (placed.z - ground)
    return gz


def automatic_windows(points: PointCloud, params: GroundParams) -> Windows:
    """Take T_c and T_a from the density."""
    first_m2 = density(points)
    all_m2 = first_m2 * len(points) / np.count_nonzero(points.first_echo)
    steps = max(round(params.quadratic_window_m / params.quadratic_step_m), 1)
    return Windows(
        params.quadratic_step_m,
        steps,
        params.quadratic_link / float(np.sqrt(first_m2)),
        max(round(params.quadratic_area_m2 * all_m2), 1),
    )


def _slide(placed: Frame, ground: Floats, graph: PointGraph, windows: Windows, growth: int) -> Floats:
    """Return the lowest fitted height of each point over all windows; infinity where there is none."""
    rows, cols = placed.shape
    keys = np.floor(placed.v / placed.cell_m).astype(np.int64) * cols
    keys += np.floor(placed.u / placed.cell_m).astype(np.int64)
    members = np.argsort(keys, kind="stable")
    starts = np.concatenate([[0], np.cumsum(np.bincount(keys, minlength=rows * cols))])
    last = max(rows - windows.steps, 0) + 1
    cuts = np.linspace(0, last, min(STRIPES, last) + 1).astype(np.int64)
    rules = (placed.cell_m, windows.steps, windows.area, growth)

    def work(stripe: int) -> Floats:
        return slide(
            (members, starts, placed.shape),
            (placed.u, placed.v, ground),
            (graph.indptr, graph.indices),
            rules,
            (int(cuts[stripe]), int(cuts[stripe + 1])),
        )

    found: Floats = np.minimum.reduce(in_threads(work, range(cuts.size - 1)))
    logger.debug("quadratic filter: %d of %d points got a fitted ground", np.isfinite(found).sum(), found.size)
    return found

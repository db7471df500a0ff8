"""Ground heights of points by quadratic surfaces in sliding windows (Cao & Wu, C13, Eqs. 4 to 6).

In each window an area opening and closing find the off-set, and a quadratic surface is fitted to it.
"""

import logging
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msbdb.grid import cell_along
from msbdb.ground.lowpoints import PointFrame, cell_side, frame, low_points, require_points
from msbdb.order import order_of_points
from msbdb.params import GroundParams
from msbdb.points.cloud import PointCloud
from msbdb.points.graph import PointGraph, connect
from msbdb.surface.gridding import density
from msbdb.threads import in_threads, kernel

logger = logging.getLogger(__name__)

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]
States = NDArray[np.int8]
Cloud = tuple[Floats, Floats, Floats]
Graph = tuple[NDArray[np.int64], NDArray[np.int32]]

STRIPES = 4
"""Parts of the rows of windows that threads work on; joined by minima, so that their number changes nothing."""

OUTSIDE, ON, OFF = 0, 1, 2
"""States of a point: not in the window, in its on-set, in its off-set."""

TERMS = 6
"""Coefficients of Eq. 4, and the fewest points of the off-set."""

DETERMINED = 1e-7
"""Least share of a term's variance that the terms before it do not explain; below, the points do not determine it."""


@dataclass(frozen=True, slots=True)
class SlidingWindows:
    """Sizes of the sliding windows.

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
    """Detect ground points: at most ``height_m`` above their ground height, and no false echoes from below.

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
    Each window takes these steps:

    1. h is the median height of its points, and the on-set are the points at least as high (C1).
    2. The on-set is opened and then the off-set closed by T_a, with connections inside of the window only (C2 to C6).
       Points removed by the opening join the off-set, points removed by the closing the on-set.
    3. The surface z = a0 + a1 x + a2 y + a3 xy + a4 x² + a5 y² (Eq. 4) is fitted to the off-set by least squares.
    4. It gives the points of the on-set their ground. The lowest over all windows stays (Eq. 5).

    Points in the off-set of all their windows keep Gz = z.

    The windows slide ``quadratic_passes`` times (the paper: once), from the second time on over the ground heights
    found. Points ``quadratic_again_m`` above the fit sink to it. The first pass does not suffice where more than half
    of a window is built: its median is a roof, and only higher points sink.

    Ours: the windows lie on the lattice of the sliding step, so that a survey cut in tiles has the same ones. The
    off-set may have fewer than six points, or not determine the surface (on a line, or a narrow strip). Then the window
    grows by a step to all sides, up to ``quadratic_growth`` times; after that it is left out. T_a is an area times the
    density (A17), and T_c a number of point spacings.

    Border: windows are cut at the data, by less than a step. Nothing depends on the order of the points.
    Cost: linear in the points, times the windows that hold each, (w / ss)², times the passes.
    """
    require_points(points)
    order = order_of_points(points.x, points.y, [points.z])
    windows = automatic_sliding_windows(points, params)
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


def automatic_sliding_windows(points: PointCloud, params: GroundParams) -> SlidingWindows:
    """Take T_c and T_a from the density."""
    first_m2 = density(points)
    all_m2 = first_m2 * len(points) / np.count_nonzero(points.first_echo)
    steps = max(round(params.quadratic_window_m / params.quadratic_step_m), 1)
    return SlidingWindows(
        params.quadratic_step_m,
        steps,
        params.quadratic_link / float(np.sqrt(first_m2)),
        max(round(params.quadratic_area_m2 * all_m2), 1),
    )


def _slide(placed: PointFrame, ground: Floats, graph: PointGraph, windows: SlidingWindows, growth: int) -> Floats:
    """Return the lowest fitted height of each point over all windows; infinity without a fit."""
    rows, cols = placed.shape
    keys = cell_along(placed.v, placed.cell_m).astype(np.int64) * cols
    keys += cell_along(placed.u, placed.cell_m).astype(np.int64)
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


@kernel
def slide(
    bins: tuple[Index, Index, tuple[int, int]],
    cloud: Cloud,
    graph: Graph,
    rules: tuple[float, int, int, int],
    rows: tuple[int, int],
) -> Floats:
    """Slide the window over a stripe of rows.

    Parameters
    ----------
    bins : tuple
        The points by cells of the sliding step in row-major order, the start of each cell in them, and their shape.
    cloud : tuple of (N,) ndarray of float64
        Local coordinates, metres.
    graph : tuple of ndarray
        Compressed rows of each point's neighbours.
    rules : tuple
        Sliding step in metres, steps a window is wide, points of T_a, and steps it may grow.
    rows : tuple of int
        First row of windows, and one past the last.

    Returns
    -------
    (N,) ndarray of float64, metres
        The lowest fitted height of each point while it was in an on-set; infinity where it never was.
    """
    members, starts, shape = bins
    step, wide, area, growth = rules
    x, y, z = cloud
    found = np.full(z.size, np.inf)
    state = np.zeros(z.size, dtype=np.int8)
    parent = np.zeros(z.size, dtype=np.int64)
    size = np.zeros(z.size, dtype=np.int64)
    for row in range(rows[0], rows[1]):
        for col in range(max(shape[1] - wide, 0) + 1):
            # Invariant: outside of this loop body every point's state is OUTSIDE, so that windows share one array.
            for grown in range(growth + 1):
                ids = _inside(
                    members, starts, shape, (row - grown, row + wide + grown), (col - grown, col + wide + grown)
                )
                if ids.size == 0:
                    break
                middle = np.median(z[ids])
                for i in ids:
                    state[i] = ON if z[i] >= middle else OFF
                _remove_small(ids, state, graph, (ON, area), (parent, size))
                _remove_small(ids, state, graph, (OFF, area), (parent, size))
                centre = ((col + 0.5 * wide) * step, (row + 0.5 * wide) * step, middle, 0.5 * step * (wide + 2 * grown))
                fit, determined = _fit(ids, state, cloud, centre)
                if determined:
                    for i in ids:
                        if state[i] == ON:
                            found[i] = min(found[i], _height(fit, x[i], y[i], centre))
                for i in ids:
                    state[i] = OUTSIDE
                if determined:
                    break
    return found


@kernel
def _inside(
    members: Index, starts: Index, shape: tuple[int, int], rows: tuple[int, int], cols: tuple[int, int]
) -> Index:
    """Return the points of a window, ascending by cell and then in their own order."""
    first_row, last_row = max(rows[0], 0), min(rows[1], shape[0])
    first_col, last_col = max(cols[0], 0), min(cols[1], shape[1])
    # The points of a row of cells are one stretch of members.
    count = 0
    for row in range(first_row, last_row):
        count += starts[row * shape[1] + last_col] - starts[row * shape[1] + first_col]
    ids = np.empty(count, dtype=np.int64)
    count = 0
    for row in range(first_row, last_row):
        for n in range(starts[row * shape[1] + first_col], starts[row * shape[1] + last_col]):
            ids[count] = members[n]
            count += 1
    return ids


@kernel
def _remove_small(ids: Index, state: States, graph: Graph, rule: tuple[int, int], sets: tuple[Index, Index]) -> None:
    """Give the components of one state with fewer points than an area the other state (C4, C5)."""
    (which, area), (parent, size) = rule, sets
    if area <= 1:
        return
    indptr, indices = graph
    for i in ids:
        parent[i] = i
        size[i] = 0
    for i in ids:
        if state[i] != which:
            continue
        for n in range(indptr[i], indptr[i + 1]):
            j = np.int64(indices[n])
            if j < i and state[j] == which:  # each pair once; points outside of the window have another state
                a, b = _root(parent, i), _root(parent, j)
                if a != b:
                    parent[max(a, b)] = min(a, b)
    for i in ids:
        if state[i] == which:
            size[_root(parent, i)] += 1
    for i in ids:
        if state[i] == which and size[_root(parent, i)] < area:
            state[i] = ON + OFF - which


@kernel
def _root(parent: Index, i: np.int64) -> np.int64:
    """Find the representative of a set, halving the path."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@kernel
def _terms(x: float, y: float, centre: tuple[float, float, float, float], terms: Floats) -> None:
    """Write the terms of Eq. 4 in coordinates from the window's centre, in halves of its width."""
    u, v = (x - centre[0]) / centre[3], (y - centre[1]) / centre[3]
    terms[0], terms[1], terms[2] = 1.0, u, v
    terms[3], terms[4], terms[5] = u * v, u * u, v * v


@kernel
def _height(fit: Floats, x: float, y: float, centre: tuple[float, float, float, float]) -> float:
    """Height of the fitted surface at a place."""
    u, v = (x - centre[0]) / centre[3], (y - centre[1]) / centre[3]
    height: float = fit[0] + centre[2] + fit[1] * u + fit[2] * v + fit[3] * u * v + fit[4] * u * u + fit[5] * v * v
    return height


@kernel
def _fit(ids: Index, state: States, cloud: Cloud, centre: tuple[float, float, float, float]) -> tuple[Floats, bool]:
    """Fit Eq. 4 to the off-set by least squares; the flag is set where its points determine all six terms."""
    x, y, z = cloud
    normal = np.zeros((TERMS, TERMS))
    right = np.zeros(TERMS)
    terms = np.empty(TERMS)
    count = 0
    for i in ids:
        if state[i] != OFF:
            continue
        count += 1
        _terms(x[i], y[i], centre, terms)
        height = z[i] - centre[2]  # from the median: small numbers keep their digits
        for a in range(TERMS):
            right[a] += terms[a] * height
            for b in range(a + 1):
                normal[a, b] += terms[a] * terms[b]
    if count < TERMS:
        return right, False
    return _solve(normal, right)


@kernel
def _solve(normal: Floats, right: Floats) -> tuple[Floats, bool]:
    """Solve the normal equations by Cholesky's decomposition of their lower triangle, unless they are deficient."""
    for a in range(TERMS):
        own = normal[a, a]
        for b in range(a):
            for c in range(b):
                normal[a, b] -= normal[a, c] * normal[b, c]
            normal[a, b] /= normal[b, b]
            normal[a, a] -= normal[a, b] ** 2
        # What remains of the term's variance after the terms before it; written so that NaN is refused.
        if not normal[a, a] > DETERMINED * own:
            return right, False
        normal[a, a] = np.sqrt(normal[a, a])
        for b in range(a):
            right[a] -= normal[a, b] * right[b]
        right[a] /= normal[a, a]
    for a in range(TERMS - 1, -1, -1):
        for b in range(a + 1, TERMS):
            right[a] -= normal[b, a] * right[b]
        right[a] /= normal[a, a]
    return right, True

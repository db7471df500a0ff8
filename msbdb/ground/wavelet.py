"""The wavelet-based clustering filter, the ground filter that the multi-scale paper names (V16)."""

import logging
import math

import numpy as np
from numpy.typing import NDArray

from msbdb.grid import Grid
from msbdb.ground.interpolation import count_edges, edge_step, interpolate_ground
from msbdb.labels import chosen_cells, label_zones
from msbdb.params import GroundParams

logger = logging.getLogger(__name__)

Heights = NDArray[np.float32]
Mask = NDArray[np.bool_]


def wavelet_ground(surface: Grid, params: GroundParams) -> Mask:
    """Detect ground cells by clustering the wavelet details of each resolution, from coarse to fine.

    Parameters
    ----------
    surface : Grid
        Lowest heights, gap-free, metres.
    params : GroundParams
        Twice ``window_m`` is the coarsest resolution; the ``edge_*`` and ``wavelet_cluster_m`` judge the clusters.

    Returns
    -------
    ndarray of bool, (H, W)
        Ground cells.

    Notes
    -----
    Published (Vu, Yamazaki and Tokunaga 2002, and the abstract of Vu and Tokunaga 2004): the gridded heights are
    decomposed by the à trous algorithm into a family of smooth and detail images; K-means groups the cells of each
    resolution into clusters. The boundaries of an object's cluster persist across resolutions, those of small objects
    on the fine ones only. So no size of kernel has to be chosen.

    Our reading, for the parts that these sources leave open: resolutions are taken from coarse to fine, and on each

    1. the details are the heights less their B3-spline smoothing to that resolution, w_1 + ... + w_k;
    2. K-means with K = 2 separates the cells that still count as ground by their details, unless both centres lie
       nearer to each other than ``wavelet_cluster_m``;
    3. an 8-connected cluster of the high class is off-terrain when at least ``edge_share`` of its boundary cells are
       edges: ``edge_step_m`` above the lowest ground beside them, at the finest resolution. This separates roofs from
       hills, whose boundaries are smooth;
    4. off-terrain cells are filled from the ground around before the next resolution.

    Not taken over: the median filter before the decomposition (low outliers are gone already, and step 4 keeps
    the edges), and the operator's choice of the resolutions. Like the published method it clusters all cells at
    once, so that its result depends on the extent of the data; the progressive filter does not.

    On towns laid over hills it loses ground that the progressive filter keeps: above 10 % of slope take that filter.

    Border: the outermost cell is repeated. Cost: some 7 levels, each with its smoothing, labelling and filling.

    References
    ----------
    Vu, T. T. and Tokunaga, M. (2004). Filtering airborne laser scanner data: a wavelet-based clustering method.
    PE&RS 70(11), 1267-1274. doi:10.14358/PERS.70.11.1267
    Vu, T. T., Yamazaki, F. and Tokunaga, M. (2002). Wavelet-based filtering the cloud points derived from airborne
    laser scanner. Proc. 23rd Asian Conference on Remote Sensing.
    """
    heights = np.asarray(surface.values, dtype=np.float32)
    ground = np.ones(heights.shape, dtype=np.bool_)
    terrain = heights
    coarsest = max(round(math.log2(max(2 * params.window_m / surface.spec.cell_m, 2.0))), 1)
    for level in range(coarsest, 0, -1):
        off = _off_terrain(surface, terrain, ground, level, params)
        if off.any():
            ground &= ~off
            terrain = np.asarray(interpolate_ground(heights, ground, surface.spec).values, dtype=np.float32)
        logger.debug("wavelet filter, level %d: %d ground cells", level, np.count_nonzero(ground))
    return ground


def smooth_b3(values: Heights, level: int) -> Heights:
    """Smooth by the à trous algorithm with the B3 spline, up to a dyadic level.

    Level j convolves both axes with (1, 4, 6, 4, 1)/16, its taps 2^j cells apart; the outermost cell is repeated.

    Examples
    --------
    >>> smooth_b3(np.array([[0, 0, 0, 16, 0, 0, 0]], dtype=np.float32), 1)
    array([[0., 1., 4., 6., 4., 1., 0.]], dtype=float32)
    """
    for spread in (2**j for j in range(level)):
        for axis in (0, 1):
            values = _spline_pass(values, spread, axis)
    return values


def _spline_pass(values: Heights, spread: int, axis: int) -> Heights:
    """Convolve one axis with the B3 spline; shifted views, since a dilated kernel is mostly zeros."""
    pad = [(0, 0), (0, 0)]
    pad[axis] = (2 * spread, 2 * spread)
    padded = np.moveaxis(np.pad(values, pad, mode="edge"), axis, 0)
    length = values.shape[axis]
    far, near, own, near2, far2 = (padded[i * spread : i * spread + length] for i in range(5))
    mean = (far + far2) * np.float32(1 / 16) + (near + near2) * np.float32(4 / 16) + own * np.float32(6 / 16)
    return np.ascontiguousarray(np.moveaxis(mean, 0, axis))


def two_means(values: NDArray[np.floating]) -> tuple[float, float]:
    """Return the two centres of a 1-D K-means with K = 2.

    In one dimension a threshold separates the clusters, so the best of all partitions is found by trying each. There
    are no seeds, and no local optimum can hide a few roofs behind the noise of much ground.

    Examples
    --------
    >>> two_means(np.array([0.0, 0.2, 5.0, 5.2, 5.4]))
    (0.1, 5.2)
    """
    ordered = np.sort(values.astype(np.float64))
    if ordered[0] == ordered[-1]:
        return float(ordered[0]), float(ordered[0])
    ordered_sum = np.cumsum(ordered)
    below = np.arange(1, ordered.size)
    above = ordered.size - below
    low, high = ordered_sum[:-1] / below, (ordered_sum[-1] - ordered_sum[:-1]) / above
    best = int(np.argmax(below * above * (high - low) ** 2))
    return float(low[best]), float(high[best])


def _off_terrain(surface: Grid, terrain: Heights, ground: Mask, level: int, params: GroundParams) -> Mask:
    """Return the ground cells that one resolution shows to be off-terrain."""
    heights, step_m = np.asarray(surface.values, dtype=np.float32), edge_step(params, surface.spec.cell_m)
    details = terrain - smooth_b3(terrain, level)
    low, high = two_means(details[ground])
    if high - low < params.wavelet_cluster_m:
        return np.zeros(ground.shape, dtype=np.bool_)
    raised = ground & (details > (low + high) / 2)
    labels, count = label_zones(raised)
    beside_ground = np.where(ground & ~raised, heights, np.float32(np.inf))
    beside_filled = np.where(ground, np.float32(np.inf), terrain)
    boundary, edges = count_edges(labels, count, heights, beside_ground, step_m)
    inner_boundary, inner_edges = count_edges(labels, count, heights, beside_filled, step_m)
    # A cluster without any ground beside it, as a roof in the gap of others, is compared with the filled terrain.
    edges = np.where(boundary > 0, edges, inner_edges)
    boundary = np.where(boundary > 0, boundary, inner_boundary)
    off = edges >= params.edge_share * np.maximum(boundary, 1)
    return chosen_cells(labels, off)

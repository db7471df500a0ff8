"""The wavelet-based clustering filter, the ground filter that the multi-scale paper names (V16)."""

import logging
import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label, minimum_filter

from msbdb.grid import Grid
from msbdb.params import GroundParams
from msbdb.surface.ground.interpolate import interpolate_ground

logger = logging.getLogger(__name__)

EIGHT = np.ones((3, 3), dtype=np.bool_)
LLOYD_LIMIT = 100
"""Most rounds of one 2-means; it converges in far fewer."""

Heights = NDArray[np.float32]
Mask = NDArray[np.bool_]


def wavelet_ground(surface: Grid, params: GroundParams) -> Mask:
    """Tell ground cells by clustering the wavelet details of each resolution, from coarse to fine.

    Parameters
    ----------
    surface : Grid
        Lowest heights, gap-free, metres.
    params : GroundParams
        Twice ``window_m`` is the coarsest resolution; the ``wavelet_*`` values judge the clusters.

    Returns
    -------
    ndarray of bool, (H, W)
        Ground cells.

    Notes
    -----
    Published (Vu, Yamazaki and Tokunaga 2002, and the abstract of Vu and Tokunaga 2004): the gridded heights are
    decomposed by the à trous algorithm into a family of smooth and detail images; K-means groups the cells of each
    resolution into clusters; objects show as clusters whose boundaries persist across resolutions, small ones only
    on the fine ones, so that no size of kernel has to be chosen.

    Our reading, for the parts that these sources leave open: resolutions are taken from coarse to fine, and on each

    1. the details are the heights less their B3-spline smoothing to that resolution, w_1 + ... + w_k;
    2. K-means with K = 2 parts the cells that still count as ground by their details, unless both centres lie
       nearer to each other than ``wavelet_cluster_m``;
    3. an 8-connected cluster of the high class is off-terrain when on at least ``wavelet_edge_share`` of its
       boundary it stands ``wavelet_step_m`` above its lowest neighbour of the ground, at the finest resolution:
       this is what tells roofs from hills, whose boundaries are smooth;
    4. off-terrain cells are filled from the ground around before the next resolution.

    Not taken over: the median filter before the decomposition (low outliers are gone already, and step 4 keeps
    the edges), and the operator's choice of the resolutions. Like the published method it clusters all cells at
    once, so that its result depends on the extent of the data; the progressive filter does not.

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
        off = _off_terrain(heights, terrain, ground, level, params)
        if off.any():
            ground &= ~off
            terrain = np.asarray(interpolate_ground(heights, ground, surface.spec).values, dtype=np.float32)
        logger.debug("wavelet filter, level %d: %d ground cells", level, np.count_nonzero(ground))
    return ground


def smooth_b3(values: Heights, level: int) -> Heights:
    """Smooth by the à trous algorithm with the B3 spline, up to a dyadic level.

    Level j convolves both axes with (1, 4, 6, 4, 1)/16, its taps 2^j cells apart; the outermost cell is repeated.
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
    """Return the two centres of a 1-D K-means with K = 2, seeded by the first and the last decile.

    Examples
    --------
    >>> two_means(np.array([0.0, 0.2, 5.0, 5.2, 5.4]))
    (0.1, 5.2)
    """
    values = np.sort(values.astype(np.float64))
    total = np.concatenate([[0.0], np.cumsum(values)])
    low, high = np.quantile(values, [0.1, 0.9])
    for _ in range(LLOYD_LIMIT):
        cut = int(np.searchsorted(values, (low + high) / 2, side="right"))
        if cut in (0, values.size):
            break
        before = (low, high)
        low, high = total[cut] / cut, (total[-1] - total[cut]) / (values.size - cut)
        if (low, high) == before:
            break
    return float(low), float(high)


def _off_terrain(heights: Heights, terrain: Heights, ground: Mask, level: int, params: GroundParams) -> Mask:
    """Return the ground cells that one resolution tells to be off-terrain."""
    details = terrain - smooth_b3(terrain, level)
    low, high = two_means(details[ground])
    if high - low < params.wavelet_cluster_m:
        return np.zeros(ground.shape, dtype=np.bool_)
    raised = ground & (details > (low + high) / 2)
    labels, count = label(raised, EIGHT)
    beside_ground = np.where(ground & ~raised, heights, np.inf)
    beside_filled = np.where(ground, np.inf, terrain)
    edge, steep = _boundary(labels, count, heights, beside_ground, params.wavelet_step_m)
    inner_edge, inner_steep = _boundary(labels, count, heights, beside_filled, params.wavelet_step_m)
    # A cluster without any ground beside it, as a roof in the gap of others, is judged by the filled terrain.
    edge, steep = np.where(edge > 0, edge, inner_edge), np.where(edge > 0, steep, inner_steep)
    off = steep >= params.wavelet_edge_share * np.maximum(edge, 1)
    off[0] = False
    return np.asarray(off[labels], dtype=np.bool_)


def _boundary(
    labels: NDArray[np.int32], count: int, heights: Heights, beside: Heights, step_m: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Count the cells of each cluster that touch a finite neighbour, and those that stand a step above it."""
    lowest = minimum_filter(beside, 3, mode="nearest")
    touching = (labels > 0) & np.isfinite(lowest)
    steep = touching & (heights - np.where(touching, lowest, 0) > step_m)
    return np.bincount(labels[touching], minlength=count + 1), np.bincount(labels[steep], minlength=count + 1)

"""The trend of the terrain: a smooth surface near the lowest points, whatever stands on it, or through known ground.

Blocks lie on the absolute lattice, and what is farther than a hundred metres counts only where no ground is nearer. So
the parts of a survey have the trend of the whole.
"""

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_cdt, uniform_filter

from msbdb.grid import Grid
from msbdb.params import GroundParams

Floats = NDArray[np.float64]
Height = TypeVar("Height", np.float32, np.float64)

REACH = 4
"""Blocks on each side of a block that its plane is fitted to; they weigh by a Gaussian of half of this."""

ROUNDS = 12
"""Rounds of the fit; until the thirtieth, the trend of four tiles moves by at most 0.2 m more."""

LEAST_RESIDUAL_M = 0.3
"""Nearer blocks count as this near, so that no single one decides the plane."""

KNOWN_PX = 8
"""Side of the blocks whose known ground is averaged, cells."""

NEAREST = 3
"""Half-width of the smallest window of known ground around a block, blocks."""

FALLING = 1 / 8
"""Weight of a window of twice the width: the nearest ground decides, and any ground serves where there is no nearer."""

WIDEST = 12
"""Ours: half-width of the widest window of every block, blocks; wider ones serve where the ground is far away."""

WIDER = 4
"""Ours: far from the ground windows grow until their half-width is twice to four times as far, to see its slope."""

SPREAD = 0.4
"""Ground that spreads by less than this standard deviation, in blocks, as a single street does, hardly has a slope."""


def lower_trend(surface: Grid, params: GroundParams) -> NDArray[np.float32]:
    """Return the trend of the terrain under a grid of lowest points.

    The lowest cell of each block of ``block_m`` is ground, unless a building covers the block. A plane is fitted to
    those of 9 by 9 blocks so that the share ``low_share`` of them lies below it; the trend goes bilinearly from the
    plane of one block's centre to the next.

    Parameters
    ----------
    surface : Grid
        Lowest heights, metres; a void has none.
    params : GroundParams
        ``block_m`` and ``low_share``.

    Returns
    -------
    (H, W) ndarray of float32, metres

    Notes
    -----
    The fit is a quantile regression (Koenker and Bassett 1978) by reweighted least squares.
    Border: windows are cut; beyond the outermost centres the trend goes on straight. Nodata: a block without heights
    does not count; where none is within reach the trend has no meaning.

    Examples
    --------
    A slope of 1 in 5 with a building of 10 m is the slope:

    >>> from pyproj import CRS
    >>> from msbdb.grid import lattice
    >>> spec = lattice((0, 0, 199, 199), 1.0, CRS.from_epsg(2154))
    >>> slope = np.indices((200, 200))[1] * 0.2
    >>> heights = slope.astype(np.float32)
    >>> heights[80:130, 80:130] += 10
    >>> trend = lower_trend(Grid(heights, np.ones((200, 200), dtype=bool), spec), GroundParams())
    >>> bool(abs((trend - slope).max() - (trend - slope).min()) < 2)
    True

    References
    ----------
    Koenker, R., Bassett, G. (1978). Regression quantiles. Econometrica 46(1), 33-50. doi:10.2307/1913643
    """
    size = max(1, round(params.block_m / surface.spec.cell_m))
    begin = _begin(surface.spec.origin, size)
    measured = np.where(surface.valid, np.asarray(surface.values, dtype=np.float64), np.inf)
    heights, rows, cols = _lowest_of_blocks(measured, size, begin)
    planes = _fit_planes(heights, rows, cols, float(size), params.low_share)
    return _between_centres(planes, size, surface.spec.shape, begin)


def known_trend(
    heights: NDArray[np.float32], ground: NDArray[np.bool_], origin: tuple[int, int] = (0, 0)
) -> NDArray[np.float32]:
    """Return a smooth surface through known ground that goes on with its slope where none is known.

    The ground of each block of 8 by 8 cells is averaged. At each block a plane is fitted to the blocks around it,
    which weigh less the farther they are. The trend goes bilinearly from the plane of one block's centre to the next.

    Parameters
    ----------
    heights : (H, W) ndarray of float32, metres
        Those outside of the ground are ignored.
    ground : (H, W) ndarray of bool
        Known ground, at least one cell.
    origin : tuple of int
        Absolute row and column of the first cell (`msbdb.grid.GridSpec.origin`).

    Returns
    -------
    (H, W) ndarray of float32, metres

    Notes
    -----
    Local linear regression. Weights fall by steps, with square windows of 56, 104 and 200 cells, and for blocks more
    than 48 cells from the ground of wider ones. A slope is damped where the ground hardly spreads across it. Border:
    windows are cut. Linear in the cells.

    Examples
    --------
    A slope of 1 in 5 goes on where its upper third is hidden:

    >>> slope = (np.indices((120, 120))[1] * 0.2).astype(np.float32)
    >>> bool(abs(known_trend(slope, slope < 16) - slope).max() < 1)
    True
    """
    begin = _begin(origin, KNOWN_PX)
    shape = _blocks(ground.shape, KNOWN_PX, begin)
    row, col = (place + first for place, first in zip(np.nonzero(ground), begin, strict=True))
    block = row // KNOWN_PX * shape[1] + col // KNOWN_PX
    z = heights[ground].astype(np.float64)
    level = float(z.mean())
    count = np.bincount(block, minlength=shape[0] * shape[1])
    north, east, up = (
        (np.bincount(block, each, count.size) / np.maximum(count, 1)).reshape(shape)
        for each in ((row + 0.5) / KNOWN_PX, (col + 0.5) / KNOWN_PX, z - level)
    )
    # A quarter of a block is enough to count in full.
    weight = np.minimum(count.reshape(shape) / (KNOWN_PX**2 / 4), 1)
    return _between_centres(_planes_through(weight, north, east, up) + level, KNOWN_PX, ground.shape, begin)


def _begin(origin: tuple[int, int], size: int) -> tuple[int, int]:
    """Return the row and column of the first cell in its block of the absolute lattice."""
    return origin[0] % size, origin[1] % size


def _blocks(shape: tuple[int, ...], size: int, begin: tuple[int, int]) -> tuple[int, int]:
    """Return the rows and columns of blocks that hold a grid."""
    return -(-(shape[0] + begin[0]) // size), -(-(shape[1] + begin[1]) // size)


def _planes_through(weight: Floats, north: Floats, east: Floats, up: Floats) -> Floats:
    """Return the height at each block's centre of the plane through the weighted means of the blocks around it."""
    of = [weight * each for each in (1, north, east, north**2, east**2, north * east, up, north * up, east * up)]
    one, n, e, nn, ee, ne, z, nz, ez = _around(of)
    row, col = (np.arange(size) + 0.5 for size in weight.shape)
    row = row[:, None]
    # Moments about the block's own centre, where the plane's constant is its height.
    nn, ee, ne = (
        nn - 2 * row * n + row**2 * one,
        ee - 2 * col * e + col**2 * one,
        ne - row * e - col * n + row * col * one,
    )
    nz, ez, n, e = nz - row * z, ez - col * z, n - row * one, e - col * one
    damping = SPREAD**2 * one
    normal = np.stack([one, n, e, n, nn + damping, ne, e, ne, ee + damping], axis=-1).reshape(*one.shape, 3, 3)
    return np.asarray(np.linalg.solve(normal, np.stack([z, nz, ez], axis=-1)[..., None])[..., 0, 0])


def _around(values: Sequence[Floats]) -> Floats:
    """Return the means over windows of twice the width each, which weigh less; the first values are the weights."""
    away = distance_transform_cdt(values[0] <= 0, metric="chessboard")
    total, share, half = np.zeros((len(values), *values[0].shape)), 1.0, NEAREST
    while True:
        looking = (half <= WIDEST) | (away > half // WIDER)
        if not looking.any():
            return total
        for found, each in zip(total, values, strict=True):
            found += share * np.where(looking, uniform_filter(each, 2 * half + 1, mode="constant"), 0.0)
        share, half = share * FALLING, 2 * half


def _between_centres(planes: Floats, size: int, shape: tuple[int, ...], begin: tuple[int, int]) -> NDArray[np.float32]:
    """Return a grid that goes bilinearly from the centre of one block to the next, and straight on to the border."""
    # One more block on all sides continues the trend; a single row of blocks is level there.
    if min(planes.shape) > 1:
        framed = np.pad(planes, 1, mode="reflect", reflect_type="odd")
    else:
        framed = np.pad(planes, 1, mode="edge")
    row, col = ((np.arange(side) + first + 0.5) / size + 0.5 for side, first in zip(shape, begin, strict=True))
    return bilinear(framed, row, col).astype(np.float32)


def bilinear(source: NDArray[Height], row: Floats, col: Floats) -> NDArray[Height]:
    """Return bilinear values at the crossings of rows and columns, one axis after the other.

    Parameters
    ----------
    source : (H, W) ndarray of float32 or float64
        Values at whole rows and columns, without NaN.
    row, col : (M,) and (N,) ndarray of float64
        From 0 to H - 1 and W - 1: nothing lies beyond the border.

    Returns
    -------
    (M, N) ndarray
        Of the type of the source, in which all is computed.

    Examples
    --------
    >>> bilinear(np.array([[0.0, 1.0], [2.0, 3.0]]), np.array([0.5]), np.array([0.0, 0.25]))
    array([[1.  , 1.25]])
    """
    r0 = np.minimum(row.astype(np.int64), max(source.shape[0] - 2, 0))
    c0 = np.minimum(col.astype(np.int64), max(source.shape[1] - 2, 0))
    r1, c1 = np.minimum(r0 + 1, source.shape[0] - 1), np.minimum(c0 + 1, source.shape[1] - 1)
    fr, fc = (row - r0).astype(source.dtype)[:, None], (col - c0).astype(source.dtype)[None, :]
    by_row = source[r0] * (1 - fr) + source[r1] * fr
    values: NDArray[Height] = by_row[:, c0] * (1 - fc) + by_row[:, c1] * fc
    return values


def _lowest_of_blocks(heights: Floats, size: int, begin: tuple[int, int]) -> tuple[Floats, Floats, Floats]:
    """Return the lowest height of each block, and its row and column from the block's centre, in cells."""
    shape = _blocks(heights.shape, size, begin)
    around = [
        (first, blocks * size - first - side) for first, blocks, side in zip(begin, shape, heights.shape, strict=True)
    ]
    framed = np.pad(heights, around, constant_values=np.inf)
    blocks = framed.reshape(shape[0], size, shape[1], size).swapaxes(1, 2).reshape(*shape, size * size)
    place = blocks.argmin(axis=-1)
    lowest = np.take_along_axis(blocks, place[..., None], axis=-1)[..., 0]
    rows, cols = (part.astype(np.float64) - (size - 1) / 2 for part in (place // size, place % size))
    return lowest, rows, cols


def _fit_planes(heights: Floats, rows: Floats, cols: Floats, size: float, low_share: float) -> Floats:
    """Return the height at each block's centre of the plane with a share of the blocks around below it."""
    steps = np.arange(-REACH, REACH + 1) * size
    east = _windows(cols) + steps[None, None, None, :]
    north = _windows(rows) + steps[None, None, :, None]
    z = _windows(heights)
    inside = np.isfinite(z)
    z = np.where(inside, z, 0.0)
    east, north = np.where(inside, east, 0.0), np.where(inside, north, 0.0)
    near = inside * np.exp(-(east**2 + north**2) / (2 * (size * REACH / 2) ** 2))
    # In blocks, so that the normal equations are of one scale; the ridge keeps single rows of blocks solvable.
    design = np.stack([np.ones_like(z), east / size, north / size], axis=-1).reshape(*heights.shape, -1, 3)
    z, near = z.reshape(*heights.shape, -1), near.reshape(*heights.shape, -1)
    nothing = np.all(~inside, axis=(-2, -1))
    ridge = np.diag([0.0, 1e-6, 1e-6]) + np.multiply.outer(nothing, np.eye(3))
    weights, fit = near, np.zeros((*heights.shape, 3))
    for _ in range(ROUNDS):
        weighted = design * weights[..., None]
        normal = np.einsum("...ki,...kj->...ij", weighted, design) + ridge
        fit = np.linalg.solve(normal, np.einsum("...ki,...k->...i", weighted, z)[..., None])[..., 0]
        residual = z - np.einsum("...ki,...i->...k", design, fit)
        side = np.where(residual > 0, low_share, 1 - low_share)
        weights = near * side / np.maximum(np.abs(residual), LEAST_RESIDUAL_M)
    return np.asarray(fit[..., 0])


def _windows(values: Floats) -> Floats:
    """Return the 9 by 9 blocks around each block; infinite beyond the border."""
    framed = np.pad(values, REACH, constant_values=np.inf)
    return sliding_window_view(framed, (2 * REACH + 1, 2 * REACH + 1))

"""Noise of the heights: how rough even ground looks, beyond what a precise scanner leaves.

Ground is even where nothing stands on it: beside crowns it is rough by these. Roofs carry the noise of the ground
around them. So what noise adds is taken from the roughness before roofs and crowns are separated by it. Strips that do
not fit in height, and coarse ranges of older scanners, act alike.
"""

import numpy as np
from numpy.typing import NDArray

from msbdb.grid import Grid
from msbdb.morphology.windows import dilation
from msbdb.surface.squares import Squares, around
from msbdb.surface.texture import NO_PLANE_M, window_cells

BARE_M = 0.5
"""Cells below this height are bare ground."""

STEP_M, STEPS = 0.005, 60
"""Width of the classes of roughness that are counted, metres, and their number; the last one is open."""

SMOOTHEST = 1 / 3
"""Ours, in sample: even ground is among the smoothest third of these bare cells, as grass, kerbs and cars are rough."""

PRECISE_M = 0.02
"""That third is smoother than this nearly everywhere on the open places. On cells above 1 m windows are wider, and it
grows."""

MEDIAN_OF_NOISE = 2.0
"""Squared median of the roughness over its squared lower quartile, in windows of nine samples of noise alone. With the
third it gives what the quarter of all bare cells gave on noisy copies, by which the detectors' values were chosen."""

UNSEEN = 1 / 3
"""Less relief than this share of the noise is not seen in it: an even surface may have as much."""

LEAST_CELLS = 50
"""With fewer bare cells the noise is taken as 0."""

Field = NDArray[np.float32]


def height_noise(roughness_m: Field, ndsm: Grid, *, window_m: float, mask_m: float) -> Field:
    """Return the roughness that noise adds to even surfaces, by the bare ground around.

    Parameters
    ----------
    roughness_m : (H, W) ndarray of float32, metres
        Residual of the best plane (`msbdb.surface.texture.roughness`).
    ndsm : Grid
        Heights above ground, metres.
    window_m : float
        Side of the windows of that residual, metres.
    mask_m : float
        Height of the mask (V17), metres: bare cells of whose window none reaches it count.

    Returns
    -------
    (H, W) ndarray of float32, metres
        The median that noise alone would give; 0 where even ground is as smooth as a precise scanner sees it, and
        where there is hardly any bare ground with nothing beside it. At most 0.42 m.

    Notes
    -----
    The smoothest third of these cells in 3 by 3 squares has a roughness of up to q. Noise is √(2 (q² - q₀²)), with
    q₀ = 0.02 m.
    Squares lie on the absolute lattice, so that tiles agree: a cell's noise depends on ground up to 50 m away.
    Bare cells beside crowns are rough by these: among dense trees hardly any is smooth.
    Border: squares and windows end at the lattice. Nodata: cells that are not valid, or without a plane, do not count.
    Linear in the cells.

    Examples
    --------
    Even ground that looks 5 cm rough, and a roof on it:

    >>> from pyproj import CRS
    >>> from msbdb.grid import lattice
    >>> high = np.zeros((20, 20), dtype=np.float32)
    >>> high[5:15, 5:15] = 6
    >>> ndsm = Grid(high, high >= 0, lattice((0, 0.1, 19, 19.9), 1.0, CRS.from_epsg(2154)))
    >>> height_noise(np.full((20, 20), 0.051, np.float32), ndsm, window_m=1.5, mask_m=2.0)[10, 10].round(3)
    np.float32(0.069)
    >>> height_noise(np.full((20, 20), 0.012, np.float32), ndsm, window_m=1.5, mask_m=2.0).max()
    np.float32(0.0)
    """
    squares = Squares.of(ndsm.spec)
    raised = ndsm.valid & (np.asarray(ndsm.values) >= mask_m)
    beside = dilation(raised.astype(np.float32), window_cells(window_m, ndsm.spec.cell_m), None) > 0
    count = squares.shape[1]
    counts = np.zeros((*squares.shape, STEPS), dtype=np.int64)
    # One row of squares after the other, as places in the lattice take more memory than the roughness.
    for number, band in enumerate(counts):
        here = slice(*np.searchsorted(squares.rows, (number, number + 1)))
        high, rough_m = np.asarray(ndsm.values[here]), roughness_m[here]
        bare = ndsm.valid[here] & ~beside[here] & (high < BARE_M) & (rough_m < NO_PLANE_M)
        step = np.minimum((rough_m[bare] / STEP_M).astype(np.int64), STEPS - 1)
        col = np.broadcast_to(squares.cols, bare.shape)[bare]
        band[:] = np.bincount(col * STEPS + step, minlength=count * STEPS).reshape(count, STEPS)
    below = around(counts).cumsum(axis=2)
    total = below[:, :, -1]
    third_m = STEP_M * (0.5 + np.argmax(below >= SMOOTHEST * total[:, :, None], axis=2))
    precise_m = PRECISE_M * max(1.0, ndsm.spec.cell_m)
    noise_m = np.sqrt(MEDIAN_OF_NOISE * np.maximum(third_m**2 - precise_m**2, 0))
    return squares.on_cells(np.where(total >= LEAST_CELLS, noise_m, 0).astype(np.float32))


def without_noise(roughness_m: Field, noise_m: Field) -> Field:
    """Return the roughness of the surface itself, √(r² - n²), and n/3 where less is left.

    Parameters
    ----------
    roughness_m : (H, W) ndarray of float32, metres
        Residual of the best plane; cells without a plane (`msbdb.surface.texture.NO_PLANE_M`) stay as they are.
    noise_m : (H, W) ndarray of float32, metres
        From `height_noise`.

    Returns
    -------
    (H, W) ndarray of float32, metres
        The given array itself where there is no noise at all.

    Examples
    --------
    >>> without_noise(np.float32([0.05, 0.13, 5.0]), np.float32([0.05, 0.05, 0.05])).round(2)
    array([0.02, 0.12, 5.  ], dtype=float32)
    """
    if not noise_m.any():
        return roughness_m
    relief_m = np.sqrt(np.maximum(roughness_m**2 - noise_m**2, (UNSEEN * noise_m) ** 2))
    return np.where((roughness_m < NO_PLANE_M) & (noise_m > 0), relief_m, roughness_m)

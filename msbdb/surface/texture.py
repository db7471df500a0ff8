"""Texture of the surface: measures that separate smooth, solid roofs from rough crowns full of gaps, without colour.

Each measure is taken in a window around the cell. Then the best of all windows that hold the cell counts. At a roof's
edge this window lies on the roof, so that edges are not blurred (Kuwahara et al. 1976).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from msbdb.grid import Frame, Grid
from msbdb.morphology.windows import dilation, erosion
from msbdb.points.cloud import PointCloud
from msbdb.surface.gridding import Samples, cell_of
from msbdb.threads import kernel

NO_PLANE_M = 5.0
"""Largest roughness that is reported, also where the samples are too few for a plane, metres."""

LEAST_SAMPLES = 5
"""A plane always fits fewer samples, or nearly: of a crown, too."""

WIDEST_SAMPLES = 7
"""Ours, in sample: least samples for a plane in the widest window, as the best of many such windows counts."""

JITTER = 0.5
"""Ours, in sample: of the variance of a place by chance in a cell. Surfaces of triangles have 0, of single echoes 1."""

STEEPEST = 1.5
"""Ours: square of the steepest slope of a roof, 51 degrees; crowns are steeper."""

Field = NDArray[np.float32]
Floats = NDArray[np.float64]
Counts = NDArray[np.int32]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Echoes:
    """Shares of echoes, each from 0 to 1 on the (H, W) lattice.

    ``split`` is the share of first echoes that have a later echo, in the small window; ``split_best`` the least such
    share over the small windows that hold the cell, ``split_wide`` over the wide ones; ``solid`` is the largest
    share of last echoes that stop near the surface over the wide windows.
    """

    split: Field
    split_best: Field
    split_wide: Field
    solid: Field


@dataclass(frozen=True, slots=True, eq=False)
class Texture:
    """What separates roofs from vegetation without colours.

    Parameters
    ----------
    ndsm : Grid
        Heights above ground, metres.
    roughness_m, wide_roughness_m : (H, W) ndarray of float32, metres
        Residual of the best plane in the small and the wide windows.
    echoes : Echoes or None
        The shares of echoes; without them the roughness decides alone.
    mask_m : float
        Height of the mask (V17), metres.
    noise_m : (H, W) ndarray of float32 or None, metres
        What noise of the heights added to the residual in the small window, and is taken off; None where nothing is.
    widest_roughness_m : (H, W) ndarray of float32 or None, metres
        Residual in windows wider than the wide ones, for cells among too few samples; None where nobody measured it.
    """

    ndsm: Grid
    roughness_m: Field
    wide_roughness_m: Field
    echoes: Echoes | None
    mask_m: float
    noise_m: Field | None = None
    widest_roughness_m: Field | None = None

    @property
    def raised(self) -> Mask:
        """The cells at or above the mask."""
        return np.asarray(self.ndsm.valid & (np.asarray(self.ndsm.values) >= self.mask_m))

    @property
    def filled_m(self) -> Field:
        """The roughness in the small window, or in the smallest one with samples enough for a plane."""
        return np.where(self.roughness_m < NO_PLANE_M, self.roughness_m, self.filled_wide_m)

    @property
    def filled_wide_m(self) -> Field:
        """The roughness in the wide window, or in the widest one where the wide one has too few samples."""
        wide, widest = self.wide_roughness_m, self.widest_roughness_m
        return wide if widest is None else np.where(wide < NO_PLANE_M, wide, widest)


def window_cells(window_m: float, cell_m: float) -> int:
    """Return the odd number of cells nearest to a window, at least 3; of two as near the larger one.

    Examples
    --------
    >>> window_cells(1.5, 0.5), window_cells(1.5, 0.4), window_cells(1.5, 0.3), window_cells(1.5, 2.0)
    (3, 3, 5, 3)
    """
    return max(3, 2 * math.floor(window_m / cell_m / 2) + 1)


def widest_window_m(wide_window_m: float, cell_m: float) -> float:
    """Return the side of the widest window, metres: a cell wider on each side than the wide one.

    Examples
    --------
    >>> widest_window_m(2.5, 1.0), widest_window_m(2.5, 0.5)
    (5.0, 3.5)
    """
    return (window_cells(wide_window_m, cell_m) + 2) * cell_m


def roughness(samples: Samples, window_m: float, least: int = LEAST_SAMPLES) -> Field:
    """Return how far the first echoes scatter from their best plane, in the best window that holds the cell.

    Parameters
    ----------
    samples : Samples
        First echoes nearest to the cells' centres, with their true places.
    window_m : float
        Side of the square window, metres.
    least : int
        Fewer samples make no plane; at least `LEAST_SAMPLES`.

    Returns
    -------
    (H, W) ndarray of float32, metres
        At most ``NO_PLANE_M``; that value also where no window holds so many samples that span a plane.

    Notes
    -----
    A plane z = a + b·e + c·n is fitted to the samples of a window by least squares. Roughness is the root of the sum of
    its squared residuals over n - 3, as three samples fit any plane. So leaves are as rough under few samples as under
    many; over n, the few samples of a sparse survey would make crowns smooth.

    A height of a raster was measured anywhere in its cell, so that slopes are rough. The variance of a place in a
    square is its side squared over 12. `JITTER` of it times the slope squared is subtracted, up to `STEEPEST`.

    Border: windows are cut at the edge. Nodata: cells without a first echo have no weight.

    Examples
    --------
    A plane slope is smooth; one sample 1 m above it is not:

    >>> from pyproj import CRS
    >>> from msbdb.grid import lattice
    >>> spec, none = lattice((0, 0, 4, 4), 1.0, CRS.from_epsg(2154)), np.zeros((5, 5), dtype=np.float32)
    >>> samples = Samples(np.indices((5, 5)).sum(axis=0) / 2, none, none, spec)
    >>> float(roughness(samples, 3.0).max())
    0.0
    >>> samples.z[2, 2] += 1
    >>> roughness(samples, 3.0)[2].round(2)
    array([0. , 0. , 0.3, 0. , 0. ], dtype=float32)
    """
    best: Field = erosion(scatter(samples, window_m, least), window_cells(window_m, samples.spec.cell_m), None)
    return best


def scatter(samples: Samples, window_m: float, least: int = LEAST_SAMPLES) -> Field:
    """Return how far the samples scatter from their best plane in the window around each cell, as for `roughness`."""
    size = window_cells(window_m, samples.spec.cell_m)
    if not samples.observed.any():
        return np.full(samples.spec.shape, NO_PLANE_M, dtype=np.float32)
    # Heights are taken from the middle of their range, so that the sums of their squares keep their digits.
    origin = float(np.nanmin(samples.z) + np.nanmax(samples.z)) / 2
    places = (samples.east, samples.north, np.float64(JITTER * samples.within_m**2 / 12))
    return _plane_residual(samples.z, places, origin, samples.spec.cell_m, (size // 2, least))


def grid_samples(surface: Grid, within_m: float = 0.0) -> Samples:
    """Return the cells of a grid as samples at their centres, or of unknown places in squares of this side, metres."""
    zero = np.zeros(surface.spec.shape, dtype=np.float32)
    z = np.where(surface.valid, np.asarray(surface.values, dtype=np.float64), np.nan)
    return Samples(z, zero, zero, surface.spec, within_m)


def echoes(points: PointCloud, ndsm: Grid, dtm: Grid, *, small_m: float, wide_m: float, mask_m: float) -> Echoes | None:
    """Return the shares of echoes, or None where the source holds no echo information.

    Parameters
    ----------
    points : PointCloud
        All echoes.
    ndsm, dtm : Grid
        Heights above ground and terrain on the lattice, metres.
    small_m, wide_m : float
        Sides of the windows, metres.
    mask_m : float
        Only echoes of the surface above this height count.
    """
    if points.return_number is None or points.number_of_returns is None or not points.has_echoes:
        return None
    spec = ndsm.spec
    heights, ground = (np.asarray(grid.values, dtype=np.float32) for grid in (ndsm, dtm))
    split, firsts, stopped, lasts = _echo_counts(
        (points.x, points.y, points.z),
        (points.return_number, points.number_of_returns),
        (heights, ground),
        np.float32(mask_m),
        spec.frame,
    )
    small, wide = window_cells(small_m, spec.cell_m), window_cells(wide_m, spec.cell_m)
    raised = heights > mask_m
    share_small, share_wide = _share(split, firsts, small), _share(split, firsts, wide)
    return Echoes(
        split=share_small,
        split_best=erosion(np.where(raised, share_small, np.float32(1)), small, None),
        split_wide=erosion(np.where(raised, share_wide, np.float32(1)), wide, None),
        solid=dilation(_share(stopped, lasts, wide), wide, None),
    )


def _share(part: Counts, whole: Counts, size: int) -> Field:
    """Share of two counts in a square window; 0 where both counts are 0."""
    above = uniform_filter(part.astype(np.float32), size, mode="constant")
    below = uniform_filter(whole.astype(np.float32), size, mode="constant")
    np.maximum(below, np.float32(0.5 / size**2), out=below)
    np.divide(above, below, out=above)
    shares: Field = np.clip(above, 0, 1, out=above)
    return shares


@kernel
def _echo_counts(
    xyz: tuple[Floats, Floats, Floats],
    returns: tuple[NDArray[np.uint8], NDArray[np.uint8]],
    surfaces: tuple[Field, Field],
    mask_m: np.float32,
    frame: Frame,
) -> tuple[Counts, Counts, Counts, Counts]:
    """Count of each cell: raised first echoes with a later echo, raised first echoes, stopped last echoes, last echoes.

    Raised is above the mask; stopped is above the mask and above half of the height of the cell's surface.
    """
    x, y, z = xyz
    number, of = returns
    heights, ground = surfaces
    split, firsts = np.zeros(heights.shape, dtype=np.int32), np.zeros(heights.shape, dtype=np.int32)
    stopped, lasts = np.zeros(heights.shape, dtype=np.int32), np.zeros(heights.shape, dtype=np.int32)
    for i in range(x.size):
        row, col = cell_of(x[i], y[i], frame, heights.shape)
        if row < 0:
            continue
        above = np.float32(z[i] - ground[row, col])
        if number[i] == 1 and above > mask_m:
            firsts[row, col] += 1
            split[row, col] += of[i] > 1
        if number[i] == of[i]:
            lasts[row, col] += 1
            stopped[row, col] += above > max(mask_m, np.float32(0.5) * heights[row, col])
    return split, firsts, stopped, lasts


@kernel
def _plane_residual(
    z: Floats, places: tuple[Field, Field, float], origin: float, cell: float, window: tuple[int, int]
) -> Field:
    """Residual of the least-squares plane through the samples of each window.

    ``window`` is half of its side in cells, and the least samples of a plane. ``places`` are the samples' offsets from
    the centres, and the variance that is not known of them, square metres. The moments are summed by columns and then
    over the columns, whose eastings are shifted to the window's centre.
    """
    (east, north, unknown_m2), (half, least), (height, width) = places, window, z.shape
    out = np.full(z.shape, np.float32(NO_PLANE_M))
    for row in range(height):
        columns = _column_moments(z, (east, north), (origin, cell), row, half)
        sums = np.zeros((10, width))
        for right in range(-half, half + 1):
            _add_columns(sums, columns, right, cell)
        for col in range(width):
            n, se, sn, sz, see = sums[0, col], sums[1, col], sums[2, col], sums[3, col], sums[4, col]
            sen, snn, sez, snz, szz = sums[5, col], sums[6, col], sums[7, col], sums[8, col], sums[9, col]
            # Without branches, as below; what has no plane is divided by 1, and not taken.
            enough = n >= least
            n = n if enough else 1.0
            cee, cen, cnn = see - se * se / n, sen - se * sn / n, snn - sn * sn / n
            cez, cnz, czz = sez - se * sz / n, snz - sn * sz / n, szz - sz * sz / n
            # Central moments; their determinant is near 0 where the samples lie on a line.
            det = cee * cnn - cen * cen
            plane = enough & (det > 1e-4 * (n * cell * cell) ** 2)
            det = det if plane else 1.0
            slope_e, slope_n = (cnn * cez - cen * cnz) / det, (cee * cnz - cen * cez) / det
            # Over n - 3, as the plane takes three degrees of freedom: the mean does not depend on the samples' number.
            residual = max(czz - slope_e * cez - slope_n * cnz, 0.0) / (n - 3)
            steep = slope_e * slope_e + slope_n * slope_n
            residual = max(residual - unknown_m2 * steep, 0.0) if steep <= STEEPEST else residual
            out[row, col] = min(np.sqrt(residual), NO_PLANE_M) if plane else NO_PLANE_M
    return out


@kernel
def _add_columns(sums: Floats, columns: Floats, right: int, cell: float) -> None:
    """Add the moments of the columns so many cells to the right of each cell, as seen from the cell's centre.

    Eastings count from the centre of their own column: e becomes e + shift, so that sum(e z) becomes sum(e z) + shift
    sum(z), and sum(e e) gains shift (2 sum(e) + n shift). A loop has few arrays, so that the processor takes several
    cells at once.
    """
    shift, first = right * cell, max(-right, 0)
    last = max(sums.shape[1] - max(right, 0), first)
    moved = slice(first + right, last + right)
    for moment in (0, 2, 3, 6, 8, 9):
        into, each = sums[moment, first:last], columns[moment, moved]
        for col in range(into.size):
            into[col] += each[col]
    for moment, of in ((1, 0), (5, 2), (7, 3)):
        into, each, base = sums[moment, first:last], columns[moment, moved], columns[of, moved]
        for col in range(into.size):
            into[col] += each[col] + shift * base[col]
    into, each, east, number = sums[4, first:last], columns[4, moved], columns[1, moved], columns[0, moved]
    for col in range(into.size):
        into[col] += each[col] + shift * (2 * east[col] + number[col] * shift)


@kernel
def _column_moments(z: Floats, offsets: tuple[Field, Field], scale: tuple[float, float], row: int, half: int) -> Floats:
    """Return the count and moments (1, e, n, z, ee, en, nn, ez, nz, zz) of each column around a row."""
    east, north = offsets
    origin, cell = scale
    columns = np.zeros((10, z.shape[1]))
    for r in range(max(row - half, 0), min(row + half + 1, z.shape[0])):
        for col in range(z.shape[1]):
            # Without a branch, so that the processor takes several columns at once; what is not seen adds 0.
            h, e, n = z[r, col] - origin, east[r, col], (row - r) * cell + north[r, col]
            seen = 0.0 if np.isnan(h) else 1.0
            h, e, n = (0.0, np.float32(0.0), 0.0) if np.isnan(h) else (h, e, n)
            columns[0, col] += seen
            columns[1, col] += e
            columns[2, col] += n
            columns[3, col] += h
            columns[4, col] += e * e
            columns[5, col] += e * n
            columns[6, col] += n * n
            columns[7, col] += e * h
            columns[8, col] += n * h
            columns[9, col] += h * h
    return columns

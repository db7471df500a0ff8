"""The bands of the spectral stage (V20, V21): colours and intensity of points on the lattice, and their scaling.

All sums over points are of whole numbers in 64 bits, so that they are exact in any order of the points.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msbdb.errors import GridMismatchError, InputError
from msbdb.grid import Bands, Frame, GridSpec
from msbdb.points.cloud import PointCloud
from msbdb.surface.gaps import nearest_cells
from msbdb.surface.gridding import cell_of
from msbdb.threads import in_threads, kernel

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

STEPS = 256
"""Bilinear weights are whole multiples of 1/256."""

INTENSITY_STEPS = 10
"""The kept intensity has so many steps for each factor of e: one is 10 %, less than the noise of a pulse."""


def grid_colours(points: PointCloud, spec: GridSpec, *, max_gap_m: float) -> Bands | None:
    """Grid the colours of the first echoes: their mean in each cell, and gaps from the nearest cell.

    Parameters
    ----------
    points : PointCloud
        Sums of the colours are exact, so the order of the points does not matter.
    spec : GridSpec
        The lattice; points outside of it are ignored.
    max_gap_m : float
        Empty cells this near to a measured one take its value; farther ones stay invalid.

    Returns
    -------
    Bands or None
        Named as the points' colours, in their units; None when the points have no colours.
    """
    colours = points.colours
    if colours is None:
        return None
    cells = cells_of(points.x, points.y, points.first_echo, spec.frame, spec.shape)
    count = counts(cells, spec.shape[0] * spec.shape[1])
    values = np.empty((len(points.colour_names), count.size), dtype=np.float32)

    def grid_band(band: int) -> None:
        means(cells, colours[:, band], count, values[band])

    in_threads(grid_band, range(len(values)))
    return _filled(
        values.reshape(-1, *spec.shape), (count > 0).reshape(spec.shape), points.colour_names, spec, max_gap_m
    )


def grid_intensity(points: PointCloud, spec: GridSpec, *, max_gap_m: float) -> Bands | None:
    """Grid the pulse intensity of the first echoes bilinearly (V20), as the band ``intensity``.

    A point gives its value to the four cell centres around it with bilinear weights, and a cell is the weighted
    mean of what it received. So the noise of single pulses is averaged out, which the paper wants of the interpolation.

    Parameters
    ----------
    points : PointCloud
        The order of the points does not matter: the weights are whole numbers of 1/256.
    spec : GridSpec
        The lattice.
    max_gap_m : float
        Cells without a point take the nearest value within this distance; farther ones stay invalid.

    Returns
    -------
    Bands or None
        In the source's units; None when the points have no intensity.
    """
    if points.intensity is None:
        return None
    values, measured = bilinear((points.x, points.y), points.first_echo, points.intensity, spec.frame, spec.shape)
    return _filled(values[None], measured, ("intensity",), spec, max_gap_m)


def kept_intensity(bands: Bands | None, wanted: Mask | None = None) -> NDArray[np.uint8] | None:
    """Return the intensity as a run keeps it, in steps of its logarithm; None when there is none.

    Parameters
    ----------
    bands : Bands, optional
        The bands of a survey.
    wanted : (H, W) ndarray of bool, optional
        The cells in which it is kept; by default all.

    Returns
    -------
    (H, W) ndarray of uint8 or None
        0 where it is unknown, none or not wanted, otherwise 1 + `INTENSITY_STEPS` ln I.

    Examples
    --------
    >>> from affine import Affine
    >>> from pyproj import CRS
    >>> spec = GridSpec((1, 4), Affine(1, 0, 0, 0, -1, 4), CRS.from_epsg(2154))
    >>> values = np.array([[[0, 1, 100, 65535]]], dtype=np.float32)
    >>> kept_intensity(Bands(values, ("intensity",), np.ones((1, 4), dtype=bool), spec)).tolist()
    [[0, 1, 47, 112]]
    """
    if bands is None or "intensity" not in bands.names:
        return None
    values = bands.values[bands.names.index("intensity")]
    known = bands.valid & (values > 0)
    if wanted is not None:
        known &= wanted
    steps = np.zeros(known.shape, dtype=np.uint8)
    steps[known] = np.minimum(
        1 + np.rint(INTENSITY_STEPS * np.log(np.maximum(values[known].astype(np.float64), 1))), 255
    )
    return steps


def stack(*parts: Bands) -> Bands:
    """Put bands of one lattice together; of bands of the same name the first is kept.

    A cell is valid where all of the parts are.

    Raises
    ------
    InputError
        For nothing to stack.
    GridMismatchError
        For parts on different lattices.
    """
    if not parts:
        msg = "There are no bands to stack; give at least one image, point colours or intensity."
        raise InputError(msg)
    spec = parts[0].spec
    for other in parts[1:]:
        if not spec.same_lattice(other.spec):
            msg = f"The bands {other.names} lie on {other.spec}, but {parts[0].names} on {spec}; resample one of them."
            raise GridMismatchError(msg)
    chosen: dict[str, NDArray[np.float32]] = {}
    for part in parts:
        for name, values in zip(part.names, part.values, strict=True):
            chosen.setdefault(name, values)
    valid = np.logical_and.reduce([part.valid for part in parts])
    values = np.zeros((len(chosen), *spec.shape), dtype=np.float32)
    for target, band in zip(values, chosen.values(), strict=True):
        np.copyto(target, band, where=valid)
    return Bands(values, tuple(chosen), valid, spec)


def spectral_bands(ortho: Bands | None, points: PointCloud | None, spec: GridSpec, *, max_gap_m: float) -> Bands | None:
    """Gather all bands that a survey has (V13, V20): its ortho or else the points' colours, and the intensity.

    Parameters
    ----------
    ortho : Bands, optional
        The orthophoto on the lattice.
    points : PointCloud, optional
        Their colours serve where there is no ortho; their intensity joins as a band in any case.
    spec : GridSpec
        The lattice.
    max_gap_m : float
        See `grid_colours`.

    Returns
    -------
    Bands or None
        None when there is neither image, nor colour, nor intensity.
    """
    parts = [ortho] if ortho is not None else []
    if points is not None and len(points) > 0:
        colours = grid_colours(points, spec, max_gap_m=max_gap_m) if ortho is None else None
        intensity = grid_intensity(points, spec, max_gap_m=max_gap_m)
        parts += [band for band in (colours, intensity) if band is not None]
    return stack(*parts) if parts else None


@dataclass(frozen=True, slots=True)
class Scaling:
    """The normalisation of each band (V21): its low and high robust value become 0 and 1.

    ``low`` and ``high`` hold one number a band, in the source's units. Kept with the classes, so that another tile
    or a later run scales in the same way.
    """

    names: tuple[str, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]

    def apply(self, values: NDArray[np.floating]) -> NDArray[np.float64]:
        """Scale values (N, B) to 0 to 1, clipped."""
        low, high = np.array(self.low), np.array(self.high)
        return np.asarray(np.clip((values - low) / np.where(high > low, high - low, 1.0), 0.0, 1.0), dtype=np.float64)


def fit_scaling(sample: NDArray[np.floating], names: tuple[str, ...], tail_percent: float) -> Scaling:
    """Find the scaling of each band from a sample (N, B): its lower and upper percentile (V21).

    Examples
    --------
    >>> scaling = fit_scaling(np.arange(101.0)[:, None], ("red",), 10.0)
    >>> scaling.low, scaling.high, scaling.apply(np.array([[0.0], [50.0], [100.0]])).ravel()
    ((10.0,), (90.0,), array([0. , 0.5, 1. ]))
    """
    low, high = np.percentile(np.asarray(sample, dtype=np.float64), [tail_percent, 100 - tail_percent], axis=0)
    return Scaling(names, tuple(low.tolist()), tuple(high.tolist()))


def _filled(
    values: NDArray[np.float32], measured: NDArray[np.bool_], names: tuple[str, ...], spec: GridSpec, max_gap_m: float
) -> Bands:
    """Fill, in place, the cells that were not measured from the nearest one that was, within the largest gap."""
    if measured.any() and not measured.all():
        measured = fill_gaps(values, measured, spec.cell_m, max_gap_m)
    return Bands(values, names, measured, spec)


def fill_gaps(values: NDArray[np.float32], measured: Mask, cell_m: float, reach_m: float) -> Mask:
    """Give the cells that were not measured the values of the nearest one that was, within the reach.

    Parameters
    ----------
    values : (B, H, W) ndarray of float32
        Bands; written in place.
    measured : (H, W) ndarray of bool
        Which cells have a value.
    cell_m, reach_m : float
        Side of a cell, and the largest distance between the centres of two cells, metres.

    Returns
    -------
    (H, W) ndarray of bool
        Where there is a value now.

    Notes
    -----
    Of cells equally near, the western counts, then the northern: the rule of SciPy's distance transform.
    """
    valid = measured.copy()
    if not measured.any():
        return valid
    gap = np.flatnonzero(~measured)
    # A cell more, because the distance in metres decides.
    nearest = nearest_cells(measured, gap, reach_m / cell_m + 1).astype(np.int64)
    (row, col), (gap_row, gap_col) = (np.divmod(cells, measured.shape[1]) for cells in (nearest, gap))
    reached = (nearest >= 0) & (np.sqrt((row - gap_row) ** 2 + (col - gap_col) ** 2) * cell_m <= reach_m)
    filled, source = gap[reached], nearest[reached]
    for band in values.reshape(len(values), -1):
        band[filled] = band[source]
    valid.ravel()[filled] = True
    return valid


@kernel
def cells_of(x: Floats, y: Floats, used: Mask, frame: Frame, shape: tuple[int, int]) -> NDArray[np.int32]:
    """Flat index of the cell that holds each point; -1 for points that are not used or lie outside."""
    found = np.full(x.size, np.int32(-1))
    for i in range(x.size):
        if used[i]:
            row, col = cell_of(x[i], y[i], frame, shape)
            if row >= 0:
                found[i] = row * shape[1] + col
    return found


@kernel
def counts(cells: NDArray[np.int32], size: int) -> NDArray[np.int32]:
    """Count the points of each cell."""
    count = np.zeros(size, dtype=np.int32)
    for cell in cells:
        if cell >= 0:
            count[cell] += 1
    return count


@kernel
def means(
    cells: NDArray[np.int32], values: NDArray[np.uint16], count: NDArray[np.int32], out: NDArray[np.float32]
) -> None:
    """Write the mean value of each cell into ``out`` (flat); 0 in empty cells."""
    total = np.zeros(out.size, dtype=np.int64)  # whole numbers: exact in any order of the points
    for i in range(cells.size):
        if cells[i] >= 0:
            total[cells[i]] += values[i]
    for cell in range(out.size):
        out[cell] = np.float32(total[cell] / max(count[cell], 1))


@kernel
def bilinear(
    xy: tuple[Floats, Floats], used: Mask, values: NDArray[np.uint16], frame: Frame, shape: tuple[int, int]
) -> tuple[NDArray[np.float32], Mask]:
    """Weighted mean of each cell over the points that have it among the four cell centres around them.

    Also returns which cells have any weight; the others are 0.
    """
    x, y = xy
    rows, cols = shape
    # Sum and weight of a cell are neighbours in memory, which is then touched once.
    sums = np.zeros((rows, cols, 2), dtype=np.int64)
    for i in range(x.size):
        if not used[i]:
            continue
        # Distances from the first cell centre in whole 1/STEPS of a cell: no sum depends on the order of the points.
        right = int(np.rint(((x[i] - frame.east_m) / frame.cell_m - frame.col) * STEPS - STEPS / 2))
        down = int(np.rint(((frame.north_m - y[i]) / frame.cell_m - frame.row) * STEPS - STEPS / 2))
        col, east = right // STEPS, right % STEPS
        row, south = down // STEPS, down % STEPS
        for below in range(2):
            r = row + below
            if r < 0 or r >= rows:
                continue
            for beside in range(2):
                c = col + beside
                if 0 <= c < cols:
                    share = (south if below else STEPS - south) * (east if beside else STEPS - east)
                    sums[r, c, 0] += share * values[i]
                    sums[r, c, 1] += share
    out = np.zeros(shape, dtype=np.float32)
    known = np.zeros(shape, dtype=np.bool_)
    for r in range(rows):
        for c in range(cols):
            if sums[r, c, 1] > 0:
                out[r, c] = np.float32(sums[r, c, 0] / sums[r, c, 1])
                known[r, c] = True
    return out, known

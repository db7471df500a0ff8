"""The bands of the spectral stage (V20, V21): colours and intensity of points on the lattice, and their scaling."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from msbdb.bands import Bands
from msbdb.errors import GridMismatchError, InputError
from msbdb.grid import GridSpec
from msbdb.pointcloud import PointCloud

WEIGHT_STEPS = 256
"""Bilinear weights are whole multiples of 1/256, so that sums over points are exact in any order."""


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
    if points.colours is None:
        return None
    row, col = spec.rowcol(points.x, points.y)
    used = points.first_echo & (row >= 0) & (row < spec.shape[0]) & (col >= 0) & (col < spec.shape[1])
    cell = (row * spec.shape[1] + col)[used]
    size = spec.shape[0] * spec.shape[1]
    count = np.bincount(cell, minlength=size)
    cells = np.maximum(count, 1)
    means = [np.bincount(cell, weights=band[used], minlength=size) / cells for band in points.colours.T]
    values = np.stack(means).reshape(-1, *spec.shape)
    return _filled(values, count.reshape(spec.shape) > 0, points.colour_names, spec, max_gap_m)


def grid_intensity(points: PointCloud, spec: GridSpec, *, max_gap_m: float) -> Bands | None:
    """Grid the pulse intensity of the first echoes bilinearly (V20), as the band ``intensity``.

    A point gives its value to the four cell centres around it with bilinear weights, and a cell is the weighted
    mean of what it was given: the noise of single pulses is averaged out, as the paper asks of the interpolation.

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
    first = points.first_echo
    total = np.zeros(spec.shape)
    weight = np.zeros(spec.shape)
    for rows, cols, share in _corners(points.x[first], points.y[first], spec):
        inside = (rows >= 0) & (rows < spec.shape[0]) & (cols >= 0) & (cols < spec.shape[1])
        cell = (rows * spec.shape[1] + cols)[inside]
        given = share[inside]
        weighted = given * points.intensity[first][inside]
        weight += np.bincount(cell, weights=given, minlength=weight.size).reshape(spec.shape)
        total += np.bincount(cell, weights=weighted, minlength=total.size).reshape(spec.shape)
    values = (total / np.maximum(weight, 1))[None]
    return _filled(values, weight > 0, ("intensity",), spec, max_gap_m)


def _corners(
    easting: NDArray[np.float64], northing: NDArray[np.float64], spec: GridSpec
) -> list[tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]]:
    """Rows, columns and whole-numbered bilinear weights of the four cell centres around each point."""
    steps = WEIGHT_STEPS
    right = np.round((easting - spec.transform.c) / spec.cell_m * steps - steps / 2).astype(np.int64)
    down = np.round((spec.transform.f - northing) / spec.cell_m * steps - steps / 2).astype(np.int64)
    col, east = np.divmod(right, steps)
    row, south = np.divmod(down, steps)
    return [
        (row + i, col + j, ((south if i else steps - south) * (east if j else steps - east)).astype(np.float64))
        for i in (0, 1)
        for j in (0, 1)
    ]


def _filled(
    values: NDArray[np.float64], measured: NDArray[np.bool_], names: tuple[str, ...], spec: GridSpec, max_gap_m: float
) -> Bands:
    """Fill the cells that were not measured from the nearest one that was, within the largest gap."""
    if not measured.any():
        return Bands(np.zeros(values.shape, dtype=np.float32), names, measured, spec)
    filled = values.astype(np.float32)
    valid = measured
    if not measured.all():
        distance, nearest = ndimage.distance_transform_edt(~measured, return_indices=True)
        valid = distance * spec.cell_m <= max_gap_m
        gap = valid & ~measured
        filled[:, gap] = filled[:, nearest[0][gap], nearest[1][gap]]
    return Bands(filled, names, valid, spec)


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
    values = np.where(valid, np.stack(list(chosen.values())), np.float32(0))
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
    """Find the scaling of each band from a sample (N, B): its lower and upper percentile (V21)."""
    low, high = np.percentile(np.asarray(sample, dtype=np.float64), [tail_percent, 100 - tail_percent], axis=0)
    return Scaling(names, tuple(low.tolist()), tuple(high.tolist()))

"""Rows of houses under one roof, divided where the material of the roof changes from front to back."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from msbdb.fuse.houses.roofdirections import RoofDirections
from msbdb.fuse.houses.roofpieces import spread
from msbdb.labels import Labels, boxes, label_zones, sizes
from msbdb.params import TouchingParams
from msbdb.spectral.colours import INTENSITY_STEPS

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

BESIDE_M = 1.5
"""Materials are compared over this distance on both sides of a line: less than half of a narrow house."""

ALONG_M = 2.0
"""Along a line the intensity is averaged over this length, against the noise of single pulses."""

DEPTH_M = 3.0
"""A line is at least so long: no house is less deep."""

LEVEL = 0.15
"""A row goes on where the median slope along it is less."""

SLOPE = 0.35
"""The median slope across a row is at least this, 19 degrees: on level roofs terraces, gravel and moss change."""

MOST = 0.7
"""A contrast counts up to this one, a factor of 2: solar panels or a window shall not stand for a whole line."""


def cut_rows(
    houses: Labels,
    heights: NDArray[np.float32],
    intensity: NDArray[np.uint8],
    directions: RoofDirections,
    params: TouchingParams,
    *,
    cell_m: float,
) -> Labels:
    """Divide houses along straight lines across their ridge, where the material changes.

    Parameters
    ----------
    houses : (H, W) ndarray of int32
        The houses that may be divided; 0 for none.
    heights : (H, W) ndarray of float32, metres
        Heights, freed of single outliers.
    intensity : (H, W) ndarray of uint8
        Of the first echoes, in steps of its logarithm; 0 where unknown.
    directions : RoofDirections
        The directions of the roofs.
    params : TouchingParams
        The least contrast and the least house.
    cell_m : float
        Side of a cell, metres.

    Returns
    -------
    (H, W) ndarray of int32
        The houses, numbered in row order; each is connected.

    Notes
    -----
    The party walls of a terrace leave no step in a roof that goes on. But each owner renews the tiles, and the pulses
    come back weaker or stronger. Both sides of a line across the ridge have the same slope, so the angle of the pulses
    is the same, and only the material differs. Two slopes of one roof are never compared.

    On cells larger than half of `BESIDE_M` nothing is divided: a side of a line would be a single cell.

    The contrast of a line is the mean of |ln(I_left / I_right)| over all its cells. The line with the largest contrast
    divides first; others follow where both sides are houses by ``house_m2`` and ``width_m``.

    Complexity: linear in the cells, and in the lines of each house.
    """
    if 2 * cell_m > BESIDE_M:
        return label_zones(houses)[0]
    found = houses.copy()
    count = int(houses.max(initial=0))
    for number, window in boxes(houses).items():
        own = houses[window] == number
        if np.count_nonzero(own) * cell_m**2 < 2 * params.house_m2:
            continue
        fields = (directions.cosine, directions.sine)
        cosine, sine = (float(field[window][own].sum(dtype=np.float64)) for field in fields)
        for angle in (math.atan2(sine, cosine) / 4, math.atan2(sine, cosine) / 4 + math.pi / 2):
            parts = _cut_row(own, (heights[window], intensity[window]), angle, params, cell_m)
            if parts.max() > 0:
                found[window][own] = np.where(parts > 0, count + parts, number)
                count += int(parts.max())
                break
    return label_zones(found)[0]


def _cut_row(
    own: Mask, roof: tuple[NDArray[np.float32], NDArray[np.uint8]], angle: float, params: TouchingParams, cell_m: float
) -> NDArray[np.int64]:
    """Return the part of each cell of a house, 0 for the first, along a row that runs at this angle."""
    row, col = np.nonzero(own)
    along = col * math.cos(angle) + row * math.sin(angle)
    across = row * math.cos(angle) - col * math.sin(angle)
    begin, top = math.floor(along.min()), math.floor(across.min())
    # The row on a lattice of its own, with the nearest cells.
    u = begin + np.arange(math.ceil(along.max()) - begin + 1)
    v = top + np.arange(math.ceil(across.max()) - top + 1)[:, None]
    c = np.rint(u * math.cos(angle) - v * math.sin(angle)).astype(np.int64)
    r = np.rint(u * math.sin(angle) + v * math.cos(angle)).astype(np.int64)
    inside = (r >= 0) & (r < own.shape[0]) & (c >= 0) & (c < own.shape[1])
    place = np.where(inside, r, 0), np.where(inside, c, 0)
    there = inside & own[place]
    heights, intensity = roof
    if not _is_row(there, heights[place].astype(np.float64), cell_m):
        return np.zeros(row.size, dtype=np.int64)
    contrast = _contrasts(there, intensity[place], cell_m)
    position = along - begin
    cuts: list[int] = []
    for line in np.argsort(-contrast, kind="stable").tolist():
        if contrast[line] < params.contrast:
            break
        if any(abs(line - cut) * cell_m < params.width_m for cut in cuts):
            continue
        trial = sorted([*cuts, line])
        parts = np.searchsorted(np.array(trial) - 0.5, position, side="right")
        first = trial.index(line)
        if all(_is_house(row[side], col[side], params, cell_m) for side in (parts == first, parts == first + 1)):
            cuts = trial
    parts = np.zeros(row.size, dtype=np.int64)
    parts[:] = np.searchsorted(np.array(cuts) - 0.5, position, side="right")
    return parts


def _is_row(there: Mask, height: Floats, cell_m: float) -> bool:
    """Return whether a roof is level along the row and slopes across it."""
    both = [there[:, 2:] & there[:, :-2], there[2:] & there[:-2]]
    slopes = [np.abs(height[:, 2:] - height[:, :-2]), np.abs(height[2:] - height[:-2])]
    if not (both[0].any() and both[1].any()):
        return False
    along, across = (float(np.median(slope[inner])) / (2 * cell_m) for slope, inner in zip(slopes, both, strict=True))
    return along < LEVEL and across >= SLOPE


def _contrasts(there: Mask, intensity: NDArray[np.uint8], cell_m: float) -> Floats:
    """Return the mean contrast of the line before each column; 0 where a line is too short."""
    known = there & (intensity > 0)
    weight = uniform_filter1d(known.astype(np.float64), max(1, round(ALONG_M / cell_m)), axis=0, mode="constant")
    value = np.where(known, intensity / INTENSITY_STEPS, 0.0)
    value = uniform_filter1d(value, max(1, round(ALONG_M / cell_m)), axis=0, mode="constant")
    value = np.where(there, value / np.maximum(weight, 1e-9), 0)
    usable = there & (weight > 1e-9)
    beside = max(2, round(BESIDE_M / cell_m))
    columns = there.shape[1]
    # Sums over the columns up to each one.
    total, number = (
        np.pad(np.cumsum(np.where(usable, part, 0.0), axis=1), ((0, 0), (1, 0)))
        for part in (value, np.ones_like(value))
    )
    line = np.arange(columns)
    left, right = np.maximum(line - beside, 0), np.minimum(line + beside, columns)
    sides = [(total[:, b] - total[:, a], number[:, b] - number[:, a]) for a, b in ((left, line), (line, right))]
    enough = (sides[0][1] >= beside / 2) & (sides[1][1] >= beside / 2)
    means = [part / np.maximum(cells, 1) for part, cells in sides]
    contrast = np.where(enough, np.minimum(np.abs(means[0] - means[1]), MOST), 0)
    meets = there.copy()
    meets[:, 1:] &= there[:, :-1]
    meets[:, 0] = False
    length = meets.sum(axis=0)
    mean = np.where(meets, contrast, 0).sum(axis=0) / np.maximum(length, 1)
    return np.where(length * cell_m >= DEPTH_M, mean, 0)


def _is_house(row: NDArray[np.int64], col: NDArray[np.int64], params: TouchingParams, cell_m: float) -> bool:
    """Return whether each connected piece of these cells is large enough, and all are wide enough, for a house."""
    if not row.size:
        return False
    cells = np.zeros((np.ptp(row) + 1, np.ptp(col) + 1), dtype=np.bool_)
    cells[row - row.min(), col - col.min()] = True
    pieces, count = label_zones(cells)
    if sizes(pieces, count).min() * cell_m**2 < params.house_m2:
        return False
    y, x = row.astype(np.float64), col.astype(np.float64)
    moments = [float(values.sum()) for values in (y, x, y * y, x * x, y * x)]
    return spread(float(y.size), moments)[0] * cell_m >= params.width_m

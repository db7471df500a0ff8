"""Pieces of roofs: the cells of buildings cut along all lines where a house may end, and where the pieces touch."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter

from msbdb.fuse.houses.roofdirections import RoofDirections
from msbdb.labels import Box, CellList, Labels, around, boxes, label_zones, sums, widened
from msbdb.threads import in_threads

Mask = NDArray[np.bool_]
Floats = NDArray[np.float64]

KINDS = ("step", "valley", "wall", "direction")
"""The kinds of evidence, in the order of the columns of `Touch`."""

SMOOTH_M = 0.4
"""Standard deviation of the smoothing before tops are sought: below it are tiles, dormers' edges and noise."""

TRUNCATE = 4.0
"""The smoothing reaches so many standard deviations."""

TOP_M = 0.4
"""A top rises this far above the saddle to a higher one: chimneys and noise are lower after the smoothing."""


@dataclass(frozen=True, slots=True, eq=False)
class RoofPieces:
    """Pieces of roofs, with sums that add up when pieces are joined.

    Parameters
    ----------
    labels : (H, W) ndarray of int32
        0 for none, otherwise row number + 1.
    cells : (N,) ndarray of float64
        Number of cells.
    heights : (N,) ndarray of float64
        Sum of their heights, metres.
    tops : (N,) ndarray of float64
        Largest height within the piece that a tenth of its cells reach, metres.
    moments : (N, 5) ndarray of float64
        Sums of row, column, row², column² and row times column.
    owners : (N,) ndarray of int64
        The parcel of each piece; 0 for none.
    rims : (N,) ndarray of float64
        Pairs of a cell of the piece and a neighbour that is in no piece; what lies beyond the lattice counts as such.
    directions : (N, 3) ndarray of float64
        Sums of the cosines, the sines and the weights of `RoofDirections`.
    """

    labels: Labels
    cells: Floats
    heights: Floats
    tops: Floats
    moments: Floats
    owners: NDArray[np.int64]
    rims: Floats
    directions: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Touches:
    """Where two pieces touch, a row each.

    Parameters
    ----------
    one, other : (B,) ndarray of int64
        Row numbers of the pieces; ``one`` is smaller.
    counts : (B, 14) ndarray of float64
        Pairs of neighbouring cells; those with a step, valley or wall; those with each of `KINDS`; sum of their
        differences of height, metres; sums of their lowest heights, and of the squares; sums of row, column, row²,
        column² and row times column.
    """

    one: NDArray[np.int64]
    other: NDArray[np.int64]
    counts: Floats


def cut_pieces(
    heights: NDArray[np.float32], built: Mask, strength: NDArray[np.float32], *, cell_m: float, core_m: float
) -> Labels:
    """Cut the cells of buildings along the lines where one house may end and the next begin.

    Parameters
    ----------
    heights : (H, W) ndarray of float32, metres
        Heights, freed of single outliers.
    built : (H, W) ndarray of bool
        Cells of buildings.
    strength : (H, W) ndarray of float32
        Evidence of a border in each cell; 1 and more is a barrier.
    cell_m : float
        Side of a cell, metres.
    core_m : float
        Radius of a disc. Where it does not pass, a barrier with a gap is closed.

    Returns
    -------
    (H, W) ndarray of int32
        Pieces, numbered in row order; 0 outside of buildings.

    Notes
    -----
    Two watersheds [1]_ are laid over each other. One floods the evidence from the cells that are at least ``core_m``
    from each barrier and each edge, so it follows steps and walls. The other floods the roofs turned upside down from
    their tops, so it follows valleys exactly, also where a dormer or a parapet interrupts them. Far too many pieces are
    the result: slopes and dormers, too. `msbdb.fuse.houses.touching` joins those that nothing separates.

    References
    ----------
    .. [1] Beucher, S., Meyer, F., 1993. The morphological approach to segmentation: the watershed transformation.
       Mathematical Morphology in Image Processing, 433-481.
    """
    islands, _ = label_zones(built)
    margin = math.ceil(TRUNCATE * SMOOTH_M / cell_m) + 1
    found = np.zeros(built.shape, dtype=np.int64)

    def cut(island: tuple[int, Box]) -> None:
        number, window = island
        near = widened(window, margin)
        own = islands[near] == number
        core, top, relief, smooth = _marks(heights[near], built[near], strength[near], cell_m=cell_m, core_m=core_m)
        # An island without any core is one piece here.
        seeds = core & own if (core & own).any() else own
        between, below = (
            _flooded(each, label_zones(of & own)[0], own) for each, of in ((relief, seeds), (-smooth, top))
        )
        # No cell is of two islands, so threads never write to the same place.
        found[near][own] = (between.astype(np.int64) * (int(below.max()) + 1) + below)[own]

    in_threads(cut, boxes(islands).items())
    cells = CellList.covering(built)
    return cells.image(cells.zones(cells.of(found), connectivity=4)[0])


def cut_bends(labels: Labels, turn_deg: NDArray[np.float32], least_deg: float) -> Labels:
    """Cut pieces also along the lines where directions turn most.

    Parameters
    ----------
    labels : (H, W) ndarray of int32
        The pieces; 0 for none.
    turn_deg : (H, W) ndarray of float32
        How far directions turn at each cell, degrees.
    least_deg : float
        Cells that turn less are of one direction where they are connected.

    Examples
    --------
    >>> turn = np.array([[0, 0, 10, 30, 20, 0, 0]], dtype=np.float32)
    >>> cut_bends(np.ones((1, 7), dtype=np.int32), turn, 15.0).tolist()
    [[1, 1, 1, 1, 2, 2, 2]]
    """
    built = labels > 0
    if not (turn_deg >= least_deg).any():
        return labels
    seeds, _ = label_zones(built & (turn_deg < least_deg))
    sides = _flooded(turn_deg, seeds, built)
    cells = CellList.covering(built)
    both = cells.of(labels).astype(np.int64) * (int(sides.max()) + 1) + cells.of(sides)
    return cells.image(cells.zones(both, connectivity=4)[0])


def _marks(
    heights: NDArray[np.float32], built: Mask, strength: NDArray[np.float32], *, cell_m: float, core_m: float
) -> tuple[Mask, Mask, NDArray[np.float32], NDArray[np.float32]]:
    """Return cores and tops of roofs, the evidence that is flooded from the cores, and the smoothed roofs."""
    from skimage.morphology import h_maxima

    core = distance_transform_edt(built & (strength < 1)) * cell_m >= core_m
    relief = gaussian_filter(np.where(built, strength, 0), 0.5)
    smooth = np.where(built, gaussian_filter(heights, SMOOTH_M / cell_m, truncate=TRUNCATE), 0).astype(np.float32)
    # Tops rise `TOP_M` above the saddles between them.
    top = h_maxima(smooth, TOP_M) > 0  # type: ignore[no-untyped-call]  # scikit-image
    return core, top, relief, smooth


def _flooded(relief: NDArray[np.float32], seeds: Labels, built: Mask) -> Labels:
    """Return the watershed of a relief within the buildings; each connected part of them holds a seed."""
    from skimage.segmentation import watershed

    found: Labels = watershed(relief, np.where(built, seeds, 0), mask=built)  # type: ignore[no-untyped-call]  # scikit-image
    return found


def measure_pieces(
    labels: Labels,
    heights: NDArray[np.float32],
    parcels: Labels | None = None,
    directions: RoofDirections | None = None,
) -> RoofPieces:
    """Sum up the cells of pieces; each piece lies in one parcel at most."""
    count = int(labels.max(initial=0))
    cells = np.flatnonzero(labels != 0)
    member = labels.ravel()[cells]
    places = (place.astype(np.float64) for place in np.divmod(cells, labels.shape[1]))
    height = heights.ravel()[cells].astype(np.float64)
    parts = (np.ones(cells.size), height, *_moments(*places))
    area, total, *moments = (sums(member, part, count) for part in parts)
    tops = np.zeros(count)
    order = np.lexsort((height, member))
    last = np.searchsorted(member[order], np.arange(1, count + 1), side="right") - 1
    tops[:] = height[order][last - np.floor(0.1 * (area - 1)).astype(np.int64)]
    owners = np.zeros(count, dtype=np.int64)
    if parcels is not None:
        owners[member - 1] = parcels.ravel()[cells]
    framed = np.pad(labels, 1)
    outside = (around(framed, np.flatnonzero(framed > 0)) == 0).sum(axis=1).astype(np.float64)
    rims = sums(member, outside, count)
    found = np.zeros((count, 3))
    if directions is not None:
        fields = (directions.cosine, directions.sine, directions.weight)
        found = np.stack([sums(member, field.ravel()[cells].astype(np.float64), count) for field in fields], axis=1)
    return RoofPieces(labels, area, total, tops, np.stack(moments, axis=1), owners, rims, found)


def _moments(row: Floats, col: Floats) -> tuple[Floats, ...]:
    """Return what is summed up for the second moments of cells."""
    return row, col, row * row, col * col, row * col


def spread(count: float, moments: Sequence[float]) -> tuple[float, float]:
    """Return the smaller and the larger side of the rectangle with the second moments of cells, cells.

    Examples
    --------
    Two rows of four cells:

    >>> row, col = np.divmod(np.arange(8.0), 4)
    >>> sums_of = [float(part.sum()) for part in (row, col, row * row, col * col, row * col)]
    >>> tuple(round(side, 6) for side in spread(8, sums_of))
    (2.0, 4.0)
    """
    row, col, row2, col2, both = (moment / count for moment in moments)
    # A cell itself has the variance 1/12.
    one, other, mixed = row2 - row * row + 1 / 12, col2 - col * col + 1 / 12, both - row * col
    middle, half = (one + other) / 2, math.hypot((one - other) / 2, mixed)
    return math.sqrt(12 * max(middle - half, 0)), math.sqrt(12 * (middle + half))


def measure_touches(
    labels: Labels, heights: NDArray[np.float32], evidence: tuple[NDArray[np.float32], ...], least: tuple[float, ...]
) -> Touches:
    """Count the pairs of neighbouring cells of two pieces, and the evidence along them.

    Parameters
    ----------
    labels : (H, W) ndarray of int32
        The pieces.
    heights : (H, W) ndarray of float32, metres
        Their heights.
    evidence : tuple of (H, W) ndarray of float32
        Of each cell, in the order of `KINDS`: metres, and degrees. A pair has what the cells around either of its two
        have.
    least : tuple of float
        From which value on each is evidence.
    """
    count = int(labels.max(initial=0))
    framed = np.pad(labels, 1)
    height = np.pad(heights, 1)
    below = np.where(framed > 0, height, np.float32(np.inf))
    strengths = [np.pad(strength, 1) for strength in evidence]
    cells, width = np.flatnonzero(framed > 0), framed.shape[1]
    keys, columns = [], []
    # To the right, down, and down along both diagonals; the frame is in no piece.
    for step in (1, width, width + 1, width - 1):
        one, other = framed.ravel()[cells], framed.ravel()[cells + step]
        pair = (one != other) & (other > 0)
        smaller, larger = np.minimum(one, other)[pair], np.maximum(one, other)[pair]
        keys.append((smaller.astype(np.int64) - 1) * count + larger - 1)
        here = cells[pair]
        there = here + step
        found = [
            (around(strength, here).max(axis=1) >= limit) | (around(strength, there).max(axis=1) >= limit)
            for strength, limit in zip(strengths, least, strict=True)
        ]
        shown = (found[0] | found[1] | found[2], *found)
        low = np.minimum(around(below, here).min(axis=1), around(below, there).min(axis=1)).astype(np.float64)
        places = (place.astype(np.float64) - 1 for place in np.divmod(here, width))
        differ = np.abs(height.ravel()[here] - height.ravel()[there]).astype(np.float64)
        columns.append(np.stack([np.ones(low.size), *shown, differ, low, low * low, *_moments(*places)], axis=1))
    touch, member = np.unique(np.concatenate(keys), return_inverse=True)
    table = np.concatenate(columns)
    counts = np.stack([sums(member + 1, column, touch.size) for column in table.T], axis=1)
    return Touches(touch // max(count, 1), touch % max(count, 1), counts)

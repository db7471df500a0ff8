"""Scales found in the image itself, by horizontal and vertical granulometry (V8; Vincent 1994)."""

import logging
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msbdb.errors import ParameterError
from msbdb.morphology.kernels import kernel
from msbdb.morphology.runs import require_image

logger = logging.getLogger(__name__)

BINS_PER_OCTAVE = 2
"""Bins of the spectrum for each doubling of the area: two peaks differ by a factor of about two at least."""

EXTREME_SHARE = 0.05
"""Share of the built cells below the finest scale, and above the coarsest."""

PEAK_SHARE = 0.02
"""Share of the built cells that a bin, smoothed, needs to be a peak."""


def opening_areas(level: NDArray[Any]) -> NDArray[np.int64]:
    """Return the area, in cells, of the horizontal and vertical openings that each cell survives.

    A cell survives the opening by a horizontal segment of n cells when the run of cells of its row, no lower than
    itself and around it, has at least n of them. Its area is the largest such n times the largest one in its column:
    that of the building part that it lies on, where this is a rectangle along the lattice.

    Parameters
    ----------
    level : (H, W) ndarray
        A mask, storeys or heights, without NaN. Not modified.

    Returns
    -------
    (H, W) ndarray of int64
        Cells; from 1.

    Raises
    ------
    InputError
        When the array is no image.

    Notes
    -----
    Border: a run cut by the edge counts by what is seen of it. Complexity: linear in the cells.

    Examples
    --------
    >>> opening_areas(np.array([[1, 2, 2, 1], [1, 1, 1, 1]]))
    array([[8, 2, 2, 8],
           [8, 8, 8, 8]])
    """
    require_image(level)
    horizontal = _row_openings(np.ascontiguousarray(level))
    vertical = _row_openings(np.ascontiguousarray(level.T))
    return horizontal.astype(np.int64) * vertical.T


def find_scales(
    mask_or_level: NDArray[Any],
    cell_area_m2: float,
    *,
    smallest_m2: float = 20.0,
    largest_m2: float = 10_000.0,
    most: int = 6,
) -> tuple[float, ...]:
    """Find the area thresholds of the scale-space from the sizes that the image contains (V8).

    Parameters
    ----------
    mask_or_level : (H, W) ndarray
        Buildings or off-ground cells: a mask, or storeys or heights with 0 for the background. Not modified.
    cell_area_m2 : float
        Area of a cell, square metres.
    smallest_m2, largest_m2 : float
        Bounds of the scales, square metres. Smaller sizes are trees and noise, larger ones joined blocks; neither
        takes part in the rule.
    most : int
        The largest number of scales, from 2.

    Returns
    -------
    tuple of float
        Square metres, ascending, each within the bounds; at least one.

    Raises
    ------
    InputError
        When the array is no image.
    ParameterError
        When the cell area or the bounds are not positive and ascending, or fewer than two scales are allowed.

    Notes
    -----
    The paper names the method (Vincent, 1994) [1]_ and no rule; the rule is ours:

    1. Each cell above 0 has a size: the area of the linear openings that it survives (`opening_areas`). Sizes
       outside of the bounds are left out.
    2. Finest scale, the smallest building: the size that 5 % of these cells do not exceed. Coarsest scale, the
       biggest building: the size that 95 % do not exceed.
    3. Between them lie the peaks of the pattern spectrum: the number of cells by size in half-octave bins, smoothed by
       (1, 2, 1) / 4. A peak is higher than the bin before, no lower than the one after, and holds at least 2 % of the
       cells; its scale is the mean size in its bin. A peak within half an octave of the finest or coarsest scale is that scale.
    4. If these are too many, the highest peaks stay; of equal ones, the smaller size.

    Without any cell in the bounds the one scale is ``smallest_m2``: the scale-space of an empty field is empty at
    any scale.

    Border and complexity are those of `opening_areas`.

    References
    ----------
    .. [1] Vincent, L., 1994. Fast grayscale granulometry algorithms. Mathematical Morphology and its Applications to
       Image Processing (ISMM'94), 265-272. doi:10.1007/978-94-011-1040-2_34.
    """
    _require_bounds(cell_area_m2, smallest_m2, largest_m2, most)
    sizes = opening_areas(mask_or_level)[mask_or_level > 0] * float(cell_area_m2)
    sizes = sizes[(sizes >= smallest_m2) & (sizes <= largest_m2)]
    if sizes.size == 0:
        logger.info("Granulometry: no size between %g and %g m2; one scale at the smallest", smallest_m2, largest_m2)
        return (float(smallest_m2),)
    extremes = np.quantile(sizes, [EXTREME_SHARE, 1 - EXTREME_SHARE], method="inverted_cdf")
    finest, coarsest = (float(size) for size in extremes)
    near = 2 ** (1 / BINS_PER_OCTAVE)
    between = [size for size in _peaks(sizes, smallest_m2, largest_m2) if finest * near < size < coarsest / near]
    scales = tuple(sorted({finest, coarsest, *between[: most - 2]}))
    logger.info("Granulometry: %d cells, scales %s m2", sizes.size, ", ".join(f"{scale:g}" for scale in scales))
    return scales


def _require_bounds(cell_area_m2: float, smallest_m2: float, largest_m2: float, most: int) -> None:
    """Refuse a cell area or bounds that leave no scale."""
    if not 0 < cell_area_m2 < math.inf:
        msg = f"The area of a cell must be positive and finite; got {cell_area_m2} m2."
        raise ParameterError(msg)
    if not 0 < smallest_m2 < largest_m2 < math.inf:
        msg = f"The scales' bounds must be positive and ascending; got {smallest_m2} and {largest_m2} m2."
        raise ParameterError(msg)
    if most < 2:
        msg = f"At least two scales must be allowed, the finest and the coarsest; got {most}."
        raise ParameterError(msg)


def _peaks(sizes: NDArray[np.float64], smallest_m2: float, largest_m2: float) -> list[float]:
    """Return the mean sizes in the peaks of the pattern spectrum, the highest peak first."""
    count = math.floor(math.log2(largest_m2 / smallest_m2) * BINS_PER_OCTAVE) + 1
    index = np.floor(np.log2(sizes / smallest_m2) * BINS_PER_OCTAVE).astype(np.intp)
    cells = np.bincount(index, minlength=count).astype(np.float64)
    sums = np.bincount(index, weights=sizes, minlength=count)
    padded = np.pad(cells, 2)
    smooth = (padded[:-2] + 2 * padded[1:-1] + padded[2:]) / 4
    here, before, after = smooth[1:-1], smooth[:-2], smooth[2:]
    # A peak's own bin is never empty: between two filled bins the smoothed spectrum rises towards the higher one.
    found = np.flatnonzero((here > before) & (here >= after) & (here >= PEAK_SHARE * sizes.size) & (cells > 0))
    highest_first = found[np.argsort(-here[found], kind="stable")]
    return [float(size) for size in sums[highest_first] / cells[highest_first]]


@kernel
def _row_openings(level: NDArray[Any]) -> NDArray[np.int32]:
    """Return for each cell the length of the run of its row, around it, that is no lower than the cell.

    A stack holds the cells whose runs are still open, never falling from its bottom to its top: a lower cell, or the
    row's end, closes the runs of all higher ones. Cells of equal value share their run.
    """
    rows, cols = level.shape
    lengths = np.empty((rows, cols), dtype=np.int32)
    stack = np.empty(cols, dtype=np.int32)
    begin = np.empty(cols, dtype=np.int32)
    for row in range(rows):
        depth = 0
        for col in range(cols):
            begin[col] = col
            while depth > 0 and level[row, stack[depth - 1]] >= level[row, col]:
                top = stack[depth - 1]
                begin[col] = begin[top]
                if level[row, top] == level[row, col]:
                    break
                lengths[row, top] = col - begin[top]
                depth -= 1
            stack[depth] = col
            depth += 1
        for top in stack[:depth]:
            lengths[row, top] = cols - begin[top]
    return lengths

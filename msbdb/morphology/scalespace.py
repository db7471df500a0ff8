"""The area open-close scale-space (Vu et al. 2009, Eq. 6; V6 to V11), and its scales found in the image itself.

The scales come from the user or from granulometry (V8): the areas of the linear openings that the cells survive.
"""

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msbdb.errors import InputError, ParameterError
from msbdb.labels import CellList, look_up, sizes
from msbdb.labels.numbering import require_image
from msbdb.morphology.area import area_open_close, require_threshold, widen
from msbdb.morphology.smallzones import merge_small_zones
from msbdb.params import GranulometryParams
from msbdb.threads import kernel

logger = logging.getLogger(__name__)

BINS_PER_OCTAVE = 2
"""Bins of the spectrum for each doubling of the area: two peaks differ by a factor of about two at least."""

DEFAULTS = GranulometryParams()


@dataclass(frozen=True, slots=True, eq=False)
class ScaleSpace:
    """An image at rising area thresholds; the array is read-only.

    Parameters
    ----------
    levels : (S, H, W) ndarray
        The image at each scale, finest first: level 0 has the smallest threshold.
    thresholds_px : tuple of int
        s of each level, cells, ascending.
    """

    levels: NDArray[Any]
    thresholds_px: tuple[int, ...]

    def __post_init__(self) -> None:
        """Check that there is one level a threshold, and freeze the array."""
        if self.levels.ndim != 3 or len(self.levels) != len(self.thresholds_px):
            msg = f"There must be one level a threshold; got {self.levels.shape} and {self.thresholds_px}."
            raise InputError(msg)
        self.levels.flags.writeable = False


def build_scale_space(
    level: NDArray[Any],
    thresholds_px: Sequence[int],
    *,
    connectivity: int = 8,
    merge_small: bool = False,
    keep_ground: bool = False,
) -> ScaleSpace:
    """Filter an image by AOC with rising thresholds, each scale fed by the one before.

    Parameters
    ----------
    level : (H, W) ndarray
        SP_0 = M: the sliced heights, such as storeys with 0 for the background. Not modified.
    thresholds_px : sequence of int
        s_1 < s_2 < ..., cells, each from 1.
    connectivity : int
        4 or 8: the same for openings and closings, and to be used for the flat zones too.
    merge_small : bool
        Merge on every scale the zones of fewer than s cells with a neighbour (`merge_small_zones`), so that each zone
        above 0 has s cells or more (V7).
    keep_ground : bool
        Cells that are 0 on the finest scale stay 0 on all others: courtyards stay open. Islands of fewer than s cells,
        which a closing can join to what is around their yard, are 0 as well.

    Returns
    -------
    ScaleSpace
        Of the image's dtype.

    Raises
    ------
    InputError
        When the array is no image.
    ParameterError
        When there is no threshold, or they do not ascend.

    Notes
    -----
    SP_i = φ_i(γ_i(SP_{i-1})) with SP_0 = M (Eq. 6): peaks and pits of at least s_i cells remain on scale i. Zones on
    the way from a pit to a peak may be smaller; without ``merge_small`` they stay.

    With one connectivity for all, flat zones only merge as s rises: each flat zone of a scale lies in one flat zone
    of the next. So a father is unique, and any one cell of the child shows it (V10, V11).

    Border, nodata and complexity are those of `msbdb.morphology.area_opening`. The cost of a scale follows the runs
    of the scale before, which become few after the first.

    Examples
    --------
    Three storeys on two cells, on a house of one storey: the tower is a part at s = 2 and gone at s = 3.

    >>> build_scale_space(np.array([[0, 0, 0, 1, 3, 3, 1, 0, 0, 0]]), [2, 3]).levels[:, 0]
    array([[0, 0, 0, 1, 3, 3, 1, 0, 0, 0],
           [0, 0, 0, 1, 1, 1, 1, 0, 0, 0]])
    """
    require_image(level)
    thresholds = tuple(thresholds_px)
    for threshold in thresholds:
        require_threshold(threshold)
    if not thresholds or any(a >= b for a, b in pairwise(thresholds)):
        msg = f"The area thresholds must be one or more ascending numbers of cells; got {thresholds}."
        raise ParameterError(msg)
    levels = np.empty((len(thresholds), *level.shape), dtype=level.dtype)
    current, island = level, np.zeros(0, dtype=np.int32)
    for index, threshold in enumerate(thresholds):
        current = area_open_close(current, threshold, connectivity=connectivity)
        if keep_ground and index:
            current = np.where(island < threshold, current.dtype.type(0), current)
        if merge_small:
            current = merge_small_zones(current, threshold, connectivity=connectivity)
        if keep_ground and not index:
            island = _island_sizes(current, connectivity)
        levels[index] = current
    return ScaleSpace(levels, tuple(int(threshold) for threshold in thresholds))


def _island_sizes(level: NDArray[Any], connectivity: int) -> NDArray[np.int32]:
    """Return for each cell above 0 the number of cells of its island; 0 elsewhere."""
    cells = CellList.covering(level > 0)
    islands, count = cells.zones(np.ones(cells.numbers.size, dtype=np.uint8), connectivity=connectivity)
    return cells.image(look_up(np.concatenate([[0], sizes(islands, count)]).astype(np.int32), islands))


def opening_areas(level: NDArray[Any]) -> NDArray[np.int64]:
    """Return the area, in cells, of the horizontal and vertical openings that each cell survives.

    A cell survives the opening by a horizontal segment of n cells when at least n cells in a row, itself included,
    are no lower than itself. Its area is the largest such n in its row times the largest in its column. For a
    rectangle along the lattice this is the area of the building part that holds the cell.

    Parameters
    ----------
    level : (H, W) ndarray
        A mask, storeys or heights, without NaN, integers up to the largest int64. Not modified.

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
    horizontal = _row_openings(widen(level))
    vertical = _row_openings(widen(level.T))
    return horizontal.astype(np.int64) * vertical.T


def find_scales(
    mask_or_level: NDArray[Any], cell_area_m2: float, params: GranulometryParams = DEFAULTS
) -> tuple[float, ...]:
    """Find the area thresholds of the scale-space from the sizes that the image contains (V8).

    Parameters
    ----------
    mask_or_level : (H, W) ndarray
        Buildings or off-ground cells: a mask, or storeys or heights with 0 for the background. Not modified.
    cell_area_m2 : float
        Area of a cell, square metres.
    params : GranulometryParams
        The bounds of the scales, their largest number, and the shares of the rule.

    Returns
    -------
    tuple of float
        Square metres, ascending, each within the bounds and, unless the image is empty, a whole number of cells; at
        least one.

    Raises
    ------
    InputError
        When the array is no image.
    ParameterError
        When the cell area is not positive, or the bounds do not ascend.

    Notes
    -----
    The paper names the method [1]_ and no rule; the rule is ours:

    1. Each cell above 0 has a size: the area of the linear openings that it survives (`opening_areas`). Sizes
       outside of the bounds are left out of all that follows.
    2. The finest scale, the smallest building, is the size that ``extreme_share`` of these cells do not exceed. The
       coarsest, the biggest building, is the size that all but ``extreme_share`` of them do not exceed.
    3. Between the two lie the peaks of the pattern spectrum: the number of cells by size, in half-octave bins,
       smoothed by (1, 2, 1) / 4. A peak is higher than the bin before, no lower than the one after, and holds at
       least ``peak_share`` of the cells; its scale is the median size in its bin. It is left out within half an octave
       of the finest or the coarsest scale.
    4. When these are more than ``most``, the highest peaks stay; of equal ones that of the smaller size.

    Without any cell in the bounds the one scale is ``smallest_m2``: an empty field is empty on every scale.

    Border and complexity are those of `opening_areas`.

    Examples
    --------
    Two houses, of 20 m2 and of 100 m2, in cells of 4 m2:

    >>> mask = np.zeros((7, 12), dtype=bool)
    >>> mask[1, 1:6] = mask[2:, 7:] = True
    >>> find_scales(mask, 4.0)
    (20.0, 100.0)

    References
    ----------
    .. [1] Vincent, L., 1994. Fast grayscale granulometry algorithms. Mathematical Morphology and its Applications to
       Image Processing (ISMM'94), Fontainebleau, 265-272.
    """
    return scales_of_sizes(sizes_of_cells(mask_or_level, cell_area_m2, params), params)


def sizes_of_cells(
    mask_or_level: NDArray[Any], cell_area_m2: float, params: GranulometryParams
) -> NDArray[np.floating]:
    """Return the sizes of cells within the bounds of the scales, square metres: the first step of `find_scales`."""
    _require_bounds(cell_area_m2, params)
    sizes = opening_areas(mask_or_level)[mask_or_level > 0] * float(cell_area_m2)
    return np.asarray(sizes[(sizes >= params.smallest_m2) & (sizes <= params.largest_m2)])


def scales_of_sizes(sizes: NDArray[np.floating], params: GranulometryParams) -> tuple[float, ...]:
    """Return the scales that the sizes of cells give, in any order: the other steps of `find_scales`."""
    if sizes.size == 0:
        logger.info("No cell has a size of %g to %g m2; one scale", params.smallest_m2, params.largest_m2)
        return (params.smallest_m2,)
    extremes = np.quantile(sizes, [params.extreme_share, 1 - params.extreme_share], method="inverted_cdf")
    finest, coarsest = (float(size) for size in extremes)
    near = 2 ** (1 / BINS_PER_OCTAVE)
    between = [size for size in _peaks(sizes, params) if finest * near < size < coarsest / near]
    scales = tuple(sorted({finest, coarsest, *between[: params.most - 2]}))
    logger.info("Scales from the sizes of %d cells: %s m2", sizes.size, ", ".join(f"{scale:g}" for scale in scales))
    return scales


def _require_bounds(cell_area_m2: float, params: GranulometryParams) -> None:
    """Refuse a cell area or bounds that leave no scale."""
    if not 0 < cell_area_m2 < math.inf:
        msg = f"The area of a cell must be positive and finite; got {cell_area_m2} m2."
        raise ParameterError(msg)
    if not 0 < params.smallest_m2 < params.largest_m2 < math.inf:
        msg = (
            "The bounds of the scales must be positive and ascend; "
            f"got granulometry.smallest_m2 = {params.smallest_m2} and granulometry.largest_m2 = {params.largest_m2}."
        )
        raise ParameterError(msg)


def _peaks(sizes: NDArray[np.floating], params: GranulometryParams) -> list[float]:
    """Return the median sizes in the peaks of the pattern spectrum, the highest peak first."""
    index = np.floor(np.log2(sizes / params.smallest_m2) * BINS_PER_OCTAVE).astype(np.intp)
    smooth = np.convolve(np.bincount(index), [0.25, 0.5, 0.25])
    # The convolution is longer by a bin on either side; the rest is empty.
    here, before, after = smooth[1:-1], smooth[:-2], smooth[2:]
    # A peak's own bin holds cells: over an empty bin the smoothed spectrum rises towards the higher neighbour.
    peaks = np.flatnonzero((here > before) & (here >= after) & (here >= params.peak_share * sizes.size))
    highest_first = peaks[np.argsort(-here[peaks], kind="stable")]
    return [float(np.quantile(sizes[index == peak], 0.5, method="inverted_cdf")) for peak in highest_first]


@kernel
def _row_openings(level: NDArray[Any]) -> NDArray[np.int32]:
    """Return for each cell the length of the run of its row around it that is nowhere lower than the cell.

    Invariant: the stack holds the cells whose runs are still open, and their values never fall from bottom to top. A
    lower cell, or the row's end, closes the runs of all higher ones. Cells of equal value share their run.
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
                begin[col] = begin[top]  # all from there on is at least as high as this cell
                if level[row, top] == level[row, col]:
                    break  # the run goes on: it ends for both at the same place
                lengths[row, top] = col - begin[top]
                depth -= 1
            stack[depth] = col
            depth += 1
        for top in stack[:depth]:
            lengths[row, top] = cols - begin[top]
    return lengths

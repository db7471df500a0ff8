"""The area open-close scale-space (Vu et al. 2009, Eq. 6; V6, V7, V10, V11)."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msbdb.errors import InputError, ParameterError
from msbdb.labels.numbering import require_image
from msbdb.morphology.area import area_open_close, require_threshold


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


def build_scale_space(level: NDArray[Any], thresholds_px: Sequence[int], *, connectivity: int = 8) -> ScaleSpace:
    """Filter an image by AOC with rising thresholds, each scale fed by the one before.

    Parameters
    ----------
    level : (H, W) ndarray
        SP_0 = M: the sliced heights, such as storeys with 0 for the background. Not modified.
    thresholds_px : sequence of int
        s_1 < s_2 < ..., cells, each from 1.
    connectivity : int
        4 or 8: the same for openings and closings, and to be used for the flat zones too.

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
    SP_i = φ_i(γ_i(SP_{i-1})) with SP_0 = M (Eq. 6): objects of at least s_i cells remain on scale i (V7).

    With one connectivity for all, flat zones only merge as s rises: each flat zone of a scale lies in one flat zone
    of the next, so a father is unique and found by looking at one cell (V10, V11).

    Border, nodata and complexity are those of `msbdb.morphology.area_opening`. The cost of a scale follows the runs
    of the scale before, which become few after the first.
    """
    require_image(level)
    thresholds = tuple(thresholds_px)
    for threshold in thresholds:
        require_threshold(threshold)
    if not thresholds or any(a >= b for a, b in pairwise(thresholds)):
        msg = f"The area thresholds must be one or more ascending numbers of cells; got {thresholds}."
        raise ParameterError(msg)
    levels = np.empty((len(thresholds), *level.shape), dtype=level.dtype)
    current = level
    for index, threshold in enumerate(thresholds):
        current = levels[index] = area_open_close(current, threshold, connectivity=connectivity)
    return ScaleSpace(levels, tuple(int(threshold) for threshold in thresholds))

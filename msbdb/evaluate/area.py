"""Agreement by area, on a grid of cells."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msbdb.evaluate.metrics import Rates, rates

Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class AreaScore:
    """Areas in m2, and their rates; the quality is the intersection over the union of the cells."""

    scored_m2: float
    reference_m2: float
    extracted_m2: float
    both_m2: float
    reference_only_m2: float
    extracted_only_m2: float
    rates: Rates


def score_area(extracted: Mask, reference: Mask, scored: Mask, cell_area_m2: float) -> AreaScore:
    """Compare the cells of buildings (V57, S11, M25, C21).

    Parameters
    ----------
    extracted, reference : (H, W) ndarray of bool
        Cells that are building.
    scored : (H, W) ndarray of bool
        The other cells are left out.
    cell_area_m2 : float
        Area of a cell, m2.
    """
    both = int(np.count_nonzero(extracted & reference & scored)) * cell_area_m2
    extracted_m2 = int(np.count_nonzero(extracted & scored)) * cell_area_m2
    reference_m2 = int(np.count_nonzero(reference & scored)) * cell_area_m2
    return AreaScore(
        scored_m2=int(np.count_nonzero(scored)) * cell_area_m2,
        reference_m2=reference_m2,
        extracted_m2=extracted_m2,
        both_m2=both,
        reference_only_m2=reference_m2 - both,
        extracted_only_m2=extracted_m2 - both,
        rates=rates(found=both, missed=reference_m2 - both, true=both, false=extracted_m2 - both),
    )

"""The rules that tell building regions by their shape (Cao & Wu, Eq. 8 and 9)."""

import numpy as np
from numpy.typing import NDArray

from msbdb.extract.area3d.shape import Shapes
from msbdb.params import Area3dParams


def perpendicular(directions: NDArray[np.float64], tolerance_deg: float) -> NDArray[np.bool_]:
    """Return (M,) whether the two main directions of (M, 2) are at a right angle, within a tolerance; NaN never is."""
    between = np.abs(directions[:, 0] - directions[:, 1])
    square: NDArray[np.bool_] = np.abs(np.minimum(between, 180 - between) - 90) <= tolerance_deg
    return square


def judge(shapes: Shapes, params: Area3dParams) -> NDArray[np.int8]:
    """Return (M,) the rule that accepts each region, 1 or 2; 0 for none (C18).

    Notes
    -----
    Rule 1: rectangularity ≥ T_rect^1 and compactness ≥ T_comp. Rule 2, asked where rule 1 does not hold:
    rectangularity ≥ T_rect^2 and compactness ≥ T_comp, and either the linearity ≥ T_line or the main directions are
    perpendicular.
    """
    compact = shapes.compactness >= params.compactness
    first = (shapes.rectangularity >= params.rectangularity_1) & compact
    straight = shapes.linearity >= params.linearity
    straight |= perpendicular(shapes.directions, params.perpendicular_deg)
    second = (shapes.rectangularity >= params.rectangularity_2) & compact & straight
    return np.where(first, 1, np.where(second, 2, 0)).astype(np.int8)


def reasons_against(shapes: Shapes, rule: NDArray[np.int8], params: Area3dParams) -> NDArray[np.object_]:
    """Return (M,) why each region is rejected, the first condition of rule 2 that fails; empty where it is accepted."""
    found = np.full(len(rule), "neither straight nor perpendicular", dtype=object)
    found[shapes.rectangularity < params.rectangularity_2] = "not rectangular enough"
    found[shapes.compactness < params.compactness] = "not compact enough"
    found[rule > 0] = ""
    return found

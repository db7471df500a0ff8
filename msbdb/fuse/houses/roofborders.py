"""Where one roof may end and the next begin: steps, valleys and walls, from profiles across each cell."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msbdb.threads import kernel

Heights = NDArray[np.float32]

NEAR_M = 0.8
"""Nearest distance at which a profile is read: beside the cells that a wall or a gutter blurs."""

NEAR_SPACINGS = 1.5
"""The same in spacings of the points: two points at least lie between both sides."""

REACH_M = 1.5
"""Length over which the slope on each side is read: less than half of a narrow house."""

STEEPEST = 1.5
"""Slopes count up to this one, a roof of 56 degrees: what is steeper is a wall."""

SHEER, SHEER_M = 2.5, 1.5
"""Within a profile, a rise from cell to cell above this slope, and above so many metres, is no roof."""


@dataclass(frozen=True, slots=True, eq=False)
class RoofBorders:
    """How strongly each cell looks like the border of two roofs; arrays (H, W) of float32, metres, 0 for not at all.

    Parameters
    ----------
    step_m : ndarray
        Jump of height across the cell, beyond what the steeper of the slopes on both sides gives.
    valley_m : ndarray
        Depth of the cell and its surroundings below the roofs on both sides.
    wall_m : ndarray
        Height of the cell above both roofs, each continued to the cell by its slope.
    """

    step_m: Heights
    valley_m: Heights
    wall_m: Heights


def find_roof_borders(heights: Heights, built: NDArray[np.bool_], *, cell_m: float, spacing_m: float) -> RoofBorders:
    r"""Measure steps, valleys and walls in four directions through each cell; the strongest of each kind counts.

    Parameters
    ----------
    heights : (H, W) ndarray of float32, metres
        Heights above ground or sea.
    built : (H, W) ndarray of bool
        Cells of buildings. A profile that leaves them within its near distance shows nothing.
    cell_m : float
        Side of a cell, metres.
    spacing_m : float
        Mean distance of the points, metres.

    Notes
    -----
    A profile reads each side at a near distance a and a far one b: left l_a, l_b, right r_a, r_b, the cell h. With the
    slopes s_l = (l_a - l_b) / (b - a) and s_r alike:

    - step = \|l_a - r_a\| - 2 a max(\|s_l\|, \|s_r\|): nothing on a slope, at a ridge or in a valley of roofs;
    - valley = min(l_b, r_b) - max(l_a, r_a, h): both sides rise away from the cell, and neither by a sheer face;
    - wall = h - max(l_a, r_a, l_a + a s_l, r_a + a s_r): nothing at a ridge, to which both slopes lead.

    Border and nodata: a far cell that is no building counts as the near one. Complexity: linear in the cells.

    Examples
    --------
    A step of 3 m between flat roofs, and a valley between two roofs that slope:

    >>> steps, valley = np.where(np.arange(12) < 6, 9.0, 6.0), 6 + 0.5 * np.abs(np.arange(12) - 6.0)
    >>> heights = np.stack([steps, valley]).astype(np.float32)
    >>> found = find_roof_borders(heights, np.ones((2, 12), dtype=bool), cell_m=1.0, spacing_m=0.5)
    >>> found.step_m[0].max().item(), found.valley_m[1].max().item()
    (3.0, 0.5)
    """
    near_m = max(NEAR_M, NEAR_SPACINGS * spacing_m)
    return RoofBorders(*_profiles(heights, built, cell_m, near_m, reach_m(spacing_m)))


def reach_m(spacing_m: float) -> float:
    """Return how far a profile reads on each side, metres, for points of this mean distance."""
    return max(NEAR_M, NEAR_SPACINGS * spacing_m) + REACH_M


@kernel
def _profiles(
    heights: Heights, built: NDArray[np.bool_], cell_m: float, near_m: float, far_m: float
) -> tuple[Heights, Heights, Heights]:
    """Return the strongest step, valley and wall of four profiles through each built cell."""
    rows, cols = heights.shape
    step, valley, wall = np.zeros_like(heights), np.zeros_like(heights), np.zeros_like(heights)
    for direction in range(4):
        down = (0, 1, 1, 1)[direction]
        right = (1, 0, 1, -1)[direction]
        unit = cell_m * np.sqrt(float(down * down + right * right))
        near = max(1, round(near_m / unit))
        far = max(near + 1, round(far_m / unit))
        sheer_m = max(SHEER * unit, SHEER_M)
        reach, run = near * unit, (far - near) * unit
        for row in range(near * down, rows - near * down):
            for col in range(cols):
                left_row, left_col = row - near * down, col - near * right
                right_row, right_col = row + near * down, col + near * right
                if left_col < 0 or left_col >= cols or right_col < 0 or right_col >= cols:
                    continue
                if not (built[row, col] and built[left_row, left_col] and built[right_row, right_col]):
                    continue
                one = far_one = heights[left_row, left_col]
                other = far_other = heights[right_row, right_col]
                sheer = False
                r, c = row - far * down, col - far * right
                if r >= 0 and 0 <= c < cols and built[r, c]:
                    far_one = heights[r, c]
                    for place in range(near, far):
                        fall = heights[row - place * down, col - place * right]
                        fall -= heights[row - (place + 1) * down, col - (place + 1) * right]
                        sheer = sheer or -fall > sheer_m
                r, c = row + far * down, col + far * right
                if r < rows and 0 <= c < cols and built[r, c]:
                    far_other = heights[r, c]
                    for place in range(near, far):
                        fall = heights[row + place * down, col + place * right]
                        fall -= heights[row + (place + 1) * down, col + (place + 1) * right]
                        sheer = sheer or -fall > sheer_m
                here = heights[row, col]
                slope_one = min(max((one - far_one) / run, -STEEPEST), STEEPEST)
                slope_other = min(max((other - far_other) / run, -STEEPEST), STEEPEST)
                jump = abs(one - other) - 2 * reach * max(abs(slope_one), abs(slope_other))
                depth = min(far_one, far_other) - max(one, other, here)
                if sheer:
                    depth = 0.0
                above = here - max(one, other, one + reach * slope_one, other + reach * slope_other)
                step[row, col] = max(step[row, col], jump)
                valley[row, col] = max(valley[row, col], depth)
                wall[row, col] = max(wall[row, col], above)
    return step, valley, wall

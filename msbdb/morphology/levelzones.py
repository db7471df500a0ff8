"""Level zones: connected cells without a real step between them, by constrained connectivity (Soille 2008)."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msbdb.errors import ParameterError
from msbdb.labels.numbering import Labels, require_connectivity, require_image
from msbdb.threads import kernel


def label_level_zones(
    heights: NDArray[np.integer],
    inside: NDArray[np.bool_],
    *,
    step: int,
    spread: int,
    free_step: int = -1,
    connectivity: int = 8,
) -> Labels:
    """Label the largest connected zones that have no large step between neighbours, and no large spread of heights.

    Parameters
    ----------
    heights : (H, W) ndarray of int32
        Heights in whole units, such as centimetres. Not modified.
    inside : (H, W) ndarray of bool
        The cells to label; others belong to no zone, and connect none.
    step : int
        Largest difference of two neighbours in one zone, units.
    spread : int
        Largest difference of any two cells of one zone, units.
    free_step : int
        Cells that steps of this size connect are one zone whatever its spread; below 0 there is no such step.
    connectivity : int
        4 or 8.

    Returns
    -------
    (H, W) ndarray of int32
        0 outside, otherwise a number for each zone: 1 + the place of its first cell among the cells inside.

    Raises
    ------
    InputError
        When the array is no image.
    ParameterError
        When step or spread is below 0, or the connectivity is neither 4 nor 8.

    Notes
    -----
    The α-zone of a cell holds all cells that it reaches by steps of α at most. The zone of a cell is its largest α-zone
    with α ≤ step whose highest and lowest cell differ by no more than the spread (α-ω-connectivity, [1]_), or with
    α ≤ free step. So a level roof stays whole where a ramp leads from it to another: its own noise is smaller than the
    steps of the ramp. Zones do not depend on any order of the cells, and islands do not influence each other.

    Border: zones end at the array. Complexity: linear in the cells.

    Examples
    --------
    Noise of 1 about a level of 10; a step of 5; and a ramp that spreads too far, so that each cell is its own zone:

    >>> heights = np.array([[10, 11, 10, 15, 16, 0, 20, 22, 24, 26, 28]])
    >>> label_level_zones(heights, heights > 0, step=2, spread=4)
    array([[ 1,  1,  1,  4,  4,  0,  6,  7,  8,  9, 10]], dtype=int32)

    References
    ----------
    .. [1] Soille, P., 2008. Constrained connectivity for hierarchical image partitioning and simplification. IEEE
       Transactions on Pattern Analysis and Machine Intelligence 30 (7), 1132-1145.
    """
    require_image(heights)
    require_connectivity(connectivity)
    if step < 0 or spread < 0:
        msg = f"Step and spread of level zones must be 0 or more; got {step} and {spread}."
        raise ParameterError(msg)
    node = np.zeros(heights.shape, dtype=np.int32)
    count = int(np.count_nonzero(inside))
    node[inside] = np.arange(1, count + 1, dtype=np.int32)
    ends, starts = _pairs(heights, node, step, connectivity)
    root = _join(heights[inside].astype(np.int64), ends, starts, spread, free_step)
    labels: Labels = np.concatenate([[0], root + 1]).astype(np.int32)[node]
    return labels


@kernel
def _pairs(
    heights: NDArray[Any], node: NDArray[np.int32], step: int, connectivity: int
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Return the pairs of neighbours in order of their steps, by a counting sort, and where each step starts."""
    rows, cols = heights.shape
    starts = np.zeros(step + 2, dtype=np.int64)
    ends = np.empty((0, 2), dtype=np.int32)
    for filling in range(2):
        for row in range(rows):
            for col in range(cols):
                if node[row, col] == 0:
                    continue
                # Each pair once: the neighbour to the right, and those in the row below.
                for down, right in ((0, 1), (1, -1), (1, 0), (1, 1)):
                    r, c = row + down, col + right
                    if r >= rows or c < 0 or c >= cols or (connectivity == 4 and down and right):
                        continue
                    if node[r, c] == 0:
                        continue
                    rise = abs(np.int64(heights[row, col]) - np.int64(heights[r, c]))
                    if rise > step:
                        continue
                    if filling:
                        ends[starts[rise], 0] = node[row, col] - 1
                        ends[starts[rise], 1] = node[r, c] - 1
                        starts[rise] += 1
                    else:
                        starts[rise + 1] += 1
        if not filling:
            starts = np.cumsum(starts)
            ends = np.empty((starts[-1], 2), dtype=np.int32)
    # Filling moved each start to the next one.
    starts[1:] = starts[:-1].copy()
    starts[0] = 0
    return ends, starts


@kernel
def _find(parent: NDArray[np.int32], node: int) -> int:
    """Return the node that stands for this one, and shorten the way to it."""
    while parent[node] != node:
        parent[node] = parent[parent[node]]
        node = parent[node]
    return node


@kernel
def _join(
    values: NDArray[np.int64], ends: NDArray[np.int32], starts: NDArray[np.int64], spread: int, free_step: int
) -> NDArray[np.int32]:
    """Return for each node the first one of its zone.

    Pairs of one step are joined together, first on trial. Where the trial spreads too far, its zones are closed as they
    were before: they, and what reaches them later, would only spread farther.
    """
    count = values.size
    parent = np.arange(count).astype(np.int32)
    low, high = values.copy(), values.copy()
    closed = np.zeros(count, dtype=np.bool_)
    trial = np.arange(count).astype(np.int32)
    trial_low, trial_high = values.copy(), values.copy()
    trial_closed = np.zeros(count, dtype=np.bool_)
    touched = np.empty(2 * max(ends.shape[0], 1), dtype=np.int32)
    for step in range(starts.size - 1):
        near = 0
        for pair in range(starts[step], starts[step + 1]):
            one, other = _find(parent, ends[pair, 0]), _find(parent, ends[pair, 1])
            if one == other or (closed[one] and closed[other]):
                continue
            touched[near], touched[near + 1] = one, other
            near += 2
            one, other = _find(trial, one), _find(trial, other)
            if one == other:
                continue
            first, second = min(one, other), max(one, other)
            trial[second] = first
            trial_low[first] = min(trial_low[first], trial_low[second])
            trial_high[first] = max(trial_high[first], trial_high[second])
            trial_closed[first] |= trial_closed[second]
        for index in range(near):
            zone = touched[index]
            whole = _find(trial, zone)
            too_far = step > free_step and trial_high[whole] - trial_low[whole] > spread
            if trial_closed[whole] or too_far:
                closed[zone] = True
            elif zone != whole:
                parent[zone] = whole
            else:
                low[zone], high[zone] = trial_low[zone], trial_high[zone]
        for index in range(near):
            zone = touched[index]
            trial[zone] = zone
            trial_low[zone], trial_high[zone] = low[zone], high[zone]
            trial_closed[zone] = closed[zone]
    for node in range(count):
        parent[node] = _find(parent, node)
    return parent

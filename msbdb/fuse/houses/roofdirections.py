"""Along which directions roofs and walls run in each cell, and where these turn."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from msbdb.labels import Labels, boxes, widened

Floats = NDArray[np.float32]

FINE_M, WIDE_M = 0.4, 2.0
"""Standard deviations of the smoothing of heights and of directions: tiles and dormers, and less than half a house."""

REACH_M = 3.0
"""Directions are compared so far on both sides of a cell: a curve of a street turns little over a house's width."""

STEEPEST = 1.0
"""A slope counts by its size, up to this one: otherwise façades alone would decide."""

CLEAR = 0.5
"""A direction is clear where its mean vector has at least this share of the single ones' length."""

LEAST = 0.01
"""Where the mean slope is less, nothing has a direction."""

TRUNCATE = 3.0
"""The smoothing reaches so many standard deviations."""


@dataclass(frozen=True, slots=True, eq=False)
class RoofDirections:
    """The directions of roofs; arrays (H, W) of float32.

    Parameters
    ----------
    cosine, sine : ndarray
        Sums over a cell's surroundings of w cos 4θ and w sin 4θ, where θ is the direction of the steepest slope and w
        its size. So a slope, its opposite and the gable beside it are one direction.
    weight : ndarray
        Sum of w alone.
    turn_deg : ndarray
        By how much the direction differs on the two sides of a cell, degrees from 0 to 45; 0 where it is not clear.
    """

    cosine: Floats
    sine: Floats
    weight: Floats
    turn_deg: Floats


def find_directions(heights: Floats, islands: Labels, *, cell_m: float) -> RoofDirections:
    """Measure the directions of roofs, and where they turn.

    Parameters
    ----------
    heights : (H, W) ndarray of float32, metres
        Heights above ground.
    islands : (H, W) ndarray of int32
        Connected cells of buildings; 0 for none. Each island is looked at by itself, with its façades.
    cell_m : float
        Side of a cell, metres.

    Notes
    -----
    Directions are compared `REACH_M` to both sides of a cell, in four directions; the largest difference counts. A cell
    without clear directions on both sides shows no turn.

    Border: beyond the lattice is no building. Complexity: linear in the cells.

    Examples
    --------
    Two level wings; the second one runs at 45 degrees to the first:

    >>> row, col = np.indices((60, 60))
    >>> wings = (np.abs(row - 40) < 6) & (col < 30) | (np.abs(row + col - 70) < 8) & (col >= 30) & (row > 12)
    >>> found = find_directions(np.float32(9 * wings), np.int32(wings), cell_m=1.0)
    >>> bool(found.turn_deg[40, 30] > 30), bool(found.turn_deg[40, 12] < 5)
    (True, True)
    """
    cosine, sine, weight, turn = (np.zeros_like(heights, dtype=np.float32) for _ in range(4))
    reach = math.ceil(TRUNCATE * (FINE_M + WIDE_M) / cell_m) + 2
    for number, window in boxes(islands).items():
        near = widened(window, reach)
        own = islands[near] == number
        found = _directions(np.where(own, heights[near], 0), cell_m)
        for whole, part in zip((cosine, sine, weight, turn), (*found, _turns(*found, cell_m)), strict=True):
            whole[near][own] = part[own]
    return RoofDirections(cosine, sine, weight, turn)


def _directions(heights: Floats, cell_m: float) -> tuple[Floats, Floats, Floats]:
    """Return the smoothed vectors of four times the direction of each cell's slope, and their weights."""
    framed = np.pad(heights.astype(np.float64), 1)
    smooth = gaussian_filter(framed, FINE_M / cell_m, mode="constant", truncate=TRUNCATE)
    down, right = (slope[1:-1, 1:-1] / cell_m for slope in np.gradient(smooth))
    size = np.hypot(down, right)
    weight = np.minimum(size, STEEPEST)
    angle = 4 * np.arctan2(down, right)
    parts = (weight * np.cos(angle), weight * np.sin(angle), weight)
    one, other, whole = (
        gaussian_filter(part, WIDE_M / cell_m, mode="constant", truncate=TRUNCATE).astype(np.float32) for part in parts
    )
    return one, other, whole


def _turns(cosine: Floats, sine: Floats, weight: Floats, cell_m: float) -> Floats:
    """Return the largest difference of the directions on both sides of each cell, degrees."""
    # Beside a façade the other side lies outside, where the façade's own direction is known as well.
    clear = np.hypot(cosine, sine) >= CLEAR * np.maximum(weight, LEAST)
    angle = np.degrees(np.arctan2(sine, cosine)) / 4
    rows, cols = weight.shape
    turn = np.zeros(weight.shape, dtype=np.float32)
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        reach = max(1, round(REACH_M / (cell_m * math.hypot(down, right))))
        down, right = reach * down, reach * right
        if rows <= 2 * down or cols <= 2 * abs(right):
            continue
        inner = np.s_[down : rows - down, abs(right) : cols - abs(right)]
        one = np.s_[: rows - 2 * down, abs(right) - right : cols - abs(right) - right]
        other = np.s_[2 * down :, abs(right) + right : cols - abs(right) + right]
        both = clear[one] & clear[other]
        differ = np.abs(np.mod(angle[one] - angle[other] + 45, 90) - 45)
        turn[inner] = np.maximum(turn[inner], np.where(both, differ, 0))
    return turn

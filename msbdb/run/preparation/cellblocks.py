"""The sample of a large raster that its plan looks at: blocks of cells, drawn by a seeded hash of their places."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from msbdb.errors import NodataError, collected_notices, give_notice
from msbdb.grid import Bounds, GridSpec
from msbdb.run.preparation.drafts import Draft
from msbdb.run.preparation.samples import BLOCK_M
from msbdb.spectral.kmeans import lattice_keys

MOST_CELLS = 12_000_000
"""Ours: as many cells are looked at for a plan; with an orthophoto of four bands they take 1.3 GB."""

MOST_SIDE = 2000
"""Ours: a block has at most so many cells a side, a third of the sample."""


def is_large_raster(cells: GridSpec) -> bool:
    """Return whether a raster has more cells than a plan looks at."""
    return cells.shape[0] * cells.shape[1] > MOST_CELLS


def block_side(cell_m: float) -> float:
    """Return the side of a block, metres: whole cells, 500 m where they are large enough.

    Examples
    --------
    >>> block_side(1.0), block_side(0.1)
    (500.0, 200.0)
    """
    return min(max(round(BLOCK_M / cell_m), 1), MOST_SIDE) * cell_m


def drawn_blocks(cells: GridSpec, *, seed: int) -> list[Bounds]:
    """Return the bounds of all blocks of a raster in the order in which they are looked at, metres.

    Their edges lie on those of cells, at whole multiples of the side on the lattice of the raster. So the order does
    not depend on its extent.
    """
    side_m, frame = block_side(cells.cell_m), cells.frame
    side = round(side_m / cells.cell_m)
    rows, columns = (
        np.arange(first // side, (first + count - 1) // side + 1)
        for first, count in zip((frame.row, frame.col), cells.shape, strict=True)
    )
    column, row = (each.ravel() for each in np.meshgrid(columns, rows))
    found = []
    for each in np.argsort(lattice_keys(row, column, seed), kind="stable").tolist():
        west, north = frame.east_m + int(column[each]) * side_m, frame.north_m - int(row[each]) * side_m
        found.append((west, north - side_m, west + side_m, north))
    return found


def looked_at(drawn: Sequence[Bounds], draft_of: Callable[[Bounds], Draft]) -> dict[Bounds, Draft]:
    """Return the drafts of the first blocks that have values and hold as many cells as a plan looks at.

    A notice holds for the survey where all blocks give it, or where it has no numbers.
    """
    found: dict[Bounds, Draft] = {}
    told: list[list[str]] = []
    count = 0
    for block in drawn:
        with collected_notices() as notices:
            try:
                found[block] = draft_of(block)
            except NodataError:
                continue
        told.append([str(notice) for notice in notices])
        count += math.prod(found[block].surface.ndsm.spec.shape)
        if count >= MOST_CELLS:
            break
    for notice in dict.fromkeys(each for own in told for each in own):
        if all(notice in own for own in told) or not any(letter.isdigit() for letter in notice):
            give_notice(notice)
    return found

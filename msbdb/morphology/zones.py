"""Flat zones: the connected areas of equal value, which become the clusters of a scale (V10, V22, V25)."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msbdb.morphology.runs import Layout, find_runs, widen
from msbdb.threads import kernel


def label_zones(values: NDArray[Any], *, connectivity: int = 8) -> tuple[NDArray[np.int32], int]:
    """Label the flat zones of an image; cells of value 0 are background and belong to none (V25).

    Parameters
    ----------
    values : (H, W) ndarray
        Booleans, integers or floats without NaN. Not modified. Floats are equal or not, without tolerance.
    connectivity : int
        4 or 8; the same as for the openings and closings, or zones of a finer scale may straddle those of a coarser
        one (V10).

    Returns
    -------
    labels : (H, W) ndarray of int32
        0 on the background, otherwise 1 to ``count`` in row-major order of the zones' first cells.
    count : int
        Number of zones.

    Raises
    ------
    InputError
        When the array is no image.
    ParameterError
        When the connectivity is neither 4 nor 8.

    Notes
    -----
    Border: what lies outside of the array does not exist; a zone ends at the edge. Complexity: union-find of runs in
    row-major order, O(n log n) for n runs and linear in the cells beside.

    Examples
    --------
    >>> label_zones(np.array([[2, 0, 5], [0, 2, 5]]))
    (array([[1, 0, 2],
           [0, 1, 2]], dtype=int32), 2)
    """
    runs = find_runs(values, connectivity)
    labels, count = _number(widen(runs.values), runs.layout)
    return runs.paint(labels), int(count)


@kernel
def _number(values: NDArray[Any], layout: Layout) -> tuple[NDArray[np.int32], int]:
    """Join each run to those of its value above it, under the earliest one; then number them."""
    starts, first, width, reach = layout
    count = values.size
    parent = np.arange(count).astype(np.int32)
    for run in range(count):
        row_end = starts[run] // width * width + width
        stop = min(starts[run + 1] + reach, row_end) - width
        other = first[0, run]
        while starts[other] < stop:
            if values[other] == values[run]:
                one, two = _root(parent, run), _root(parent, other)
                parent[max(one, two)] = min(one, two)
            other += 1
    labels = np.zeros(count, dtype=np.int32)
    zones = 0
    for run in range(count):
        if values[run] != 0:
            if parent[run] == run:
                zones += 1
                labels[run] = zones
            else:
                labels[run] = labels[parent[run]]
    return labels, zones


@kernel
def _root(parent: NDArray[np.int32], run: int) -> int:
    """Return the earliest run of a run's zone, as far as known, and halve the way to it."""
    while parent[run] != run:
        parent[run] = parent[parent[run]]
        run = parent[run]
    return run

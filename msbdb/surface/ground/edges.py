"""What both filters judge regions by: walls stand above the ground beside them, hills rise from it."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter

from msbdb.labels import sizes
from msbdb.params import GroundParams

Heights = NDArray[np.float32]
Counts = NDArray[np.int64]


def edge_step(params: GroundParams, cell_m: float) -> float:
    """Return the step of an edge, metres: it grows with cells above 1 m, over which terrain itself rises more."""
    return params.edge_step_m * max(cell_m, 1.0)


def count_edges(
    labels: NDArray[np.int32], count: int, heights: Heights, beside: Heights, step_m: float
) -> tuple[Counts, Counts]:
    """Count the cells on the boundary of each cluster, and those of them that are an edge.

    Parameters
    ----------
    labels : (H, W) ndarray of int32
        Clusters 1 to ``count``; 0 elsewhere.
    count : int
        Number of clusters.
    heights : (H, W) ndarray of float32, metres
        Lowest heights.
    beside : (H, W) ndarray of float32, metres
        Heights of the cells to compare with; infinity where a cell is not to be compared with.
    step_m : float
        A cell that stands more than this above the lowest of its eight neighbours in ``beside`` is an edge.

    Returns
    -------
    boundary, edges : (count,) ndarray of int
        Cells of each cluster with a neighbour in ``beside``, and the edges among them.
    """
    lowest = minimum_filter(beside, 3, mode="nearest")
    boundary = (labels > 0) & np.isfinite(lowest)
    edges = boundary & (heights - np.where(boundary, lowest, 0) > step_m)
    return sizes(labels[boundary], count), sizes(labels[edges], count)

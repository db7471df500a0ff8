"""Reshaping by vegetation: trees that reach into a building are cut off it (V37-V39)."""

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from msbdb.extract.multiscale.clusters import Clusters, Step
from msbdb.extract.multiscale.kernels import edges, reaching_in
from msbdb.extract.multiscale.pieces import cut, joined
from msbdb.labels import Labels, label_zones

VEGETATION = "vegetation"


def cut_vegetation(clusters: Clusters, vegetation: NDArray[np.bool_], *, smallest_px: int, connectivity: int) -> Step:
    """Take the vegetation that reaches in from outside away from every cluster.

    Parameters
    ----------
    clusters : Clusters
        Nested clusters.
    vegetation : (H, W) ndarray of bool
        Cells of vegetation classes. A blob is a connected component of them (V39).
    smallest_px : int
        s of the finest scale, cells: smaller pieces are dropped (V38).
    connectivity : int
        4 or 8, as for the scale-space.

    Returns
    -------
    Step
        Nested clusters again.

    Notes
    -----
    The band of a cluster is the dilation of its boundary cells by 3 by 3 (A6): three cells wide, on both sides of the
    outline. A blob that meets the band gets mark 0 when it lies in the band wholly (a fringe of mixed cells: the roof
    stays) and mark 1 otherwise (a tree that reaches in): its cells are taken from the cluster. A blob in the middle
    of a roof meets no band and stays (a green roof).

    Scales go from coarse to fine: what is cut from a father is cut from all in it as well, so that children stay
    inside of their fathers.
    """
    if not vegetation.any():
        return joined(clusters, [])
    cells, starts = _blobs(vegetation, connectivity)
    gone = np.zeros(vegetation.shape, dtype=np.bool_)
    steps = []
    for level in reversed(range(len(clusters.labels))):
        living = clusters.at(level)
        objects = np.where(clusters.flags(living)[clusters.labels[level]], clusters.labels[level], np.int32(0))
        gone |= reaching_in(objects, edges(objects), cells, starts, len(clusters.rows))
        touched = _labels_in(objects, gone, len(clusters.rows))
        if touched.size:
            zones = np.where(clusters.flags(touched)[objects] & ~gone, objects, np.int32(0))
            step = cut(
                clusters, level, zones, touched, smallest_px=smallest_px, connectivity=connectivity, reason=VEGETATION
            )
            steps.append(step)
            clusters = step.clusters
    return joined(clusters, steps)


def _blobs(vegetation: NDArray[np.bool_], connectivity: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """List the cells of the blobs, blob by blob, and where each blob's cells start."""
    labels, count = label_zones(vegetation, connectivity=connectivity)
    cells = np.flatnonzero(labels).astype(np.int32)
    member = labels.ravel()[cells] - 1
    # Turning a sparse matrix from rows to columns is a counting sort.
    table = sparse.csr_array((cells, member, np.arange(cells.size + 1)), shape=(cells.size, count)).tocsc()
    return table.data.astype(np.int32), table.indptr.astype(np.int32)


def _labels_in(objects: Labels, cells: NDArray[np.bool_], count: int) -> NDArray[np.intp]:
    """Return the row numbers of the objects that have some of the cells."""
    found = np.zeros(count + 1, dtype=np.bool_)
    found[objects[cells]] = True
    return np.flatnonzero(found[1:])

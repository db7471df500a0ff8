"""Fewer points of the same places: a share of them, or no more a square metre than all values were judged on."""

import numpy as np
from numpy.typing import NDArray

from msbdb.points.cellindex import CellIndex, index_cells, most_in_a_cell
from msbdb.points.cloud import PointCloud
from msbdb.threads import kernel

Mask = NDArray[np.bool_]

CELL_M = 2.0
"""Side of the cells whose points are counted: large enough that chance hardly counts."""

FACTORS = (73_856_093, 19_349_663, 83_492_791)
"""Odd numbers that spread coordinates (Teschner et al. 2003), and one of 64 bits that mixes them (Knuth 1998)."""

MIXING = np.uint64(0x9E3779B97F4A7C15)


def lots(cloud: PointCloud) -> NDArray[np.uint64]:
    """Return (N,) numbers that are spread evenly over 64 bits: a hash of each point's place in millimetres."""
    return _hashed(cloud.x, cloud.y, cloud.z)


def _hashed(*place: NDArray[np.float64]) -> NDArray[np.uint64]:
    """Return the hashes of coordinates."""
    mixed = np.zeros(place[0].shape, dtype=np.int64)
    for values, factor in zip(place, FACTORS, strict=True):
        mixed ^= np.round(values * 1000).astype(np.int64) * factor
    return np.asarray(mixed.view(np.uint64) * MIXING)


def drawn(cloud: PointCloud, share: float) -> Mask:
    """Return which points belong to a share of them, by lot; the same ones in any part of the survey."""
    if share >= 1:
        return np.ones(len(cloud), dtype=np.bool_)
    return lots(cloud) < np.uint64(share * 2**64)


def thinned(cloud: PointCloud, most_density: float) -> PointCloud:
    """Return a cloud that has no more first echoes a square metre than asked.

    Parameters
    ----------
    cloud : PointCloud
        Of any density.
    most_density : float
        First echoes a square metre; 0 returns the cloud as it is.

    Returns
    -------
    PointCloud
        The same one where nothing is too dense.

    Notes
    -----
    Cells of 2 m on the absolute lattice that hold more first echoes keep a share of all their echoes, by lot. So strips
    that overlap become as dense as others, and a part of a survey keeps the points that the whole does. Border: a cell
    that the survey cuts is judged by the area of a whole one.

    Examples
    --------
    >>> from pyproj import CRS
    >>> x, y = np.random.default_rng(1).uniform(0, 10, (2, 10_000))
    >>> dense = PointCloud(x, y, np.zeros(10_000), CRS.from_epsg(2154))
    >>> round(len(thinned(dense, 20.0)) / 100)
    20
    >>> thinned(dense, 200.0) is dense
    True
    """
    kept = kept_of(cloud, most_density)
    return cloud if kept.all() else cloud.take(kept)


def kept_of(cloud: PointCloud, most_density: float) -> Mask:
    """Return (N,) bool, which points `thinned` keeps."""
    kept = np.ones(len(cloud), dtype=np.bool_)
    if not most_density or not len(cloud):
        return kept
    most = most_density * CELL_M**2
    if most_in_a_cell(cloud.x, cloud.y, CELL_M) > most:
        index = index_cells(cloud.x, cloud.y, CELL_M)
        dense, limits = _in_dense_cells(index, cloud.first_echo, most)
        kept[dense] = _hashed(cloud.x[dense], cloud.y[dense], cloud.z[dense]) < limits
    return kept


@kernel
def _in_dense_cells(index: CellIndex, first: Mask, most: float) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Return the points of cells with more first echoes than ``most``, and below which lot each of them stays."""
    limits = np.zeros(index.keys.size)
    count = 0
    for cell in range(index.keys.size):
        points = index.order[index.starts[cell] : index.starts[cell + 1]]
        echoes = 0
        for point in points:
            echoes += first[point]
        if echoes > most:
            limits[cell] = most / echoes * 2.0**64
            count += points.size
    dense, limit = np.empty(count, dtype=np.int32), np.empty(count)
    end = 0
    for cell in range(index.keys.size):
        if limits[cell] > 0:
            points = index.order[index.starts[cell] : index.starts[cell + 1]]
            dense[end : end + points.size] = points
            limit[end : end + points.size] = limits[cell]
            end += points.size
    return dense, limit

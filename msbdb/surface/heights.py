"""Height above ground."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from msbdb.errors import GridMismatchError
from msbdb.grid import Grid
from msbdb.pointcloud import PointCloud

PER_METRE = 100
"""Heights above ground are whole centimetres, finer than any scanner: so they can be kept without loss."""


def normalise(dsm: Grid, dtm: Grid) -> Grid:
    """Subtract the terrain from the surface (V13), in whole centimetres.

    Parameters
    ----------
    dsm, dtm : Grid
        On one lattice, metres.

    Returns
    -------
    Grid
        nDSM, metres; valid where both are, 0 elsewhere. Negative heights stay as they are.

    Raises
    ------
    GridMismatchError
        When the lattices differ.
    """
    if not dsm.spec.same_lattice(dtm.spec):
        msg = (
            f"The DSM {dsm.spec.shape} at {dsm.spec.bounds} and the DTM {dtm.spec.shape} at {dtm.spec.bounds} must "
            "share one lattice; resample one of them."
        )
        raise GridMismatchError(msg)
    valid = dsm.valid & dtm.valid
    height = np.asarray(dsm.values, dtype=np.float64) - np.asarray(dtm.values, dtype=np.float64)
    whole = np.round(np.where(valid, height, 0) * PER_METRE) / PER_METRE
    return Grid(whole.astype(np.float32), valid, dsm.spec)


def heights_above(points: PointCloud, dtm: Grid) -> NDArray[np.float64]:
    """Subtract the terrain from the points themselves, nothing being rasterised but the terrain (C13, S1).

    Parameters
    ----------
    points : PointCloud
        N points in the terrain's CRS.
    dtm : Grid
        Terrain without gaps, metres; taken bilinearly between cell centres, and held constant beyond the outermost.

    Returns
    -------
    (N,) ndarray of float64
        Heights above ground, metres; negative below it.
    """
    west, north, cell_m = dtm.spec.transform.c, dtm.spec.transform.f, dtm.spec.cell_m
    row = (north - points.y) / cell_m - 0.5
    col = (points.x - west) / cell_m - 0.5
    terrain = map_coordinates(dtm.values, (row, col), output=np.float64, order=1, mode="nearest", prefilter=False)
    return np.asarray(points.z - terrain)

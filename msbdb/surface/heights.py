"""Height above ground."""

import numpy as np

from msbdb.errors import GridMismatchError
from msbdb.grid import Grid

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

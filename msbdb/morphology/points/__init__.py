"""Morphology on the points themselves, without a lattice (Cao & Wu, C1 to C7): their cells, graph and filters."""

from msbdb.morphology.points.cells import CellIndex, cell_at, cell_place, index_cells, strip

__all__ = [
    "CellIndex",
    "cell_at",
    "cell_place",
    "index_cells",
    "strip",
]

"""Morphology on the points themselves, without a lattice (Cao & Wu, C1 to C7): their cells, graph and filters."""

from msbdb.morphology.points.area import (
    PointScaleSpace,
    area_closing,
    area_open_close,
    area_opening,
    build_point_scale_space,
    components,
    open_close_on_set,
)
from msbdb.morphology.points.cells import CellIndex, cell_place, index_cells, parts_of, strip
from msbdb.morphology.points.clusters import linked
from msbdb.morphology.points.graph import PointGraph, connect
from msbdb.morphology.points.nearest import nearest

__all__ = [
    "CellIndex",
    "PointGraph",
    "PointScaleSpace",
    "area_closing",
    "area_open_close",
    "area_opening",
    "build_point_scale_space",
    "cell_place",
    "components",
    "connect",
    "index_cells",
    "linked",
    "nearest",
    "open_close_on_set",
    "parts_of",
    "strip",
]

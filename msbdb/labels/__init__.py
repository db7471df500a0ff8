"""Label images: labelling, numbering, sizes, overlaps, and the statistics of labelled regions.

A label image is an array of int32: 0 for no region, 1 to ``count`` for the regions. All functions
but `label_zones` and `boxes` also take labelled points, as arrays of one dimension.
"""

from msbdb.labels.celllist import CellList
from msbdb.labels.colouring import colour_touching, touching_pairs
from msbdb.labels.islands import Islands, islands_of
from msbdb.labels.mincut import Pairs, minimum_cut, neighbours
from msbdb.labels.numbering import (
    EIGHT,
    Box,
    Labels,
    around,
    boxes,
    by_three,
    chosen_cells,
    join_cells,
    label_zones,
    look_up,
    renumber,
    reorder,
    shared_cells,
    sizes,
    small_zones,
    sums,
    widened,
)
from msbdb.labels.statistics import (
    HeightOrder,
    central_cells,
    centroids,
    height_statistics,
    measure,
    offsets,
    order_heights,
    quantiles,
    region_means,
)

__all__ = [
    "EIGHT",
    "Box",
    "CellList",
    "HeightOrder",
    "Islands",
    "Labels",
    "Pairs",
    "around",
    "boxes",
    "by_three",
    "central_cells",
    "centroids",
    "chosen_cells",
    "colour_touching",
    "height_statistics",
    "islands_of",
    "join_cells",
    "label_zones",
    "look_up",
    "measure",
    "minimum_cut",
    "neighbours",
    "offsets",
    "order_heights",
    "quantiles",
    "region_means",
    "renumber",
    "reorder",
    "shared_cells",
    "sizes",
    "small_zones",
    "sums",
    "touching_pairs",
    "widened",
]

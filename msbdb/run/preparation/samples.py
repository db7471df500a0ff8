"""The sample of a large cloud that its plan looks at: blocks of points, drawn by a seeded hash of their places."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import geopandas as gpd
import numpy as np
import shapely

from msbdb.grid import Bounds
from msbdb.io.lasheader import read_las_header
from msbdb.io.vector import Area
from msbdb.params import Params
from msbdb.points.cloud import PointCloud
from msbdb.run.inputs import Inputs
from msbdb.spectral.kmeans import lattice_keys
from msbdb.surface.gridding import CELL_LADDER_M, cell_size

if TYPE_CHECKING:
    from pyproj import CRS

MOST_POINTS = 12_000_000
"""Ours: as many points are read for a plan at once."""


MOST_BYTES = 1.7 * 2**30
"""Ours: what a plan may take of 2 GiB beside the program."""


POINT_BYTES, CELL_BYTES, GROUND_CELL_BYTES = 45, 100, 250
"""Ours, measured (docs/scale.md): what a plan takes for each point, cell, and cell of the ground filter."""


BLOCK_M = 500.0
"""Ours: side of a block of a sample, metres, several times as wide as the largest building."""


LEAST_BLOCK_M = 62.5
"""Ours: blocks of very fine cells are halved down to this."""


BLOCK_SHARE = 4
"""Ours: a block takes at most this part of the memory, so that several make a sample."""


def bytes_to_plan(points: float, area_m2: float, cell_m: float, params: Params) -> float:
    """Return what a plan of so many points on a lattice of this area takes, bytes beside the program."""
    ground_m = max(params.ground.ground_cell_m, cell_m / 2)
    return POINT_BYTES * points + area_m2 * (CELL_BYTES / cell_m**2 + GROUND_CELL_BYTES / ground_m**2)


def is_small(points: float, bounds: Bounds, cell_m: float, params: Params) -> bool:
    """Return whether a plan looks at all points of a survey: they and the lattice over them are not too many."""
    west, south, east, north = bounds
    need = bytes_to_plan(points, (east - west) * (north - south), cell_m, params)
    return points <= MOST_POINTS and need <= MOST_BYTES


@dataclass(frozen=True, slots=True, eq=False)
class SampledBlocks:
    """The blocks of a sample, by their south-western corners and their side, metres, in the CRS of the points."""

    corners: tuple[tuple[float, float], ...]
    side_m: float
    crs: "CRS"

    @classmethod
    def over(
        cls, ground: shapely.Geometry, points: float, cell_m: float, crs: "CRS", params: Params
    ) -> "SampledBlocks":
        """Draw blocks of a ground with points, about as many as a plan may look at.

        The blocks lie at whole multiples of their side. Their order is a hash of their place and of the seed, so that
        it does not depend on the files.
        """
        side_m = BLOCK_M
        while side_m > LEAST_BLOCK_M and bytes_to_plan(0, side_m**2, cell_m, params) * BLOCK_SHARE > MOST_BYTES:
            side_m /= 2
        west, south, east, north = shapely.bounds(ground)
        columns, rows = (
            np.arange(math.floor(low / side_m), math.floor(high / side_m) + 1)
            for low, high in ((west, east), (south, north))
        )
        column, row = (each.ravel() for each in np.meshgrid(columns, rows))
        squares = shapely.box(column * side_m, row * side_m, (column + 1) * side_m, (row + 1) * side_m)
        area = shapely.area(shapely.intersection(squares, ground))
        order = np.argsort(lattice_keys(row, column, params.spectral.seed), kind="stable")
        order = order[area[order] > 0]
        held = area[order] / area.sum() * points
        need = np.cumsum([bytes_to_plan(*each, cell_m, params) for each in zip(held, area[order], strict=True)])
        enough = min(np.searchsorted(np.cumsum(held), MOST_POINTS), np.searchsorted(need, MOST_BYTES))
        corners = ((float(column[one] * side_m), float(row[one] * side_m)) for one in order[: int(enough) + 1])
        return cls(tuple(corners), side_m, crs)

    @classmethod
    def of_cloud(cls, cloud: PointCloud, cell_m: float, params: Params) -> "SampledBlocks":
        """Draw blocks of a cloud, of those that hold points."""
        places = (np.floor(axis / LEAST_BLOCK_M).astype(np.int64) for axis in (cloud.x, cloud.y))
        column, row = np.unique(np.column_stack([*places]), axis=0).T * LEAST_BLOCK_M
        squares = shapely.box(column, row, column + LEAST_BLOCK_M, row + LEAST_BLOCK_M)
        return cls.over(shapely.union_all(squares), len(cloud), cell_m, cloud.crs, params)

    def area_in(self, interest: Area | None) -> Area:
        """Return the ground of all blocks, or what of it lies in an area of interest with its margin."""
        west, south = np.array(self.corners).T
        shape = shapely.union_all(shapely.box(west, south, west + self.side_m, south + self.side_m))
        if interest is not None:
            shape = shapely.intersection(shape, interest.shape_in(self.crs))
        return Area(gpd.GeoSeries([shape], crs=self.crs), 0.0, "the sample of blocks")

    def cut(self, cloud: PointCloud) -> Iterator[tuple[tuple[float, float], PointCloud]]:
        """Yield the points of each block that has first echoes, in the order of the corners."""
        column, row = np.floor(cloud.x / self.side_m), np.floor(cloud.y / self.side_m)
        for west, south in self.corners:
            own = cloud.take((column == west // self.side_m) & (row == south // self.side_m))
            if own.first_echo.any():
                yield (west, south), own


def blocks_to_sample(inputs: Inputs, params: Params, interest: Area | None = None) -> SampledBlocks | None:
    """Draw the blocks of a sample by what the headers of points say; None where a plan can read all points.

    How large the cells of a block will be follows from the points a square metre of the files' boxes. Files whose
    boxes cannot be right draw no blocks.
    """
    infos = [read_las_header(path) for path in inputs.points]
    how = inputs.reference_of_points() if infos else None
    if how is None:
        return None
    boxes = shapely.box(*np.array([how.box_in_metres(info.bounds) for info in infos]).T)
    counts = np.array([info.points for info in infos])
    # A stray point widens the box of its file: by such a box the points are too far apart for any building.
    sound = counts >= shapely.area(boxes) / CELL_LADDER_M[-1] ** 2
    every = shapely.union_all(boxes[sound])
    ground = every if interest is None else shapely.intersection(every, interest.shape_in(how.crs))
    if not ground.area:
        return None
    points_m2 = counts[sound].sum() / every.area
    cell_m = params.surface.cell_m or cell_size(points_m2, literal=params.surface.cell_rule == "literal")
    points = points_m2 * ground.area
    # How wide fewer points lie is known once they are read.
    if points <= MOST_POINTS:
        return None
    return SampledBlocks.over(ground, points, cell_m, how.crs, params)

"""Candidate regions of points: what both detectors on points share.

They take heights and NDVI of the points, give their regions ids and rows on the lattice, and outline them.
"""

from dataclasses import dataclass, replace

import geopandas as gpd
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from msbdb.bands import Bands
from msbdb.detect.scene import Regions, Scene
from msbdb.grid import GridSpec
from msbdb.ground.quadratic import ground_heights
from msbdb.identity import part_ids
from msbdb.labels import Labels, region_means, sums
from msbdb.ledger import Books
from msbdb.outline.pointoutlines import outline_regions
from msbdb.outline.polygons import rasterise
from msbdb.params import Params
from msbdb.points.cloud import PointCloud
from msbdb.surface import heights_above
from msbdb.tables import REJECTION

Floats = NDArray[np.float64]

PLACES = 2**31
"""Width of the numbering of cells: a place is row times this plus column, both counted from its half."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """The candidate regions of one extractor.

    Parameters
    ----------
    method : str
        ``area3d`` or ``adaptive``.
    labels : (N,) ndarray of int32
        For each point of the cloud, in the cloud's order: 0 for none, otherwise row number + 1 in ``regions``.
    regions : DataFrame
        ``tables.CANDIDATE_REGION`` without geometry, in order of the ids. Regions share no point.
    rejections : DataFrame
        ``tables.REJECTION`` without geometry: a row for each region that a stage dropped.
    counts : dict
        By stage: regions ``in`` (with the ``pieces`` that the stage cut
        itself, less those it joined), ``kept`` and ``dropped``.
    """

    method: str
    labels: NDArray[np.int32]
    regions: pd.DataFrame
    rejections: pd.DataFrame
    counts: dict[str, dict[str, int]]


def point_heights(scene: Scene, params: Params) -> Floats:
    """Return the points' heights above ground, metres.

    The quadratic ground filter gives them itself (C13, Eq. 6); any other filter gives a terrain to subtract.
    """
    surface, cloud = scene.require_surface(), scene.require_cloud()
    if surface.ground_filter == "quadratic":
        return np.asarray(cloud.z - ground_heights(cloud, params.ground))
    return heights_above(cloud, surface.dtm)


def point_ndvi(bands: Bands | None, cloud: PointCloud) -> NDArray[np.float32] | None:
    """Return the vegetation index (nir - red) / (nir + red) of each point's cell.

    Parameters
    ----------
    bands : Bands, optional
        Of an orthophoto, or gridded from the points.
    cloud : PointCloud
        N points in the bands' CRS.

    Returns
    -------
    (N,) ndarray of float32 or None
        From -1 to 1; NaN where the cell has no colours or is black, or there is no cell. None without the bands
        ``red`` and ``nir``.
    """
    red, nir = (None, None) if bands is None else (bands.band("red"), bands.band("nir"))
    if bands is None or red is None or nir is None:
        return None
    total = red + nir
    usable = bands.valid & (total > 0)
    index: NDArray[np.float32] = np.full(red.shape, np.nan, dtype=np.float32)
    np.divide(nir - red, total, out=index, where=usable)
    return bands.spec.sample(index, cloud.x, cloud.y, outside=np.nan)


def outlined(found: Candidates, scene: Scene, params: Params) -> Regions:
    """Return candidate regions of points as regions of the lattice: the cells within their outlines (S7)."""
    surface, cloud, spec = scene.require_surface(), scene.require_cloud(), scene.heights.spec
    spacing_m = 1 / surface.density**0.5
    outlines = outline_regions(
        cloud.x, cloud.y, found.labels, len(found.regions), spacing_m=spacing_m, params=params.vector
    )
    table = gpd.GeoDataFrame(found.regions, geometry=list(outlines), crs=spec.crs)
    return Regions(
        found.method, rasterise(outlines, spec), table, found.rejections, found.counts, of_points=found.labels
    )


@dataclass(frozen=True, slots=True, eq=False)
class PlacedPoints:
    """Points that lie on a lattice, from which the regions that they form take ids.

    Parameters
    ----------
    x, y : (N,) ndarray of float64, metres
        From the origin.
    origin : (2,) ndarray of float64
        Easting and northing of the origin.
    area_m2 : (N,) ndarray of float64
        Area that each point stands for.
    place : (N,) ndarray of int64
        Row-major number of the point's cell, see `places`.
    spec : GridSpec
        The lattice.
    key : str
        Name of the survey and kind of region; part of the ids.
    """

    x: Floats
    y: Floats
    origin: Floats
    area_m2: Floats
    place: NDArray[np.int64]
    spec: GridSpec
    key: str

    def take(self, index: NDArray[np.integer]) -> "PlacedPoints":
        """Return some of the points."""
        return replace(self, x=self.x[index], y=self.y[index], area_m2=self.area_m2[index], place=self.place[index])

    def areas(self, labels: Labels, count: int) -> Floats:
        """Return the area of each region, m2."""
        return sums(labels, self.area_m2, count)

    def centroids(self, labels: Labels, count: int) -> tuple[Floats, Floats]:
        """Return easting and northing of the mean place of the points of each region, metres."""
        return (
            region_means(self.x, labels, count) + self.origin[0],
            region_means(self.y, labels, count) + self.origin[1],
        )

    def ids(self, labels: Labels, count: int, *, stage: int = 0) -> NDArray[np.int64]:
        """Return ids of regions from their first cells; those that a stage, counted from 1, rejected have their own.

        Every label from 1 to ``count`` has a point. Regions that share their first cell are told apart by the order of
        their labels.
        """
        first = np.full(count + 1, np.iinfo(np.int64).max)
        np.minimum.at(first, labels, self.place)
        first = first[1:]
        order = np.argsort(first, kind="stable")
        begins = np.diff(first[order], prepend=-1) != 0
        piece = np.empty(count, dtype=np.int64)
        piece[order] = np.arange(count) - np.maximum.accumulate(np.where(begins, np.arange(count), 0))
        row, col = np.divmod(first, PLACES)
        row, col = row - PLACES // 2 + self.spec.origin[0], col - PLACES // 2 + self.spec.origin[1]
        return part_ids(self.key, self.spec.cell_m, threshold_px=stage, row=row, col=col, piece=piece)


def places(spec: GridSpec, easting: Floats, northing: Floats) -> NDArray[np.int64]:
    """Return the row-major numbers of the cells that hold points, also outside of the lattice's extent."""
    row, col = spec.rowcol(easting, northing)
    return (row + PLACES // 2) * np.int64(PLACES) + (col + PLACES // 2)


class PointBooks(Books):
    """The books of an extractor on points: labelled regions of points become ``tables.REJECTION``."""

    def __init__(self, method: str, points: PlacedPoints) -> None:
        super().__init__(method)
        self.points = points

    def reject(self, stage: str, reasons: NDArray[np.object_], labels: Labels, number: int, *, scale: int = 0) -> int:
        """Write labelled regions into the ledger; return how many.

        Parameters
        ----------
        stage : str
            Its name.
        reasons : (M,) ndarray of str
            One a region, in the labels' order.
        labels : (N,) ndarray of int32
            1 to M, each with a point; 0 for none.
        number : int
            Number of the stage, scale and kind, from 1; part of the ids.
        scale : int
            Number of the height scale, from 1; 0 where there are none.
        """
        count = len(reasons)
        inside = np.flatnonzero(labels)
        points, labels = self.points.take(inside), labels[inside]
        xcen, ycen = points.centroids(labels, count)
        rows = pd.DataFrame(
            {
                "region_id": points.ids(labels, count, stage=number),
                "reason": reasons,
                "scale": scale,
                "area_m2": points.areas(labels, count),
                "xcen": xcen,
                "ycen": ycen,
            }
        )
        return self.write(stage, rows)

    def rejections(self) -> pd.DataFrame:
        """Return all lost regions in the order of writing."""
        return REJECTION.typed(self.lost(REJECTION.empty()))

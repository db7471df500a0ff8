"""Candidate regions of points: what both detectors on points share.

They take heights and NDVI of the points, give their regions ids and rows on the lattice, and outline them.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray

from msbdb.detect.scene import Regions, Scene
from msbdb.grid import Bands, Frame, GridSpec
from msbdb.ground.quadratic import ground_heights
from msbdb.identity import part_ids
from msbdb.labels import HeightOrder, Labels, height_statistics, region_means, reorder, sizes, sums
from msbdb.ledger import Ledger, Marks
from msbdb.outline.pointoutlines import outline_regions
from msbdb.outline.polygons import Geometries, rasterise
from msbdb.params import Params
from msbdb.points.aside import let_go
from msbdb.points.cellindex import number_along
from msbdb.points.cloud import PointCloud
from msbdb.surface import Surface, heights_above, heights_of_cells, points_of_cells
from msbdb.tables import CANDIDATE_REGION, REJECTION
from msbdb.threads import kernel

Floats = NDArray[np.float64]

PLACES = 2**31
"""Width of the numbering of cells: a place is row times this plus column, both counted from its half."""

TAKEN = 0.5
"""Ours, in sample: share of the noise's variance that is taken off. With all of it noisy crowns pass for roofs."""

FEW = 4
"""Rejected points that are less than one in so many are looked at apart."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """The candidate regions of one detector.

    Parameters
    ----------
    method : str
        ``area3d`` or ``adaptive``.
    labels : (N,) ndarray of int32
        For each point of the cloud, in the cloud's order: 0 for none, otherwise row number + 1 in ``regions``.
    regions : DataFrame
        ``tables.CANDIDATE_REGION`` without geometry, in order of the ids. Regions share no point.
    rejections : DataFrame
        ``tables.REJECTION`` without geometry: a row for each region that a stage dropped. Regions smaller than
        ``fuse.piece_m2`` are only counted later, and have the id 0.
    counts : dict
        By stage: regions ``in`` (with the ``pieces`` that the stage cut
        itself, less those it joined), ``kept`` and ``dropped``.
    marks : Marks
        Which stage dropped the points of a cell, and why.
    """

    method: str
    labels: NDArray[np.int32]
    regions: pd.DataFrame
    rejections: pd.DataFrame
    counts: dict[str, dict[str, int]]
    marks: Marks


def detect_on_points(extract: Callable[..., Candidates], scene: Scene, params: Params) -> Regions:
    """Detect candidate regions among the points of a scene, and outline them on the lattice (S7).

    Parameters
    ----------
    extract : callable
        `extract_area3d` or `extract_adaptive`: from points and their heights to candidate regions.
    scene : Scene
        With a surface; where it has no points, the cells of the surface stand for them.
    params : Params
        The detector's own section, ``surface``, ``ground`` and ``vector``.

    Returns
    -------
    Regions
        The table has the columns of ``tables.CANDIDATE_REGION`` and outlines; the labels are the cells within these.
    """
    surface, spec = scene.require_surface(), scene.heights.spec
    cloud = points_of_cells(surface).aside() if scene.cloud is None else scene.cloud
    # Heights and NDVI have no name here, so that a detector can free them.
    found = extract(
        cloud,
        point_heights(scene, params),
        spec=spec,
        survey=scene.survey.name,
        params=params,
        ndvi=point_ndvi(scene.bands, cloud),
        noise_m=point_noise(scene, cloud),
        recorded=recorded_at(scene, cloud),
    )
    spacing_m = 1 / surface.density**0.5
    # Where regions meet, the order decides: by place, because the ids depend on the name of the survey.
    order = np.lexsort((found.regions["xcen"], found.regions["ycen"]))
    labels = reorder(found.labels, order, len(order))
    inside = np.flatnonzero(labels)
    x, y, labels = cloud.x[inside], cloud.y[inside], labels[inside]
    del inside
    let_go()
    by_place = outline_regions(x, y, labels, len(order), spacing_m=spacing_m, params=params.vector)
    outlines = by_place[np.argsort(order)]
    return Regions(
        found.method,
        reorder(rasterise(by_place, spec), np.argsort(order), len(order)),
        gpd.GeoDataFrame(found.regions, geometry=list(outlines), crs=spec.crs),
        found.rejections,
        found.counts,
        of_points=found.labels,
        answers=found.marks.on(spec.shape),
    )


def point_noise(scene: Scene, cloud: PointCloud) -> NDArray[np.float32] | None:
    """Return the noise of the heights that is taken off the surface around points, metres; None where none is.

    It has `TAKEN` of the variance that bare ground around a point shows. Cells of a raster have none: what makes these
    rough is the relief in a cell.
    """
    if scene.noise_m is None or scene.cloud is None:
        return None
    noise_m = scene.heights.spec.sample(scene.noise_m, cloud.x, cloud.y, outside=0)
    return np.asarray(np.float32(TAKEN**0.5) * noise_m)


def recorded_at(scene: Scene, cloud: PointCloud) -> NDArray[np.float32] | None:
    """Return how far later echoes were recorded around points, from 0 to 1; None where they were everywhere."""
    if scene.recorded is None:
        return None
    return np.asarray(scene.heights.spec.sample(scene.recorded, cloud.x, cloud.y, outside=1))


def point_heights(scene: Scene, params: Params) -> Floats:
    """Return the points' heights above ground, metres: those of the scene, or computed where it has none."""
    if scene.above is not None:
        return scene.above
    surface = scene.require_surface()
    return heights_of_cells(surface) if scene.cloud is None else heights_of_points(surface, scene.cloud, params)


def heights_of_points(surface: Surface, cloud: PointCloud, params: Params) -> Floats:
    """Return the points' heights above ground, metres.

    The quadratic ground filter gives them itself (C13, Eq. 6); any other filter gives a terrain to subtract.
    """
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
        Area of each point.
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

    def labelled_cells(self, labels: Labels) -> tuple[Labels, NDArray[np.int64]]:
        """Return labels and cells of the labelled points that lie on the lattice; each pair of them once, or more.

        Of points that follow each other and share label and cell, the first one counts.
        """
        return _labelled_cells(labels, self.place, self.spec.shape)

    def areas(self, labels: Labels, count: int) -> Floats:
        """Return the area of each region, m2."""
        return sums(labels, self.area_m2, count)

    def centroids(self, labels: Labels, count: int) -> tuple[Floats, Floats]:
        """Return easting and northing of the mean place of the points of each region, metres."""
        return (
            region_means(self.x, labels, count) + self.origin[0],
            region_means(self.y, labels, count) + self.origin[1],
        )

    def ids(
        self, labels: Labels, count: int, *, stage: int = 0, wanted: NDArray[np.bool_] | None = None
    ) -> NDArray[np.int64]:
        """Return ids of regions from their first cells; rejected regions, of a stage from 1 on, have their own.

        Every label from 1 to ``count`` has a point. Regions that share their first cell are numbered in the order of
        their labels. Regions that are not ``wanted``, (M,) bool, have the id 0.
        """
        first = _first_places(labels, self.place, count)[1:]
        order = np.argsort(first, kind="stable")
        begins = np.diff(first[order], prepend=-1) != 0
        piece = np.empty(count, dtype=np.int64)
        piece[order] = np.arange(count) - np.maximum.accumulate(np.where(begins, np.arange(count), 0))
        chosen = np.flatnonzero(np.ones(count, dtype=np.bool_) if wanted is None else wanted)
        row, col = np.divmod(first[chosen], PLACES)
        row, col = row - PLACES // 2 + self.spec.origin[0], col - PLACES // 2 + self.spec.origin[1]
        found = np.zeros(count, dtype=np.int64)
        found[chosen] = part_ids(self.key, self.spec.cell_m, threshold_px=stage, row=row, col=col, piece=piece[chosen])
        return found


def places(spec: GridSpec, easting: Floats, northing: Floats) -> NDArray[np.int64]:
    """Return the row-major numbers of the cells that hold points, also outside of the lattice's extent."""
    return _places(easting, northing, spec.frame)


@kernel
def _places(easting: Floats, northing: Floats, frame: Frame) -> NDArray[np.int64]:
    """Return the numbers of the cells by `GridSpec.rowcol`, without arrays in between."""
    found = np.empty(easting.size, dtype=np.int64)
    for i in range(easting.size):
        row = int(number_along(frame.north_m - northing[i], frame.cell_m)) - frame.row
        col = int(number_along(easting[i] - frame.east_m, frame.cell_m)) - frame.col
        found[i] = (row + PLACES // 2) * PLACES + col + PLACES // 2
    return found


@kernel
def _labelled_cells(
    labels: Labels, place: NDArray[np.int64], shape: tuple[int, int]
) -> tuple[Labels, NDArray[np.int64]]:
    """Return the pairs of `PlacedPoints.labelled_cells`."""
    rows, cols = shape
    found, cells = np.empty(labels.size, dtype=labels.dtype), np.empty(labels.size, dtype=np.int64)
    count = 0
    for i in range(labels.size):
        if labels[i] == 0:
            continue
        row, col = place[i] // PLACES - PLACES // 2, place[i] % PLACES - PLACES // 2
        if row < 0 or row >= rows or col < 0 or col >= cols:
            continue
        cell = row * cols + col
        if count == 0 or cells[count - 1] != cell or found[count - 1] != labels[i]:
            found[count], cells[count] = labels[i], cell
            count += 1
    return found[:count].copy(), cells[:count].copy()


@kernel
def _first_places(labels: Labels, place: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Return the least place of each label from 0 on."""
    found = np.full(count + 1, np.iinfo(np.int64).max)
    for i in range(labels.size):
        found[labels[i]] = min(found[labels[i]], place[i])
    return found


class PointLedger(Ledger):
    """The ledger of a detector on points: labelled regions become ``tables.REJECTION``, and their cells are marked."""

    def __init__(self, method: str, points: PlacedPoints, least_m2: float) -> None:
        super().__init__(method, least_m2)
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
            Number of the height scale, from 1; 0 without height scales.
        """
        count = len(reasons)
        points = self.points
        if FEW * np.count_nonzero(labels) < labels.size:  # else a copy would take more memory than it saves time
            inside = np.flatnonzero(labels)
            points, labels = points.take(inside), labels[inside]
        xcen, ycen = points.centroids(labels, count)
        area_m2 = points.areas(labels, count)
        rows = pd.DataFrame(
            {
                "region_id": points.ids(labels, count, stage=number, wanted=area_m2 >= self.least_m2),
                "reason": reasons,
                "scale": scale,
                "area_m2": area_m2,
                "xcen": xcen,
                "ycen": ycen,
            }
        )
        self.mark(stage, reasons, *points.labelled_cells(labels))
        return self.write(stage, rows)

    def rejections(self) -> pd.DataFrame:
        """Return all dropped regions in the order of writing."""
        return REJECTION.typed(self.lost(REJECTION.empty()))


def describe_candidates(
    points: PlacedPoints,
    labels: Labels,
    heights: Floats,
    ndvi: NDArray[np.floating] | None,
    shape: Mapping[str, NDArray[np.generic] | str | float],
    *,
    method: str,
) -> pd.DataFrame:
    """Return the rows of labelled regions (``tables.CANDIDATE_REGION``, without geometry), in the labels' order.

    Parameters
    ----------
    points : PlacedPoints
        N points.
    labels : (N,) ndarray of int32
        1 to M without a gap; 0 for none.
    heights : (N,) ndarray of float64, metres
        Above ground.
    ndvi : (N,) ndarray of float, optional
        NaN where a point has none.
    shape : mapping
        The columns that the detector measures itself, each (M,) or one value: the rule, the height scale and the shape.
    method : str
        Name of the detector.
    """
    count = int(labels.max(initial=0))
    inside = np.flatnonzero(labels != 0)
    order = inside[np.argsort(heights[inside], kind="stable")]
    statistics = height_statistics(labels, slice(0, count), HeightOrder(order.astype(np.int32), heights[order]))
    xcen, ycen = points.centroids(labels, count)
    rows = pd.DataFrame(
        {
            "candidate_id": points.ids(labels, count),
            "method": method,
            "points": sizes(labels, count),
            "area_m2": points.areas(labels, count),
            **shape,
            "ndvi": np.nan if ndvi is None else region_means(ndvi, labels, count),
            **{name: statistics[name].to_numpy() for name in statistics.columns},
            "xcen": xcen,
            "ycen": ycen,
        }
    )
    return CANDIDATE_REGION.typed(rows)


def in_order_of_ids(
    labels: Labels, regions: pd.DataFrame, index: NDArray[np.integer], number: int, ledger: PointLedger
) -> Candidates:
    """Put described regions in the order of their ids, and the labels in that of the cloud.

    Parameters
    ----------
    labels : (N,) ndarray of int32
        Labels of some points of the cloud.
    regions : DataFrame
        Their rows, in the labels' order.
    index : (N,) ndarray of int
        The places of these points in the cloud.
    number : int
        How many points the cloud has; those without a label get 0.
    ledger : PointLedger
        The rejected regions and the counts.
    """
    order = np.argsort(regions["candidate_id"].to_numpy(), kind="stable")
    found = np.zeros(number, dtype=np.int32)
    found[index] = reorder(labels, order, len(order))
    rows = regions.iloc[order].reset_index(drop=True)
    return Candidates(ledger.method, found, rows, ledger.rejections(), ledger.counts, ledger.marked())


def strings_of_points(x: Floats, y: Floats, member: NDArray[np.integer]) -> Geometries:
    """Return (M,) a line through the points of each group 0 to M - 1, in any order, for hulls and rectangles.

    Shapely builds lines faster than collections of points. Each line begins with its first point twice, because a
    line needs two.
    """
    order = np.argsort(member, kind="stable")
    begins = np.flatnonzero(np.diff(member[order], prepend=-1))
    order = np.insert(order, begins, order[begins])
    lines = shapely.linestrings(np.column_stack((x[order], y[order])), indices=member[order])
    return np.asarray(lines, dtype=np.object_)

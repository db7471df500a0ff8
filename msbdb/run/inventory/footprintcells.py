"""The cells of a survey in footprints: what is built there, and how high it is, window by window.

A measure of a footprint depends on its own cells, on the detected buildings there, and on the footprints and the ground
nearby. So each window holds some footprints as a whole and what their measures look at, and the result is that of one
window over all.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import geopandas as gpd
import numpy as np
import shapely
from numpy.typing import NDArray

from msbdb.change.surveywindows import WINDOW_CELLS, windows
from msbdb.database import Engine, RasterWindows
from msbdb.detect.scene import Elevations
from msbdb.fuse.buildings import covered_shares
from msbdb.fuse.roofheights import AROUND, measure_heights
from msbdb.grid import Grid, GridSpec
from msbdb.kept import REGION_NAMES, in_metres, lattice_of
from msbdb.labels import Box, Labels, height_statistics, look_up, order_heights, shared_cells, sizes, sums
from msbdb.outline.polygons import rasterise_window
from msbdb.params import HeightParams, Params
from msbdb.tables import EXTRACTOR_SHARES, HEIGHTS, Survey

STANDS = 0.5
"""Ours, as for an evaluation: a building stands where at least this share of the footprint is detected as one."""

STATISTICS = ("h_max", "h_mean", "h_p50", "h_p90")

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Shapes = NDArray[np.object_]


class DrawnShapes:
    """Polygons that are drawn on the windows of a lattice, as they would be on the whole.

    Parameters
    ----------
    shapes : (N,) ndarray of polygonal geometries
        In the CRS of the lattice. Of those that overlap, the later one wins a cell.
    spec : GridSpec
        The lattice.
    """

    def __init__(self, shapes: Shapes, spec: GridSpec) -> None:
        self.shapes, self.spec = shapes, spec
        self._tree = shapely.STRtree(shapes)

    def __len__(self) -> int:
        """Return the number of polygons."""
        return len(self.shapes)

    def within(self, window: Box) -> tuple[Labels, Ints]:
        """Return the labels of the cells of a window, from 1 on, and the place in ``shapes`` of each, ascending."""
        place = shapely.box(*self.spec.crop(*window).bounds).buffer(self.spec.cell_m)
        rows = np.sort(self._tree.query(place)).astype(np.int64)
        return rasterise_window(self.shapes[rows], self.spec, window), rows

    def windows(self, margin_cells: int, side: int) -> Iterator[tuple[Ints, Box]]:
        """Yield windows, and the places of the polygons that each has as a whole with a margin; those beside have none.

        A cell more keeps the cells at the edge of an outline, whatever its last digits are.
        """
        around_m = (margin_cells + 1) * self.spec.cell_m
        return windows(self.shapes, np.arange(len(self.shapes)), self.spec, around_m=around_m, side=side)


@dataclass(frozen=True, slots=True, eq=False)
class WindowCells:
    """Some cells of a survey.

    Parameters
    ----------
    heights : Grid
        Heights above ground, metres.
    elevations : Elevations
        Terrain and echoes, where they are known.
    standing : (H, W) ndarray of int32
        The detected building of each cell: its row in the survey's order + 1; 0 for none.
    """

    heights: Grid
    elevations: Elevations
    standing: Labels


class SurveyCells:
    """The cells of a survey that the database has, read window by window.

    Parameters
    ----------
    engine : Engine
        From ``open_database``.
    record : Survey
        The survey.
    buildings : GeoDataFrame
        Its detected buildings.
    side : int
        Side of a window, cells. A footprint that is larger has a window of its own.
    """

    def __init__(self, engine: Engine, record: Survey, buildings: gpd.GeoDataFrame, side: int = WINDOW_CELLS) -> None:
        self.spec, self.side = lattice_of(record), side
        self.buildings = DrawnShapes(buildings.geometry.to_numpy(), self.spec)
        self._rasters = RasterWindows(engine, record.name)
        self.of_points = any(source.role == "points" for source in record.sources)
        self.has_echoes = "echoes" in self._rasters.names
        self.detectors = tuple(method for method, name in REGION_NAMES.items() if name in self._rasters.names)

    def read(self, box: Box) -> WindowCells:
        """Return the cells of a window."""
        spec, names = self.spec.crop(*box), self._rasters.names
        above_ground = in_metres(self._rasters.read("ndsm_cm", *box).astype(np.int32))
        valid = self._rasters.read("valid", *box).astype(np.bool_)
        terrain = self._rasters.read("terrain_cm", *box).astype(np.int32) if "terrain_cm" in names else None
        echoes = self._rasters.read("echoes", *box).astype(np.uint16) if self.has_echoes else None
        labels, rows = self.buildings.within(box)
        standing = look_up(np.append(0, rows + 1).astype(np.int32), labels)
        return WindowCells(Grid(above_ground, valid, spec), Elevations(terrain, echoes, self.of_points), standing)

    def regions(self, method: str, box: Box) -> Labels:
        """Return the labels of a detector's regions in a window."""
        return self._rasters.read(REGION_NAMES[method], *box).astype(np.int32)


def shares_inside(footprints: DrawnShapes, survey: SurveyCells) -> dict[str, Floats]:
    """Return which share of footprints a survey saw, and which share its buildings and regions cover.

    Parameters
    ----------
    footprints : DrawnShapes
        N footprints that do not overlap.
    survey : SurveyCells
        What the survey found.

    Returns
    -------
    dict of str to (N,) ndarray of float64
        ``seen_share``: with heights. ``building_share``: on detected buildings, of the cells with heights. ``points``:
        first echoes, and ``point_share`` of them on detected buildings, of a survey of points. ``main``: the row of the
        detected building that covers most cells, of equal ones the first; -1 for none. A column of ``EXTRACTOR_SHARES``
        for each detector with regions. NaN for a share of nothing.
    """
    count, spec, counts_points = len(footprints), survey.spec, survey.of_points and survey.has_echoes
    areas_m2 = shapely.area(footprints.shapes)
    found = {"seen_share": np.zeros(count), "building_share": np.full(count, np.nan)}
    found |= {"points": np.full(count, 0.0 if counts_points else np.nan), "point_share": np.full(count, np.nan)}
    found["main"] = np.full(count, -1.0)
    found |= {EXTRACTOR_SHARES[method]: np.full(count, np.nan) for method in survey.detectors}
    for own, box in footprints.windows(0, survey.side):
        cells = survey.read(box)
        labels, rows = footprints.within(box)
        inside = np.where(cells.heights.valid, labels, 0)
        built = np.where(cells.standing > 0, inside, 0)
        seen = sizes(inside, len(rows)).astype(np.float64)
        with np.errstate(invalid="ignore", divide="ignore"):
            here = {"seen_share": np.minimum(seen * spec.cell_area_m2 / areas_m2[rows], 1.0)}
            here["building_share"] = sizes(built, len(rows)) / seen
            if counts_points and cells.elevations.echoes is not None:
                echoes = cells.elevations.echoes.astype(np.float64)
                here["points"] = sums(labels, echoes, len(rows))
                here["point_share"] = sums(built, echoes, len(rows)) / here["points"]
        here["main"] = _largest(built, cells.standing, len(rows))
        has_cells = sizes(labels, len(rows)) > 0
        for method in survey.detectors:
            share = covered_shares(labels, len(rows), survey.regions(method, box))
            here[EXTRACTOR_SHARES[method]] = np.where(has_cells, share, np.nan)
        _keep(found, own, here, rows)
    return found


def heights_inside(
    footprints: DrawnShapes, survey: SurveyCells, building_share: Floats, params: Params
) -> dict[str, Floats]:
    """Return heights, volume and storeys of footprints.

    Parameters
    ----------
    footprints : DrawnShapes
        N footprints that do not overlap.
    survey : SurveyCells
        What the survey found.
    building_share : (N,) ndarray of float64
        From `shares_inside`: where it is less than `STANDS`, all cells of a footprint count, otherwise those on
        detected buildings.
    params : Params
        Those of the survey's heights and surface.

    Returns
    -------
    dict of str to (N,) ndarray of float64
        `STATISTICS`, ``volume_m3`` and `HEIGHTS`; NaN where no cell counts.
    """
    found = {name: np.full(len(footprints), np.nan) for name in (*STATISTICS, "volume_m3", *HEIGHTS)}
    for own, box in footprints.windows(reach_cells(params.heights, survey.spec.cell_m), survey.side):
        cells = survey.read(box)
        labels, rows = footprints.within(box)
        inside = np.where(cells.heights.valid, labels, 0)
        stands = np.append(False, building_share[rows] >= STANDS)
        used = np.where(stands[labels] & (cells.standing == 0), 0, inside)
        some = np.flatnonzero(sizes(used, len(rows)) > 0)
        if some.size:
            number = np.zeros(len(rows) + 1, dtype=np.int32)
            number[some + 1] = np.arange(1, some.size + 1)
            _keep(found, own, _measured(number[used], some.size, cells, params), rows[some])
    return found


def reach_cells(params: HeightParams, cell_m: float) -> int:
    """Return how far from a footprint its heights depend on other cells, cells.

    Ground within a ring counts for the nearest footprint, which lies as far from it as the own one at most.

    Examples
    --------
    >>> reach_cells(HeightParams(ring_m=2.0, far_ring_m=10.0), 0.5)
    40
    """
    ring_m = max(params.far_ring_m, params.ring_m, 2 * cell_m)
    return max(math.ceil(2 * ring_m / cell_m), AROUND)


def cells_within(survey: SurveyCells, footprints: DrawnShapes) -> tuple[Ints, Ints]:
    """Return the number of cells of each detected building, and how many of them lie in footprints."""
    buildings = survey.buildings
    cells, within = np.zeros(len(buildings), dtype=np.int64), np.zeros(len(buildings), dtype=np.int64)
    for own, box in buildings.windows(0, survey.side):
        labels, rows = buildings.within(box)
        covered = footprints.within(box)[0] > 0
        places = np.searchsorted(rows, own)
        cells[own] = sizes(labels, len(rows))[places]
        within[own] = sizes(np.where(covered, labels, 0), len(rows))[places]
    return cells, within


def _measured(labels: Labels, count: int, cells: WindowCells, params: Params) -> dict[str, Floats]:
    """Measure the footprints of a window; each has a cell."""
    heights = cells.heights
    of_cells = height_statistics(labels, slice(0, count), order_heights(heights, labels > 0))
    above = np.maximum(np.asarray(heights.values, dtype=np.float64), 0) * heights.spec.cell_area_m2
    roofs = measure_heights(labels, count, heights, cells.elevations, params=params.heights, surface=params.surface)
    found = {name: of_cells[name].to_numpy() for name in STATISTICS} | {"volume_m3": sums(labels, above, count)}
    return found | {name: roofs[name].to_numpy(dtype=np.float64) for name in HEIGHTS}


def _keep(found: dict[str, Floats], own: Ints, here: dict[str, Floats], rows: Ints) -> None:
    """Write the values of a window's own footprints; ``rows`` are all that it measured, ascending."""
    kept = np.isin(rows, own)
    for name, values in here.items():
        found[name][rows[kept]] = values[kept]


def _largest(built: Labels, standing: Labels, count: int) -> Floats:
    """Return the row of the detected building that covers most of each footprint; -1 for none."""
    footprint, building, cells = shared_cells(built, standing)
    main = np.full(count, -1.0)
    order = np.lexsort((-building, cells))  # the last one wins: most cells, and of equals the first building
    main[footprint[order] - 1] = building[order] - 1
    return main

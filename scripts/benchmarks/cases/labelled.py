"""The labelled places, their points, and which of their cells are building."""

from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import geopandas as gpd
import laspy
import numpy as np
from numpy.typing import NDArray
from pyproj import CRS
from rasterio.features import rasterize
from scipy.ndimage import distance_transform_edt

from msbdb.grid import GridSpec, lattice
from msbdb.labels import label_zones, sizes
from msbdb.points.cloud import BUILDING_CLASS, NOISE_CLASSES

OVERLAP_CLASS = 12
REACH_CELLS = 2
LARGE_M2 = 50.0
"""Objects of this area must be found."""

CELLS_M = ((3.0, 0.5), (0.8, 1.0), (0.0, 2.0))
"""The cell of a reference by the least density, first echoes a square metre, that it suits."""

Mask = NDArray[np.bool_]
S = TypeVar("S", bound=np.generic)


@dataclass(frozen=True)
class Place:
    """A labelled place: its files under MSBDB_DATA, and what other programs reach."""

    name: str
    files: tuple[str, ...]
    crs: str
    pdal: float | None = None
    whitebox: float | None = None
    footprints: str = ""
    aoi: str = ""
    dropped: tuple[int, ...] = NOISE_CLASSES

    def read(self, data: Path) -> list[laspy.LasData]:
        """Read the points of all files."""
        return [laspy.read(data / name) for name in self.files]


DELFT = ("delft/delft_1.laz", "delft/delft_2.laz")
AMSTERDAM = ("amsterdam/ahn3.laz",)
RD, LAMBERT, UTM_30, SWEREF = "EPSG:28992", "EPSG:2154", "EPSG:25830", "EPSG:3006"
PLACES = (
    Place("delft_1", DELFT[:1], RD, 69.4, 61.6),
    Place("delft_2", DELFT[1:], RD, 80.9, 75.1),
    Place("delft_cadastre", DELFT, RD, 70.6, 57.8, "delft/footprints.gpkg", "delft/aoi.gpkg"),
    Place("montpellier", ("montpellier/points.laz",), LAMBERT, 74.0, 72.0),
    Place("beziers_left", ("beziers/points_left.laz",), LAMBERT, 59.2),
    Place("beziers_right", ("beziers/points_right.laz",), LAMBERT, 29.6),
    Place("amsterdam", AMSTERDAM, RD, 47.8, 72.7),
    Place("amsterdam_cadastre", AMSTERDAM, RD, 48.2, 73.2, "amsterdam/footprints.gpkg", "amsterdam/aoi.gpkg"),
    Place("sevilla_plaza", ("sevilla_plaza/points.laz",), UTM_30, 42.1, 76.5, dropped=(*NOISE_CLASSES, OVERLAP_CLASS)),
    Place("champs", ("champs/points.laz",), LAMBERT, 60.4, 91.4),
    Place("guldheden_east", ("guldheden_east/points.laz",), SWEREF, 54.0, 32.4, "guldheden_east/footprints.gpkg"),
)
NAMED = {place.name: place for place in PLACES}


@dataclass(frozen=True)
class Objects:
    """How many objects there are, and how many of them the other side covers by half at least."""

    covered: int
    all: int


@dataclass(frozen=True)
class Reference:
    """Which cells of a lattice are building, and which are scored."""

    built: Mask
    scored: Mask
    spec: GridSpec

    def sampled(self, values: NDArray[S], spec: GridSpec) -> NDArray[S]:
        """Return the values of another lattice's cells at the centres of this one's; 0 outside of it."""
        rows, cols = np.indices(self.spec.shape)
        east, north = self.spec.xy(rows.ravel(), cols.ravel())
        return spec.sample(values, east, north, outside=0).reshape(self.spec.shape)

    def onto(self, found: Mask, spec: GridSpec) -> Mask:
        """Return the scored cells of this lattice whose centre lies in a found cell of another one."""
        there: Mask = self.sampled(found, spec) & self.scored
        return there

    def quality(self, found: Mask, spec: GridSpec) -> float:
        """Compare cells of another lattice with the reference, per cent."""
        there = self.onto(found, spec)
        both = np.count_nonzero(there & self.built)
        either = np.count_nonzero(there | (self.built & self.scored))
        return 100 * both / max(either, 1)

    def found_objects(self, found: Mask, spec: GridSpec) -> Objects:
        """Count the large objects of the reference, and those that were found."""
        return self._covered(self.built & self.scored, self.onto(found, spec))

    def true_objects(self, found: Mask, spec: GridSpec) -> Objects:
        """Count the large objects that were found, and those that are true."""
        return self._covered(self.onto(found, spec), self.built)

    def _covered(self, ones: Mask, others: Mask) -> Objects:
        """Count the large connected objects of a mask, and those that another mask covers by half at least."""
        labels, count = label_zones(ones)
        cells = sizes(labels, count)
        shared = sizes(labels[others], count)
        large = cells * self.spec.cell_area_m2 >= LARGE_M2
        return Objects(int(np.count_nonzero(large & (2 * shared >= cells))), int(np.count_nonzero(large)))


def cell_for(density: float) -> float:
    """Return the cell of the reference that suits a density, metres."""
    return next(cell_m for least, cell_m in CELLS_M if density >= least)


def first_density(clouds: list[laspy.LasData]) -> float:
    """Return the first echoes a square metre of the covered cells of 2 m."""
    x, y, first = (np.concatenate(parts) for parts in zip(*(_first_echoes(cloud) for cloud in clouds), strict=True))
    cells = np.unique(np.floor(np.column_stack((x, y)) / 2), axis=0)
    return float(np.count_nonzero(first) / (4 * len(cells)))


def _first_echoes(cloud: laspy.LasData) -> tuple[NDArray[np.float64], NDArray[np.float64], Mask]:
    return np.asarray(cloud.x), np.asarray(cloud.y), np.asarray(cloud.return_number) <= 1


def reference_of(place: Place, clouds: list[laspy.LasData], data: Path, cell_m: float) -> Reference:
    """Make the reference of a place from the classes of its points, or from its cadastre.

    Parameters
    ----------
    place : Place
        With the classes that are left out, and its cadastre.
    clouds : list of LasData
        With their classes.
    data : Path
        Folder of the cadastre.
    cell_m : float
        Side of a cell, metres.

    Notes
    -----
    A cell is building where at least half of its first echoes are of class 6. Cells without an echo take the nearest
    one within `REACH_CELLS`; what is farther is not scored, nor are cells whose centre lies outside of the points: a
    survey that is cut at whole metres has points on its edge. A cadastre is scored within its area of interest.
    """
    x, y, classes, number = (
        np.concatenate([np.asarray(cloud[field]) for cloud in clouds])
        for field in ("x", "y", "classification", "return_number")
    )
    spec = lattice((x.min(), y.min(), x.max(), y.max()), cell_m, CRS.from_user_input(place.crs))
    row, col = spec.rowcol(x, y)
    inside = (row >= 0) & (row < spec.shape[0]) & (col >= 0) & (col < spec.shape[1])
    chosen = inside & ~np.isin(classes, place.dropped) & (number <= 1)
    cell = row[chosen] * spec.shape[1] + col[chosen]
    echoes = np.bincount(cell, minlength=spec.shape[0] * spec.shape[1]).reshape(spec.shape)
    roofs = np.bincount(cell[classes[chosen] == BUILDING_CLASS], minlength=echoes.size).reshape(spec.shape)
    distance, (rows, cols) = distance_transform_edt(echoes == 0, return_indices=True)
    east, north = (part.reshape(spec.shape) for part in spec.xy(*(part.ravel() for part in np.indices(spec.shape))))
    within = (east >= x.min()) & (east <= x.max()) & (north >= y.min()) & (north <= y.max())
    if not place.footprints:
        scored = (distance <= REACH_CELLS) & within
        return Reference((2 * roofs >= echoes)[rows, cols] & scored, scored, spec)
    built = _cells_of(data / place.footprints, spec)
    scored = _cells_of(data / place.aoi, spec) if place.aoi else distance <= 10 * REACH_CELLS
    return Reference(built, scored & within, spec)


def _cells_of(path: Path, spec: GridSpec) -> Mask:
    """Return the cells whose centre lies in a layer's polygons."""
    shapes = gpd.read_file(path).to_crs(spec.crs).geometry
    burnt = rasterize(list(shapes), out_shape=spec.shape, transform=spec.transform, fill=0, default_value=1)
    return np.asarray(burnt > 0)

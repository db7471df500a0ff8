"""Small towns of box-shaped houses as surveys, built by the real stages from heights above ground that are known."""

from dataclasses import replace
from functools import cache

import geopandas as gpd
import numpy as np
from hypothesis import strategies as st
from pyproj import CRS
from shapely import box

from msbdb.detect.detectors import detect_multiscale
from msbdb.detect.scene import Scene
from msbdb.grid import Grid, lattice
from msbdb.kept import KeptRun, Rasters
from msbdb.landcover import ClassMap
from msbdb.outline.polygons import rasterise
from msbdb.params import Params, as_dict
from msbdb.run.describe import count_cells, make_frames
from msbdb.spectral.coverclasses import Cover
from msbdb.tables import SPECTRAL_CLASS, SPECTRAL_CLASS_BAND, Counts, Run, Source, Survey

EPSG = 32631
UTM = CRS.from_epsg(EPSG)
WEST, SOUTH = 500_000.0, 4_000_000.0

House = tuple[float, float, float, float, float]
"""West, south, east and north in metres from the corner, and the height."""

ROW: list[House] = [(10.0 + 20 * n, 10.0, 22.0 + 20 * n, 22.0, 6.0 + n) for n in range(8)]
"""Eight houses of 12 x 12 m, which most tests leave as they are, so that the offset can be told."""

Steps = tuple[int, int, int, int, float]
"""A random house: its west and south sides, width and depth in steps of 8 m, and its height."""

RANDOM_TOWN = st.lists(
    st.tuples(st.integers(0, 5), st.integers(0, 5), st.integers(1, 4), st.integers(1, 2), st.sampled_from([4.0, 9.0])),
    max_size=7,
)

BOUNDS = (0.0, 0.0, 200.0, 120.0)
"""West, south, east and north of a town, metres from the corner."""


def outline(house: House, shift: float = 0.0) -> object:
    """Return a house's footprint."""
    west, south, east, north, _ = house
    return box(WEST + west + shift, SOUTH + south, WEST + east + shift, SOUTH + north)


def random_houses(town: list[Steps], east_m: float = 0.0) -> list[House]:
    """Return the houses of a random town, all moved to the east, without those that overlap an earlier one."""
    houses: list[House] = []
    for west, south, width, depth, height in town:
        left, low = 40.0 + 8 * west + east_m, 50.0 + 8 * south
        place = (left, low, left + 8 * width, low + 8 * depth)
        if all(box(*place).intersection(box(*house[:4])).area == 0 for house in houses):
            houses.append((*place, height))
    return houses


def footprints(houses: list[House]) -> gpd.GeoDataFrame:
    """Return footprints with heights, as an office may have them."""
    shapes = [outline(house) for house in houses]
    return gpd.GeoDataFrame({"HGT": [house[4] for house in houses]}, geometry=shapes, crs=UTM)


def town_heights(
    houses: list[House], *, bounds: tuple[float, float, float, float] = BOUNDS, shift: float = 0.0
) -> Grid:
    """Return the heights above ground of a town, shifted to the east; the last house lies on top."""
    west, south, east, north = bounds
    spec = lattice((WEST + west, SOUTH + south, WEST + east - 0.01, SOUTH + north - 0.01), 0.5, UTM)
    labels = rasterise([outline(house, shift) for house in houses], spec)
    heights = np.concatenate([[0.0], [house[4] for house in houses]])
    return Grid(heights[labels].astype(np.float32), np.ones(spec.shape, dtype=np.bool_), spec)


def town_build(
    name: str,
    date: str,
    houses: list[House],
    *,
    bounds: tuple[float, float, float, float] = BOUNDS,
    shift: float = 0.0,
    version: str = "1",
) -> KeptRun:
    """Return the build of a survey of a town; the frames are the caller's own."""
    made = _town_build(name, date, tuple(houses), bounds=bounds, shift=shift, version=version)
    return replace(made, frames={table: frame.copy() for table, frame in made.frames.items()})


@cache
def _town_build(
    name: str,
    date: str,
    houses: tuple[House, ...],
    *,
    bounds: tuple[float, float, float, float],
    shift: float,
    version: str,
) -> KeptRun:
    ndsm = town_heights([*houses], bounds=bounds, shift=shift)
    params = Params()
    roofs = (np.asarray(ndsm.values) > 2).astype(np.uint8)
    structure = ClassMap(roofs, {1: "building", 2: "vegetation"}, ndsm.spec)
    cover = Cover(structure, None, SPECTRAL_CLASS.empty(), SPECTRAL_CLASS_BAND.empty(), False, False, {})
    source = Source(f"{name}.tif", "ndsm", "ab" * 32, 1000)
    survey = Survey(name, date, UTM.to_wkt(), EPSG, "", 10.0, ndsm.spec.cell_m, ndsm.spec.bounds, (source,))
    scene = Scene(survey, ndsm, cover, None)
    found = detect_multiscale(scene, params)
    forest = replace(found.forest, parts=found.forest.parts.assign(speindex=0))
    frames = make_frames(scene, {"multiscale": found}, forest, params)
    counts = Counts(
        {"multiscale": found.counts}, count_cells(ndsm, cover), {"colours_decide": 0, "green_decides": 0}, {}
    )
    run = Run(("multiscale",), "default", version, dict(as_dict(params)), counts, {}, ())
    return KeptRun(survey, run, frames, Rasters.of_heights(ndsm, roofs))

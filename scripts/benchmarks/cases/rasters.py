"""A cloud as an office may have it: a surface of its highest first echoes, gaps filled, and a terrain through class 2."""

from pathlib import Path

import numpy as np
from pyproj import CRS
from rasterio.fill import fillnodata
from simulated.files import write_heights

from msbdb.grid import Grid, lattice
from msbdb.ground.choice import terrain
from msbdb.io.las import read_points
from msbdb.params import GroundParams
from msbdb.run.inputs import Inputs

NODATA = -9999.0

REACH_PX = 6
"""Gaps are filled from the cells up to this far around."""


def as_rasters(files: tuple[Path, ...], crs: str, cell_m: float, folder: Path, *, gaps: bool = False) -> Inputs:
    """Write the DSM and the DTM of files with class 2, with cells of so many metres, and return them as inputs.

    With ``gaps`` cells of the DSM without an echo have no value.
    """
    points = read_points(files, crs=CRS.from_user_input(crs))
    spec = lattice(points.bounds, cell_m, points.crs)
    first = points.first_echo
    surface = np.full(spec.shape, NODATA, dtype=np.float32)
    np.maximum.at(surface, spec.rowcol(points.x[first], points.y[first]), points.z[first].astype(np.float32))
    if not gaps:
        surface = fillnodata(surface, surface != NODATA, max_search_distance=REACH_PX)
    ground, _ = terrain(points, spec, GroundParams(ground_filter="class2"))
    found = {"dsm": Grid(surface, surface != NODATA, spec), "dtm": ground}
    return Inputs(**{name: write_heights(folder / f"{name}.tif", grid) for name, grid in found.items()})

"""The surface of a survey from rasters of heights, or of a part of it, and the terrain that a user gives."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from msbdb.errors import GridMismatchError, InputError, NodataError, give_notice
from msbdb.grid import Bounds, Grid, GridSpec
from msbdb.ground.interpolation import interpolate_ground
from msbdb.io.raster import align_grid, read_grid, states_crs
from msbdb.run.inputs import Inputs
from msbdb.surface import Surface, surface_from_rasters, without_narrow_gaps
from msbdb.surface.gridding import CELL_LADDER_M

LARGEST_OFFSET_M = 10.0
"""Ours: a surface has open ground somewhere, and other height references are farther away, such as the ellipsoid."""

LOW_PERCENT = 5.0
"""Ours: this share of a surface is ground, also in an old town or a park."""

GAPS = "The DTM has no value in some cells of the DSM; they were interpolated."
"""Without numbers, so that the parts of a survey agree in it."""

NARROW_GAPS = (
    "The raster of heights has many narrow gaps. They are filled with the nearest heights. "
    "Only measured heights separate roofs from vegetation."
)

MANY_GAPS = 0.01
"""Ours: fewer cells that were filled, in shares of all, need no notice."""

NO_TERRAIN = "Where no DTM is near, nothing was built: the DTM is smaller than the DSM."


def surface_of_rasters(inputs: Inputs, max_gap_m: float, seen: Bounds | None = None) -> Surface:
    """Take the surface from rasters of heights.

    Parameters
    ----------
    inputs : Inputs
        A DSM with a DTM, or an nDSM.
    max_gap_m : float
        Narrow gaps are filled (`msbdb.surface.without_narrow_gaps`), metres.
    seen : tuple of float, optional
        West, south, east and north of a part, metres: cells with their centre there are read, and no others.

    Raises
    ------
    NodataError
        When no cell of the part has a value, or no terrain is there.
    MsbdbError
        As `msbdb.io.raster.read_grid`.
    """
    wanted = _wanted(inputs, seen)
    if inputs.ndsm is not None:
        ndsm = read_grid(inputs.ndsm, crs=inputs.any_crs, role="nDSM", z_unit=inputs.z_unit, within=wanted)
        note_sparse(1 / ndsm.spec.cell_area_m2, f"cells of the nDSM {inputs.ndsm.name}")
        filled = filled_between(ndsm, max_gap_m)
        return surface_from_rasters(filled, flat_ground(ndsm), measured=ndsm.valid, terrain_known=False)
    if inputs.dsm is None or inputs.dtm is None:  # kept from happening by Inputs
        msg = "A DSM needs a DTM."
        raise InputError(msg)
    dsm = read_grid(inputs.dsm, crs=inputs.any_crs, role="DSM", z_unit=inputs.z_unit, within=wanted)
    note_sparse(1 / dsm.spec.cell_area_m2, f"cells of the DSM {inputs.dsm.name}")
    measured, dsm = dsm.valid, filled_between(dsm, max_gap_m)
    try:
        dtm = read_grid(inputs.dtm, crs=inputs.any_crs, role="DTM", z_unit=inputs.z_unit, over=dsm.spec)
        dtm = align_grid(dtm, dsm.spec, role="DTM")
    except GridMismatchError as error:
        if seen is None:
            raise
        give_notice(NO_TERRAIN)
        raise NodataError(str(error)) from error
    surface = surface_from_rasters(dsm, without_gaps(dtm, dsm, in_part=seen is not None), measured=measured)
    if seen is None:
        note_offset([surface.ndsm])
    return surface


def _wanted(inputs: Inputs, seen: Bounds | None) -> Bounds | None:
    """Return the bounds of the cells to read: of an area of interest those of its box; None for all."""
    cells = None if inputs.aoi is None else inputs.cells()
    if cells is None or seen is None:
        return seen if cells is None else cells.bounds
    (west, south, east, north), (left, bottom, right, top) = seen, cells.bounds
    return (max(west, left), max(south, bottom), min(east, right), min(north, top))


def read_terrain(inputs: Inputs, path: Path, spec: GridSpec) -> Grid:
    """Read the terrain around a lattice of points; the stated CRS is of the points where the raster has its own."""
    crs = None if states_crs(path) else inputs.any_crs
    return read_grid(path, crs=crs, role="DTM", z_unit=inputs.z_unit, over=spec)


def note_sparse(points_m2: float, what: str) -> None:
    """Give notice of heights that are too far apart for any building: farther than the largest cell."""
    spacing, largest = points_m2**-0.5, CELL_LADDER_M[-1]
    if spacing > largest * (1 + 1e-6):
        msg = (
            f"The {what} are {spacing:.1f} m apart on average, too far for buildings, at most {largest:g} m. "
            "Check the CRS and the unit of the coordinates, or give denser data."
        )
        give_notice(msg)


def note_offset(heights: Sequence[Grid]) -> None:
    """Give notice of a given terrain that is nowhere near the lowest heights of all blocks of a surface above it."""
    every = [np.asarray(each.values)[each.valid] for each in heights]
    above = every[0] if len(every) == 1 else np.concatenate(every)
    low = float(np.percentile(above, LOW_PERCENT)) if above.size else 0.0
    if abs(low) > LARGEST_OFFSET_M:
        share, where = (100 - LOW_PERCENT, "above") if low > 0 else (LOW_PERCENT, "below")
        msg = (
            f"Of the surface, {share:.0f} % are {abs(low):.0f} m or more {where} the given DTM. "
            "Check its place, its unit and its height reference."
        )
        give_notice(msg)


def without_gaps(dtm: Grid, dsm: Grid, *, in_part: bool = False) -> Grid:
    """Interpolate the terrain where it has no value but the surface has one: often under the middle of buildings.

    The notice of this has no numbers where they are those of a part of the survey.
    """
    gaps = int(np.count_nonzero(dsm.valid & ~dtm.valid))
    if not gaps:
        return dtm
    share = 100 * gaps / np.count_nonzero(dsm.valid)
    msg = f"The DTM has no value in {gaps} cells of the DSM ({share:.1f} %); they were interpolated."
    give_notice(GAPS if in_part else msg)
    return interpolate_ground(dtm.values, dtm.valid, dtm.spec)


def filled_between(heights: Grid, max_gap_m: float) -> Grid:
    """Fill the narrow gaps of a raster of heights, with a notice where there are many."""
    filled = without_narrow_gaps(heights, max_gap_m)
    if np.count_nonzero(filled.valid & ~heights.valid) > MANY_GAPS * np.count_nonzero(filled.valid):
        give_notice(NARROW_GAPS)
    return filled


def flat_ground(ndsm: Grid) -> Grid:
    """Return the terrain of heights that are above ground already: zero everywhere."""
    return Grid(np.zeros(ndsm.spec.shape, dtype=np.float32), np.ones(ndsm.spec.shape, dtype=np.bool_), ndsm.spec)

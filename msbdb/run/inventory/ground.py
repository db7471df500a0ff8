"""The ground of a survey that the database has, read window by window."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from msbdb.change.surveywindows import WINDOW_CELLS, Heights, Shapes, windows
from msbdb.database import Engine, RasterWindows
from msbdb.detect.scene import Elevations
from msbdb.grid import Grid
from msbdb.kept import in_metres, lattice_of
from msbdb.tables import Survey


class StoredGround:
    """Heights of a survey above ground, and above sea where its terrain is known; a `Ground` of a comparison.

    Parameters
    ----------
    engine : Engine
        The database.
    record : Survey
        The survey.
    offset : tuple of float
        Its offset to the inventory in x, y and height, metres. The heights are given without it; those above sea keep
        the zero of their survey.
    """

    def __init__(self, engine: Engine, record: Survey, offset: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
        own = lattice_of(record)
        dx, dy, self._dz = offset
        self._is_moved = any(offset)
        self.spec = replace(own, transform=type(own.transform).translation(-dx, -dy) @ own.transform)
        self._rasters = RasterWindows(engine, record.name)

    def read(self, rows: slice, cols: slice) -> Heights:
        """Return the cells within two slices."""
        spec, terrain = self.spec.crop(rows, cols), self.terrain_cm(rows, cols)
        above_ground = in_metres(self._rasters.read("ndsm_cm", rows, cols).astype(np.int32))
        valid = self._rasters.read("valid", rows, cols).astype(np.bool_)
        above_sea = None
        if terrain is not None:
            above_sea = Grid(np.where(valid, in_metres(terrain, above=above_ground), np.float32(0)), valid, spec)
        if self._is_moved:
            above_ground = np.where(valid, above_ground - np.float32(self._dz), np.float32(0))
        return Heights(Grid(above_ground, valid, spec), above_sea)

    def terrain_cm(self, rows: slice, cols: slice) -> NDArray[np.int32] | None:
        """Return the level of the terrain within two slices, centimetres; None where it is not known."""
        if "terrain_cm" not in self._rasters.names:
            return None
        return self._rasters.read("terrain_cm", rows, cols).astype(np.int32)

    def beneath(self, shapes: Shapes, around_m: float = 0.0) -> Iterator[tuple[list[int], Grid, Elevations]]:
        """Yield heights and terrain by windows that hold some of the outlines each, with their places in ``shapes``.

        Outlines beside the survey have no window.
        """
        each = np.arange(len(shapes))
        for rows, box in windows(shapes, each, self.spec, around_m=around_m + self.spec.cell_m, side=WINDOW_CELLS):
            yield rows.tolist(), self.read(*box).above_ground, Elevations(self.terrain_cm(*box))

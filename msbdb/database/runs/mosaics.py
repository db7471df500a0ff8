"""Rasters of runs that were built in tiles: pieces on the absolute lattice, read as one, a band of rows at a time."""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Connection, Engine, select

from msbdb.database.dialects.connection import snapshot
from msbdb.database.runs.basis import OutdatedError
from msbdb.database.runs.packing import unpack
from msbdb.database.schema.sqltables import SQL

RASTER_TILE, RUN, RUN_STATE, SURVEY = SQL["raster_tile"], SQL["run"], SQL["run_state"], SQL["survey"]


Held = dict[tuple[int, int], NDArray[Any]]
"""Cells of pieces by their first row and column."""


@dataclass(frozen=True, slots=True)
class Mosaic:
    """A raster of a run in pieces; cells that no piece has are 0.

    Parameters
    ----------
    connection : Connection
        An open transaction.
    run_id : int
        The run.
    name : str
        Name of the raster.
    origin : tuple of int
        Absolute row and column of the survey's first cell.
    shape : tuple of int
        Rows and columns of the survey.
    places : tuple of (int, int, int, int)
        First row and column of each piece, and its rows and columns, in order.
    dtype : dtype
        That of all pieces together.
    """

    connection: Connection
    run_id: int
    name: str
    origin: tuple[int, int]
    shape: tuple[int, int]
    places: tuple[tuple[int, int, int, int], ...]
    dtype: "np.dtype[Any]"

    def bands(self) -> Iterator[NDArray[Any]]:
        """Yield all rows from north to south, in bands of full width."""
        first, last = self.origin[0], self.origin[0] + self.shape[0]
        edges = {edge for row, _, rows, _ in self.places for edge in (row, row + rows) if first < edge < last}
        cuts = [first, *sorted(edges), last]
        held: Held = {}
        for top, bottom in pairwise(cuts):
            yield self.window(slice(top - first, bottom - first), slice(0, self.shape[1]), held)

    def window(self, rows: slice, cols: slice, held: Held) -> NDArray[Any]:
        """Return the cells within two slices; ``held`` gets the pieces that they meet, and keeps no others."""
        top, bottom = self.origin[0] + rows.start, self.origin[0] + rows.stop
        left, right = self.origin[1] + cols.start, self.origin[1] + cols.stop
        cells = np.zeros((bottom - top, right - left), dtype=self.dtype)
        meeting = [
            (row, column, row + height, column + width)
            for row, column, height, width in self.places
            if row < bottom and row + height > top and column < right and column + width > left
        ]
        for place in held.keys() - {place[:2] for place in meeting}:
            del held[place]
        for row, column, end_row, end_column in meeting:
            if (row, column) not in held:
                held[row, column] = self._read(row, column)
            high, low, west, east = max(row, top), min(end_row, bottom), max(column, left), min(end_column, right)
            some = held[row, column][high - row : low - row, west - column : east - column]
            cells[high - top : low - top, west - left : east - left] = some
        return cells

    def whole(self) -> NDArray[Any]:
        """Return all cells."""
        cells = np.empty(self.shape, dtype=self.dtype)
        row = 0
        for band in self.bands():
            cells[row : row + len(band)] = band
            row += len(band)
        return cells

    def sha256(self) -> str:
        """Return the checksum of all cells, as that of a raster that was written whole."""
        digest = hashlib.sha256()
        for band in self.bands():
            digest.update(band.data)
        return digest.hexdigest()

    def _read(self, row: int, column: int) -> NDArray[Any]:
        """Return the cells of a piece."""
        own = RASTER_TILE.c
        query = select(own.dtype, own.shape, own.data).where(
            own.run_id == self.run_id,
            own.name == self.name,
            own.lattice_row == row,
            own.lattice_column == column,
        )
        found = self.connection.execute(query).one_or_none()
        if found is None:
            raise OutdatedError
        return unpack(found.data, found.dtype, found.shape)


def mosaics_of(connection: Connection, run_id: int) -> dict[str, Mosaic]:
    """Return the rasters of a run that are in pieces, by name and in order of the names."""
    edges = (SURVEY.c.west, SURVEY.c.south, SURVEY.c.east, SURVEY.c.north, SURVEY.c.cell_m)
    own = RASTER_TILE.c
    rows = connection.execute(
        select(own.name, own.lattice_row, own.lattice_column, own.dtype, own.shape).where(own.run_id == run_id)
    ).all()
    if not rows:
        return {}
    west, south, east, north, cell_m = connection.execute(
        select(*edges).join(RUN, RUN.c.survey_id == SURVEY.c.survey_id).where(RUN.c.run_id == run_id)
    ).one()
    origin = round(-north / cell_m), round(west / cell_m)
    shape = round((north - south) / cell_m), round((east - west) / cell_m)
    by_name: dict[str, list[Any]] = {}
    for row in rows:
        by_name.setdefault(row.name, []).append(row)
    return {
        name: Mosaic(
            connection,
            run_id,
            name,
            origin,
            shape,
            tuple(sorted((one.lattice_row, one.lattice_column, *one.shape) for one in pieces)),
            np.result_type(*{one.dtype for one in pieces}),
        )
        for name, pieces in sorted(by_name.items())
    }


class RasterWindows:
    """Rasters of a run, read window by window.

    Of a raster in pieces the pieces of the last window are in memory; one that was written whole is there as a whole.
    """

    def __init__(self, engine: Engine, survey: str) -> None:
        self._engine = engine
        with snapshot(engine) as connection:
            self._run_id = _run_of(connection, survey)
            self._mosaics = mosaics_of(connection, self._run_id)
            names = connection.scalars(select(RUN_STATE.c.name).where(RUN_STATE.c.run_id == self._run_id))
            self.names = frozenset([*names, *self._mosaics])
        self._held: dict[str, Held] = {name: {} for name in self._mosaics}
        self._whole: dict[str, NDArray[Any]] = {}

    def read(self, name: str, rows: slice, cols: slice) -> NDArray[Any]:
        """Return the cells of a raster within two slices.

        Raises
        ------
        OutdatedError
            When others replaced the run meanwhile.
        """
        if name in self._whole:
            return self._whole[name][rows, cols]
        with snapshot(self._engine) as connection:
            if name in self._mosaics:
                return replace(self._mosaics[name], connection=connection).window(rows, cols, self._held[name])
            query = select(RUN_STATE).where(RUN_STATE.c.run_id == self._run_id, RUN_STATE.c.name == name)
            found = connection.execute(query).one_or_none()
        if found is None:
            raise OutdatedError
        self._whole[name] = unpack(found.data, found.dtype, found.shape)
        return self._whole[name][rows, cols]


def read_value_counts(engine: Engine, survey: str, name: str, count: int) -> NDArray[np.int64]:
    """Return how many cells of a raster in pieces have each value from 0 to below ``count``."""
    found = np.zeros(count, dtype=np.int64)
    with snapshot(engine) as connection:
        raster = mosaics_of(connection, _run_of(connection, survey)).get(name)
        for band in () if raster is None else raster.bands():
            found += np.bincount(band.ravel(), minlength=count)
    return found


def _run_of(connection: Connection, survey: str) -> int:
    """Return the key of a survey's run."""
    query = select(RUN.c.run_id).join(SURVEY, RUN.c.survey_id == SURVEY.c.survey_id).where(SURVEY.c.name == survey)
    return int(connection.scalars(query).one())

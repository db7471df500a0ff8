"""Rasters of runs that were built in tiles: pieces on the absolute lattice, read as one, a band of rows at a time."""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Connection, Engine, select

from msbdb.database.dialects.connection import snapshot
from msbdb.database.runs.packing import unpack
from msbdb.database.schema.sqltables import SQL

RASTER_TILE, RUN, SURVEY = SQL["raster_tile"], SQL["run"], SQL["survey"]


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
        held: dict[tuple[int, int], NDArray[Any]] = {}
        for top, bottom in pairwise(cuts):
            band = np.zeros((bottom - top, self.shape[1]), dtype=self.dtype)
            meeting = [place for place in self.places if place[0] < bottom and place[0] + place[2] > top]
            held = {place[:2]: held[place[:2]] for place in meeting if place[:2] in held}
            for row, column, _, _ in meeting:
                if (row, column) not in held:
                    held[row, column] = self._read(row, column)
                self._paste(band, held[row, column][top - row : bottom - row], column - self.origin[1])
            yield band

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
        found = self.connection.execute(query).one()
        return unpack(found.data, found.dtype, found.shape)

    def _paste(self, band: NDArray[Any], cells: NDArray[Any], column: int) -> None:
        """Write the rows of a piece into a band, as far as the survey reaches."""
        left, right = max(column, 0), min(column + cells.shape[1], self.shape[1])
        if left < right:
            band[:, left:right] = cells[:, left - column : right - column]


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


def read_value_counts(engine: Engine, survey: str, name: str, count: int) -> NDArray[np.int64]:
    """Return how many cells of a raster in pieces have each value from 0 to below ``count``."""
    found = np.zeros(count, dtype=np.int64)
    with snapshot(engine) as connection:
        query = select(RUN.c.run_id).join(SURVEY, RUN.c.survey_id == SURVEY.c.survey_id).where(SURVEY.c.name == survey)
        raster = mosaics_of(connection, connection.scalars(query).one()).get(name)
        for band in () if raster is None else raster.bands():
            found += np.bincount(band.ravel(), minlength=count)
    return found

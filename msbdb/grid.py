"""Georeferenced grids: the lattice, with shape, place and CRS; on it values with their validity, and image bands."""

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple, TypeVar

import numpy as np
from affine import Affine
from numpy.typing import NDArray
from pyproj import CRS

from msbdb.errors import CRSError, GridMismatchError, InputError

S = TypeVar("S", bound=np.generic)
F = TypeVar("F", float, NDArray[np.float64])

Bounds = tuple[float, float, float, float]

LATTICE_TOLERANCE = 1e-6
"""Largest misfit, in cells, at which two lattices still count as the same, and a place as on the edge of a cell."""


class Frame(NamedTuple):
    """What a kernel needs of a lattice to place points in it by `cell_along`.

    Parameters
    ----------
    row, col : int
        Absolute lattice row and column of the first cell.
    cell_m : float
        Side of a cell, metres.
    east_m, north_m : float
        How far the lattice lies beside the absolute one, metres; 0 but for rasters that are given.
    """

    row: int
    col: int
    cell_m: float
    east_m: float
    north_m: float


def cell_along(place: F, cell_m: float) -> F:
    """Return the absolute number of the cell that holds a place along an axis: the only rule from points to cells.

    Parameters
    ----------
    place : float or ndarray of float64, metres
        Eastings for columns, northings with the opposite sign for rows.
    cell_m : float
        Side of a cell, metres.

    Returns
    -------
    float or ndarray of float64
        Whole numbers. A place within `LATTICE_TOLERANCE` of an edge lies on it, and has the cell to its east or south.

    Notes
    -----
    Nothing but the place and the cell decides, so that all windows of a survey see a point in the same cell.

    Examples
    --------
    On cells of 0.3 m, 0.9 m begins the fourth one; without a tolerance it may lie in the third, by rounding:

    >>> place = 100.8 - 99.9
    >>> float(cell_along(place, 0.3)), place // 0.3
    (3.0, 2.0)
    """
    number: F = np.floor(place / cell_m + LATTICE_TOLERANCE)
    return number


@dataclass(frozen=True, slots=True)
class GridSpec:
    """Shape, position and CRS of a north-up grid of square cells, apart from its values.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns.
    transform : Affine
        Maps (column, row) of a cell corner to (easting, northing), in metres.
    crs : CRS
        A projected CRS in metres.
    beside : tuple of float, optional
        How far the lattice lies beside the absolute one, eastwards and northwards, metres; by default the place says
        it. Parts of a lattice keep it, so that they count their cells alike.
    """

    shape: tuple[int, int]
    transform: Affine
    crs: CRS
    beside: tuple[float, float] | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        """Refuse empty, rotated or south-up grids and cells that are not square."""
        rows, cols = self.shape
        t = self.transform
        if rows < 1 or cols < 1:
            msg = f"A grid needs at least one cell; got the shape {self.shape}."
            raise InputError(msg)
        if t.b != 0 or t.d != 0 or t.a <= 0 or t.e >= 0:
            msg = f"A grid must be north-up and unrotated; got the transform {tuple(t)[:6]}. Warp it first."
            raise InputError(msg)
        if not math.isclose(t.a, -t.e, rel_tol=1e-6):
            msg = f"A grid must have square cells; got {t.a} by {-t.e}. Warp it first."
            raise InputError(msg)
        require_metric(self.crs)

    @property
    def cell_m(self) -> float:
        """Side of a cell, metres."""
        return float(self.transform.a)

    @property
    def cell_area_m2(self) -> float:
        """Area of a cell, square metres."""
        return self.cell_m**2

    @property
    def bounds(self) -> Bounds:
        """West, south, east and north edge, metres."""
        rows, cols = self.shape
        west, north = self.transform.c, self.transform.f
        return (west, north - rows * self.cell_m, west + cols * self.cell_m, north)

    @property
    def origin(self) -> tuple[int, int]:
        """Absolute lattice (row, column) of the first cell; rows count southwards from northing 0."""
        east_m, north_m = self.beside or (0.0, 0.0)
        return (round((north_m - self.transform.f) / self.cell_m), round((self.transform.c - east_m) / self.cell_m))

    @property
    def frame(self) -> Frame:
        """What a kernel needs to place a point."""
        (row, col), cell_m = self.origin, self.cell_m
        east_m, north_m = (0.0 if abs(each) <= LATTICE_TOLERANCE * cell_m else each for each in self._beside())
        return Frame(row, col, cell_m, east_m, north_m)

    def _beside(self) -> tuple[float, float]:
        """Return how far the lattice lies beside the absolute one, metres."""
        if self.beside is not None:
            return self.beside
        (row, col), cell_m = self.origin, self.cell_m
        return (self.transform.c - col * cell_m, self.transform.f + row * cell_m)

    def corners(
        self, row: NDArray[np.integer | np.floating], col: NDArray[np.integer | np.floating]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Easting and northing of the north-western corners of cells, metres: the same from any part of the lattice."""
        own = self.frame
        east = own.east_m + (own.col + np.asarray(col, dtype=np.float64)) * own.cell_m
        north = own.north_m - (own.row + np.asarray(row, dtype=np.float64)) * own.cell_m
        return east, north

    def xy(self, row: NDArray[np.integer], col: NDArray[np.integer]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Easting and northing of cell centres, metres."""
        return self.corners(np.asarray(row) + 0.5, np.asarray(col) + 0.5)

    def rowcol(
        self, easting: NDArray[np.float64], northing: NDArray[np.float64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Row and column of the cells that hold the points; may lie outside of the shape."""
        own = self.frame
        col = cell_along(np.asarray(easting) - own.east_m, own.cell_m).astype(np.int64) - own.col
        row = cell_along(own.north_m - np.asarray(northing), own.cell_m).astype(np.int64) - own.row
        return row, col

    def centres(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Easting (W,) of the columns' centres and northing (H, 1) of the rows', metres, which broadcast to (H, W)."""
        rows, cols = self.shape
        return self.xy(np.arange(rows)[:, None], np.arange(cols))

    def inside(self, row: NDArray[np.integer], col: NDArray[np.integer]) -> NDArray[np.bool_]:
        """Return which cells, given by rows and columns that broadcast, lie on the grid."""
        rows, cols = self.shape
        lie: NDArray[np.bool_] = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
        return lie

    def holding(self, bounds: "Bounds") -> NDArray[np.bool_]:
        """Return which (H, W) cells have their centre in bounds; one on the west or south edge counts."""
        west, south, east, north = bounds
        x, y = self.centres()
        return (x >= west) & (x < east) & (y >= south) & (y < north)

    def sample(
        self, values: NDArray[S], easting: NDArray[np.float64], northing: NDArray[np.float64], *, outside: float
    ) -> NDArray[S]:
        """Return the values of the cells that hold points.

        Parameters
        ----------
        values : (H, W) ndarray
            One value a cell of this grid.
        easting, northing : ndarray of float64
            Points in the grid's CRS, metres; of shapes that broadcast, as those of `centres` do.
        outside : float
            The value of points outside of the grid, such as NaN or False.

        Returns
        -------
        ndarray
            Of the dtype of ``values`` and the points' shape.

        Raises
        ------
        GridMismatchError
            When the values are not one a cell.
        """
        if values.shape != self.shape:
            msg = f"A grid of {self.shape} cells is sampled in values of its shape; got {values.shape}."
            raise GridMismatchError(msg)
        row, col = self.rowcol(easting, northing)
        held = values[np.clip(row, 0, self.shape[0] - 1), np.clip(col, 0, self.shape[1] - 1)]
        return np.where(self.inside(row, col), held, values.dtype.type(outside))

    def same_lattice(self, other: "GridSpec") -> bool:
        """Whether both grids have the same shape, position and CRS."""
        if self.shape != other.shape or self.crs != other.crs:
            return False
        tolerance = LATTICE_TOLERANCE * self.cell_m
        return all(abs(a - b) <= tolerance for a, b in zip(self.transform, other.transform, strict=True))

    def crop(self, rows: slice, cols: slice) -> "GridSpec":
        """Return the part of this lattice within two slices of non-negative start and stop."""
        transform = self.transform @ Affine.translation(cols.start, rows.start)
        shape = (rows.stop - rows.start, cols.stop - cols.start)
        return replace(self, shape=shape, transform=transform, beside=self._beside())

    def within(self, bounds: "Bounds") -> tuple[slice, slice]:
        """Return the rows and columns of the cells that have their centre in bounds; empty slices where none has.

        One on the west or south edge counts.
        """
        west, south, east, north = bounds
        x, y = self.centres()
        cols, rows = np.flatnonzero((x >= west) & (x < east)), np.flatnonzero(((y >= south) & (y < north)).ravel())
        if not len(rows) or not len(cols):
            return slice(0, 0), slice(0, 0)
        return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(cols[0]), int(cols[-1]) + 1)


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """Values and their validity on a lattice; both arrays are read-only.

    Parameters
    ----------
    values : (H, W) ndarray
        Finite everywhere; zero where not valid. float32 metres for heights.
    valid : (H, W) ndarray of bool
        Where a value was observed or filled by a stated rule.
    spec : GridSpec
        The lattice.
    """

    values: NDArray[np.generic]
    valid: NDArray[np.bool_]
    spec: GridSpec

    def __post_init__(self) -> None:
        """Check the shapes and freeze the arrays."""
        if self.values.shape != self.spec.shape or self.valid.shape != self.spec.shape:
            msg = f"Values {self.values.shape}, validity {self.valid.shape} and lattice {self.spec.shape} must agree."
            raise GridMismatchError(msg)
        if self.valid.dtype != np.bool_:
            msg = f"Validity must be bool; got {self.valid.dtype}."
            raise InputError(msg)
        self.values.flags.writeable = False
        self.valid.flags.writeable = False

    def with_values(self, values: NDArray[np.generic], valid: NDArray[np.bool_] | None = None) -> "Grid":
        """Return other values on the same lattice, with the same validity unless another is given."""
        return Grid(values, self.valid if valid is None else valid, self.spec)

    def crop(self, rows: slice, cols: slice) -> "Grid":
        """Return the part within two slices of non-negative start and stop."""
        return Grid(self.values[rows, cols], self.valid[rows, cols], self.spec.crop(rows, cols))


def require_metric(crs: CRS) -> None:
    """Refuse a CRS that is not projected with metres on both axes.

    Raises
    ------
    CRSError
        With the CRS's name and the next step.
    """
    if not crs.is_projected:
        msg = (
            f"The CRS must be projected, in metres; got '{crs.name}', in degrees or without a projection. "
            "Reproject the data first, for instance with 'pdal translate' and filters.reprojection, or gdalwarp."
        )
        raise CRSError(msg)
    units = {axis.unit_conversion_factor for axis in crs.axis_info[:2]}
    if units != {1.0}:
        msg = f"The CRS must be in metres; got '{crs.name}' in {crs.axis_info[0].unit_name}."
        raise CRSError(msg)


def lattice(bounds: Bounds, cell_m: float, crs: CRS) -> GridSpec:
    """Return the smallest grid on the absolute lattice that covers the bounds.

    The lattice's corners lie at whole multiples of the cell, so that neighbouring tiles share their indices.

    Parameters
    ----------
    bounds : tuple of float
        West, south, east and north, metres. A point on the east or south edge gets a cell of its own.
    cell_m : float
        Side of a cell, metres.
    crs : CRS
        A projected CRS in metres.

    Examples
    --------
    >>> spec = lattice((100.3, 200.2, 101.9, 200.9), 0.5, CRS.from_epsg(2154))
    >>> spec.shape, spec.bounds
    ((2, 4), (100.0, 200.0, 102.0, 201.0))
    """
    west, south, east, north = bounds
    col0, col1, row0, row1 = (math.floor(cell_along(each, cell_m)) for each in (west, east, -north, -south))
    transform = Affine(cell_m, 0.0, col0 * cell_m, 0.0, -cell_m, -row0 * cell_m)
    return GridSpec((row1 - row0 + 1, col1 - col0 + 1), transform, crs)


@dataclass(frozen=True, slots=True, eq=False)
class Bands:
    """Band values and their shared validity on a lattice (V13: any number of bands); the arrays are read-only.

    Parameters
    ----------
    values : (B, H, W) ndarray of float32
        Finite everywhere, in the source's units (digital numbers); zero where not valid.
    names : tuple of str
        One unique name a band; ``red``, ``green``, ``blue``, ``nir`` and ``intensity`` have a meaning.
    valid : (H, W) ndarray of bool
        Where every band was observed.
    spec : GridSpec
        The lattice.
    """

    values: NDArray[np.float32]
    names: tuple[str, ...]
    valid: NDArray[np.bool_]
    spec: GridSpec

    def __post_init__(self) -> None:
        """Check shapes, dtypes and names, and freeze the arrays."""
        expected = (len(self.names), *self.spec.shape)
        if self.values.shape != expected or self.valid.shape != self.spec.shape:
            msg = (
                f"Values {self.values.shape} and validity {self.valid.shape} must fit the bands and lattice {expected}."
            )
            raise GridMismatchError(msg)
        if self.values.dtype != np.float32 or self.valid.dtype != np.bool_:
            msg = f"Values must be float32 and validity bool; got {self.values.dtype} and {self.valid.dtype}."
            raise InputError(msg)
        if not self.names or len(set(self.names)) != len(self.names):
            msg = f"Every band needs a name of its own; got {self.names}."
            raise InputError(msg)
        self.values.flags.writeable = False
        self.valid.flags.writeable = False

    def band(self, name: str) -> NDArray[np.float32] | None:
        """Return the (H, W) values of the named band, or None if there is no such band."""
        return self.values[self.names.index(name)] if name in self.names else None

"""The two kinds of reference, and both sides of a comparison on one grid."""

from dataclasses import dataclass

import geopandas as gpd
import numpy as np
import shapely
from numpy.typing import NDArray
from pyproj import CRS
from scipy import ndimage

from msbdb.errors import CRSError, InputError, NodataError
from msbdb.grid import Bounds, GridSpec, lattice
from msbdb.labels import label_zones, renumber, sizes
from msbdb.outline.polygons import Geometries, polygonise, rasterise
from msbdb.params import EvaluateParams

Mask = NDArray[np.bool_]

MAX_CELLS = 250_000_000
"""Largest grid on which areas are compared: about 1 GB a layer of labels."""

COUNTED_SHARE = 0.5
"""An object counts when at least this share of its area lies in scored cells."""


@dataclass(frozen=True, slots=True, eq=False)
class PolygonReference:
    """True footprints.

    Parameters
    ----------
    frame : GeoDataFrame
        Polygons with a CRS; other geometries are ignored.
    height : str, optional
        Column of heights above ground, metres, null where unknown.
    """

    frame: gpd.GeoDataFrame
    height: str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class PointReference:
    """Classified points.

    Parameters
    ----------
    easting, northing : (N,) ndarray of float64
        Coordinates, metres.
    building : (N,) ndarray of bool
        Which points are building (class 6).
    crs : CRS
        Their projected CRS.
    first_echo : (N,) ndarray of bool, optional
        Which points are first echoes; all when not given.
    """

    easting: NDArray[np.float64]
    northing: NDArray[np.float64]
    building: Mask
    crs: CRS
    first_echo: Mask | None = None


Reference = PolygonReference | PointReference


@dataclass(frozen=True, slots=True, eq=False)
class Side:
    """The buildings of one side, before any mask.

    Attributes
    ----------
    outlines : (N,) ndarray of polygonal geometries
        Of each object.
    labels : (H, W) ndarray of int32
        Index + 1 of the object in each cell; where objects overlap, the smaller one has the cell
        (of equal ones, the easternmost).
    mask : (H, W) ndarray of bool
        Cells that are building, of objects or not.
    area_m2, height_m : (N,) ndarray of float64
        Area of the whole object, and its height above ground, NaN where unknown.
    """

    outlines: Geometries
    labels: NDArray[np.int32]
    mask: Mask
    area_m2: NDArray[np.float64]
    height_m: NDArray[np.float64]

    def counted(self, scored_m2: NDArray[np.float64]) -> Mask:
        """Return which objects have at least half of their area in scored cells, given that area of each."""
        return np.asarray((scored_m2 > 0) & (scored_m2 >= COUNTED_SHARE * self.area_m2))


def polygons(
    frame: gpd.GeoDataFrame | gpd.GeoSeries, crs: CRS, what: str, column: str | None = None
) -> tuple[Geometries, NDArray[np.float64]]:
    """Return the valid polygonal geometries of a frame in a CRS, and a column's values (NaN without).

    Null and empty geometries, lines and points are left out; invalid rings are repaired.

    Raises
    ------
    CRSError
        When the frame has no CRS.
    InputError
        When it has geometries but no polygon, or not the column.
    """
    if frame.crs is None:
        msg = f"The {what} has no CRS; state it, as in EPSG:28992."
        raise CRSError(msg)
    if column is not None and column not in frame.columns:
        msg = f"The {what} has no column '{column}'; it has {', '.join(str(name) for name in frame.columns)}."
        raise InputError(msg)
    values = (
        np.full(len(frame), np.nan) if column is None else frame[column].to_numpy(dtype=np.float64, na_value=np.nan)
    )
    if not len(frame):
        return np.empty(0, dtype=np.object_), values
    here = frame.geometry if frame.crs == crs else frame.geometry.to_crs(horizontal(crs))
    repaired = shapely.make_valid(shapely.force_2d(here.to_numpy()), method="structure", keep_collapsed=False)
    polygonal = np.isin(
        shapely.get_type_id(repaired), (shapely.GeometryType.POLYGON, shapely.GeometryType.MULTIPOLYGON)
    )
    if not polygonal.any():
        msg = f"The {what} holds {len(frame)} geometries but no polygon."
        raise InputError(msg)
    keep = polygonal & ~shapely.is_empty(repaired)
    return repaired[keep], values[keep]


def horizontal(crs: CRS) -> CRS:
    """Return the horizontal part of a compound CRS, or the CRS."""
    return crs.sub_crs_list[0] if crs.is_compound else crs


def grid_over(bounds: Bounds, params: EvaluateParams, crs: CRS) -> GridSpec:
    """Return the lattice over the bounds, with two cells of margin.

    Raises
    ------
    InputError
        When it has too many cells.
    """
    west, south, east, north = bounds
    cells = (east - west) * (north - south) / params.cell_m**2
    if not cells <= MAX_CELLS:
        msg = (
            f"Comparing {(east - west) / 1000:.1f} by {(north - south) / 1000:.1f} km at {params.cell_m} m takes "
            f"{cells:.2g} cells, more than {MAX_CELLS:.2g}. Give an area of interest, or a larger cell."
        )
        raise InputError(msg)
    margin = 2 * params.cell_m
    return lattice((west - margin, south - margin, east + margin, north + margin), params.cell_m, horizontal(crs))


def polygon_side(outlines: Geometries, height_m: NDArray[np.float64], spec: GridSpec) -> Side:
    """Put polygons on the grid; a cell belongs to the polygon that holds its centre."""
    area = shapely.area(outlines)
    west, south, _, _ = shapely.bounds(outlines).T
    order = np.lexsort((south, west, -area))
    drawn = rasterise(outlines[order], spec)
    labels = np.concatenate(([0], order + 1)).astype(np.int32)[drawn]
    return Side(outlines, labels, labels > 0, area, height_m)


def point_side(reference: PointReference, spec: GridSpec, params: EvaluateParams) -> tuple[Side, Mask, Mask]:
    """Put classified points on the grid.

    A cell is building when at least half of its first echoes are: the view from above, without walls below eaves.
    Cells without a first echo take the class of the nearest cell with one, up to ``max_gap_m`` between their centres;
    farther cells are not known. Objects are the 8-connected components of at least ``min_object_m2``.

    Returns
    -------
    side : Side
        The reference as objects.
    known : (H, W) ndarray of bool
        Cells with a class, in which objects are compared.
    observed : (H, W) ndarray of bool
        Cells that hold a first echo themselves, in which areas are compared: there no class is invented.

    Raises
    ------
    NodataError
        When no first echo lies on the grid.
    """
    row, col = spec.rowcol(reference.easting, reference.northing)
    chosen = spec.inside(row, col)
    if reference.first_echo is not None:
        chosen &= reference.first_echo
    if not chosen.any():
        msg = "No first echo of the reference lies within the compared area; check the CRS and the area of interest."
        raise NodataError(msg)
    cell = (row * spec.shape[1] + col)[chosen]
    size = spec.shape[0] * spec.shape[1]
    votes = np.bincount(cell, minlength=size).reshape(spec.shape)
    ayes = np.bincount(cell[reference.building[chosen]], minlength=size).reshape(spec.shape)
    observed = votes > 0
    distance, nearest = ndimage.distance_transform_edt(~observed, sampling=spec.cell_m, return_indices=True)
    known = np.asarray(distance <= params.max_gap_m)
    mask = known & ((2 * ayes >= votes) & observed)[tuple(nearest)]
    components, count = label_zones(mask)
    components_m2 = sizes(components, count) * spec.cell_area_m2
    large = components_m2 >= params.min_object_m2
    labels, kept = renumber(components, large)
    outlines = polygonise(labels, spec, kept)
    area = np.asarray(components_m2[large], dtype=np.float64)
    return Side(outlines, labels, mask, area, np.full(len(area), np.nan)), known, observed

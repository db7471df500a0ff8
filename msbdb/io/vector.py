"""Polygons and points read from any vector format, such as reference footprints; and packed as vector tiles (MVT)."""

import logging
import os
import tempfile
from dataclasses import dataclass
from pathlib import Path

import geopandas as gpd
import numpy as np
import pyogrio
import shapely
from numpy.typing import NDArray
from pyogrio.errors import DataLayerError, DataSourceError
from pyproj import CRS

from msbdb.errors import FileError, InputError, MsbdbWarning, NodataError, give_notice
from msbdb.grid import Bounds
from msbdb.io.crs import CrsLike, parse_crs, settle

logger = logging.getLogger(__name__)

POINT, POLYGON, MULTIPOLYGON, COLLECTION = 0, 3, 6, 7
"""Shapely's type numbers of points, and of the geometries that hold areas."""

WORLD_M = 20_037_508.342789244
"""Half the side of the world's square in EPSG:3857, whose tile of zoom 0 is the whole of it."""

STEPS, MARGIN = 4096, 64
"""Steps of a tile's side, and how far beyond its edges outlines go, so that none of their lines is seen there."""

MOST_BYTES = 50_000_000
"""Size at which GDAL would leave out details and features (ours): far above that of all features we let in."""


@dataclass(frozen=True, slots=True, eq=False)
class Area:
    """A part of the ground: polygons, and how far beyond them it reaches.

    Parameters
    ----------
    polygons : GeoSeries
        With their CRS.
    margin_m : float
        Distance beyond the polygons, metres.
    what : str
        What it is, for messages.
    """

    polygons: gpd.GeoSeries
    margin_m: float
    what: str

    @classmethod
    def of_box(cls, bounds: Bounds, crs: CRS) -> "Area":
        """Return a rectangle without a margin."""
        return cls(gpd.GeoSeries([shapely.box(*bounds)], crs=crs), 0.0, f"the block at {bounds[0]:.0f},{bounds[1]:.0f}")

    def shape_in(self, crs: CRS, *, margin: bool = True) -> shapely.Geometry:
        """Return one shape in a metric CRS, with the margin or without."""
        shape = self.polygons.to_crs(crs).union_all()
        return shapely.buffer(shape, self.margin_m) if margin and self.margin_m else shape


def held(shape: shapely.Geometry, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which points a shape holds; those on its edge count."""
    west, south, east, north = shapely.bounds(shape)
    inside = (x >= west) & (x <= east) & (y >= south) & (y <= north)
    if shape.equals(shapely.box(west, south, east, north)):
        return np.asarray(inside, dtype=np.bool_)
    shapely.prepare(shape)
    near = np.flatnonzero(inside)
    inside[near] = shapely.intersects_xy(shape, x[near], y[near])
    return np.asarray(inside, dtype=np.bool_)


def read_polygons(
    path: str | os.PathLike[str], *, layer: str | None = None, crs: CrsLike | None = None, to: CrsLike | None = None
) -> gpd.GeoDataFrame:
    """Read the polygons of a layer, valid and two-dimensional, with their attributes.

    Parameters
    ----------
    path : path
        A file of any vector format that GDAL reads.
    layer : str, optional
        Its layer; needed if there are several.
    crs : int, str or CRS, optional
        The CRS of a file that has none; where the file has one, it must be the same.
    to : int, str or CRS, optional
        The CRS to reproject the polygons to.

    Returns
    -------
    GeoDataFrame
        Polygons and multipolygons in the file's order, the index from 0.

    Raises
    ------
    FileError
        If the file or the layer cannot be read.
    InputError
        If the layer must be named.
    CRSError
        If the CRS is missing, or in conflict with ``crs``.
    NodataError
        If there are no polygons.

    Warns
    -----
    MsbdbWarning
        If geometries were repaired (OGC validity, keeping their areas) or left out (no area).
    """
    path = Path(path)
    frame = _read(path, layer)
    found = None if frame.crs is None else CRS.from_user_input(frame.crs)
    frame = frame.set_crs(settle(found, crs, path.name), allow_override=True)
    geometry = shapely.force_2d(np.asarray(frame.geometry.array))
    broken = ~shapely.is_missing(geometry) & ~shapely.is_valid(geometry)
    geometry[broken] = shapely.make_valid(geometry[broken])
    geometry = np.array([_areas_of(each) for each in geometry], dtype=object)
    kept = ~shapely.is_missing(geometry) & ~shapely.is_empty(geometry)
    for count, what in (
        (int(broken.sum()), "repaired"),
        (int((~kept).sum()), "left out, because they are no polygons"),
    ):
        if count:
            give_notice(f"{path.name}: {count} geometries were {what}.")
    if not kept.any():
        msg = f"{path} holds no polygons. Give a layer of polygons."
        raise NodataError(msg)
    frame = frame.set_geometry(gpd.GeoSeries(geometry, index=frame.index, crs=frame.crs))
    frame = frame[kept].reset_index(drop=True)
    logger.info("Read %d polygons from %s", len(frame), path)
    return frame if to is None else frame.to_crs(parse_crs(to))


def read_point_features(
    path: str | os.PathLike[str], *, layer: str | None = None, crs: CrsLike | None = None, to: CrsLike | None = None
) -> gpd.GeoDataFrame:
    """Read the points of a layer, two-dimensional, with their attributes.

    Parameters
    ----------
    path, layer, crs, to
        As for `read_polygons`.

    Returns
    -------
    GeoDataFrame
        Points in the file's order, the index from 0; a multipoint of one point counts as that point.

    Raises
    ------
    FileError, InputError, CRSError
        As `read_polygons`.
    NodataError
        If there are no points.

    Warns
    -----
    MsbdbWarning
        If geometries were left out.
    """
    path = Path(path)
    frame = _read(path, layer)
    found = None if frame.crs is None else CRS.from_user_input(frame.crs)
    frame = frame.set_crs(settle(found, crs, path.name), allow_override=True)
    geometry = shapely.force_2d(np.asarray(frame.geometry.array))
    single = shapely.get_num_geometries(geometry) == 1
    geometry[single] = shapely.get_geometry(geometry[single], 0)
    kept = (shapely.get_type_id(geometry) == POINT) & ~shapely.is_empty(geometry)
    if not kept.any():
        msg = f"{path} holds no points. Give a layer of points."
        raise NodataError(msg)
    if not kept.all():
        give_notice(
            f"{path.name}: {(~kept).sum()} geometries were left out, because they are no points.",
            MsbdbWarning,
            stacklevel=2,
        )
    frame = frame.set_geometry(gpd.GeoSeries(geometry, index=frame.index, crs=frame.crs))[kept].reset_index(drop=True)
    return frame if to is None else frame.to_crs(parse_crs(to))


def _read(path: Path, layer: str | None) -> gpd.GeoDataFrame:
    """Return a layer of a file, whatever its geometries."""
    if not path.exists():
        msg = f"{path} does not exist. Check the path."
        raise FileError(msg)
    try:
        layers = [str(name) for name, kind in pyogrio.list_layers(path) if kind is not None]
        if layer is None and len(layers) > 1:
            msg = f"{path} has the layers {', '.join(layers)}; choose one by --layer."
            raise InputError(msg)
        frame = pyogrio.read_dataframe(path, layer=layer if layer is not None or not layers else layers[0])
    except (DataSourceError, DataLayerError) as error:
        msg = f"{path} cannot be read ({error}). Check that it is a vector file, and the layer's name."
        raise FileError(msg) from error
    if not isinstance(frame, gpd.GeoDataFrame):
        msg = f"{path} has no geometries. Give a layer of polygons."
        raise NodataError(msg)
    return frame


def _areas_of(geometry: shapely.Geometry | None) -> shapely.Geometry | None:
    """Return the polygonal part of a geometry; None if it has no area."""
    kind = shapely.get_type_id(geometry)
    if kind in (POLYGON, MULTIPOLYGON):
        return geometry
    if kind != COLLECTION:
        return None
    parts = shapely.get_parts(geometry)
    areas = parts[np.isin(shapely.get_type_id(parts), (POLYGON, MULTIPOLYGON))]
    return shapely.union_all(areas) if len(areas) else None


def bounds_of_tile(zoom: int, row: int, column: int) -> Bounds:
    """Return west, south, east and north of a tile of WebMercatorQuad, EPSG:3857.

    Examples
    --------
    >>> [round(edge) for edge in bounds_of_tile(1, 0, 1)]
    [0, 0, 20037508, 20037508]
    """
    side = 2 * WORLD_M / 2**zoom
    west, north = column * side - WORLD_M, WORLD_M - row * side
    return west, north - side, west + side, north


def tile_of(frame: gpd.GeoDataFrame, bounds: Bounds, layer: str) -> bytes | None:
    """Return a tile as Mapbox Vector Tile 2.1; None where it would be empty.

    Parameters
    ----------
    frame : GeoDataFrame
        Features with their properties, in EPSG:3857.
    bounds : tuple of float
        West, south, east and north of the tile, a square.
    layer : str
        The name of the only layer.

    Notes
    -----
    GDAL writes whole sets of tiles. It is given a scheme whose only tile of zoom 0 is the one that is wanted.
    """
    if frame.empty:  # GDAL 3.12 never ends without a feature
        return None
    west, _, east, north = bounds
    options = {
        "FORMAT": "DIRECTORY", "COMPRESS": "NO", "MINZOOM": "0", "MAXZOOM": "0", "SIMPLIFICATION": "0",
        "TILING_SCHEME": f"EPSG:3857,{west!r},{north!r},{east - west!r}", "EXTENT": str(STEPS), "BUFFER": str(MARGIN),
        "MAX_SIZE": str(MOST_BYTES), "MAX_FEATURES": str(len(frame)),
    }  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "tiles"
        pyogrio.write_dataframe(frame, out, driver="MVT", layer=layer, dataset_options=options)
        tile = out / "0" / "0" / "0.pbf"
        return tile.read_bytes() if tile.is_file() else None


def archive_of(frame: gpd.GeoDataFrame, layer: str, zooms: tuple[int, int]) -> bytes:
    """Return all tiles of a town as one archive, PMTiles 3, packed by gzip.

    Parameters
    ----------
    frame : GeoDataFrame
        One feature or more with their properties, in any CRS.
    layer : str
        The name of the only layer.
    zooms : tuple of int
        The first zoom, and the last one.
    """
    options = {
        "MINZOOM": str(zooms[0]), "MAXZOOM": str(zooms[1]), "SIMPLIFICATION": "0", "EXTENT": str(2 * STEPS),
        "BUFFER": str(2 * MARGIN), "MAX_SIZE": str(MOST_BYTES), "MAX_FEATURES": str(len(frame)),
    }  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "town.pmtiles"
        pyogrio.write_dataframe(frame, out, driver="PMTiles", layer=layer, dataset_options=options)
        return out.read_bytes()

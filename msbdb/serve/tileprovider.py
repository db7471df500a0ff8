"""The layers of a database as vector tiles of pygeoapi: one provider for SpatiaLite and PostGIS, which only reads."""

from collections.abc import Mapping
from typing import Any

import geopandas as gpd
import pandas as pd
import shapely
from flask import current_app, g
from pygeoapi.models.provider.base import TileMatrixSetEnum
from pygeoapi.provider.base import ProviderInvalidQueryError
from pygeoapi.provider.tile import BaseTileProvider
from pyproj import CRS
from werkzeug.exceptions import BadRequest, NotFound

from msbdb.database import LAYERS, FeatureLayer, FeatureQuery, read_page
from msbdb.errors import InputError
from msbdb.grid import Bounds
from msbdb.io.vector import MARGIN, STEPS, WORLD_M, bounds_of_tile, tile_of
from msbdb.serve.featureprovider import ENGINE, SYSTEM, days_of, field_of, transformer
from msbdb.tables import Column
from msbdb.tables.view_columns import IDS

SCHEME = TileMatrixSetEnum.WEBMERCATORQUAD.value
"""The only scheme of tiles that is served."""

FORMAT = {"name": "mvt", "mimetype": "application/vnd.mapbox-vector-tile"}

ZOOMS = (12, 22)
"""The first zoom, on which a tile is up to 10 km wide and a house a pixel, and the last of common viewers (ours)."""

MOST_FEATURES = 10_000
"""Features of a tile at most, those of the largest area first (ours): of a dense town about 3 km² have as many."""

LAST_LATITUDE = 85.05
"""The world's square ends near it, degrees north and south."""

KINDS: Mapping[str, str] = {
    "int64": "Int64",
    "Int64": "Int64",
    "int32": "Int64",
    "float64": "Float64",
    "bool": "boolean",
}
"""The type in which a column without texts goes to GDAL, which leaves out what is null."""

RELATION = "http://www.opengis.net/def/rel/ogc/1.0"


class TileProvider(BaseTileProvider):  # type: ignore[misc]  # the library has no type information
    """The tiles of a layer of the database that the app serves.

    Parameters
    ----------
    provider_def : dict
        ``data`` is the name of a layer of `msbdb.database.LAYERS`; ``options`` has the ``bounds`` of the database in
        longitude and latitude.
    """

    def __init__(self, provider_def: dict[str, Any]) -> None:
        super().__init__(provider_def)
        self.layer: FeatureLayer = LAYERS[self.data]
        self.engine, self.crs = current_app.config[ENGINE], current_app.config[SYSTEM]
        self.tile_type = "vector"

    def get_layer(self) -> str:
        """Return the name of the layer in the tiles."""
        return self.layer.name

    def get_tiling_schemes(self) -> list[Any]:
        """Return the schemes of tiles."""
        return [SCHEME]

    def get_tiles_service(self, *, servicepath: str, **_: object) -> dict[str, Any]:
        """Return a link by which clients form the addresses of tiles."""
        path = servicepath.replace("{tileMatrixSetId}", SCHEME.tileMatrixSet)
        title = "Vector tiles, by tileMatrix, tileRow and tileCol"
        return {"links": [{"rel": "item", "type": self.mimetype, "title": title, "href": path, "templated": True}]}

    def get_metadata(self, *, server_url: str, title: str, description: str, **_: object) -> dict[str, Any]:
        """Return what a set of tiles has, as OGC API Tiles and the standard of two-dimensional tiles name it."""
        columns = [column for column in self.layer.columns if column.dtype != "json"]
        own = f"{server_url}/collections/{self.layer.name}/tiles/{SCHEME.tileMatrixSet}"
        scheme = f"{server_url}/TileMatrixSets/{SCHEME.tileMatrixSet}?f=json"
        return {
            "title": title,
            "description": description,
            "dataType": "vector",
            "crs": SCHEME.crs,
            "tileMatrixSetURI": SCHEME.tileMatrixSetURI,
            "tileMatrixSetLimits": [limits_of(zoom, self.options["bounds"]) for zoom in range(ZOOMS[0], ZOOMS[1] + 1)],
            "layers": [
                {
                    "id": self.layer.name, "title": title, "dataType": "vector",
                    "minTileMatrix": str(ZOOMS[0]), "maxTileMatrix": str(ZOOMS[1]),
                    "propertiesSchema": {
                        "type": "object", "properties": {column.name: field_of(column) for column in columns},
                    },
                }
            ],
            "links": [
                {"rel": "self", "type": "application/json", "title": "This document as JSON", "href": f"{own}?f=json"},
                {"rel": "alternate", "type": "text/html", "title": "This document as HTML", "href": f"{own}?f=html"},
                {
                    "rel": f"{RELATION}/tiling-scheme", "type": "application/json", "title": "The scheme of the tiles",
                    "href": scheme,
                },
                *self.get_tiles_service(servicepath=f"{own}/{{tileMatrix}}/{{tileRow}}/{{tileCol}}?f=mvt")["links"],
            ],
        }  # fmt: skip

    def get_tiles(self, *, z: str, y: str, x: str, **_: object) -> bytes | None:
        """Return a tile; None for an empty one. The window is the app's, in the database's CRS.

        Raises
        ------
        ProviderInvalidQueryError
            For a day that does not fit.
        """
        if g.window.is_empty:
            return None
        try:
            wanted = FeatureQuery(
                window=g.window, days=days_of(g.days), order=[("area_m2", True)], limit=MOST_FEATURES,
                names=[column.name for column in self.layer.columns if column.dtype != "json"],
            )  # fmt: skip
            rows = read_page(self.engine, self.layer, wanted).rows
        except InputError as error:
            raise ProviderInvalidQueryError(user_msg=str(error)) from error
        shapes = shapely.from_wkb([bytes(row.pop("wkb")) for row in rows])
        shapes = shapely.transform(shapes, transformer(self.crs, CRS(3857)).transform, interleaved=False)
        table = {column.name: _values(rows, column) for column in self.layer.columns if column.dtype != "json"}
        frame = gpd.GeoDataFrame(table, geometry=shapes, crs=3857)
        return tile_of(frame, bounds_of_tile(int(z), int(y), int(x)), self.layer.name)


def require_scheme(name: str) -> str:
    """Return the name of a scheme of tiles; refuse one that is not served."""
    if name != SCHEME.tileMatrixSet:
        msg = f"The tiles are those of {SCHEME.tileMatrixSet} alone."
        raise NotFound(msg)
    return name


def box_of_tile(scheme: str, zoom: str, row: str, column: str) -> Bounds:
    """Return the bounds of what is read for a tile, its margin with it, EPSG:3857.

    Raises
    ------
    HTTPException
        For words that are no numbers, and for tiles that do not exist.
    """
    require_scheme(scheme)
    words = (zoom, row, column)
    if not all(word.isascii() and word.isdecimal() and len(word) < 10 for word in words):
        msg = "The address of a tile ends with three whole numbers: tileMatrix, tileRow and tileCol."
        raise BadRequest(msg)
    z, y, x = map(int, words)
    if not (ZOOMS[0] <= z <= ZOOMS[1] and max(x, y) < 2**z):
        msg = f"There are tiles of the zooms {ZOOMS[0]} to {ZOOMS[1]}, and none beside the world."
        raise NotFound(msg)
    west, south, east, north = bounds_of_tile(z, y, x)
    more = (east - west) * MARGIN / STEPS
    return west - more, south - more, east + more, north + more


def limits_of(zoom: int, bounds: Bounds) -> dict[str, Any]:
    """Return the rows and columns of a zoom in which tiles are, of bounds in longitude and latitude.

    Examples
    --------
    >>> limits_of(12, (0.01, 40.0, 0.02, 40.01))
    {'tileMatrix': '12', 'minTileRow': 1550, 'maxTileRow': 1550, 'minTileCol': 2048, 'maxTileCol': 2048}
    """
    shown = bounds[0], max(bounds[1], -LAST_LATITUDE), bounds[2], min(bounds[3], LAST_LATITUDE)
    west, south, east, north = transformer(CRS("OGC:CRS84"), CRS(3857)).transform_bounds(*shown)
    side, last = 2 * WORLD_M / 2**zoom, 2**zoom - 1
    columns = [min(max(int((edge + WORLD_M) // side), 0), last) for edge in (west, east)]
    rows = [min(max(int((WORLD_M - edge) // side), 0), last) for edge in (north, south)]
    return {
        "tileMatrix": str(zoom),
        "minTileRow": rows[0], "maxTileRow": rows[1], "minTileCol": columns[0], "maxTileCol": columns[1],
    }  # fmt: skip


def _values(rows: list[dict[str, Any]], column: Column) -> "pd.Series[Any]":
    """Return a column of rows; ids are texts."""
    kind = "object" if column.name in IDS else KINDS.get(column.dtype, "object")
    return pd.Series([row[column.name] for row in rows], dtype=kind)

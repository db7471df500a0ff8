"""The app: the documents of OGC API Features and Tiles as JSON and as plain pages, and the page of the town in 3-D."""

import json
import logging
import math
import tempfile
import threading
from collections.abc import Callable, Mapping
from functools import partial
from http import HTTPStatus
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlencode

import pygeoapi.api as core
import shapely
from flask import Flask, Response, g, render_template, request
from pygeoapi.api import API, APIRequest, itemtypes, tiles
from pygeoapi.openapi import get_oas
from pygeoapi.util import get_crs_from_uri
from werkzeug.exceptions import BadRequest, HTTPException, NotFound
from werkzeug.wrappers import Request

from msbdb.database import LAYERS, Engine, FeatureLayer, ServedState, database_crs_of, read_state
from msbdb.errors import DatabaseError, MsbdbError, collected_notices
from msbdb.run.townpage import view_page
from msbdb.serve.featureprovider import ENGINE, SYSTEM, FeatureProvider, field_of, north_first, transformer
from msbdb.serve.tileprovider import FORMAT, SCHEME, TileProvider, box_of_tile, require_scheme

logger = logging.getLogger(__name__)

PAGE_ROWS, MOST_ROWS = 100, 10_000
"""Features of a page by default, and at most (ours): GDAL asks for 1000, and 10,000 buildings are about 20 MB."""

CRS84 = "http://www.opengis.net/def/crs/OGC/1.3/CRS84"
EPSG = "http://www.opengis.net/def/crs/EPSG/0/{}"

OFFERED = (4326, 3857)
"""EPSG codes that are offered beside CRS84 and the database's own."""

MARGIN = 0.1
"""Share of the extent by which a window may reach beyond it before it is cut (ours); PROJ fails far from a CRS."""

SEGMENTS = 64
"""Straight pieces of each side of a window (ours), which is curved in another CRS."""

MOST_BYTES = 1_000_000
"""Of the body of a request, which only filters need."""

HEADERS = {
    "Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
"""Of each answer: it runs no script and loads nothing. The page in 3-D has its own policy, for its two scripts."""

NOT_SERVED = ("/processes", "/jobs", "/stac")
"""Beginnings of paths that pygeoapi describes, but that this server does not have."""

NOT_OFFERED = ("/processes", "/job-list")
"""Ends of the relations of links that pygeoapi shows, but that this server does not have."""

NOT_READ = "/conf/create-replace-delete"
"""End of the conformance class of servers that write."""

Answer = tuple[Mapping[str, str], int, str | bytes]


class ServedTown:
    """A database as pygeoapi and the browser see it, made again when the database changes.

    Parameters
    ----------
    db : str
        The database.
    engine : Engine
        The same, opened to read.
    url : str
        The address at which clients find the server, without a slash at its end.
    """

    def __init__(self, db: str, engine: Engine, url: str) -> None:
        self.db, self.engine, self.url = db, engine, url
        self.crs = database_crs_of(engine)
        authority = self.crs.to_authority()
        self.stored = EPSG.format(authority[1]) if authority and authority[0] == "EPSG" else ""
        own = [self.stored] if self.stored else []
        self.systems = list(dict.fromkeys([CRS84, *own, *map(EPSG.format, OFFERED)]))
        self._lock, self._page_lock = threading.Lock(), threading.Lock()
        self._made: tuple[ServedState, API] | None = None
        self._page: tuple[str, bytes] | None = None

    def now(self) -> tuple[ServedState, API]:
        """Return the committed state, and pygeoapi for it."""
        made = self._made
        state = read_state(self.engine, None if made is None else made[0])
        with self._lock:
            if self._made is None or self._made[0] != state:
                self._made = state, API(self._configuration(state), {})
            return self._made

    def page(self) -> bytes:
        """Return the page in 3-D.

        Raises
        ------
        MsbdbError
            When the town is too large for a page, or MapLibre GL JS is missing.
        """
        token = self.now()[0].token
        with self._page_lock:
            if self._page is None or self._page[0] != token:
                with tempfile.TemporaryDirectory() as folder, collected_notices() as notices:
                    out = Path(folder) / "town.html"
                    view_page(self.db, out, survey=None, what="parts", aoi=None, ortho=None, overwrite=False)
                    self._page = token, out.read_bytes()
                for notice in notices:
                    logger.info("The page: %s", notice)
            return self._page[1]

    def window(self, box: list[float], uri: str, bounds: tuple[float, float, float, float] | None) -> shapely.Geometry:
        """Return a box of a CRS as a polygon in the database's, cut where the data end; empty beside the data."""
        if bounds is None:
            return shapely.Polygon()
        crs = get_crs_from_uri(uri)
        west, south, east, north = transformer(self.crs, crs).transform_bounds(*bounds)
        dx, dy = MARGIN * (east - west), MARGIN * (north - south)
        x0, y0, x1, y1 = (box[1], box[0], box[3], box[2]) if north_first(crs) else box
        cut = shapely.intersection(
            shapely.box(x0, y0, x1, y1), shapely.box(west - dx, south - dy, east + dx, north + dy)
        )
        if cut.is_empty:
            return shapely.Polygon()
        pieces = shapely.segmentize(cut, max(east - west, north - south) / SEGMENTS)
        return shapely.transform(pieces, transformer(crs, self.crs).transform, interleaved=False)

    def _configuration(self, state: ServedState) -> dict[str, Any]:
        """Return the configuration of pygeoapi."""
        extent = [-180.0, -90.0, 180.0, 90.0]
        if state.bounds is not None:
            bounds = transformer(self.crs, get_crs_from_uri(CRS84)).transform_bounds(*state.bounds)
            extent = [round(edge, 6) for edge in bounds]
        title = f"msbdb: {unquote(Path(str(self.engine.url.database)).stem)}"
        return {
            "server": {
                "url": self.url, "bind": {}, "encoding": "utf-8", "languages": ["en-US"], "map": {},
                "limits": {"default_items": PAGE_ROWS, "max_items": MOST_ROWS, "on_exceed": "throttle"},
            },
            "logging": {"level": "ERROR"},
            "metadata": {
                "identification": {
                    "title": title, "description": "Buildings, their parts, their history and the evidence for them",
                    "keywords": ["buildings", "LiDAR"], "url": f"{self.url}/page", "terms_of_service": None,
                },
                "license": {"name": "", "url": ""}, "provider": {"name": "msbdb", "url": self.url},
                "contact": {"name": "msbdb"},
            },
            "resources": {name: self._collection(layer, extent) for name, layer in LAYERS.items()},
        }  # fmt: skip

    def _collection(self, layer: FeatureLayer, extent: list[float]) -> dict[str, Any]:
        """Return a layer as a collection of pygeoapi."""
        provider = {
            "type": "feature", "name": f"{FeatureProvider.__module__}.{FeatureProvider.__name__}", "data": layer.name,
            "id_field": layer.key, "time_field": layer.days[0] if layer.days else None, "crs": list(self.systems),
        }  # fmt: skip
        tiled = {
            "type": "tile", "name": f"{TileProvider.__module__}.{TileProvider.__name__}", "data": layer.name,
            "format": FORMAT, "options": {"bounds": extent},
        }  # fmt: skip
        return {
            "type": "collection", "title": layer.title, "description": layer.doc, "keywords": ["buildings"],
            "links": [],
            "extents": {"spatial": {"bbox": extent, "crs": CRS84}},
            "providers": [provider | ({"storage_crs": self.stored} if self.stored else {}), tiled],
        }  # fmt: skip


def make_app(town: ServedTown, hosts: list[str] | None) -> Flask:
    """Return the app of a town.

    Parameters
    ----------
    town : ServedTown
        What it serves.
    hosts : list of str or None
        The names by which clients may call the server, so that no foreign page reaches it by a name of its own; None
        for all.
    """
    app = Flask(__name__)
    app.config[ENGINE], app.config[SYSTEM] = town.engine, town.crs
    app.config["TRUSTED_HOSTS"] = hosts
    app.config["MAX_CONTENT_LENGTH"] = MOST_BYTES

    def answer(function: Callable[..., Answer], *words: str, formats: tuple[str, ...] = ("json", "html")) -> Response:
        """Answer by a function of pygeoapi, as JSON, as a page, or as CSV."""
        asked = format_of(formats)
        state, api = town.now()
        if "bbox" in request.args:
            g.window = town.window(*box_of(town.systems), state.bounds)
        headers, status, content = function(api, as_json(asked, api), *words)
        if asked == "csv":
            return Response(content, status, dict(headers))
        if asked == "json" and function is itemtypes.get_collection_items:
            return Response(with_own_links(str(content), state), status, dict(headers))
        document = completed(json.loads(content), state, *words)
        if asked == "json":
            return Response(json.dumps(document), status, dict(headers))
        return Response(page_of(document, town.url), status, mimetype="text/html")

    def items(name: str) -> Response:
        if "sortby" in request.args and not all(word.strip("+-") for word in request.args["sortby"].split(",")):
            msg = "sortby has an empty name; write it as sortby=-h_max,uid."
            raise BadRequest(msg)
        if request.args.get("f") == "csv" and "skipGeometry" in request.args:
            msg = "CSV has the outlines of the features. Leave out skipGeometry, or ask for f=json."
            raise BadRequest(msg)
        return answer(itemtypes.get_collection_items, name, formats=("json", "html", "csv"))

    def tile(name: str, scheme: str, z: str, y: str, x: str) -> Response:
        if request.args.get("f", FORMAT["name"]) != FORMAT["name"]:
            msg = "Tiles are Mapbox Vector Tiles; ask for f=mvt."
            raise BadRequest(msg)
        state, api = town.now()
        g.window = town.window([*box_of_tile(scheme, z, y, x)], EPSG.format(3857), state.bounds)
        g.days = request.args.get("datetime")
        _, status, content = tiles.get_collection_tiles_data(api, as_json("mvt", api), name, scheme, z, y, x)
        if status == HTTPStatus.NO_CONTENT:
            return Response(status=status)
        return Response(content, status, mimetype=FORMAT["mimetype"] if status == HTTPStatus.OK else "application/json")

    def page() -> Response:
        try:
            return Response(town.page(), mimetype="text/html")
        except DatabaseError:
            raise
        except MsbdbError as error:
            raise NotFound(str(error)) from error

    one = "/collections/<name>"
    views: dict[str, Callable[..., Response]] = {
        "/": partial(answer, core.landing_page),
        "/conformance": partial(answer, core.conformance),
        "/openapi": partial(answer, openapi_of),
        "/collections": partial(answer, core.describe_collections),
        one: lambda name: answer(core.describe_collections, name),
        f"{one}/schema": lambda name: answer(core.get_collection_schema, name),
        f"{one}/queryables": lambda name: answer(itemtypes.get_collection_queryables, name),
        f"{one}/items": items,
        f"{one}/items/<key>": lambda name, key: answer(itemtypes.get_collection_item, name, key),
        f"{one}/tiles": lambda name: answer(tiles.get_collection_tiles, name),
        f"{one}/tiles/<scheme>": lambda name, scheme: answer(
            tiles.get_collection_tiles_metadata, name, require_scheme(scheme)
        ),
        f"{one}/tiles/<scheme>/<z>/<y>/<x>": tile,
        "/TileMatrixSets": partial(answer, tiles.tilematrixsets),
        "/TileMatrixSets/<scheme>": lambda scheme: answer(tiles.tilematrixset, require_scheme(scheme)),
        "/page": page,
    }
    for path, view in views.items():
        app.add_url_rule(path, path, view, methods=["GET"])
    app.after_request(guarded_answer)
    app.register_error_handler(HTTPException, refused)
    app.register_error_handler(DatabaseError, failed)
    return app


def guarded_answer(response: Response) -> Response:
    """Return an answer with the headers that guard it."""
    policy = "Content-Security-Policy"
    own = request.path == "/page" and response.status_code == HTTPStatus.OK
    response.headers.update({name: value for name, value in HEADERS.items() if not (own and name == policy)})
    logger.info("%s %s: %d", request.method, request.path, response.status_code)
    return response


def refused(error: HTTPException) -> Response:
    """Answer what is wrong with a request."""
    return refusal(error.code or 500, error.name, error.description or error.name)


def failed(error: DatabaseError) -> Response:
    """Answer that the database cannot be read; the reason is the operator's."""
    logger.error("%s", error)
    return refusal(503, "Service Unavailable", "The database cannot be read now. Try again later.")


def refusal(status: int, name: str, words: str) -> Response:
    """Return an error as OGC API writes it."""
    return Response(json.dumps({"code": name, "description": words}), status, mimetype="application/json")


def format_of(formats: tuple[str, ...]) -> str:
    """Return the format that a client asks for: by ``f``, else by its preference; JSON by default."""
    asked = request.args.get("f", "")
    if asked and asked not in formats:
        msg = f"The format {asked[:20]!r} is not offered here; ask for f={' or f='.join(formats)}."
        raise BadRequest(msg)
    preferred = request.accept_mimetypes.best_match(["application/json", "application/geo+json", "text/html"])
    return asked or ("html" if preferred == "text/html" else "json")


def as_json(asked: str, api: API) -> APIRequest:
    """Return the request for pygeoapi, with JSON in place of a page."""
    query = [(name, value) for name, value in request.args.items(multi=True) if name != "f"]
    query += [("f", "csv")] if asked == "csv" else []
    environ = request.environ | {"QUERY_STRING": urlencode(query), "HTTP_ACCEPT": "application/json"}
    return APIRequest.from_flask(Request(environ), api.locales)


def box_of(systems: list[str]) -> tuple[list[float], str]:
    """Return the bounds that a client asks for, two corners in the order of their CRS's axes, and its URI."""
    words, uri = request.args["bbox"].split(","), request.args.get("bbox-crs", CRS84)
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        numbers = []
    if len(numbers) == 6:
        numbers = [*numbers[:2], *numbers[3:5]]
    if len(numbers) != 4 or not all(map(math.isfinite, numbers)):
        msg = "bbox needs four numbers: west,south,east,north, in the order of the axes of bbox-crs."
        raise BadRequest(msg)
    if numbers[0] > numbers[2] or numbers[1] > numbers[3]:
        msg = "The first corner of bbox must be the lower one in both axes."
        raise BadRequest(msg)
    if uri not in systems:
        msg = f"bbox-crs must be one of {', '.join(systems)}."
        raise BadRequest(msg)
    return numbers, uri


def openapi_of(api: API, asked: APIRequest) -> Answer:
    """Return pygeoapi's description of itself by OpenAPI, with what is served here alone."""
    if not api.openapi:
        made = get_oas(api.config)
        made["paths"] = {
            path: {"get": ways["get"]} for path, ways in made["paths"].items() if not path.startswith(NOT_SERVED)
        }
        made["components"]["parameters"]["f"]["schema"]["enum"] = ["json", "html"]
        api.openapi = made
    found: Answer = core.openapi_(api, asked)
    return found


def completed(document: dict[str, Any], state: ServedState, *words: str) -> dict[str, Any]:
    """Return a document of pygeoapi with what it leaves out, and without what is not served here."""
    if "conformsTo" in document:
        document["conformsTo"] = [name for name in document["conformsTo"] if not name.endswith(NOT_READ)]
    for own in (document, *document.get("collections", ())):
        if "links" in own:
            own["links"] = [link for link in own["links"] if _is_served(link)]
        days = LAYERS[own["id"]].days if own.get("id") in LAYERS else ()
        if days and state.begin:
            own["extent"]["temporal"] = {"interval": [[f"{state.begin}T00:00:00Z", None]]}
    if "tileMatrixSets" in document:
        document["tileMatrixSets"] = [own for own in document["tileMatrixSets"] if own["id"] == SCHEME.tileMatrixSet]
        for link in document["links"]:
            link["href"] = link["href"].replace("/tileMatrixSets", "/TileMatrixSets")
    if "$schema" in document and words:
        for column in LAYERS[words[0]].columns:
            document["properties"][column.name] |= field_of(column)
    if any(link["rel"] == "service-desc" for link in document.get("links", ())):
        next(link for link in document["links"] if link["rel"] == "about")["title"] = "The page of the town in 3-D"
    return document


def with_own_links(content: str, state: ServedState) -> str:
    """Return a page of features without the links that are not served; the features, which come first, stay text."""
    features, mark, rest = content.rpartition('"links":[')
    return features + json.dumps(completed(json.loads("{" + mark + rest), state))[1:] if mark else content


def _is_served(link: Mapping[str, str]) -> bool:
    return not link["rel"].endswith(NOT_OFFERED) and link.get("type") != "application/ld+json"


def page_of(document: Mapping[str, Any], url: str) -> str:
    """Return a document as a page without scripts."""
    features = document.get("features", [document] if document.get("type") == "Feature" else ())
    steps = [word for word in request.path.split("/") if word]
    crumbs = [("/".join([url, *steps[: count + 1]]), step) for count, step in enumerate(steps)]
    layer = LAYERS.get(steps[1]) if len(steps) > 1 else None
    title = document.get("title") or (layer.title if layer else steps[-1] if steps else "msbdb")
    shown = {"document": document, "features": features, "crumbs": crumbs, "url": url, "title": title}
    return str(render_template("document.html", path=request.path, **shown))
